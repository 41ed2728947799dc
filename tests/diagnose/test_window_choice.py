"""The length of windows, by how far a simulation follows its log."""

import mujoco
import numpy as np
import pytest

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.data import MIN_TRAINING_WINDOWS, cut_data
from deepkoco.diagnose.window_choice import SHARES, followed_length, length_for_enough
from deepkoco.fit.data.windows import cut_windows, window_length
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import ExtendedSystem, load_system, make_system
from tests.fit.identify_logs import arm_log
from tests.oracle.levitated_ball import Maglev, levitated_ball
from tests.oracle.servo_unit import go1_like
from tests.oracle.servo_unit import log_of as servo_log

SHOULDER, ELBOW = "shoulder", "elbow"
LINK = """<link name="{0}"><inertial><mass value="{1}"/><origin xyz="0 0 -0.15"/>
<inertia ixx="{2}" ixy="0" ixz="0" iyy="{2}" iyz="0" izz="0.002"/></inertial></link>"""
JOINT = """<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/><origin xyz="0 0 {3}"/>
<axis xyz="0 1 0"/><limit lower="-6" upper="6" effort="40" velocity="10"/><dynamics damping="0.003"/></joint>"""


@pytest.fixture
def urdf(tmp_path):
    links = '<link name="base"/>' + LINK.format("upper", 3.0, 0.03) + LINK.format("fore", 1.5, 0.012)
    joints = JOINT.format(SHOULDER, "base", "upper", 0.5) + JOINT.format(ELBOW, "upper", "fore", -0.3)
    path = tmp_path / "arm.urdf"
    path.write_text(f'<robot name="arm">{links}{joints}</robot>')
    return path


def record(urdf, seconds, rotor, damping, dry) -> Recording:
    """The arm in MuJoCo, held up by a controller at 200 Hz, with drives of which the file says nothing."""
    spec = mujoco.MjSpec.from_file(str(urdf))
    for joint in spec.joints:
        spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        joint.armature, joint.damping = rotor, [damping, 0.0, 0.0]
    spec.joint(ELBOW).frictionloss = dry
    spec.option.timestep = 2.5e-4
    model = spec.compile()
    data, rng = mujoco.MjData(model), np.random.default_rng(5)
    phase, middle = rng.uniform(0.0, 6.0, (2, 3)), np.array([2.6, -1.2])
    data.qpos[:] = middle
    mujoco.mj_forward(model, data)
    t = 0.005 * np.arange(round(seconds / 0.005))
    rows, torques = np.zeros((len(t), 4)), np.zeros((len(t), 2))
    for k, now in enumerate(t):
        goal = middle + 0.3 * np.sin(np.array([1.7, 3.3, 5.9]) * now + phase).sum(-1)
        torques[k] = [60.0, 30.0] * (goal - data.qpos) - [6.0, 3.0] * data.qvel + data.qfrc_bias
        rows[k] = np.concatenate([data.qpos, data.qvel])
        data.ctrl[:] = torques[k]
        mujoco.mj_step(model, data, 20)
    rows += [2e-4, 2e-4, 5e-3, 5e-3] * rng.standard_normal(rows.shape)
    names = (SHOULDER, ELBOW)
    channels = {f"q_{n}": Series(t, rows[:, i], "rad", "measurement") for i, n in enumerate(names)}
    channels |= {f"dq_{n}": Series(t, rows[:, 2 + i], "rad/s", "measurement") for i, n in enumerate(names)}
    channels |= {n: Series(t, torques[:, i], "N m", "command") for i, n in enumerate(names)}
    return Recording(channels)


def test_a_simulation_that_follows_its_log_keeps_the_usual_windows():
    arm = make_system("two_link_arm")
    assert followed_length([arm_log(0)], arm) == window_length(arm)


def test_windows_are_as_short_as_a_simulation_that_runs_away_needs(urdf):
    arm = load_system(str(urdf))
    log = record(urdf, 6.0, 0.1, 1.0, 2.0)
    length = followed_length([log], arm)
    assert length in [share * window_length(arm) for share in SHARES[1:]]
    drives = {
        "armature(shoulder)": 0.1,
        "armature(elbow)": 0.1,
        "damping(shoulder)": 1.0,
        "damping(elbow)": 1.0,
    }
    told = ExtendedSystem(arm, ("coulomb(elbow)",), drives | {"coulomb(elbow).torque": 2.0})
    assert followed_length([log], told) > length


@pytest.mark.study
@pytest.mark.long
@pytest.mark.timeout(900)
def test_friction_of_an_arm_is_named_though_its_file_says_nothing_of_its_drives(urdf):
    arm = load_system(str(urdf))
    found = diagnose([record(urdf, 20.0, 0.1, 1.0, 2.0)], arm)
    assert found.window_s == pytest.approx(window_length(arm))
    assert [cause.name for cause in found.causes] == ["coulomb(elbow)"]
    size = found.causes[0].parameters["coulomb(elbow).torque"]
    assert size.low <= 2.0 <= size.high
    # The scale of all loads is known by priors alone; the ratio to what the motor delivers is known from the log.
    gain = found.to_json()["fit"]["final"]["gain(elbow)"]["value"]
    assert size.value / gain == pytest.approx(2.0, rel=0.03)


def test_an_unstable_plant_with_a_wrong_mass_gets_windows_in_which_it_does_not_run_away():
    system = Maglev()
    right, wrong = (followed_length([levitated_ball(mass)], system) for mass in (0.065, 0.075))
    assert wrong < min(right, SHARES[-1] * window_length(system))


def test_healthy_logs_lengthen_windows_only_where_their_simulation_does_not_run_away():
    unstable, ball = Maglev(), levitated_ball(0.065)
    assert followed_length([ball], unstable, [ball]) < 0.25 * window_length(unstable)
    servo, log = make_system("servo_pendulum"), servo_log(go1_like(), "sin_time_square", 0, 20.0)
    off = ExtendedSystem(servo, (), {"stiffness": 2.0})
    assert followed_length([log], off) < window_length(off)
    assert followed_length([log], off, [log]) == window_length(off)


@pytest.mark.study
def test_the_damping_of_an_unstable_plant_is_named_with_its_size():
    # Longer windows, in which the simulation runs away, must not take the place of those in which it was found.
    found = diagnose([levitated_ball(0.065, 6.0, drag=0.3)], Maglev())
    assert [cause.name for cause in found.causes] == ["viscous"]
    (damping,) = found.causes[0].parameters.values()
    assert damping.value == pytest.approx(0.3, rel=0.1)


def test_the_shortest_window_still_has_twenty_steps():
    log = levitated_ball(0.065, 1.0)
    for length in (0.02, 0.05, 1.0):
        windows = cut_windows([log], Maglev(), length)
        assert windows.steps >= 20
        assert windows.length == pytest.approx(length, rel=0.05)


@pytest.mark.parametrize("seconds", [20.0, 6.0])
def test_a_short_log_gets_windows_short_enough_to_fit_some_and_to_hold_some_out(seconds):
    system, unit = make_system("servo_pendulum"), go1_like()
    log = servo_log(unit, "sin_time_square", 0, seconds)
    usual = window_length(system)
    length = length_for_enough([log], system, usual)
    data = cut_data([log], (), system, length)
    assert (length == usual) == (seconds == 20.0)
    assert len(data.train) >= MIN_TRAINING_WINDOWS
    assert data.held is not None


def test_a_log_too_short_for_any_window_keeps_the_usual_length():
    system = make_system("servo_pendulum")
    log = servo_log(go1_like(), "sin_sin", 0, 0.4)
    assert length_for_enough([log], system, window_length(system)) == window_length(system)


def test_windows_of_a_log_without_speeds_are_as_short_as_those_with_them():
    # The speed of the servo pendulum is a channel that benches of servos do not log.
    system = make_system("servo_pendulum")
    far = ExtendedSystem(system, (), {"stiffness": 1.0, "inertia": 0.1, "viscous": 0.0, "damping": 0.0})
    log = servo_log(go1_like(), "sin_time_square", 0, 20.0)
    assert log.names("measurement") == ("theta",)
    assert followed_length([log], far) < followed_length([log], system)
