"""A trained latent model as plain NumPy arrays: what runs in a control loop, and what is stored on disk."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

Array = NDArray[np.float64]
FORMAT_VERSION = 1
WEIGHTS_FILE = "model.safetensors"
CONFIG_FILE = "config.json"


class ModelFolderError(ValueError):
    """A folder does not hold a readable exported model."""


@dataclass(frozen=True)
class ExportedModel:
    """Encoder, eigenvalues and cost factor for control with NumPy only.

    One batch-1 evaluation in eager torch takes three times as long as these few matrix products.

    Attributes:
        encoder: Weight (out, in) and bias (out,) of each layer of phi.
        cost_factor: The same for psi.
        mu: Growth rates (P,) [1/s].
        omega: Frequencies (P,) [rad/s].
        time_step: Seconds per step.
        action_weight: R of the cost model.
        action_size: M.
    """

    encoder: tuple[tuple[Array, Array], ...]
    cost_factor: tuple[tuple[Array, Array], ...]
    mu: Array
    omega: Array
    time_step: float
    action_weight: float
    action_size: int

    @property
    def observation_size(self) -> int:
        """N, entries of an observation."""
        return self.encoder[0][0].shape[1] - self.action_size

    @property
    def eigenvalues(self) -> NDArray[np.complex128]:
        """Discrete-time eigenvalues e^{(mu + i omega) dt} (P,), one of each conjugate pair."""
        return np.exp((self.mu + 1j * self.omega) * self.time_step)

    def linearise(self, observation: Array, action: Array) -> tuple[Array, Array]:
        """Latent, input matrix and cost row at one point or a batch of points.

        Args:
            observation: (..., N).
            action: (..., M).

        Returns:
            Rows (..., 1 + M, 2P): the latent s, then the M columns of B as rows; and the cost row C (...,
            2P).

        Source: DeepKoCo, Eq. 5.6-5.8.
        """
        x = np.concatenate((observation, action), axis=-1)
        # Value and derivatives go through the layers as rows of one matrix: half the calls.
        weight, bias = self.encoder[0]
        rows = np.empty((*x.shape[:-1], 1 + self.action_size, weight.shape[0]))
        rows[..., 0, :] = x @ weight.T
        rows[..., 1:, :] = weight.T[-self.action_size :]
        rows[..., 0, :] += bias
        for weight, bias in self.encoder[1:]:
            rows *= rows[..., :1, :] > 0
            rows = rows @ weight.T
            rows[..., 0, :] += bias
        return rows, self.factor(rows[..., 0, :])

    def factor(self, latent: Array) -> Array:
        """The cost row C_s = psi(s).

        Args:
            latent: (..., 2P).

        Returns:
            C (..., 2P).
        """
        h = latent
        for weight, bias in self.cost_factor[:-1]:
            h = np.maximum(h @ weight.T + bias, 0.0)
        weight, bias = self.cost_factor[-1]
        return h @ weight.T + bias

    def save(self, folder: Path, extra: dict[str, Any]) -> None:
        """Write `model.safetensors` and `config.json` into a new folder, all or nothing.

        Args:
            folder: Must not exist.
            extra: Further entries of config.json (the planner's settings and the action limits).

        Raises:
            ModelFolderError: The folder exists.
        """
        if folder.exists():
            raise ModelFolderError(f"{folder}: exists already; choose another folder")
        arrays = {"mu": self.mu, "omega": self.omega}
        for name, layers in (("encoder", self.encoder), ("cost_factor", self.cost_factor)):
            for i, (weight, bias) in enumerate(layers):
                arrays[f"{name}.{i}.weight"], arrays[f"{name}.{i}.bias"] = weight, bias
        config = {
            "format": "deepkoco-model",
            "version": FORMAT_VERSION,
            "time_step": self.time_step,
            "action_weight": self.action_weight,
            "action_size": self.action_size,
            "layers": {"encoder": len(self.encoder), "cost_factor": len(self.cost_factor)},
            **extra,
        }
        partial = folder.with_name(folder.name + ".partial")
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        save_file({k: np.ascontiguousarray(v) for k, v in arrays.items()}, partial / WEIGHTS_FILE)
        (partial / CONFIG_FILE).write_text(json.dumps(config, indent=2) + "\n")
        os.replace(partial, folder)

    @classmethod
    def load(cls, folder: Path) -> tuple[ExportedModel, dict[str, Any]]:
        """Read an exported model.

        Args:
            folder: Folder written by `save`.

        Returns:
            The model and the whole of config.json.

        Raises:
            ModelFolderError: A file is missing, damaged, or was written by another format or version.
        """
        for name in (CONFIG_FILE, WEIGHTS_FILE):
            if not (folder / name).is_file():
                raise ModelFolderError(f"{folder}: no {name}; give the folder of an exported model")
        try:
            config = json.loads((folder / CONFIG_FILE).read_text(encoding="utf-8"))
        except ValueError as error:
            raise ModelFolderError(f"{folder / CONFIG_FILE}: damaged, it is not JSON: {error}") from error
        if not isinstance(config, dict):
            raise ModelFolderError(f"{folder / CONFIG_FILE}: damaged, it does not hold named entries")
        if config.get("format") != "deepkoco-model" or config.get("version") != FORMAT_VERSION:
            raise ModelFolderError(
                f"{folder / CONFIG_FILE}: format {config.get('format')!r} version {config.get('version')!r}; "
                f"this release reads 'deepkoco-model' version {FORMAT_VERSION}"
            )
        try:
            arrays = load_file(folder / WEIGHTS_FILE)
        except SafetensorError as error:
            raise ModelFolderError(f"{folder / WEIGHTS_FILE}: damaged: {error}") from error

        def layers(name: str) -> tuple[tuple[Array, Array], ...]:
            count = int(config["layers"][name])
            return tuple((arrays[f"{name}.{i}.weight"], arrays[f"{name}.{i}.bias"]) for i in range(count))

        try:
            model = cls(
                layers("encoder"),
                layers("cost_factor"),
                arrays["mu"],
                arrays["omega"],
                float(config["time_step"]),
                float(config["action_weight"]),
                int(config["action_size"]),
            )
        except KeyError as error:
            raise ModelFolderError(f"{folder}: damaged, entry {error} is missing") from error
        except (TypeError, ValueError) as error:
            raise ModelFolderError(f"{folder / CONFIG_FILE}: damaged: {error}") from error
        model._check_shapes(folder)
        return model, config

    def _check_shapes(self, folder: Path) -> None:
        """Check that the layers fit each other and the sizes."""
        latents = 2 * self.mu.size
        for name, layers in (("encoder", self.encoder), ("cost_factor", self.cost_factor)):
            size = layers[0][0].shape[-1] if layers and name == "encoder" else latents
            for i, (weight, bias) in enumerate(layers):
                if weight.shape != (bias.size, size) or bias.ndim != 1:
                    raise ModelFolderError(
                        f"{folder / WEIGHTS_FILE}: damaged, {name}.{i}.weight has shape {weight.shape}"
                    )
                size = bias.size
            if not layers or size != latents:
                raise ModelFolderError(f"{folder}: damaged, {name} does not end in {latents} entries")
        if self.omega.shape != self.mu.shape or not 1 <= self.action_size < self.encoder[0][0].shape[1]:
            raise ModelFolderError(f"{folder}: damaged, omega or action_size does not fit the other entries")
