"""Further robots of the study; each file simulates one and writes its logs as a workshop does."""

from experiments.studies.diagnosis.new_users.workshop.registry import (
    ROBOT_OF,
    WORKSHOP,
    write_robot_case,
    write_workshop_case,
)

__all__ = ["ROBOT_OF", "WORKSHOP", "write_robot_case", "write_workshop_case"]
