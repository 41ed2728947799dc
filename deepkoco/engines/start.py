"""Where an episode starts."""

from __future__ import annotations

import torch
from torch import Tensor

from deepkoco.systems import Parameters, System


def start_state(system: System, parameters: Parameters, batch: int) -> Tensor:
    """The parameter ``start`` as states (B, S), float64; zeros where there is none."""
    width = len(system.state_names)
    start = parameters.get("start")
    if start is None:
        return torch.zeros(batch, width, dtype=torch.float64)
    return start.to(torch.float64).expand(batch, width).clone()
