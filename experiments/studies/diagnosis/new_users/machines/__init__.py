"""Machines that nobody of the package had tried, and the logs of their cases; each file simulates one."""

from experiments.studies.diagnosis.new_users.cases import Case
from experiments.studies.diagnosis.new_users.machines import (
    ballscrew,
    conveyor,
    desk_arm,
    gantry,
    gimbal,
    pantilt,
    pitchdrive,
    press,
    springleg,
)
from experiments.studies.diagnosis.new_users.workshop.bench import Robot

MACHINE_OF: dict[str, Robot] = {
    name: module.ROBOT
    for module in (
        gantry,
        gimbal,
        press,
        pantilt,
        desk_arm,
        conveyor,
        ballscrew,
        pitchdrive,
        springleg,
    )
    for name in module.ROBOT.cases
}
MACHINES: dict[str, Case] = {name: robot.cases[name] for name, robot in MACHINE_OF.items()}
