"""Import of DeepKoopman autoencoders (Lusch, Kutz and Brunton): eigenvalues that depend on the latent."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from safetensors import SafetensorError
from safetensors.numpy import load_file
from scipy.linalg import block_diag

from deepkoco.koopman.lifting.edmdc import TargetCost
from deepkoco.koopman.lifting.lifted_linear import LiftedCost, LiftedLinearModel, target_cost
from deepkoco.koopman.lifting.lifting import Array, LiftingError
from deepkoco.koopman.lifting.network import Network

_FILE = re.compile(r"(?:^|.*[_-])([Wb](?:E|D|O[CR]\d+_)\d+)\.csv")


class DeepKoopmanError(ValueError):
    """Arrays are not those of a DeepKoopman autoencoder."""


@dataclass(frozen=True)
class DeepKoopmanModel:
    r"""An autonomous model $y = \varphi(o)$, $y_{k+1} = K(y_k) y_k$, $o = \varphi^{-1}(y)$.

    K is block diagonal. Block j of a complex pair is $e^{\mu \Delta t}$ times the rotation by $\omega \Delta t$,
    with $(\omega, \mu)$ a network of the pair's squared radius; a real eigenvalue is $e^{\mu \Delta t}$ with
    $\mu$ a network of its own coordinate. The pairs come first.

    Attributes:
        encoder: phi.
        decoder: phi^-1.
        pair_rates: One network per complex pair, from its squared radius to (omega [rad/s], mu [1/s]).
        real_rates: One network per real eigenvalue, from its coordinate to mu [1/s].
        time_step: Seconds per step.

    Source: Lusch, Kutz and Brunton, Deep learning for universal linear embeddings of nonlinear dynamics, Nature
    Communications 9 (2018).
    """

    encoder: Network
    decoder: Network
    pair_rates: tuple[Network, ...]
    real_rates: tuple[Network, ...]
    time_step: float

    def __post_init__(self) -> None:
        """Check that the networks fit each other."""
        size = 2 * len(self.pair_rates) + len(self.real_rates)
        if self.encoder.size != size or self.decoder.observation_size != size:
            raise DeepKoopmanError(
                f"{len(self.pair_rates)} pairs and {len(self.real_rates)} real eigenvalues make {size} latents; the "
                f"encoder gives {self.encoder.size}, the decoder takes {self.decoder.observation_size}"
            )
        if self.decoder.size != self.encoder.observation_size:
            raise DeepKoopmanError(
                f"the encoder takes {self.encoder.observation_size} entries, the decoder gives {self.decoder.size}"
            )
        for kind, networks, outputs in (("OC", self.pair_rates, 2), ("OR", self.real_rates, 1)):
            for i, network in enumerate(networks, 1):
                if (network.observation_size, network.size) != (1, outputs):
                    raise DeepKoopmanError(
                        f"auxiliary network {kind}{i} has {network.observation_size} inputs and {network.size} "
                        f"outputs; it should have 1 and {outputs}"
                    )
        if not 0 < self.time_step < np.inf:
            raise DeepKoopmanError(f"time_step = {self.time_step}; give seconds above 0")

    def encode(self, observations: ArrayLike) -> Array:
        """The latents (..., n) of observations (..., N)."""
        return self.encoder(np.asarray(observations, np.float64))

    def decode(self, latents: ArrayLike) -> Array:
        """The observations (..., N) of latents (..., n)."""
        return self.decoder(np.asarray(latents, np.float64))

    def eigenvalues(self, latent: ArrayLike) -> NDArray[np.complex128]:
        """Discrete-time eigenvalues at a latent.

        Args:
            latent: (..., n).

        Returns:
            One of each pair, then the real ones (..., pairs + reals).
        """
        latent = np.asarray(latent, np.float64)
        values = []
        for j, network in enumerate(self.pair_rates):
            radius = np.square(latent[..., 2 * j : 2 * j + 2]).sum(-1, keepdims=True)
            omega, mu = np.moveaxis(network(radius), -1, 0)
            values.append(np.exp((mu + 1j * omega) * self.time_step))
        for j, network in enumerate(self.real_rates, 2 * len(self.pair_rates)):
            values.append(np.exp(network(latent[..., j : j + 1])[..., 0] * self.time_step).astype(complex))
        return np.stack(values, -1)

    def transition(self, latent: ArrayLike) -> Array:
        """K at one latent (n,): a matrix (n, n)."""
        values, pairs = self.eigenvalues(latent), len(self.pair_rates)
        blocks = [np.array([[v.real, -v.imag], [v.imag, v.real]]) for v in values[:pairs]]
        return np.asarray(block_diag(*blocks, *([[v.real]] for v in values[pairs:])), np.float64)

    def predict(self, observation: ArrayLike, steps: int) -> Array:
        """Predict with eigenvalues taken anew at every step, as in training.

        Args:
            observation: o_0 (N,).
            steps: T.

        Returns:
            Predicted observations of steps 0 .. T (T + 1, N); the first is decoded too.
        """
        latents = [self.encode(observation)]
        for _ in range(steps):
            latents.append(self.transition(latents[-1]) @ latents[-1])
        return self.decode(np.array(latents))

    def fit_inputs(self, observations: Sequence[Array], actions: Sequence[Array]) -> Array:
        r"""Fit B of $y_{k+1} = K(y_k) y_k + B a_k$ to recorded episodes under control.

        Args:
            observations: Episodes of (T_i, N).
            actions: a_k, applied from step k to k + 1, episodes of (T_i, M).

        Returns:
            B (n, M), by least squares.
        """
        residuals, inputs = [], []
        for o, a in zip(observations, actions, strict=True):
            latents = self.encode(o)
            free = np.array([self.transition(y) @ y for y in latents[:-1]])
            residuals.append(latents[1:] - free)
            inputs.append(np.asarray(a, np.float64)[: len(free)])
        solution, *_ = np.linalg.lstsq(np.vstack(inputs), np.vstack(residuals))
        return np.asarray(solution.T, np.float64)

    def latent_model(
        self, at: ArrayLike, inputs: ArrayLike, cost: TargetCost | LiftedCost
    ) -> LiftedLinearModel:
        r"""A model for the planner: eigenvalues frozen at one observation, with inputs of the user.

        The network is of an autonomous system and knows nothing of inputs, so B must be given or fitted with
        `fit_inputs`. A planner's dynamics are one matrix, so K is that of `at`: right near it, and as wrong
        elsewhere as the spectrum is continuous. A cost on observations goes through the decoder, linearised there.

        Args:
            at: Observation (N,), usually the target.
            inputs: B (n, M).
            cost: Cost of observations or of latents.

        Returns:
            The latent model.

        Raises:
            LiftedModelError: Shapes do not fit.
        """
        latent = self.encode(at)
        if isinstance(cost, TargetCost):
            output = self.decoder.jacobian(latent)
            offset = self.decode(latent) - output @ latent
            target = np.asarray(cost.target, np.float64) - offset
            cost = target_cost(output, cost.weights, target, cost.action_weight)
        return LiftedLinearModel(self.encoder, self.transition(latent), inputs, cost, self.time_step)


def read_deepkoopman(
    weights: Mapping[str, ArrayLike] | str | Path, time_step: float, activation: str = "relu"
) -> DeepKoopmanModel:
    """Read an autoencoder in the published naming.

    `WE1, bE1, ...` are the encoder's layers, `WD1, bD1, ...` the decoder's, `WOCj_1, bOCj_1, ...` those of the
    auxiliary network of complex pair j, `WORj_1, ...` of real eigenvalue j. A layer is x W + b, W (inputs, outputs).

    Args:
        weights: Arrays by name, a safetensors file with them, or a folder of CSV files whose names end in
            NAME.csv, as the published code writes them.
        time_step: Seconds per step; `delta_t` of the published parameters.
        activation: Of the hidden layers: "relu", "sigmoid" or "elu"; `act_type` of the published parameters.

    Returns:
        The model.

    Raises:
        DeepKoopmanError: An array is missing, is no number, or does not fit the others.
    """
    arrays = _read_arrays(Path(weights)) if isinstance(weights, str | Path) else dict(weights)
    known = set()

    def network(name: str) -> Network | None:
        layers = []
        while f"W{name}{len(layers) + 1}" in arrays:
            i = len(layers) + 1
            if f"b{name}{i}" not in arrays:
                raise DeepKoopmanError(f"b{name}{i} is missing")
            try:
                weight, bias = (np.asarray(arrays[f"{kind}{name}{i}"], np.float64) for kind in "Wb")
            except (TypeError, ValueError) as error:
                raise DeepKoopmanError(
                    f"layer {name}{i} holds what is no array of numbers: {error}"
                ) from error
            if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
                raise DeepKoopmanError(f"layer {name}{i} holds numbers that are not finite")
            layers.append((np.atleast_2d(weight).T, bias.reshape(-1)))
            known.update({f"W{name}{i}", f"b{name}{i}"})
        try:
            return Network(tuple(layers), activation) if layers else None
        except LiftingError as error:
            raise DeepKoopmanError(f"network {name}: {error}") from error

    def networks(name: str) -> tuple[Network, ...]:
        found = []
        while (one := network(f"{name}{len(found) + 1}_")) is not None:
            found.append(one)
        return tuple(found)

    encoder, decoder = network("E"), network("D")
    if encoder is None or decoder is None:
        raise DeepKoopmanError(f"{'WE1' if encoder is None else 'WD1'} is missing; give the published names")
    model = DeepKoopmanModel(encoder, decoder, networks("OC"), networks("OR"), time_step)
    unknown = sorted(set(arrays) - known)
    if unknown:
        raise DeepKoopmanError(
            f"{unknown[0]} belongs to no layer; the layers of a network are numbered from 1"
        )
    return model


def _read_arrays(path: Path) -> dict[str, Array]:
    """Arrays by their published names."""
    try:
        if not path.is_dir():
            return load_file(path)
        found: dict[str, Path] = {}
        for file in sorted(path.iterdir()):
            if (match := _FILE.fullmatch(file.name)) is not None:
                if match[1] in found:
                    raise DeepKoopmanError(
                        f"{path}: {found[match[1]].name} and {file.name} both hold {match[1]}; keep one model a folder"
                    )
                found[match[1]] = file
        arrays = {name: np.loadtxt(file, delimiter=",", ndmin=1) for name, file in found.items()}
    except (OSError, SafetensorError, KeyError, ValueError) as error:
        raise DeepKoopmanError(f"{path}: cannot be read: {error}") from error
    # A CSV file does not tell a column from a row: a layer has as many outputs as its bias.
    outputs = {name: arrays[f"b{name[1:]}"].size for name in arrays if f"b{name[1:]}" in arrays}
    for name, size in outputs.items():
        if name[0] == "W" and size and arrays[name].size % size == 0:
            arrays[name] = arrays[name].reshape(-1, size)
    return arrays
