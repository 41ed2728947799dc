"""What can be wrong with a planner."""

from __future__ import annotations


class PlannerConfigError(ValueError):
    """A setting of the planner is out of range."""


class UnknownSolverError(ValueError):
    """The named QP solver is not installed, or cannot solve the chosen form."""


class SolverError(RuntimeError):
    """A program was not solved."""
