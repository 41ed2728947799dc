"""Teachers by name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from baselines.imitation.teachers.controller import ControllerTeacher
from baselines.imitation.teachers.function import FunctionTeacher
from baselines.imitation.teachers.keys import KeyTeacher
from baselines.imitation.teachers.late import LateTeacher
from baselines.imitation.teachers.optimal import OptimalTeacher
from baselines.imitation.teachers.teacher import Teacher, TeacherError
from deepkoco.own_objects import names_object

TEACHERS: dict[str, Callable[[], Teacher]] = {"optimal": OptimalTeacher, "keys": KeyTeacher}


def make_teacher(name: str, answer_delay: tuple[int, int] = (0, 0)) -> Teacher:
    """Make a teacher.

    Args:
        name: A name of `TEACHERS`, FILE.py:FUNCTION, MODULE:FUNCTION or the folder of a trained run.
        answer_delay: Fewest and most steps until an answer comes.

    Raises:
        TeacherError: There is no such teacher.
    """
    if name in TEACHERS:
        teacher = TEACHERS[name]()
    elif Path(name).is_dir():
        teacher = ControllerTeacher(Path(name))
    elif names_object(name):
        teacher = FunctionTeacher(name)
    else:
        raise TeacherError(
            f'teacher = "{name}": no folder of a trained run; give one, {", ".join(TEACHERS)}, or FILE.py:FUNCTION'
        )
    return LateTeacher(teacher, *answer_delay) if max(answer_delay) > 0 else teacher
