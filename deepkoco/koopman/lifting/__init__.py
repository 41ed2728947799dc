"""Models that are linear in a lifted observation."""

from deepkoco.koopman.lifting.lifting import (
    FunctionLifting,
    Identity,
    Lifting,
    LiftingError,
    Polynomial,
    RadialBasis,
    RandomFourier,
    ScaledRadialBasis,
    StackedHistory,
    TimeDelays,
    stack_history,
)

__all__ = [
    "FunctionLifting",
    "Identity",
    "Lifting",
    "LiftingError",
    "Polynomial",
    "RadialBasis",
    "RandomFourier",
    "ScaledRadialBasis",
    "StackedHistory",
    "TimeDelays",
    "stack_history",
]
