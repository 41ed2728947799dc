"""Physics of the unit against closed forms, SciPy and the sign of every hidden effect."""

import math
import statistics

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from deepkoco.systems import make_system, rk4_step
from deepkoco.systems.effects import EFFECTS
from deepkoco.unit import make_unit
from deepkoco.unit.plant import Plant
from deepkoco.unit.spec import UnitSpec
from deepkoco.unit.unit_file import CARRIED

QUIET = {"rate_hz": 100.0, "noise_sd": {"theta": 0.0, "omega": 0.0}}


def unit(system="rod_pendulum", state=(0.0, 0.0), **effects) -> UnitSpec:
    return make_unit(system, effects=effects, sensor=QUIET, initial_state=state, heartbeat=60.0)


def swing(spec: UnitSpec, command=0.0, seconds=1.0) -> Plant:
    plant = Plant(spec)
    plant.send(command)
    plant.advance(seconds)
    return plant


def read(plant: Plant) -> tuple[float, ...]:
    plant.sample(0)
    plant.advance(plant.time + 1.0)
    return plant.take()[0][1]


def scipy_rod(torque, theta, omega, seconds):
    """theta'' = 15 sin(theta) + 3 torque, written out for g = 10, m = l = 1."""

    def slope(t, x):
        return [x[1], 15.0 * math.sin(x[0]) + 3.0 * torque(t, *x)]

    return solve_ivp(slope, (0.0, seconds), (theta, omega), rtol=1e-11, atol=1e-12).y[:, -1]


def test_small_oscillation_has_the_closed_form_period():
    # rod about hanging: omega_n^2 = 3 g / (2 l) = 15; theta = pi + a cos(omega_n t), a = 1e-3
    plant = Plant(unit(state=(math.pi + 1e-3, 0.0)))
    for k in range(1, 400):
        plant.advance(k * 0.01)
        expected = 1e-3 * math.cos(math.sqrt(15.0) * k * 0.01)
        assert plant.joint.theta - math.pi == pytest.approx(expected, abs=2e-8)


def test_free_swing_keeps_its_energy():
    plant = Plant(unit(state=(0.1, 0.0)))
    energies = []
    for k in range(1, 3001):
        plant.advance(k * 0.01)
        energies.append(plant.joint.omega**2 / 6.0 + 5.0 * math.cos(plant.joint.theta))
    assert max(energies) - min(energies) < 1e-6


def test_driven_rod_agrees_with_scipy():
    plant = Plant(unit(state=(2.0, 1.0)))
    plant.send(1.5)
    plant.advance(2.0)
    theta, omega = scipy_rod(lambda t, th, om: 1.5, 2.0, 1.0, 2.0)
    assert (plant.joint.theta, plant.joint.omega) == pytest.approx((theta, omega), abs=1e-7)


def test_lag_and_drag_agree_with_scipy():
    plant = swing(unit(state=(3.0, 0.0), lag={"time_constant": 0.05}, quadratic={"drag": 0.1}), 2.0, 1.5)

    def torque(t, theta, omega):
        return 2.0 * (1.0 - math.exp(-t / 0.05)) - 0.1 * omega * abs(omega)

    assert (plant.joint.theta, plant.joint.omega) == pytest.approx(scipy_rod(torque, 3.0, 0.0, 1.5), abs=1e-6)


def test_joint_sticks_where_gravity_stays_below_dry_friction():
    effects = {"coulomb": {"torque": 0.2}}
    inside, outside = math.asin(0.2 / 5.0) * 0.99, math.asin(0.2 / 5.0) * 1.01
    for angle, sticks in ((inside, True), (outside, False)):
        plant = Plant(unit(state=(math.pi + angle, 0.0), **effects))
        plant.advance(1.0)
        assert (plant.joint.theta == math.pi + angle) == sticks


def test_dry_friction_takes_its_torque_times_the_way():
    # From 2 rad/s at hanging: J 2^2 / 2 = F x + G (1 - cos x) at the first turning point x
    inertia, friction, gravity = 1.0 / 3.0, 0.1, 5.0
    turning = brentq(lambda x: 2.0 * inertia - friction * x - gravity * (1.0 - math.cos(x)), 0.0, 2.0)
    plant = Plant(unit(state=(math.pi, 2.0), coulomb={"torque": friction}))
    angles = []
    for k in range(1, 600):
        plant.advance(k * 1e-3)
        angles.append(plant.joint.theta - math.pi)
    assert max(angles) == pytest.approx(turning, abs=1e-6)


def test_swing_comes_to_rest_within_the_sticking_band():
    plant = Plant(unit(state=(2.0, 0.0), coulomb={"torque": 0.3}))
    plant.advance(30.0)
    assert plant.joint.omega == 0.0
    assert 5.0 * abs(math.sin(plant.joint.theta)) <= 0.3


def test_sharp_friction_is_the_limit_of_smooth_friction():
    effects = {"stribeck": {"coulomb": 0.2, "breakaway": 0.2, "speed": 0.5}}
    sharp = swing(
        make_unit("rod_pendulum", effects=effects, initial_state=(2.0, 0.0), heartbeat=60), 0.0, 1.7
    )
    smooth = swing(
        make_unit(
            "rod_pendulum", effects=effects, initial_state=(2.0, 0.0), friction_smoothing=1e-3, heartbeat=60
        ),
        0.0,
        1.7,
    )
    assert sharp.joint.theta == pytest.approx(smooth.joint.theta, abs=2e-3)


@pytest.mark.parametrize("system", ["rod_pendulum", "torque_pendulum", "pendulum"])
def test_plain_unit_agrees_with_the_simulator(system):
    simulator = make_system(system)
    smoothing = 0.1 if system == "pendulum" else 0.0  # as the simulator smooths its own Coulomb term
    spec = make_unit(
        system, sensor=QUIET, initial_state=(2.5, 0.5), friction_smoothing=smoothing, heartbeat=60
    )
    plant = swing(spec, 1.0, 1.0)
    parameters = simulator.default_parameters()
    state = parameters["viscous"].new_tensor([2.5, 0.5])
    for _ in range(1000):
        state = rk4_step(simulator, state, parameters["viscous"].new_tensor(1.0), 1e-3, parameters)
    assert (plant.joint.theta, plant.joint.omega) == pytest.approx(tuple(state.tolist()), abs=1e-6)


@pytest.mark.parametrize("system", ["rod_pendulum", "torque_pendulum", "pendulum"])
def test_null_effects_change_nothing(system):
    nulls = {
        name: {p.name: p.value for p in effect.parameters(make_system(system))}
        for name, effect in EFFECTS.items()
        if name in CARRIED and name != "cogging"
    }
    plain, null = (make_unit(system, effects=e, initial_state=(2.5, 0.5), heartbeat=60) for e in ({}, nulls))
    a, b = swing(plain, 1.0), swing(null, 1.0)
    assert (a.joint.theta, a.joint.omega) == (b.joint.theta, b.joint.omega)
    assert read(a) == read(b)


def test_command_acts_exactly_one_delay_later():
    plant = Plant(unit(state=(math.pi, 0.0), actuation_delay={"delay": 0.0375}))
    plant.advance(0.01)
    plant.send(1.0)
    plant.advance(0.0475)
    assert abs(plant.joint.omega) < 1e-12
    plant.advance(0.0575)  # 10 ms of theta'' = 3 rad/s2, gravity still negligible
    assert plant.joint.omega == pytest.approx(0.03, rel=1e-3)


def test_measurement_shows_the_state_one_delay_ago():
    plant = Plant(unit(state=(1.0, 0.0), sensing_delay={"delay": 0.025}))
    plant.advance(0.1)
    then = (plant.joint.theta, plant.joint.omega)
    plant.sample(7)
    plant.advance(0.1249)
    assert plant.take() == []
    plant.advance(0.125)
    assert plant.take() == [(7, then)]


@given(sd=st.floats(0.0, 0.05), seed=st.integers(0, 1000))
@settings(max_examples=30, deadline=None)
def test_messages_arrive_once_in_order_and_never_early(sd, seed):
    law = {"delay": {"mean": 0.02, "sd": sd}}
    spec = make_unit("rod_pendulum", effects={"sensing_delay": law}, seed=seed)
    plant, seen = Plant(spec), []
    for k in range(60):
        plant.advance(k * 0.01)
        plant.sample(k)
        for seq, _ in plant.take():
            assert seq * 0.01 <= plant.time
            seen.append(seq)
    plant.advance(plant.time + 1.0)
    seen += [seq for seq, _ in plant.take()]
    assert seen == list(range(60))


def test_heartbeat_sets_the_command_to_zero():
    plant = Plant(make_unit("rod_pendulum", heartbeat=0.2))
    plant.advance(1.0)  # before the first command nothing is missed
    plant.send(2.0)
    plant.advance(1.19)
    assert (plant.command, plant.stops) == (2.0, 0)
    plant.advance(1.21)
    assert (plant.command, plant.stops) == (0.0, 1)
    plant.advance(3.0)
    assert plant.stops == 1


@pytest.mark.parametrize("command", [math.nan, math.inf, -math.inf])
def test_a_command_that_is_not_finite_stops_the_unit_and_is_counted(command):
    plant = swing(unit(), 0.4, 0.1)
    plant.send(command)
    plant.advance(0.2)
    assert (plant.command, plant.stops) == (0.0, 1)
    assert math.isfinite(plant.joint.theta + plant.joint.omega)
    plant.send(0.3)
    plant.advance(0.21)
    assert (plant.command, plant.stops) == (0.3, 1)


def test_commands_are_cut_to_the_limits():
    plant = swing(unit(), 99.0, 0.1)
    assert plant.command == 2.0


# What each effect does after 0.2 s from hanging at rest under 1 N m, against the unit without it.
@pytest.mark.parametrize(
    ("effect", "values", "sign"),
    [
        ("actuation_delay", {"delay": 0.05}, -1),
        ("lag", {"time_constant": 0.05}, -1),
        ("viscous", {"change": 0.1}, -1),
        ("coulomb", {"torque": 0.1}, -1),
        ("stribeck", {"coulomb": 0.0, "breakaway": 0.2, "speed": 1.0}, -1),
        ("quadratic", {"drag": 0.1}, -1),
        ("gain", {"factor": 1.2}, 1),
        ("gain_curve", {"curvature": -0.1}, -1),
        ("lost_commands", {"share": 1.0}, -1),
        ("torque_bias", {"effort": 0.1}, 1),
        ("dead_zone", {"width": 0.1}, -1),
        ("saturation", {"limit": 0.8}, -1),
        ("payload", {"mass": 0.2}, -1),
        ("event", {"torque": 0.2, "start": 0.1, "duration": 0.05}, 1),
    ],
)
def test_effect_moves_the_unit_the_right_way(effect, values, sign):
    start = (math.pi, 0.0)
    plain, changed = (swing(unit(state=start, **e), 1.0, 0.2) for e in ({}, {effect: values}))
    assert sign * (changed.joint.theta - plain.joint.theta) > 1e-4


def test_a_lost_command_leaves_the_one_before_and_follows_from_the_seed():
    def held(seed):
        plant = Plant(make_unit("rod_pendulum", effects={"lost_commands": {"share": 0.3}}, seed=seed))
        acted = []
        for k in range(400):
            plant.send(0.001 * (k + 1))
            plant.advance(0.01 * (k + 1))
            acted.append(round(1000 * plant.command))
        return acted

    acted = held(1)
    assert all(a == k + 1 or a == (acted[k - 1] if k else 0) for k, a in enumerate(acted))
    assert sum(a != k + 1 for k, a in enumerate(acted)) == pytest.approx(120, abs=40)
    assert acted == held(1)
    assert acted != held(2)


def test_sensor_effects_change_the_reading_and_not_the_motion():
    plain = swing(unit(state=(1.0, 0.5)))
    changed = swing(unit(state=(1.0, 0.5), sensor_bias={"angle": 0.1}, sensor_scale={"factor": 1.1}))
    assert changed.joint.theta == plain.joint.theta
    theta, omega = plain.joint.theta, plain.joint.omega
    assert read(changed) == pytest.approx((1.1 * theta + 0.1, 1.1 * omega))


def test_payload_is_a_point_mass_at_the_tip():
    # rod 1 kg + 0.5 kg at 1 m: omega_n^2 = (0.5 + 0.5) g / (1/3 + 0.5) = 12
    plant = Plant(unit(state=(math.pi + 1e-3, 0.0), payload={"mass": 0.5}))
    plant.advance(math.pi / math.sqrt(12.0))
    assert plant.joint.theta - math.pi == pytest.approx(-1e-3, abs=1e-8)


def test_noise_has_the_stated_size_and_its_own_seed():
    def readings(seed, stream=0):
        plant = Plant(make_unit("rod_pendulum", seed=seed), stream=stream)
        for k in range(2000):
            plant.sample(k)
            plant.advance(plant.time + 1e-3)
        return [values for _, values in plant.take()]

    first = readings(1)
    theta, omega = zip(*first, strict=True)
    assert statistics.pstdev(theta) == pytest.approx(0.002, rel=0.1)
    assert statistics.pstdev(omega) == pytest.approx(0.05, rel=0.1)
    assert first == readings(1)
    assert first != readings(2)
    assert first != readings(1, stream=1)


def test_quantised_readings_lie_on_the_grid():
    spec = make_unit("rod_pendulum", sensor={"quantisation": {"theta": 0.01}}, initial_state=(1.0, 2.0))
    theta, omega = read(Plant(spec))
    assert theta / 0.01 == pytest.approx(round(theta / 0.01))
    assert omega / 0.01 != pytest.approx(round(omega / 0.01), abs=1e-6)


def test_advancing_in_pieces_is_advancing_at_once():
    spec = unit(
        state=(2.0, 0.0), coulomb={"torque": 0.1}, event={"torque": 1.0, "start": 0.3, "duration": 0.1}
    )
    once, pieces = swing(spec, 1.0, 1.0), Plant(spec)
    pieces.send(1.0)
    for t in np.sort(np.random.default_rng(0).uniform(0.0, 1.0, 200)):
        pieces.advance(float(t))
    pieces.advance(1.0)
    assert pieces.joint.theta == pytest.approx(once.joint.theta, abs=1e-7)
