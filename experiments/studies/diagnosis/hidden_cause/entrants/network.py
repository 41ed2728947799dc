"""A residual network: a small perceptron on angle, speed and effort that adds the missing torque."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from experiments.studies.diagnosis.hidden_cause.entrants.missing import (
    Missing,
    missing_torque,
    simulation_with,
)
from experiments.studies.diagnosis.hidden_cause.entrants.naming import USUAL, load_of
from experiments.studies.diagnosis.hidden_cause.kinds import NOTHING, UNKNOWN
from experiments.studies.diagnosis.hidden_cause.questions import Answer, Handed

WIDTH, STEPS, RATE, DECAY = 32, 600, 5e-3, 1e-4
SAMPLES = 3000  # at most


class ResidualNetwork:
    """It has no names: "unknown" where its torque is above the usual 4 % of a joint's load, else "nothing".

    With healthy logs, the torque of a network of these is taken off before it is compared.
    """

    name = "network"

    def answer(self, handed: Handed) -> Answer:
        """Learn the missing torque of the log."""
        system, before = handed.system, torch.random.get_rng_state()
        try:
            seen = missing_torque(system, handed.log)
            model = _Torque(seen, handed.seed)
            at = [torch.from_numpy(np.ascontiguousarray(x)) for x in (seen.q, seen.v, seen.u)]
            shown = model(*at).detach()
            if handed.healthy:
                usual = _Torque(missing_torque(system, handed.healthy), handed.seed)
                shown = shown - usual(*at).detach()
        finally:
            torch.random.set_rng_state(before)
        sizes = [float(shown[:, j].square().mean().sqrt()) / load_of(system, j) for j in range(system.joints)]
        name = UNKNOWN if max(sizes) >= USUAL else NOTHING
        return Answer(name, (), simulation_with(system, model), f"{max(sizes):.3g} of the load")


class _Torque:
    """A fitted network with its scales."""

    def __init__(self, seen: Missing, seed: int) -> None:
        torch.manual_seed(seed % 2**31)
        pick = np.unique(np.linspace(0, len(seen.q) - 1, min(len(seen.q), SAMPLES)).astype(int))
        given = torch.from_numpy(np.column_stack([x[pick] for x in (seen.q, seen.v, seen.u)]))
        wanted = torch.from_numpy(seen.torque[pick])
        self._middle, self._spread = given.mean(0), given.std(0) + 1e-9
        self._size = wanted.std(0) + 1e-9
        self._net = nn.Sequential(
            nn.Linear(given.shape[1], WIDTH),
            nn.Tanh(),
            nn.Linear(WIDTH, WIDTH),
            nn.Tanh(),
            nn.Linear(WIDTH, wanted.shape[1]),
        ).double()
        optimiser = torch.optim.AdamW(self._net.parameters(), lr=RATE, weight_decay=DECAY)
        scaled, goal = (given - self._middle) / self._spread, wanted / self._size
        for _ in range(STEPS):
            optimiser.zero_grad()
            # Differentiated positions have outliers where a joint turns.
            loss = nn.functional.huber_loss(self._net(scaled), goal)
            loss.backward()
            optimiser.step()

    def __call__(self, q: Tensor, v: Tensor, u: Tensor) -> Tensor:
        given = torch.cat([q, v, u], -1)
        return self._net((given - self._middle) / self._spread) * self._size
