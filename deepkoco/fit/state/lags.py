"""Actuators with a time constant: what they deliver is a part of the state that a filter estimates."""

from __future__ import annotations

import torch
from torch import Tensor

from deepkoco.systems import Parameters, System


class LagStates:
    """The efforts of those actuators that answer with a first-order lag, T e' = u - e, behind a system's S states.

    Over a step h with a held target u, e(h) = u + (e - u) exp(-h / T), and its mean is
    u + (e - u) (1 - exp(-h / T)) T / h: what a simulation takes for its effort over a tick, and what a filter carries
    for each of its points.

    Args:
        system: Which E of its commands lag is read from its nominal parameters.
    """

    def __init__(self, system: System) -> None:
        self.system = system
        lags = system.command_lags(system.default_parameters())
        several = lags.reshape(-1)
        self.commands = tuple(k for k in range(len(several)) if float(several[k]) > 0.0)
        """Numbers of the commands that lag."""
        self.shortest = min((float(several[k]) for k in self.commands), default=float("inf"))
        """Shortest of their time constants [s]."""
        self.states = len(system.state_names)

    @property
    def width(self) -> int:
        """S + E."""
        return self.states + len(self.commands)

    def plain(self, points: Tensor) -> Tensor:
        """The system's own states (..., S) of points (..., S + E)."""
        return points[..., : self.states] if self.commands else points

    def efforts(self, effort: Tensor) -> Tensor:
        """What lags (..., E) of an effort (..., M), or (...) of a single command."""
        parts = (effort,) if len(self.system.commands) == 1 else effort.unbind(-1)
        return torch.stack([parts[k] for k in self.commands], -1)

    def slopes(self, points: Tensor, target: Tensor, parameters: Parameters) -> tuple[Tensor, Tensor]:
        """Effort that acts now, of the shape of ``target``, and slope of the efforts that lag (..., E).

        Args:
            points: (..., S + E).
            target: (..., M), or (...) of a single command: what the actuators go to.
            parameters: Named values, each scalar or (...).
        """
        acting, slopes = self._parts(target), []
        for place, k in enumerate(self.commands):
            effort, lag = points[..., self.states + place], self._lag(k, parameters)
            slopes.append((acting[k] - effort) / lag)
            acting[k] = effort
        return self._joined(acting, target), torch.stack(slopes, -1)

    def after(
        self, points: Tensor, target: Tensor, h: Tensor, parameters: Parameters
    ) -> tuple[Tensor, list[Tensor]]:
        """Mean effort over a step, of the shape of ``target``, and what lags at its end, E times (...).

        Args:
            points: (..., S + E).
            target: (..., M), or (...) of a single command, held.
            h: Length of the step [s], (...) or a shape that broadcasts against it; may be 0.
            parameters: Named values, each scalar or (...).
        """
        means, ends = self._parts(target), []
        for place, k in enumerate(self.commands):
            effort, lag = points[..., self.states + place], self._lag(k, parameters)
            # Where a unit is faster than the model, down to no lag at all, the effort is the target.
            share = h / torch.where(lag > 0, lag, 1.0)
            decay = torch.where(lag > 0, torch.exp(-share), 0.0)
            mean = torch.where(share > 0, (1.0 - decay) / torch.where(share > 0, share, 1.0), 1.0)
            away = effort - means[k]
            ends.append(means[k] + away * decay)
            means[k] = means[k] + away * torch.where(lag > 0, mean, 0.0)
        return self._joined(means, target), ends

    def _parts(self, target: Tensor) -> list[Tensor]:
        return [target] if len(self.system.commands) == 1 else list(target.unbind(-1))

    def _joined(self, parts: list[Tensor], target: Tensor) -> Tensor:
        if len(self.system.commands) == 1:
            return parts[0]
        return torch.stack(torch.broadcast_tensors(*parts), -1)

    def _lag(self, command: int, parameters: Parameters) -> Tensor:
        lags = self.system.command_lags(parameters)
        return lags if len(self.system.commands) == 1 else lags[..., command]


def mean_further_delay(system: System) -> float:
    """Mean delay of the commands beyond that of the soonest one [s], at nominal parameters."""
    delays = system.further_delays(system.default_parameters())
    return sum(float(d) for d in delays) / len(delays) if delays else 0.0
