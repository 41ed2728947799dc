"""Study: a real Dynamixel XL330 on a pendulum of known mass; its servo gain is found in a log against healthy logs.

python -m experiments.studies.diagnosis.servo_bench --data FOLDER [--held sin_sin] [--effects 0]

Healthy are the logs at gain 100; diagnosed are a log at gain 200 and, as a control, a log at gain 100 that the healthy
ones leave out. FOLDER holds kp100_*.csv and kp200_*.csv with t, position, goal_position, torque_enable. The supply
voltage of each second is the same within 1 % (the readings of a millisecond are not: pulses), so it is no input.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from deepkoco.diagnose import Diagnosis, diagnose
from deepkoco.diagnose.healthy import LARGEST_EXTENSION, learn_baseline
from deepkoco.diagnose.progress import silent
from deepkoco.diagnose.report.text import headline
from deepkoco.logs.recording import Recording, read_log
from deepkoco.systems import drawing
from deepkoco.systems.channel import Channel
from deepkoco.systems.dry_friction import DryFriction, Levels
from deepkoco.systems.gear_friction import gear_friction_of, gear_friction_parameters
from deepkoco.systems.joint import angle_channel
from deepkoco.systems.motion import Acceleration, Delivery, InverseInertia, Motion
from deepkoco.systems.parameter import Parameter, Parameters
from deepkoco.systems.servo import Servo
from deepkoco.systems.system import System

MASS, LENGTH, GRAVITY, VOLTS = 0.49, 0.1, 9.81, 7.3
# The drive's own reading of its load is this share of the voltage in all eight logs; a turn has 4096 ticks.
SHARE_PER_GAIN = 4096 / (2 * np.pi) / 256 / 1000  # of the full voltage, per rad and unit of the gain
MOTIONS = ("sin_sin", "sin_time_square", "up_and_down", "lift_and_drop")


class Xl330Bench(System):
    """(m l^2 + J) theta'' = servo(q) - m g l sin(theta + z) - b theta' - friction of the gear, theta = 0 hanging."""

    name, joints = "xl330_bench", 1
    mass = MASS
    state_names, state_units = ("theta", "omega"), ("rad", "rad/s")

    def __init__(self) -> None:
        self.parameters = (
            Parameter("servo_gain", 100.0, "1", 10.0, 1000.0, 0.1, "k, a setting that the drive tells"),
            # Data sheet: 0.52 N m and 1.47 A at 5 V and standstill.
            Parameter("torque_constant", 0.35, "N m/A", 0.05, 2.0, 0.1, "K, behind the gear"),
            Parameter("resistance", 3.4, "ohm", 0.3, 20.0, 1.0, "R, of the motor"),
            Parameter("armature", 1e-3, "kg m2", 1e-6, 0.02, 1e-3, "J, behind the gear"),
            Parameter("viscous", 0.01, "N m s/rad", 0.0, 0.5, 0.01, "b"),
            # The drive compares the goal with its own encoder: a zero of it acts as a turned direction of gravity.
            Parameter("zero", 0.0, "rad", -0.2, 0.2, 0.02, "z, of the encoder against hanging"),
            *gear_friction_parameters(0.02, 0.8),
        )
        self.measurements = (angle_channel(0.0005),)

    @property
    def commands(self) -> tuple[Channel, ...]:
        return (
            Channel("goal", "rad", "command", -3.2, 3.2, description="goal of the servo"),
            Channel("enable", "1", "command", 0.0, 1.0, description="1 while on", default=1.0),
        )

    @property
    def command_joints(self) -> tuple[int, ...]:
        return (0,)

    @property
    def measured_states(self) -> tuple[int, ...]:
        return (0,)

    @property
    def load_scale(self) -> float:
        return self.mass * GRAVITY * LENGTH

    def ideal_measurement(self, state: Tensor) -> Tensor:
        return state[..., :1]

    @property
    def delivered_scales(self) -> tuple[tuple[float, str], ...]:
        return ((self.load_scale, "N m"),)

    def delivery(self, parameters: Parameters) -> Delivery:
        constant = parameters["torque_constant"]
        per_volt = constant / parameters["resistance"]
        stall = VOLTS * per_volt
        stiffness = SHARE_PER_GAIN * parameters["servo_gain"] * stall
        servo = Servo(stiffness, 0.0, stall, constant * per_volt)

        def deliver(motion: Motion) -> tuple[Tensor, ...]:
            goal, enable = motion.efforts
            return (servo.torque(goal, motion.angles[0], motion.speeds[0], enable),)

        return deliver

    def _weight(self, motion: Motion, parameters: Parameters) -> Tensor:
        mass = self.mass + parameters.get("payload", 0.0)
        return -mass * GRAVITY * LENGTH * torch.sin(motion.angles[0] + parameters["zero"])

    def accelerations(self, parameters: Parameters) -> Acceleration:
        p, deliver, friction = parameters, self.delivery(parameters), gear_friction_of(parameters)
        inertia = (self.mass + p.get("payload", 0.0)) * LENGTH**2 + p["armature"]

        def acceleration(motion: Motion) -> tuple[Tensor, ...]:
            motor, weight, speed = deliver(motion)[0], self._weight(motion, p), motion.speeds[0]
            torque = motor + weight - p["viscous"] * speed
            if motion.smoothing is not None and not bool(torch.isinf(motion.smoothing[0]).all()):
                level = friction.level(motor, weight, speed)
                torque = torque - level * torch.tanh(speed / motion.smoothing[0])
            if motion.loads is not None and motion.loads[0] is not None:
                torque = torque + motion.loads[0]
            return (torque / inertia,)

        return acceleration

    def inverse_inertia(self, parameters: Parameters) -> InverseInertia:
        inverse = 1.0 / ((self.mass + parameters.get("payload", 0.0)) * LENGTH**2 + parameters["armature"])
        return lambda motion: ((inverse,),)

    def dry_friction_limits(self, parameters: Parameters) -> tuple[Tensor, ...]:
        return (parameters["dry_friction"],)

    def dry_friction_levels(self, parameters: Parameters) -> DryFriction:
        deliver, friction = self.delivery(parameters), gear_friction_of(parameters)

        def levels(motion: Motion, steady: Levels) -> Levels:
            return (friction.level(deliver(motion)[0], self._weight(motion, parameters), motion.speeds[0]),)

        return DryFriction((parameters["dry_friction"],), (0,), levels)

    def derivative(self, state: Tensor, effort: Tensor, parameters: Parameters) -> Tensor:
        theta, omega = state.unbind(-1)
        smooth = (torch.full_like(omega, self.smoothing_speeds[0]),)
        motion = Motion((theta,), (omega,), tuple(effort.unbind(-1)), smoothing=smooth)
        return torch.stack(torch.broadcast_tensors(omega, *self.accelerations(parameters)(motion)), -1)

    def with_payload(self, mass: Tensor, parameters: Parameters) -> Parameters:
        return {**parameters, "payload": mass}

    def draw_on(
        self, image: np.ndarray, measurement: np.ndarray, command: np.ndarray | float | None = None
    ) -> None:
        drawing.draw_point_mass(image, float(measurement[0]) - np.pi)


def read(folder: Path, gain: int, motion: str) -> Recording:
    """One log of the bench."""
    columns = {
        "goal": ("goal_position", "rad", "command"),
        "enable": ("torque_enable", "1", "command"),
        "theta": ("position", "rad", "measurement"),
    }
    channels = {name: dict(zip(("column", "unit", "kind"), c, strict=True)) for name, c in columns.items()}
    mapping = {"time": {"column": "t", "unit": "s"}, "channels": channels}
    return read_log(folder / f"kp{gain}_{motion}.csv", mapping, allow_constant_command=True)


def summary(result: Diagnosis) -> dict:
    """Headline, causes and residuals."""
    return {
        "verdict": result.verdict,
        "headline": headline(result),
        "causes": [
            {
                "class": list(c.members),
                "given": c.given,
                "parameters": {n: [e.value, e.low, e.high] for n, e in c.parameters.items()},
            }
            for c in result.causes
        ],
        "chi2": [result.chi2_before, result.chi2_after],
        "doubts": result.unexplained.get("doubts", []),
        "best": [[c.name, round(c.delta_bic, 1)] for c in result.candidates[:5]],
        "healthy_effects": (result.data.get("healthy") or {}).get("effects"),
        "refit": {n: e.value for n, e in result.refit.items()},
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--held", choices=MOTIONS, default="sin_sin", help="motion of the diagnosed logs")
    parser.add_argument("--gains", type=int, nargs="+", default=[200, 100])
    parser.add_argument("--window", type=float, default=1.0, help="length of a window [s]")
    parser.add_argument("--effects", type=int, default=LARGEST_EXTENSION, help="most effects of healthy logs")
    parser.add_argument("--progress", action="store_true", help="print each step with its processor time")
    args = parser.parse_args()
    progress = _say if args.progress else silent
    healthy = [read(args.data, 100, motion) for motion in MOTIONS if motion != args.held]
    system = Xl330Bench()
    began = time.process_time()
    baseline = learn_baseline(healthy, system, args.window, progress, args.effects)
    learned = round(time.process_time() - began, 1)
    for gain in args.gains:
        log = read(args.data, gain, args.held)
        result = diagnose([log], system, baseline=baseline, window=args.window, progress=progress)
        seconds = {"learned": learned, "so_far": round(time.process_time() - began, 1)}
        print(
            json.dumps({"gain": gain, "motion": args.held, **summary(result), "cpu_s": seconds}, indent=1),
            flush=True,
        )


def _say(step: str) -> None:
    sys.stderr.write(f"{time.process_time():8.1f} s  {step}\n")


if __name__ == "__main__":
    main()
