"""A DC motor that turns a load by a belt, stiff or elastic; only the motor's encoder is read."""

from deepkoco import Channel, Parameter, System

ELECTRICAL = (
    Parameter("constant", 0.05, "N m/A", 0.005, 0.5, 5e-4, "K, torque per current"),
    Parameter("resistance", 2.0, "1", 0.2, 20.0, 0.04, "R, of the winding [Ohm]"),
)
INERTIAS = (
    Parameter("motor_inertia", 5e-5, "kg m2", 5e-6, 5e-4, 1e-6, "rotor and pulley"),
    Parameter("load_inertia", 1.5e-4, "kg m2", 1e-5, 2e-3, 3e-5, "load, seen from the motor"),
    Parameter("viscous", 1e-4, "N m s/rad", 0.0, 1e-2, 1e-4, "b, friction of the bearings"),
)


class Motor(System):
    """J theta'' = K (u - K theta') / R - b theta': the belt holds motor and load together."""

    joint_units = "rad"
    parameters = (*ELECTRICAL, *INERTIAS)
    commands = (Channel("voltage", "V", "command", -12.0, 12.0),)
    measurements = (Channel("angle", "rad", "measurement", noise_sd=1e-3, angle=True),)

    def accelerations(self, p):
        inertia, per_volt = p["motor_inertia"] + p["load_inertia"], p["constant"] / p["resistance"]

        def law(motion):
            speed = motion.speeds[0]
            torque = per_volt * (motion.efforts[0] - p["constant"] * speed) - p["viscous"] * speed
            return ((torque + motion.load(0)) / inertia,)

        return law


class BeltMotor(System):
    """The same with an elastic belt: the load is a joint of its own, which nothing measures."""

    joint_names = ("motor", "load")
    joint_units = ("rad", "rad")
    parameters = (
        *ELECTRICAL,
        *INERTIAS,
        Parameter("stiffness", 0.6, "N m/rad", 0.01, 100.0, 0.3, "k, of the belt"),
        Parameter("belt_damping", 1e-3, "N m s/rad", 0.0, 0.1, 1e-3, "d, of the belt"),
    )
    commands = Motor.commands
    measurements = Motor.measurements

    def accelerations(self, p):
        per_volt = p["constant"] / p["resistance"]

        def law(motion):
            (angle, far), (speed, far_speed) = motion.angles, motion.speeds
            belt = p["stiffness"] * (far - angle) + p["belt_damping"] * (far_speed - speed)
            torque = per_volt * (motion.efforts[0] - p["constant"] * speed) + belt + motion.load(0)
            far_torque = -belt - p["viscous"] * far_speed + motion.load(1)
            return torque / p["motor_inertia"], far_torque / p["load_inertia"]

        return law
