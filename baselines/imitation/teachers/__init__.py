"""Who answers: a trained controller, planning on the true equations, a function, a person; at once or late."""

from baselines.imitation.teachers.named import make_teacher
from baselines.imitation.teachers.teacher import Teacher, TeacherError

__all__ = ["Teacher", "TeacherError", "make_teacher"]
