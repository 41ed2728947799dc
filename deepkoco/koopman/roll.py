"""From what was observed earlier to the point at which the next action will begin to act."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from deepkoco.koopman.forward_model import ForwardModel
from deepkoco.koopman.latent_model import Array, LatentDynamics, LatentModel


class StateRoll(Protocol):
    """Linearises a model at a point of which only an earlier observation is known."""

    def linearise_later(
        self, observation: Array, elapsed: float, times: Array, actions: Array
    ) -> tuple[Array, Array]:
        """Latent, input columns and cost factor at the later point.

        Args:
            observation: o (N,), as observed.
            elapsed: Steps from the observation to the later point, 0 or more, not only whole ones.
            times: When the action changes, in steps since the observation (K,): increasing, in (0, elapsed].
            actions: The action at the observation, then after each change (1 + K, M).

        Returns:
            Rows (1 + M, n) and factor (r, n), as by `LatentModel.linearise`.
        """
        ...


def roll_latent(
    dynamics: LatentDynamics, rows: Array, elapsed: float, times: Array, increments: Array
) -> Array:
    r"""Roll a latent through changes of the action.

    $s(t) = \Lambda^{t/T} s(0) + \sum_i \Lambda^{(t - t_i)/T} B \Delta a_i$: a change of the action moves the
    latent by B da when it happens, as in $s_{k+1} = \Lambda s_k + B \Delta a_k$, where it happens at k + 1.

    Args:
        dynamics: Lambda.
        rows: s(0) and the columns of B as rows (1 + M, n).
        elapsed: t / T, in steps.
        times: t_i / T (K,), of 0 .. t / T.
        increments: da_i (K, M).

    Returns:
        s(t) (n,).

    Source: DeepKoCo, Eq. 5.5, with powers of Eq. 5.4 that are not whole.
    """
    moved = np.concatenate((rows[:1], increments @ rows[1:]))
    return dynamics.advance_by(moved, elapsed - np.concatenate(([0.0], times))).sum(0)


class LatentRoll:
    """Rolls the latent with B of the observed point, and keeps B and C of that point for the plan.

    Exact for a model that is linear in its latent (`LiftedLinearModel`). The pair (B, C) of a trained model is
    good for the T steps that it was trained to predict, of which the roll takes some from the plan's horizon. C
    at the rolled latent would be worse: psi has only seen latents that the encoder gives.
    """

    def __init__(self, model: LatentModel) -> None:
        """Roll the latents of a model."""
        self._model = model

    def linearise_later(
        self, observation: Array, elapsed: float, times: Array, actions: Array
    ) -> tuple[Array, Array]:
        """See `StateRoll`."""
        rows, factor = self._model.linearise(observation, actions[0])
        if elapsed > 0.0:
            rows[0] = roll_latent(self._model.dynamics, rows, elapsed, times, np.diff(actions, axis=0))
        return rows, factor


class ObservationRoll:
    """Predicts the observation with a forward model and encodes what it predicts.

    B and C then belong to the predicted point, and the plan keeps its whole horizon.
    """

    def __init__(self, model: LatentModel, forward: ForwardModel) -> None:
        """Predict with `forward`, encode with `model`."""
        self._model, self._forward = model, forward

    def linearise_later(
        self, observation: Array, elapsed: float, times: Array, actions: Array
    ) -> tuple[Array, Array]:
        """See `StateRoll`."""
        if elapsed > 0.0:
            observation = self._forward.predict(observation, elapsed, times, actions)
        return self._model.linearise(observation, actions[-1])
