# pyright: reportAssignmentType=false, reportIncompatibleVariableOverride=false, reportIncompatibleMethodOverride=false
"""Causes that all actuators share, and one factor on all parameters of a kind."""

from dataclasses import replace

import pytest
import torch

from deepkoco.diagnose import diagnose
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.report.text import spoken
from deepkoco.fit.request import command_delays
from deepkoco.systems import (
    Channel,
    ExtendedSystem,
    MemoryEffectError,
    Motion,
    Parameter,
    System,
    make_system,
)
from deepkoco.systems.bodies.two_link_arm import TwoLinkArm
from deepkoco.systems.effects import effects_of
from tests.oracle.unit import hidden_log

ARM = make_system("two_link_arm")
ONE, BOTH = ("joint 1",), ("joint 1", "joint 2")


class TwoServos(TwoLinkArm):
    """An arm whose frictions are named by their kind."""

    joint_names = ("upper", "lower")

    def __init__(self) -> None:
        super().__init__()
        self.parameters = tuple(replace(p, name=self._kind(p.name)) for p in self.parameters)

    @staticmethod
    def _kind(name):
        return name.replace("viscous_1", "damping(upper)").replace("viscous_2", "damping(lower)")

    def accelerations(self, parameters):
        back = {"damping(upper)": "viscous_1", "damping(lower)": "viscous_2"}
        return super().accelerations({back.get(n, n): v for n, v in parameters.items()})


def of(*values):
    return torch.tensor(values, dtype=torch.float64)


def test_common_effects_exist_where_several_commands_drive():
    assert {"gain(all)", "lag(all)", "actuation_delay(all)", "gain_drift(all)"} <= set(effects_of(ARM))
    for name in ("rod_pendulum", "furuta_pendulum", "servo_pendulum"):
        assert not any("(all)" in n for n in effects_of(make_system(name)))


def test_common_gain_multiplies_every_command_and_the_gain_of_one():
    system = ExtendedSystem(
        ARM, ("gain(all)", "gain(joint 2)"), {"gain(all).factor": 0.5, "gain(joint 2).factor": 3.0}
    )
    p = system.default_parameters()
    assert torch.equal(system.actuate(of(2.0, 4.0), p), of(1.0, 6.0))
    t = of(0.0, 0.1)
    assert torch.equal(system.shape_command(0, of(2.0, 2.0)[:, None], t, p)[:, 0], of(1.0, 1.0))
    assert torch.equal(system.shape_command(1, of(2.0, 2.0)[:, None], t, p)[:, 0], of(3.0, 3.0))


def test_common_delay_adds_to_the_own_delays_and_keeps_a_timing_for_environments():
    values = {"actuation_delay(all).delay": 0.02, "lag(all).time_constant": 0.1}
    system = ExtendedSystem(ARM, ("actuation_delay(all)", "lag(all)", "actuation_delay(joint 1)"), values)
    p = system.default_parameters()
    assert float(system.timing(p).actuation_delay) == 0.02
    assert float(system.timing(p).lag) == 0.1
    p["actuation_delay(joint 1).delay"] = of(0.01)[0]
    assert float(system.command_timing(0, p).delay) == pytest.approx(0.03)
    assert float(system.command_timing(1, p).delay) == pytest.approx(0.02)
    assert [float(x) for x in system.command_timing(1, p).lag] == [0.1]
    with pytest.raises(MemoryEffectError, match="delays or lags of their own"):
        system.timing(p)


def test_crosstalk_is_a_share_of_one_effort_on_the_other_joint():
    name = "crosstalk(joint 1 to joint 2)"
    system = ExtendedSystem(ARM, (name,), {f"{name}.share": 0.1})
    p = system.default_parameters()
    angles, speeds, efforts = of(0.3, -0.4).unbind(), of(1.0, 2.0).unbind(), of(5.0, 1.0).unbind()
    found = system.accelerations(p)(Motion(angles, speeds, efforts))
    wanted = ARM.accelerations(p)(Motion(angles, speeds, efforts, (None, of(0.5)[0])))
    assert torch.allclose(torch.stack(found), torch.stack(wanted))
    assert catalogue(ARM)[name].joint == 1


def test_joints_of_a_long_arm_are_coupled_to_their_neighbours_only():
    class Snake(TwoLinkArm):
        joints = 6
        command_joints = tuple(range(6))

    pairs = System.coupled_joints.fget(object.__new__(Snake))
    assert len(pairs) == 10
    assert all(abs(a - b) == 1 for a, b in pairs)
    assert ARM.coupled_joints == ((0, 1), (1, 0))


def test_fit_frees_one_delay_per_command_and_not_the_common_one_too():
    assert command_delays(ARM) == ("actuation_delay(joint 1).delay", "actuation_delay(joint 2).delay")


def test_common_factor_scales_all_parameters_of_a_kind():
    base = TwoServos()
    system = ExtendedSystem(base, ("scaled(damping)",), {"scaled(damping).factor": 2.0})
    state, effort = of(0.3, 0.2, 1.0, -2.0), of(1.0, 0.5)
    doubled = base.default_parameters()
    doubled |= {n: 2.0 * doubled[n] for n in ("damping(upper)", "damping(lower)")}
    assert torch.allclose(
        system.derivative(state, effort, system.default_parameters()), base.derivative(state, effort, doubled)
    )
    assert "scaled(damping)" in catalogue(base)
    assert not any(n.startswith("scaled") for n in catalogue(ARM))
    assert spoken("scaled(damping)") == "common factor of all damping"


@pytest.mark.study
@pytest.mark.parametrize(
    ("kind", "joints", "values", "named"),
    [
        ("gain", BOTH, {"factor": 0.8}, "gain(all)"),
        pytest.param("gain", ONE, {"factor": 0.8}, "gain(joint 1)", marks=pytest.mark.long),
        pytest.param(
            "actuation_delay", BOTH, {"delay": 0.02}, "actuation_delay(all)", marks=pytest.mark.long
        ),
        ("actuation_delay", ONE, {"delay": 0.02}, "actuation_delay(joint 1)"),
    ],
)
def test_common_cause_wins_only_where_all_joints_have_it(kind, joints, values, named):
    hidden = {f"{kind}({joint})": values for joint in joints}
    result = diagnose([hidden_log("two_link_arm", hidden, "steps", 77, 20.0)], "two_link_arm")
    assert len(result.causes) == 1
    assert named in result.causes[0].members
    common = f"{kind}(all)"
    assert (common in result.causes[0].members) == (named == common)


class Tilted(System):
    """A ball on a beam that a servo turns to its goal; what the servo delivers is not declared."""

    joint_names, joint_units = ("ball", "beam"), ("m", "rad")
    parameters = (Parameter("bandwidth", 18.0, "rad/s", 1.0, 200.0, 1.0, "of the servo"),)
    commands = (Channel("goal", "rad", "command", -0.6, 0.6),)
    measurements = (
        Channel("ball", "m", "measurement", noise_sd=1e-3),
        Channel("beam", "rad", "measurement", noise_sd=1e-3),
    )
    command_joints = (1,)

    def accelerations(self, p):
        def law(s):
            turn = p["bandwidth"] ** 2 * (s.efforts[0] - s.angles[1]) - 2.0 * p["bandwidth"] * s.speeds[1]
            return -7.0 * s.angles[1].sin() + s.load(0), turn + s.load(1)

        return law


class Driven(Tilted):
    """The same with a motor, whose torque is the command."""

    commands = (Channel("torque", "N m", "command", -0.6, 0.6),)


def test_a_goal_is_no_load_that_may_act_on_another_joint():
    assert "crosstalk(beam to ball)" in catalogue(Driven())
    assert "crosstalk(beam to ball)" not in catalogue(Tilted())
