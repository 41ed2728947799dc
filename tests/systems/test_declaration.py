"""A system of one's own: what may be left out has a default, what is missing or wrong is told when it is made."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco import Channel, Parameter, System
from deepkoco.systems import (
    ExtendedSystem,
    Motion,
    load_model,
    load_system,
    make_system,
    rk4_step,
    save_model,
)
from deepkoco.systems.declaration import DeclarationError
from deepkoco.systems.effects import effects_of
from tests.oracle.own_robots import CartPoleUnit, MotorUnit

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
FORCE = Channel("force", "N", "command", -5.0, 5.0)
PLACE = Channel("place", "m", "measurement", noise_sd=1e-3)
MASS = Parameter("mass", 2.0, "kg", 0.1, 10.0, 0.5, "m")


class Slider(System):
    """As little as can be declared."""

    joint_units = "m"
    parameters = (MASS,)
    commands = (FORCE,)
    measurements = (PLACE,)

    def accelerations(self, parameters):
        return lambda motion: ((motion.efforts[0] + motion.load(0)) / parameters["mass"],)


class FirstOrder(System):
    """The same by its derivative."""

    joint_units = "m"
    parameters = (MASS,)
    commands = (FORCE,)
    measurements = (PLACE,)

    def derivative(self, state, effort, parameters):
        return torch.stack(torch.broadcast_tensors(state[..., 1], effort / parameters["mass"]), -1)


def doubles(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


@pytest.mark.parametrize("kind", [Slider, FirstOrder])
def test_system_fills_in_what_a_class_leaves_out(kind):
    system = kind()
    assert system.name == {"Slider": "slider", "FirstOrder": "first_order"}[kind.__name__]
    assert (system.joints, system.state_units) == (1, ("m", "m/s"))
    assert system.measured_states == (0,)
    assert system.load_scales == pytest.approx((5.0,))
    known = effects_of(system)
    assert {"coulomb", "actuation_delay", "gain", "sensor_bias(place)"} - set(known) <= {"sensor_bias(place)"}
    assert "payload" not in known
    picture = system.draw(np.array([0.4]), np.array([2.0]), 64)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 2


@settings(max_examples=30, deadline=None)
@given(
    place=st.floats(-3, 3),
    speed=st.floats(-3, 3),
    force=st.floats(-5, 5),
    dry=st.floats(0, 2),
    mass=st.floats(0.2, 5),
)
def test_accelerations_and_derivative_of_one_system_agree_under_an_effect(place, speed, force, dry, mass):
    values = {"coulomb.torque": dry, "mass": mass}
    one, other = (ExtendedSystem(kind(), ("coulomb",), values) for kind in (Slider, FirstOrder))
    state, effort = doubles(place, speed), torch.tensor(force, dtype=torch.float64)
    first, second = (s.derivative(state, effort, s.default_parameters()) for s in (one, other))
    assert first.tolist() == pytest.approx(second.tolist(), abs=1e-12)
    expected = (force - dry * math.tanh(speed / one.smoothing_speeds[0])) / mass
    assert float(first[1]) == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_loads_act_on_the_joints_that_a_force_drives_where_only_the_derivative_is_given():
    class Voltage(FirstOrder):
        commands = (Channel("voltage", "V", "command", -5.0, 5.0),)

    assert FirstOrder().loaded_joints == (0,)
    assert Voltage().loaded_joints == ()
    assert not {"coulomb", "viscous"} & set(effects_of(Voltage()))
    assert "gain" in effects_of(Voltage())


def test_typical_loads_are_the_weight_of_a_pole_and_the_stall_torque_of_a_motor():
    cart, motor = load_system(f"{EXAMPLES}/cart_pole.py"), load_system(f"{EXAMPLES}/motor.py:Motor")
    assert cart.load_scales[0] == pytest.approx(10.0, rel=0.15)
    assert cart.load_scales[1] == pytest.approx(0.2 * 9.81 * 0.3, rel=0.02)
    assert motor.load_scales == pytest.approx((0.05 / 2.0 * 12.0,))


@pytest.mark.parametrize("turns", [1.0, 16.0])
def test_the_typical_load_of_a_servo_is_that_near_its_goal_however_far_it_may_go(turns):
    class Turntable(System):
        parameters = (Parameter("kp", 12.0, "N m/rad", 0.5, 100.0, 1.0, "servo"),)
        joint_units = ("rad",)
        commands = (Channel("goal", "rad", "command", -6.3 * turns, 6.3 * turns),)
        measurements = (Channel("angle", "rad", "measurement", noise_sd=1e-3, angle=True),)

        def accelerations(self, p):
            return lambda s: ((p["kp"] * (s.efforts[0] - s.angles[0]) - s.speeds[0] + s.load(0)) / 0.03,)

    assert Turntable().load_scales == pytest.approx((12.0 * 0.2,))


def test_the_typical_load_of_a_joint_on_a_spring_is_near_what_its_actuator_delivers():
    """A voice coil of 6 N moves a stage on flexures of 3000 N/m by 2 mm, and not by half a metre."""

    class Coil(System):
        parameters = (Parameter("stiffness", 3000.0, "N/m", 100.0, 5e4, 150.0, "flexures"),)
        joint_units = ("m",)
        commands = (Channel("current", "A", "command", -1.0, 1.0),)
        measurements = (Channel("position", "m", "measurement", noise_sd=3e-7),)

        def accelerations(self, p):
            return lambda s: (
                (6.0 * s.efforts[0] - p["stiffness"] * s.angles[0] - s.speeds[0] + s.load(0)) / 0.3,
            )

    assert 6.0 <= Coil().load_scales[0] <= 12.0


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("cart_pole.py:CartPole", CartPoleUnit()),
        ("motor.py:Motor", MotorUnit()),
        ("motor.py:BeltMotor", MotorUnit(stiffness=0.6)),
    ],
)
def test_examples_have_thirty_lines_and_move_as_units_that_share_no_code_with_them(text, unit):
    system = load_system(f"{EXAMPLES}/{text}")
    source = (EXAMPLES / text.split(":")[0]).read_text().split(f"class {text.split(':')[1]}(")[1]
    assert len(source.split("\n\n\n")[0].strip().splitlines()) <= 31  # without the docstring 30
    rng = np.random.default_rng(1)
    for _ in range(5):
        state, effort = rng.uniform(-2.0, 2.0, 2 * system.joints), float(rng.uniform(-4.0, 4.0))
        slope = system.derivative(torch.from_numpy(state), doubles(effort)[0], system.default_parameters())
        assert slope.tolist() == pytest.approx(unit._slope(state, effort).tolist(), rel=1e-9)


def test_example_round_trips_through_a_model_file_with_an_effect(tmp_path):
    cart = load_system(f"{EXAMPLES}/cart_pole.py:CartPole")
    save_model(
        tmp_path / "model.yaml", ExtendedSystem(cart, ("coulomb(cart)",), {"coulomb(cart).torque": 0.7})
    )
    again = load_model(tmp_path / "model.yaml")
    assert again.joint_names == ("cart", "pole")
    state = doubles(0.0, 0.1, 0.5, -0.2)
    p = again.default_parameters()
    slower = rk4_step(again, state, doubles(1.0)[0], 0.01, p)
    assert float(slower[2]) < float(
        rk4_step(cart, state, doubles(1.0)[0], 0.01, cart.default_parameters())[2]
    )


def declared(**changes):
    """A class like Slider with some of its attributes changed; None leaves one out."""
    body = {
        n: getattr(Slider, n)
        for n in ("joint_units", "parameters", "commands", "measurements", "accelerations")
    }
    body |= changes
    return type("Mine", (System,), {n: v for n, v in body.items() if v is not None})


def law(of):
    """Accelerations from a function of parameters and motion."""
    return lambda self, parameters: lambda motion: of(parameters, motion)


SPEED, SECOND = (Channel(n, u, "measurement", noise_sd=1.0) for n, u in (("b", "m/s"), ("c", "m")))
MILLIMETRES = Channel("place", "mm", "measurement", noise_sd=1.0)
NOISELESS = Channel("place", "m", "measurement")
ENDLESS = Channel("force", "N", "command")
BRAKE = Channel("brake", "N", "command", 0.0, 1.0)
WRONG = [
    ({"joint_units": None}, r"joint_units = \(\"m\", \"rad\"\)"),
    ({"joint_units": "deg"}, "has the units deg and deg/s.* a log may use other units"),
    ({"joint_units": "K"}, "other quantities, such as a temperature or a pressure, are no joints"),
    ({"joint_names": ("a", "b")}, "a name for each of 1 joints"),
    ({"parameters": None}, "Mine lacks parameters: write parameters ="),
    ({"parameters": MASS}, "parameters is one Parameter, not a tuple: put a comma"),
    ({"parameters": (MASS, MASS)}, 'two parameters are called "mass"'),
    ({"commands": None}, "Mine lacks commands: write commands ="),
    ({"commands": ()}, "swings freely, declare a push that logs do not show"),
    ({"commands": (ENDLESS,)}, "limits of the actuator"),
    ({"commands": (FORCE, BRAKE)}, "give the index of the joint"),
    ({"commands": (SPEED,)}, 'b is among the commands, and its kind is "measurement"'),
    ({"measurements": ()}, "Mine lacks measurements"),
    ({"measurements": (NOISELESS,)}, r"place has no noise; .* noise_sd=0.001 \[m\]"),
    ({"measurements": (MILLIMETRES,)}, "place is in mm, and the state .* in m"),
    ({"measurements": (PLACE, SPEED, SECOND)}, "3 measurements, measured_states"),
    ({"measured_states": ("place",)}, "give the index of the state that each measurement shows"),
    ({"accelerations": None}, "Mine has no equations: write accelerations"),
    (
        {"accelerations": None, "derivative": lambda self, state, effort, p: state[..., :1]},
        "its derivative has the rates of 0 speeds for 1 joint; .* its derivative has 2 entries",
    ),
    (
        {"accelerations": None, "derivative": lambda self, state, effort, p: state[..., [1, 0, 1]]},
        "its derivative has the rates of 2 speeds for 1 joint; .* its derivative has 2 entries",
    ),
    ({"accelerations": law(lambda p, motion: (motion.efforts[0] / p["mas"],))}, "fail .* KeyError: 'mas'"),
    ({"accelerations": law(lambda p, motion: motion.efforts[0])}, "are Tensor; return a tuple of 1 tensors"),
    ({"accelerations": law(lambda p, motion: (motion.efforts[0] / p["mass"],))}, r"add motion\.load\(0\)"),
    ({"accelerations": law(lambda p, m: (m.efforts[0].mean() + m.load(0),))}, "alone; compute with torch"),
    ({"accelerations": law(lambda p, m: (torch.log(-m.angles[0]),))}, "is .*nan.* give a finite number"),
    ({"accelerations": law(lambda p, m: (m.efforts[0] * math.sin(m.angles[0]),))}, "a batch of 3 states"),
]


@pytest.mark.parametrize(("changes", "said"), WRONG)
def test_a_system_that_declares_too_little_or_wrong_says_what_to_write(changes, said):
    with pytest.raises(DeclarationError, match=said) as caught:
        declared(**changes)()
    assert "\n" not in str(caught.value)
    assert "Mine" in str(caught.value)


def test_motion_gives_zero_where_there_is_no_load():
    one = doubles(1.0)
    motion = Motion((one,), (one,), (one,))
    assert motion.load(0) == 0.0
    assert motion._replace(loads=(one,)).load(0) is one
    assert motion._replace(loads=(None,)).load(0) == 0.0


@pytest.mark.parametrize("name", ["pendulum", "furuta_pendulum", "servo_pendulum"])
def test_measured_states_default_to_those_of_the_same_name(name):
    system = make_system(name)
    units = [system.state_units[s] for s in system.measured_states]
    assert units == [c.unit for c in system.measurements]
