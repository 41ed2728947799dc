"""What a user knows better than the model file: values, priors, noise and servos, in a small YAML file beside it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np

from deepkoco.suggestion import did_you_mean
from deepkoco.systems.channel import Channel
from deepkoco.systems.parameter import Parameter, ParameterError
from deepkoco.systems.trees.tree import Actuator, Tree, TreeError
from deepkoco.yaml_file import YamlFileError, read_yaml

ENDING = ".parameters.yaml"
KEYS = ("parameters", "servos", "noise", "zero_sd", "payload", "held")
FIELDS = ("value", "prior_sd", "low", "high")
JOINT_KINDS = ("damping", "frictionloss", "armature", "stiffness", "springref")


class TreeSettings:
    """Settings of a tree, as read from YAML.

    .. code-block:: yaml

        parameters:                 # names as the system has them; * stands for anything
          mass(fore): 0.75          # a value alone
          "com_*(fore)": {prior_sd: 0.02}
          "damping(*)": {value: 0.1, prior_sd: 0.05, low: 0, high: 1}   # also where the model has none
          "length(*)": {prior_sd: 0.002}      # fixed unless it is named here, as axis_x, axis_y, axis_z, zero,
          zero(elbow): {prior_sd: 0.01}       # inertia_xy, inertia_xz and inertia_yz are
        servos:                     # of joints whose model has no actuators: goals of positions in place of loads
          "*": {kp: 20, kv: 0.5, force: 3.0}
        noise: {"q_*": 0.0015}      # standard deviation of sensors
        zero_sd: {"q_*": 0.02}      # of their zeros, from log to log
        payload: gripperframe       # place of the payload
        held: ["finger_*", root]    # joints that do not move in the logs: a gripper, the base on its stand;
                                    # {finger_left: 0.04} holds one at a position [rad, m]

    Args:
        given: The document.
        source: Named in messages.

    Raises:
        TreeError: A key is unknown.
    """

    def __init__(self, given: Mapping[str, Any], source: str = "settings") -> None:
        self.given, self.source = given, source
        for key in given:
            if key not in KEYS:
                raise self._error(
                    f'unknown key "{key}"{did_you_mean(str(key), KEYS) or ";"} known: {", ".join(KEYS)}'
                )

    @classmethod
    def beside(cls, path: Path) -> TreeSettings:
        """Those of the file ``ROBOT.parameters.yaml`` beside ``ROBOT.xml``; none if it is not there.

        Raises:
            TreeError: The file cannot be read.
        """
        own = path.with_name(path.stem + ENDING)
        return cls.read(own) if own.is_file() else cls({})

    @classmethod
    def read(cls, path: Path) -> TreeSettings:
        """Those of a YAML file.

        Raises:
            TreeError: The file cannot be read.
        """
        try:
            document = read_yaml(path)
        except YamlFileError as error:
            raise TreeError(str(error)) from error
        if not isinstance(document, Mapping):
            raise TreeError(f"{path}: expected the keys {', '.join(KEYS)}")
        return cls(document, str(path))

    @property
    def held(self) -> dict[str, float]:
        """Position [rad, m] of each joint that is held, by name or pattern; NaN: where the model is drawn.

        Raises:
            TreeError: It is neither a list of names nor names with positions.
        """
        given = self.given.get("held") or []
        if isinstance(given, str):
            given = [given]
        if isinstance(given, Mapping):
            return {str(name): self._number(f"held: {name}", value) for name, value in given.items()}
        if not isinstance(given, list):
            raise self._error(f"held: expected a list of joints, or joints and positions, got {given!r}")
        return {str(name): math.nan for name in given}

    def applied_to(self, tree: Tree) -> Tree:
        """The tree with servos, and with values of joints that its model leaves at 0."""
        tree = self._with_servos(tree)
        joints = list(tree.joints)
        for pattern, fields in self._of("parameters").items():
            value = self._fields(pattern, fields).get("value")
            for index, joint in enumerate(joints):
                for kind in JOINT_KINDS:
                    if value is not None and fnmatchcase(f"{kind}({joint.name})", pattern):
                        if kind in ("damping", "frictionloss", "armature") and value < 0.0:
                            raise self._error(f"{pattern}: {value:g} is below 0")
                        joint = joints[index] = replace(joint, **{kind: float(value)})
        return replace(tree, joints=tuple(joints))

    def parameters(
        self, declared: Iterable[Parameter], optional: Iterable[Parameter] = ()
    ) -> tuple[Parameter, ...]:
        """The declared parameters with the values, priors and bounds given here.

        Args:
            declared: Parameters of the system.
            optional: Parameters that it has if their kind is written here: ``length(fore)`` or ``length(*)``.

        Raises:
            TreeError: No parameter has the name, or a value is outside its bounds.
        """
        result = {p.name: p for p in declared}
        patterns = self._of("parameters")
        for p in optional:
            kind = p.name.partition("(")[0] + "("
            if any(pattern.startswith(kind) and fnmatchcase(p.name, pattern) for pattern in patterns):
                result[p.name] = p
        for pattern, fields in patterns.items():
            found = self._matching(pattern, result, "parameter")
            for name in found:
                own = self._fields(pattern, fields)
                p = result[name]
                value = own.get("value", p.value)
                low, high = own.get("low", min(p.low, value)), own.get("high", max(p.high, value))
                try:
                    sd, guessed = own.get("prior_sd", p.prior_sd), p.guessed and "prior_sd" not in own
                    result[name] = replace(p, value=value, low=low, high=high, prior_sd=sd, guessed=guessed)
                except ParameterError as error:
                    raise self._error(str(error)) from None
        return tuple(result.values())

    def channels(self, measurements: Iterable[Channel]) -> tuple[Channel, ...]:
        """The measurements with the noise and the zeros given here."""
        result = {c.name: c for c in measurements}
        for key, field in (("noise", "noise_sd"), ("zero_sd", "zero_sd")):
            for pattern, value in self._of(key).items():
                for name in self._matching(pattern, result, "measurement"):
                    own = result[name]
                    number = self._number(f"{key}: {pattern}", value, 0.0)
                    guessed = own.guessed and field != "noise_sd"
                    result[name] = replace(own, **{field: number, "guessed": guessed})
        return tuple(result.values())

    def tip(self, sites: Iterable[str], otherwise: str) -> str:
        """Place of the payload."""
        given = self.given.get("payload", otherwise)
        known = tuple(sites)
        if given not in known:
            raise self._error(
                f'payload: there is no place "{given}"{did_you_mean(str(given), known) or ";"} '
                f"known: {', '.join(known)}"
            )
        return given

    def _with_servos(self, tree: Tree) -> Tree:
        servos = self._of("servos")
        if not servos:
            return tree
        if not tree.without_actuators:
            raise self._error(
                "servos: the model has actuators of its own; change them there, or take this key out"
            )
        actuators = {tree.joints[a.joint].name: a for a in tree.actuators}
        for pattern, fields in servos.items():
            for name in self._matching(pattern, actuators, "joint"):
                actuators[name] = self._servo(actuators[name], pattern, fields)
        return replace(tree, actuators=tuple(actuators.values()))

    def _servo(self, actuator: Actuator, pattern: str, fields: Any) -> Actuator:
        where = f"servos: {pattern}"
        if not isinstance(fields, Mapping) or "kp" not in fields or set(fields) - {"kp", "kv", "force"}:
            raise self._error(f"{where}: expected {{kp: ..., kv: ..., force: ...}}, of which kp is needed")
        kp, kv = self._number(where, fields["kp"], 0.0), self._number(where, fields.get("kv", 0.0), 0.0)
        limit = self._number(where, fields.get("force", math.inf), 0.0)
        limit = min(limit, actuator.high)
        return replace(
            actuator, gain=(kp, 0.0, 0.0), bias=(0.0, -kp, -kv), low=-np.inf, high=np.inf, force_low=-limit,
            force_high=limit,
        )  # fmt: skip

    def _of(self, key: str) -> Mapping[str, Any]:
        found = self.given.get(key) or {}
        if not isinstance(found, Mapping):
            raise self._error(f"{key}: expected names and values, got {found!r}")
        return {str(name): value for name, value in found.items()}

    def _fields(self, name: str, given: Any) -> dict[str, float]:
        if not isinstance(given, Mapping):
            return {"value": self._number(name, given)}
        for field in given:
            if field not in FIELDS:
                raise self._error(f'{name}: unknown "{field}"; known: {", ".join(FIELDS)}')
        return {str(field): self._number(f"{name}: {field}", value) for field, value in given.items()}

    def _number(self, where: str, given: Any, least: float = -math.inf) -> float:
        if (
            isinstance(given, bool)
            or not isinstance(given, int | float)
            or math.isnan(given)
            or given < least
        ):
            kind = "a number" if math.isinf(least) else f"a number of at least {least:g}"
            raise self._error(f"{where}: expected {kind}, got {given!r}")
        return float(given)

    def _matching(self, pattern: str, names: Iterable[str], kind: str) -> list[str]:
        known = list(names)
        found = [name for name in known if fnmatchcase(name, pattern)]
        if not found:
            hint = did_you_mean(pattern, known) or ";"
            raise self._error(f'there is no {kind} "{pattern}"{hint} known: {", ".join(known)}')
        return found

    def _error(self, text: str) -> TreeError:
        return TreeError(f"{self.source}: {text}")
