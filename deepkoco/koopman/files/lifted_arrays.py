"""The lifted linear model as named arrays and plain settings, as the folder of a model stores it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from deepkoco.koopman.files.stored_values import number_above, text, weights, weights_as_stored, whole_number
from deepkoco.koopman.lifting.lifted_linear import LiftedCost, LiftedLinearModel
from deepkoco.koopman.lifting.lifting import (
    Array,
    Identity,
    Lifting,
    LiftingError,
    Polynomial,
    RadialBasis,
    RandomFourier,
    ScaledRadialBasis,
    TimeDelays,
)
from deepkoco.koopman.lifting.network import Network

LIFTINGS: dict[str, type[Any]] = {
    "identity": Identity,
    "polynomial": Polynomial,
    "radial_basis": RadialBasis,
    "random_fourier": RandomFourier,
    "scaled_radial_basis": ScaledRadialBasis,
    "time_delays": TimeDelays,
    "network": Network,
}
"""Liftings that a folder can hold."""
LARGEST_LIFTING = 10_000
"""Most lifted entries that are read, and most entries of a history."""


def lifted_parts(model: LiftedLinearModel) -> tuple[dict[str, Any], dict[str, Array]]:
    """Take a model apart.

    Args:
        model: The model.

    Returns:
        Settings for config.json, and `transition`, `inputs`, `cost.factor`, `cost.offset` and `lifting.NAME`.

    Raises:
        LiftingError: The lifting is a function of the user, which no file can hold.
    """
    name = next((n for n, kind in LIFTINGS.items() if type(model.lifting) is kind), None)
    if name is None:
        raise LiftingError(
            f"a {type(model.lifting).__name__} cannot be written to a file; use one of {', '.join(LIFTINGS)}"
        )
    lifting: dict[str, Any] = {"kind": name}
    arrays = {
        "transition": model.transition,
        "inputs": model.inputs,
        "cost.factor": model.cost.factor,
        "cost.offset": model.cost.offset,
    }
    for field in fields(LIFTINGS[name]):
        value = getattr(model.lifting, field.name)
        if isinstance(value, np.ndarray):
            arrays[f"lifting.{field.name}"] = value
        elif isinstance(value, tuple):
            lifting[field.name] = len(value)
            for i, (weight, bias) in enumerate(value):
                arrays[f"lifting.{i}.weight"], arrays[f"lifting.{i}.bias"] = weight, bias
        else:
            lifting[field.name] = value
    settings = {
        "time_step": model.time_step,
        "action_weight": weights_as_stored(model.action_weight),
        "lifting": lifting,
    }
    return settings, arrays


def read_lifted(settings: Mapping[str, Any], arrays: Mapping[str, Array]) -> LiftedLinearModel:
    """Put a model together and check that its parts fit each other.

    Args:
        settings: At least its entries of config.json.
        arrays: At least its arrays.

    Returns:
        The model.

    Raises:
        KeyError: An entry or an array is missing.
        TypeError: An entry is of the wrong kind.
        ValueError: Parts do not fit each other; the message names the first that does not.
    """
    lifting = _read_lifting(settings["lifting"], arrays)
    weight = weights(settings["action_weight"], "action_weight")
    cost = LiftedCost(arrays["cost.factor"], arrays["cost.offset"], weight)
    if cost.factor.ndim != 2 or cost.offset.ndim != 1:
        raise ValueError(f"cost.factor has shape {cost.factor.shape}")
    time_step = number_above(settings["time_step"], "time_step", 0.0)
    return LiftedLinearModel(lifting, arrays["transition"], arrays["inputs"], cost, time_step)


def _read_lifting(stored: Mapping[str, Any], arrays: Mapping[str, Array]) -> Lifting:
    """A lifting from its entry of config.json; every value is checked against the type of its field."""
    kind = text(stored["kind"], "lifting.kind")
    if kind not in LIFTINGS:
        raise ValueError(f"lifting.kind = {kind[:50]!r}; this release reads {', '.join(LIFTINGS)}")
    values: dict[str, Any] = {}
    for field in fields(LIFTINGS[kind]):
        name = f"lifting.{field.name}"
        if field.type == "Array":
            values[field.name] = arrays[name]
        elif field.type == "int":
            least = 1 if field.name == "observation_size" else 0
            values[field.name] = whole_number(stored[field.name], name, least)
        elif field.type == "float":
            values[field.name] = number_above(stored[field.name], name, 0.0, equal=True)
        elif field.type == "str":
            values[field.name] = text(stored[field.name], name)
        elif field.type == "bool":
            if not isinstance(stored[field.name], bool):
                raise ValueError(f"{name} should be true or false")
            values[field.name] = stored[field.name]
        else:
            count = min(whole_number(stored[field.name], name, 1), len(arrays))
            values[field.name] = tuple(
                (arrays[f"lifting.{i}.weight"], arrays[f"lifting.{i}.bias"]) for i in range(count)
            )
    if kind == "polynomial":
        _check_polynomial(values["observation_size"], values["degree"])
    lifting = LIFTINGS[kind](**values)
    if max(lifting.size, lifting.window * lifting.observation_size) > LARGEST_LIFTING or not lifting.size:
        raise ValueError(f"the lifting has {lifting.size} entries; 1 to {LARGEST_LIFTING} are read")
    return lifting


def _check_polynomial(size: int, degree: int) -> None:
    """Refuse a number of monomials that would fill the memory while they are counted."""
    count = 1
    for k in range(1, degree + 1):
        count = count * (size + k) // k
        if count > LARGEST_LIFTING:
            raise ValueError(f"monomials up to degree {degree} of {size} entries are too many")
