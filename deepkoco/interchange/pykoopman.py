"""Import of EDMDc and DMDc models of pykoopman, from a fitted object or from its matrices."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from deepkoco.koopman.lifting.edmdc import TargetCost
from deepkoco.koopman.lifting.lifted_linear import (
    LiftedCost,
    LiftedLinearModel,
    LiftedModelError,
    target_cost,
)
from deepkoco.koopman.lifting.lifting import (
    Array,
    FunctionLifting,
    Identity,
    Lifting,
    Polynomial,
    RadialBasis,
    RandomFourier,
    TimeDelays,
)


def _function(observables: Any) -> FunctionLifting:
    """Any fitted observables through their own `transform`; it wants the window as rows, oldest first."""
    size, consumed = int(observables.n_input_features_), int(getattr(observables, "n_consumed_samples", 0))
    outputs = int(observables.n_output_features_)

    def lift(stacked: Array) -> Array:
        rows = stacked.reshape(-1, consumed + 1, size)[:, ::-1]
        lifted = np.vstack([observables.transform(np.ascontiguousarray(window)) for window in rows])
        return lifted.reshape(*stacked.shape[:-1], outputs)

    return FunctionLifting(lift, size, outputs, consumed + 1)


LIFTINGS = {
    "Identity": lambda o: Identity(o.n_input_features_),
    "Polynomial": lambda o: Polynomial(o.n_input_features_, o.degree, o.include_bias, o.interaction_only),
    "RadialBasisFunction": lambda o: RadialBasis(
        np.asarray(o.centers, np.float64).T,
        o.rbf_type,
        float(o.kernel_width),
        float(o.polyharmonic_coeff),
        bool(o.include_state),
    ),
    "RandomFourierFeatures": lambda o: RandomFourier(np.asarray(o.w, np.float64).T, bool(o.include_state)),
    "TimeDelay": lambda o: TimeDelays(o.n_input_features_, o.n_delays, o.delay),
}
"""Our lifting by the class of pykoopman's observables; any other is called as it is, see `from_pykoopman`."""


def from_pykoopman(model: Any, cost: TargetCost | LiftedCost, time_step: float) -> LiftedLinearModel:
    """Take over a fitted `pykoopman.Koopman` with control.

    Identity, polynomial, radial, Fourier and delay observables become liftings of this package, which a folder
    can hold. Custom and concatenated ones are called in pykoopman: the model works, but it cannot be saved.

    Args:
        model: Fitted, with the regressor EDMDc or DMDc.
        cost: The user's cost on observations, or one on lifted observations.
        time_step: Seconds per step.

    Returns:
        A latent model.

    Raises:
        LiftedModelError: The model is not fitted, has no control input, or does not fit the cost.
    """
    try:
        observables = model.observables
        make = LIFTINGS.get(type(observables).__name__, _function)
        lifting = make(observables)
        output, inputs = model.C, model.B
    except Exception as error:  # scikit-learn's NotFittedError is an AttributeError and a ValueError
        reason = " ".join(str(error).split())[:200]
        raise LiftedModelError(f"not a fitted pykoopman model with control: {reason}") from error
    return from_matrices(lifting, model.A, inputs, output, cost, time_step)


def from_matrices(
    lifting: Lifting,
    transition: ArrayLike,
    inputs: ArrayLike,
    output: ArrayLike,
    cost: TargetCost | LiftedCost,
    time_step: float,
) -> LiftedLinearModel:
    """A latent model from the matrices of z' = A z + B a, o = C z, wherever they come from.

    Args:
        lifting: z = g(o).
        transition: A (p, p), real.
        inputs: B (p, M).
        output: C (N, p).
        cost: The user's cost on observations, or one on lifted observations.
        time_step: Seconds per step.

    Returns:
        A latent model.

    Raises:
        LiftedModelError: Shapes do not fit, or a matrix is complex.
    """
    matrices = [np.asarray(matrix) for matrix in (transition, inputs, output)]
    for name, matrix in zip("ABC", matrices, strict=True):
        if np.iscomplexobj(matrix) and np.abs(np.imag(matrix)).max() > 1e-9 * max(1.0, np.abs(matrix).max()):
            raise LiftedModelError(f"{name} is complex; give the matrices in real coordinates")
    a, b, c = (np.ascontiguousarray(np.real(matrix), np.float64) for matrix in matrices)
    if c.ndim != 2 or c.shape[1] != lifting.size:
        raise LiftedModelError(f"C has shape {c.shape}; the lifting gives {lifting.size} entries")
    if isinstance(cost, TargetCost):
        cost = target_cost(c, cost.weights, cost.target, cost.action_weight)
    return LiftedLinearModel(lifting, a, b, cost, time_step)
