"""Cases of the study: a robot, what is hidden in it, and which names say so."""

from __future__ import annotations

from dataclasses import dataclass, field

DEGREES = 0.017453292519943295


@dataclass(frozen=True)
class Case:
    """One log.

    Attributes:
        robot: Name of its equations in :mod:`.units` and of its format in :mod:`.logs`.
        hidden: Parameters of the unit that differ, and effects that it has.
        right: Names that say so, with or without a place; empty for "nothing".
        truth: Size that the first parameter of the cause should have; None where there is none.
        healthy: Number of healthy logs beside it.
        spread: Relative standard deviation of each parameter from log to log.
        jitter: Standard deviation of the stamps [s].
        system: Description that the user has; None takes that of the robot.
    """

    robot: str
    hidden: dict[str, float] = field(default_factory=dict)
    right: tuple[str, ...] = ()
    truth: float | None = None
    healthy: int = 0
    spread: float = 0.0
    jitter: float = 0.0
    system: str | None = None


# Values that the user's description declares, and their standard deviations. A unit is off by half of them.
NOMINAL: dict[str, dict[str, float]] = {
    "cart": {
        "cart_mass": 0.8, "pole_mass": 0.2, "length": 0.5, "cart_viscous": 0.8, "pole_viscous": 0.001,
    },
    "stiff": {
        "constant": 0.06, "resistance": 1.5, "motor_inertia": 6e-5, "load_inertia": 2e-4, "viscous": 2e-4,
    },
    "belt": {
        "constant": 0.06, "resistance": 1.5, "motor_inertia": 6e-5, "load_inertia": 2e-4, "viscous": 2e-4,
        "stiffness": 1.0, "belt_damping": 1e-3,
    },
    "crane": {"drive_gain": 60.0, "trolley_mass": 4.0, "load_mass": 1.5, "cable": 1.2, "air": 0.02},
    "axis": {"mass": 40.0, "kv": 20.0, "kp": 2000.0, "viscous": 150.0},
    "wheel": {
        "body_inertia": 0.012, "wheel_inertia": 6e-4, "weight": 0.9, "constant": 0.035, "body_viscous": 1e-3,
        "wheel_viscous": 5e-5,
    },
    "cylinder": {"flow_gain": 0.04, "time_constant": 0.06},
    "leg": {
        "m1": 1.2, "I1": 0.006, "m2": 0.5, "I2": 0.0025, "b1": 0.15, "b2": 0.08, "stiffness": 6.0, "ref": 0.5,
    },
}  # fmt: skip
SPREAD: dict[str, dict[str, float]] = {
    "cart": {
        "cart_mass": 0.03, "pole_mass": 0.01, "length": 0.005, "cart_viscous": 0.3, "pole_viscous": 0.0007,
    },
    "stiff": {
        "constant": 6e-4, "resistance": 0.03, "motor_inertia": 1e-6, "load_inertia": 2e-5, "viscous": 7e-5,
    },
    "belt": {
        "constant": 6e-4, "resistance": 0.03, "motor_inertia": 1e-6, "load_inertia": 2e-5, "viscous": 7e-5,
        "stiffness": 0.3, "belt_damping": 5e-4,
    },
    "crane": {"drive_gain": 8.0, "trolley_mass": 0.2, "load_mass": 0.05, "cable": 0.02, "air": 0.01},
    "axis": {"mass": 2.0, "kv": 1.0, "kp": 100.0, "viscous": 60.0},
    "wheel": {
        "body_inertia": 5e-4, "wheel_inertia": 2e-5, "weight": 0.03, "constant": 0.001, "body_viscous": 4e-4,
        "wheel_viscous": 2e-5,
    },
    "cylinder": {"flow_gain": 0.004, "time_constant": 0.006},
    "leg": {
        "m1": 0.024, "I1": 1.2e-4, "m2": 0.01, "I2": 5e-5, "b1": 0.05, "b2": 0.03, "stiffness": 0.3, "ref": 0.02,
    },
}  # fmt: skip
SYSTEM = {
    "cart": "cart.py", "stiff": "motor.py:Stiff", "belt": "motor.py:Belt", "crane": "crane.py", "axis": "axis.py",
    "wheel": "wheel.py", "cylinder": "cylinder.py", "leg": "leg.urdf",
}  # fmt: skip

DELAY, DRY = ("actuation_delay",), ("coulomb", "stribeck")
CASES: dict[str, Case] = {
    "cart_healthy": Case("cart"),
    "cart_delay": Case("cart", {"delay": 0.025}, DELAY, 0.025),
    "cart_friction": Case("cart", {"coulomb": 0.6}, ("coulomb(cart)", "stribeck(cart)"), 0.6),
    "cart_polemass": Case("cart", {"pole_mass": 0.35}, ("changed(pole_mass)",), 0.35),
    "cart_gain": Case("cart", {"gain": 0.8}, ("gain",), 0.8),
    "cart_pivot": Case("cart", {"pole_coulomb": 0.01}, ("coulomb(pole)", "stribeck(pole)"), 0.01),
    "cart_healthy_h3": Case("cart", healthy=3, spread=0.015),
    "cart_delay_h3": Case("cart", {"delay": 0.015}, DELAY, 0.015, healthy=3, spread=0.015),
    "cart_friction_h1": Case(
        "cart", {"coulomb": 0.4}, ("coulomb(cart)", "stribeck(cart)"), 0.4, healthy=1, spread=0.01
    ),
    "motor_healthy": Case("stiff"),
    "motor_jitter": Case("stiff", jitter=2e-4),
    "motor_delay": Case("stiff", {"delay": 0.02}, DELAY, 0.02, jitter=1e-4),
    "motor_friction": Case("stiff", {"coulomb": 0.02}, DRY, 0.02),
    "motor_load": Case("stiff", {"load_inertia": 3.5e-4}, ("changed(load_inertia)",), 3.5e-4),
    # The size is the share of the inertia behind the belt.
    "motor_elastic": Case(
        "belt", {"stiffness": 0.5, "belt_damping": 3e-4}, ("elastic",), 0.77, system="motor.py:Stiff"
    ),
    "motor_elastic_stiff": Case(
        "belt", {"stiffness": 3.0, "belt_damping": 1e-3}, ("elastic",), 0.77, system="motor.py:Stiff"
    ),
    "motor_friction_h3": Case("stiff", {"coulomb": 0.015}, DRY, 0.015, healthy=3, spread=0.015),
    "belt_healthy": Case("belt"),
    # Within the declared spread of the stiffness, so "nothing" is right too.
    "belt_soft": Case("belt", {"stiffness": 0.25}, ("changed(stiffness)", "nothing"), 0.25),
    "belt_loadfriction": Case("belt", {"coulomb": 0.02}, ("coulomb(load)", "stribeck(load)"), 0.02),
    "belt_delay": Case("belt", {"delay": 0.02}, DELAY, 0.02),
    "crane_healthy": Case("crane"),
    "crane_camera": Case("crane", {"sway_delay": 0.08}, ("channel_delay(sway)",), 0.08),
    "crane_cable": Case("crane", {"cable": 1.45}, ("changed(cable)",), 1.45),
    "crane_friction": Case("crane", {"coulomb": 6.0}, ("coulomb(trolley)", "stribeck(trolley)"), 6.0),
    "crane_swaybias": Case("crane", {"sway_bias": 2.0 * DEGREES}, ("sensor_bias(sway)",), 2.0 * DEGREES),
    "crane_load_h3": Case("crane", {"load_mass": 2.2}, ("changed(load_mass)",), 2.2, healthy=3, spread=0.01),
    "axis_healthy": Case("axis"),
    # Half of the play is its parameter.
    "axis_play": Case("axis", {"play": 60e-6}, ("gear_play",), 30e-6),
    "axis_friction": Case("axis", {"coulomb": 60.0}, DRY, 60.0),
    "axis_delay": Case("axis", {"delay": 0.008}, DELAY, 0.008),
    # A servo that is read by the scale that it is wrong by cannot tell it from a gain of its goal.
    "axis_pitch": Case("axis", {"scale": 1.004}, ("sensor_scale", "gain"), 1.004),
    "axis_healthy_h1": Case("axis", healthy=1, spread=0.01),
    "wheel_healthy": Case("wheel"),
    "wheel_bearing": Case("wheel", {"wheel_coulomb": 0.004}, ("coulomb(wheel)", "stribeck(wheel)"), 0.004),
    "wheel_gain": Case("wheel", {"gain": 0.8}, ("gain", "changed(constant)"), 0.8),
    "wheel_cable": Case("wheel", {"spring": 0.25}, ("spring(body)", "changed(weight)"), 0.25),
    "wheel_tacho": Case("wheel", {"rpm_scale": 1.08}, ("sensor_scale(wheel)",), 1.08),
    "wheel_delay_h3": Case("wheel", {"delay": 0.012}, DELAY, 0.012, healthy=3, spread=0.01),
    "cyl_healthy": Case("cylinder"),
    "cyl_overlap": Case("cylinder", {"dead_zone": 0.6}, ("dead_zone",), 0.6),
    "cyl_areas": Case("cylinder", {"asymmetry": 0.15}, ("asymmetry",), 0.15),
    "cyl_delay": Case("cylinder", {"delay": 0.03}, DELAY, 0.03),
    "cyl_healthy_h3": Case("cylinder", healthy=3, spread=0.015),
    "leg_healthy": Case("leg"),
    "leg_spring": Case("leg", {"stiffness": 3.5}, ("changed(stiffness(knee))",), 3.5),
    "leg_payload": Case("leg", {"payload": 0.25}, ("payload",), 0.25),
    "leg_knee": Case("leg", {"knee_coulomb": 0.15}, ("coulomb(knee)", "stribeck(knee)"), 0.15),
    "leg_delay": Case("leg", {"delay": 0.012}, DELAY, 0.012),
    "leg_hip_h3": Case(
        "leg", {"hip_gain": 0.75}, ("gain(hip)", "changed(gain(hip))"), 0.75, healthy=3, spread=0.015
    ),
}
