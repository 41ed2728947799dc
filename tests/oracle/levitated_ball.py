"""A ball below a magnet in closed loop, as a unit of its own and as a class that its user writes."""

import numpy as np

from deepkoco import Channel, Parameter, System
from deepkoco.logs.recording import Recording, Series


def levitated_ball(mass: float, seconds: float = 4.0, drag: float = 0.0) -> Recording:
    """A ball that a controller holds below a magnet, at 1 kHz: it falls twice as far every 16 ms on its own.

    Args:
        mass: Of the ball [kg].
        seconds: Length of the log [s].
        drag: Damping by eddy currents [N s/m].
    """
    rng, step, parts = np.random.default_rng(3), 1e-3, 20
    t = step * np.arange(round(seconds / step))
    gap, speed, before, rate, integral, rows = 0.01, 0.0, 0.01, 0.0, 0.0, np.zeros((len(t), 2))
    for k, now in enumerate(t):
        seen = gap + 6e-6 * rng.standard_normal()
        rate, before = rate + 0.3 * ((seen - before) / step - rate), seen
        error = seen - 0.01 - 5e-4 * (np.sin(3.0 * now) + np.sin(11.0 * now))
        integral += step * error
        current = 0.99 + 350.0 * error + 9.0 * rate + 800.0 * integral
        rows[k] = seen, current
        for _ in range(parts):
            speed += step / parts * (9.81 - (6.5e-5 * current**2 / gap**2 + drag * speed) / mass)
            gap += step / parts * speed
    return Recording(
        {"gap": Series(t, rows[:, 0], "m", "measurement"), "current": Series(t, rows[:, 1], "A", "command")}
    )


class Maglev(System):
    joint_units = "m"
    parameters = (
        Parameter("mass", 0.065, "kg", 0.01, 0.5, 0.001, "of the ball"),
        Parameter(
            "magnet", 6.5e-5, "N m2/A2", 1e-5, 1e-3, 4e-6, "force times squared gap per squared current"
        ),
    )
    commands = (Channel("current", "A", "command", 0.0, 4.0),)
    measurements = (Channel("gap", "m", "measurement", noise_sd=1e-5),)

    def accelerations(self, p):
        def law(motion):
            pull = p["magnet"] * motion.efforts[0] ** 2 / motion.angles[0] ** 2
            return ((p["mass"] * 9.81 - pull + motion.load(0)) / p["mass"],)

        return law
