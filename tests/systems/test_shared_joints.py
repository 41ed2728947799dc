"""Several actuators on one joint: each has its own gain, delay and limits."""

import pytest
import torch

from deepkoco import Channel, Parameter, System, load_system
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.causes.driving import driving_command
from deepkoco.systems import ExtendedSystem
from deepkoco.systems.added_loads import SumOverJoints
from deepkoco.systems.declaration import DeclarationError
from deepkoco.systems.effects.effect import Effect, PlacedEffect
from deepkoco.systems.motion import Motion

TWO_SERVOS = """<mujoco><compiler angle="radian"/><worldbody>
<body><joint name="j1" axis="0 1 0" damping="0.1"/><geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="1"/>
<body pos="0 0 -0.3"><joint name="j2" axis="0 1 0" damping="0.1"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="1"/></body></body></worldbody>
<actuator><position name="p1" joint="j1" kp="30"/><velocity name="v1" joint="j1" kv="1"/><motor name="m2" joint="j2"/>
</actuator></mujoco>"""


class Seesaw(System):
    joint_units = "rad"
    command_joints = (0, 0)
    parameters = (Parameter("inertia", 2.0, "kg m2", 0.1, 10.0, 0.1, "J"),)
    commands = (Channel("left", "N m", "command", -1.0, 1.0), Channel("right", "N m", "command", -1.0, 1.0))
    measurements = (Channel("roll", "rad", "measurement", noise_sd=1e-3),)

    def accelerations(self, p):
        return lambda motion: ((motion.efforts[1] - motion.efforts[0] + motion.load(0)) / p["inertia"],)


def test_effects_of_actuators_that_share_a_joint_are_named_after_their_commands():
    known = catalogue(Seesaw())
    names = {"gain(left)", "gain(right)", "gain(all)", "lag(left)", "lag(all)", "saturation(right)"}
    assert names | {"coulomb"} <= set(known)
    assert "gain" not in known
    assert driving_command(Seesaw(), 0, known["gain(right)"]) == 1
    assert driving_command(Seesaw(), 0, known["coulomb"]) == 0


def test_an_effect_of_one_actuator_leaves_the_other_alone():
    weak = ExtendedSystem(Seesaw(), ("gain(right)", "lag(left)", "actuation_delay(all)"))
    p = weak.default_parameters()
    p |= {k: torch.tensor(v) for k, v in {"gain(right).factor": 0.5, "lag(left).time_constant": 0.1}.items()}
    p["actuation_delay(all).delay"] = torch.tensor(0.02)
    assert weak.actuate(torch.tensor([1.0, 1.0]), p).tolist() == [1.0, 0.5]
    left, right = (weak.command_timing(k, p) for k in (0, 1))
    assert (float(sum(left.lag)), float(sum(right.lag))) == (pytest.approx(0.1), 0.0)
    assert float(left.delay) == float(right.delay) == pytest.approx(0.02)


def test_a_name_of_two_actuators_that_is_a_joint_is_refused():
    class Clash(Seesaw):
        joint_names = ("left",)

    with pytest.raises(DeclarationError, match='command "left" drives a joint together'):
        Clash()


def test_an_actuator_of_two_that_is_called_all_is_refused():
    class Clash(Seesaw):
        commands = (
            Channel("all", "N m", "command", -1.0, 1.0),
            Channel("right", "N m", "command", -1.0, 1.0),
        )

    with pytest.raises(
        DeclarationError, match=r'"all" drives .* "gain\(all\)" is the gain that all commands'
    ):
        Clash()


def shown_effort(system, efforts):
    """Effort that an effect at the first joint is shown."""
    seen = Effect("seen", "friction", "load", lambda *_: (), "its effort", lambda joint, p: joint.effort)
    p = system.default_parameters()
    still = tuple(torch.zeros((), dtype=torch.float64) for _ in range(system.joints))
    motion = Motion(still, still, tuple(torch.tensor(e, dtype=torch.float64) for e in efforts))
    loads = SumOverJoints(system, p, p, [PlacedEffect("seen", seen, 0)], None)(
        motion, (None,) * system.joints
    )
    return float(loads[0])


def test_an_effect_at_a_joint_is_shown_the_effort_of_its_first_actuator():
    assert shown_effort(Seesaw(), (0.3, -0.8)) == pytest.approx(0.3)


def test_an_effect_at_a_joint_of_a_robot_file_is_shown_what_its_servos_deliver_together(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(TWO_SERVOS)
    arm = load_system(str(path))
    assert [c.name for c in arm.commands] == ["p1", "m2", "v1"]
    # At rest at 0: 30 N m/rad of 0.1 rad, and 1 N m s/rad of 0.5 rad/s.
    assert shown_effort(arm, (0.1, 7.0, 0.5)) == pytest.approx(3.5)


def test_a_second_servo_of_a_joint_is_as_late_as_the_first(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(TWO_SERVOS)
    late = ExtendedSystem(load_system(str(path)), ("actuation_delay(j1)", "lag(j2)"))
    p = late.default_parameters()
    p |= {"actuation_delay(j1).delay": torch.tensor(0.03), "lag(j2).time_constant": torch.tensor(0.05)}
    timing = {c.name: late.command_timing(k, p) for k, c in enumerate(late.commands)}
    assert {n: float(t.delay) for n, t in timing.items()} == pytest.approx(
        {"p1": 0.03, "v1": 0.03, "m2": 0.0}
    )
    assert {n: float(sum(t.lag)) for n, t in timing.items()} == pytest.approx(
        {"p1": 0.0, "v1": 0.0, "m2": 0.05}
    )
