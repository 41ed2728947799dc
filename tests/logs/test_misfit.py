"""`deepkoco inspect` without a system: it names one that can have made the log, or says that none can."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

from deepkoco.cli.command_line import main
from deepkoco.excitation.record import record
from deepkoco.logs.formats import open_log
from deepkoco.logs.inspect import NoProposalError, propose, survey_log
from deepkoco.unit import make_unit

T = np.arange(0.0, 12.0, 0.01)


def cart_pole() -> dict[str, np.ndarray]:
    """Position of the cart [m], angle of the pole [rad], their speeds, and the force [N]."""
    kicks = np.random.default_rng(0).uniform(-4, 4, 200)

    def force(t: float, state: np.ndarray) -> float:
        return kicks[int(t / 0.1)] - 2.0 * state[0] - state[2]

    def law(t: float, state: np.ndarray) -> list[float]:
        _, angle, v, w = state
        sine, cosine = np.sin(angle), np.cos(angle)
        a = (force(t, state) + 0.2 * sine * (0.4 * w * w + 9.81 * cosine)) / (0.6 + 0.2 * sine**2)
        return [v, w, a, (-a * cosine - 9.81 * sine) / 0.4 - 0.1 * w]

    y = solve_ivp(law, (0.0, 12.0), [0.0, 0.4, 0.0, 0.0], t_eval=T, max_step=0.01).y
    return {
        "x": y[0],
        "theta": y[1],
        "vx": y[2],
        "omega": y[3],
        "force": np.array([force(*a) for a in zip(T, y.T, strict=True)]),
    }


def motor() -> dict[str, np.ndarray]:
    """A motor that turns freely: angle [rad], speed [rad/s], voltage [V]."""
    voltage = np.repeat(np.random.default_rng(1).uniform(-12, 12, 24), 50)
    speed = np.zeros(len(T))
    for k in range(len(T) - 1):
        speed[k + 1] = speed[k] + 0.01 * (16.0 * voltage[k] - 8.0 * speed[k])
    return {"theta": np.append(0.0, np.cumsum(0.01 * speed[:-1])), "omega": speed, "voltage": voltage}


def survey(path, columns, **rename):
    pd.DataFrame({"t": T, **columns}).rename(columns=rename).to_csv(path, index=False)
    return survey_log(open_log(path))


CART = {
    "x": "cart_position",
    "theta": "pole_angle",
    "vx": "cart_velocity",
    "omega": "pole_rate",
    "force": "motor_force",
}


@pytest.mark.parametrize(
    ("kept", "rename", "reason"),
    [
        (("x", "theta", "vx", "omega", "force"), {}, 'it has no joint for "theta", "omega"'),
        (("x", "theta", "vx", "omega", "force"), CART, 'it has no joint for "pole_angle", "pole_rate"'),
        (("x", "theta", "force"), {}, 'it has no joint for "theta"'),
        (("x", "vx", "force"), {}, "gravity accelerates the joint"),
    ],
)
def test_no_known_system_is_a_cart_pole(tmp_path, kept, rename, reason):
    columns = {name: value for name, value in cart_pole().items() if name in kept}
    with pytest.raises(NoProposalError, match="none of the known systems fits this log") as caught:
        propose(survey(tmp_path / "a.csv", columns, **rename))
    assert reason in str(caught.value)
    assert "--system my_robot.py:CLASS, arm.xml" in str(caught.value)


@pytest.mark.parametrize("rename", [{}, {"voltage": "u"}])
def test_no_known_system_is_a_motor_without_gravity(tmp_path, rename):
    with pytest.raises(
        NoProposalError, match=r"none of the known systems fits .* gravity accelerates the joint"
    ):
        propose(survey(tmp_path / "a.csv", motor(), **rename))


def test_a_position_that_ignores_a_goal_is_no_servo(tmp_path):
    columns = {"goal": np.sin(T), "position": np.sin(7.3 * T + 1.0)}
    fitting = propose(survey(tmp_path / "a.csv", columns), "servo_pendulum")
    assert fitting.doubt == '"position" does not follow "goal" as behind a servo'


@pytest.mark.parametrize("name", ["pendulum", "rod_pendulum", "torque_pendulum"])
@pytest.mark.parametrize("excitation", ["prbs", "chirp"])
def test_a_system_fits_its_own_logs(tmp_path, name, excitation):
    log = record(make_unit(name, seed=2), excitation, 10.0, clock="simulated", seed=2)
    columns = {n: s.hold(log.channels["theta"].t) for n, s in log.channels.items()}
    path = tmp_path / "a.csv"
    pd.DataFrame({"t": log.channels["theta"].t, **columns}).to_csv(path, index=False)
    found = survey_log(open_log(path))
    assert propose(found, name).doubt is None
    fitting = propose(found)
    assert name in (fitting.proposal.system, *fitting.alike)


def test_inspect_prints_that_none_fits(tmp_path, capsys):
    path = tmp_path / "cart.csv"
    survey(path, cart_pole())
    assert main(["inspect", str(path)]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "none of the known systems fits this log" in text
    assert "sure (" not in text
    assert main(["inspect", str(path), "--system", "quadrotor_height"]) == 0
    assert 'quadrotor_height does not fit this log: it has no joint for "theta"' in " ".join(
        capsys.readouterr().out.split()
    )
