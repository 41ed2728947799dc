"""A system extended by effects, itself a system, and its file model.yaml."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml
from torch import Tensor

from deepkoco.systems.effects import EFFECTS, Effect
from deepkoco.systems.joint import JointSystem
from deepkoco.systems.registry import one_joint
from deepkoco.systems.system import ParameterError, Parameters, Timing

MODEL_VERSION = 1


class ModelFileError(ValueError):
    """A model.yaml cannot be read."""


class ExtendedSystem(JointSystem):
    """A base system plus effects; parameters of an effect are named ``effect.parameter``.

    With every effect at its null value it computes what the base computes. The key
    ``external_torque`` [N m], where a caller gives it, is one more load on the joint.

    Args:
        base: System to extend.
        effects: Names of the effects, in any order; they act in the order of the registry.
        values: New nominal values by full name; those not given keep the base's value or are null.

    Raises:
        ParameterError: An effect or a name in ``values`` is unknown, or a value is out of bounds.
    """

    def __init__(
        self, base: JointSystem, effects: tuple[str, ...] = (), values: Mapping[str, float] | None = None
    ) -> None:
        unknown = [name for name in effects if name not in EFFECTS]
        if unknown:
            raise ParameterError(f"unknown effect {', '.join(unknown)}; known: {', '.join(EFFECTS)}")
        self.base = base
        self.name = base.name
        self.upright = base.upright
        self.effects: tuple[Effect, ...] = tuple(e for name, e in EFFECTS.items() if name in effects)
        declared = list(base.parameters)
        for effect in self.effects:
            declared += [replace(p, name=f"{effect.name}.{p.name}") for p in effect.parameters(base)]
        self.parameters = tuple(declared)
        self.command = base.command
        self.measurements = base.measurements
        if values:
            for name in values:
                self.parameter(name)
            self.parameters = tuple(
                replace(p, value=float(values[p.name])) if p.name in values else p for p in declared
            )

    @property
    def load_scale(self) -> float:
        return self.base.load_scale

    def inertia(self, parameters: Parameters) -> Tensor:
        return self.base.inertia(self._body(parameters))

    def torque(self, theta: Tensor, omega: Tensor, effort: Tensor, parameters: Parameters) -> Tensor:
        total = self.base.torque(theta, omega, effort, self._body(parameters))
        for effect, own in self._at("load", parameters):
            total = total + effect.apply(omega, own)
        if "external_torque" in parameters:
            total = total + parameters["external_torque"]
        return total

    def actuate(self, command: Tensor, parameters: Parameters) -> Tensor:
        effort = self.base.actuate(command, parameters)
        for effect, own in self._at("command", parameters):
            effort = effect.apply(effort, own)
        return effort

    def timing(self, parameters: Parameters) -> Timing:
        zero = torch.zeros((), dtype=torch.float64)
        return Timing(
            parameters.get("actuation_delay.delay", zero),
            parameters.get("sensing_delay.delay", zero),
            parameters.get("lag.time_constant", zero),
        )

    def measure(self, state: Tensor, parameters: Parameters) -> Tensor:
        measurement = self.base.measure(state, parameters)
        for effect, own in self._at("sensor", parameters):
            measurement = effect.apply(measurement, own)
        return measurement

    def with_payload(self, mass: Tensor, parameters: Parameters) -> Parameters:
        return self.base.with_payload(mass, parameters)

    def draw_body(self, image: np.ndarray, angle_from_upright: float) -> None:
        self.base.draw_body(image, angle_from_upright)

    def _at(self, place: str, parameters: Parameters) -> list[tuple[Effect, dict[str, Tensor]]]:
        return [(e, _own(e.name, parameters)) for e in self.effects if e.place == place]

    def _body(self, parameters: Parameters) -> Parameters:
        for effect, own in self._at("body", parameters):
            parameters = effect.apply(self.base, parameters, own)
        return parameters


def _own(effect: str, parameters: Parameters) -> dict[str, Tensor]:
    prefix = f"{effect}."
    return {name[len(prefix) :]: value for name, value in parameters.items() if name.startswith(prefix)}


def save_model(path: str | Path, system: JointSystem, provenance: Mapping[str, Any] | None = None) -> None:
    """Write a system as model.yaml, atomically.

    Args:
        path: File to write.
        system: Plain or extended system.
        provenance: Where it comes from (log, verdict, version), stored beside it.

    Raises:
        FileExistsError: The file is there already.
    """
    path = Path(path)
    if path.exists():
        raise FileExistsError(f"{path} exists; choose another name")
    base = system.base if isinstance(system, ExtendedSystem) else system
    effects = [e.name for e in system.effects] if isinstance(system, ExtendedSystem) else []
    document = {
        "version": MODEL_VERSION,
        "system": base.name,
        "effects": effects,
        "parameters": {p.name: {"value": p.value, "unit": p.unit} for p in system.parameters},
        "provenance": dict(provenance or {}),
    }
    partial = path.with_suffix(path.suffix + ".partial")
    partial.write_text(yaml.safe_dump(document, sort_keys=False))
    os.replace(partial, path)


def load_model(path: str | Path) -> ExtendedSystem:
    """Read a system from model.yaml.

    Raises:
        ModelFileError: The file is missing, is not YAML, or does not describe a known system.
    """
    path = Path(path)
    try:
        document = yaml.safe_load(path.read_text())
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ModelFileError(f"{path}: cannot be read as YAML: {error}") from error
    if not isinstance(document, dict) or document.get("version") != MODEL_VERSION:
        raise ModelFileError(f"{path}: not a model file of version {MODEL_VERSION}")
    try:
        values = {name: float(entry["value"]) for name, entry in document["parameters"].items()}
        return ExtendedSystem(one_joint(document["system"]), tuple(document["effects"]), values)
    except (KeyError, TypeError, AttributeError) as error:
        raise ModelFileError(f"{path}: misses or garbles the entry {error}") from error
    except ValueError as error:
        raise ModelFileError(f"{path}: {error}") from error
