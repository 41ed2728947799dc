"""Group the columns of a log by joint: position, speed, goal and effort of each."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from deepkoco.logs.inspect.evidence import POSITIONS, SPEEDS
from deepkoco.logs.inspect.names import COMMANDED, WANTED, read_name, said_by, unit_suffix
from deepkoco.logs.inspect.survey import ColumnSurvey
from deepkoco.logs.units import parse_unit

GOAL = {*COMMANDED, *WANTED, "commands", "goals", "actions", "targets", "trajectory", "controls"}
MEASURED = {
    "meas",
    "measured",
    "actual",
    "feedback",
    "observation",
    "state",
    "states",
    "ist",
    "istwert",
    "present",
}
# A short word for a length is as often a name: x, y and z of an axis, the hub of a wheel.
POSITION = {*said_by("angle"), "angles", *(word for word in said_by("length") if len(word) > 3)}
SPEED = {*said_by("angular velocity"), *(word for word in said_by("velocity") if len(word) > 2)}
EFFORT = {*said_by("torque"), *said_by("force"), *said_by("current"), "load", "torques", "currents"}
LOADS = ("torque", "force")
EFFORTS = (*LOADS, "current", "voltage")
RATES = {"angle": "angular velocity", "length": "velocity"}
FILLER = {
    "joint",
    "joints",
    "dof",
    "points",
    "main",
    "data",
    "motor",
    "motors",
    "interface",
    "values",
    "value",
    "act",
    "cur",
}
# Letters by which formulas call a quantity, and columns what they hold in its unit.
SYMBOLS = {
    "angular velocity": ("n", "w"), "velocity": ("v",), "torque": ("m", "t"), "force": ("f",), "current": ("i",),
    "voltage": ("u",),
}  # fmt: skip
MOTORS, ELECTRIC = {"motor", "motors"}, ("current", "voltage")
GOALS = {"position": "goal", "speed": "goal speed", "effort": "goal effort"}
DRIVEN = {"goal", "goal speed", "effort", "goal effort"}
_ROLE_WORDS = GOAL | MEASURED | POSITION | SPEED | EFFORT | FILLER


@dataclass
class LogJoint:
    """The columns of one joint.

    Attributes:
        label: name of the joint in the log, in lower case.
        columns: "position", "speed", "goal" or "effort" -> column; "goal effort" is a commanded effort, "goal speed" a
            commanded speed.
    """

    label: str
    columns: dict[str, ColumnSurvey] = field(default_factory=dict)


def log_joints(
    columns: Sequence[ColumnSurvey],
    joints: Sequence[str] = (),
    units: Sequence[str] = ("rad", "m"),
    passive: int = 0,
) -> list[LogJoint]:
    """Group columns by joint, in the order of the log; joints without a position are left out.

    A column whose words say no role has the one that its unit says: ``A1[deg]`` is a position, ``M1[Nm]`` an effort.
    A column that is called as a joint of the model, ``tilt``, is a position where it has no unit. A unit alone speaks
    less than words: where words name positions for all joints of the model, ``level[deg]`` is no joint. Nor is
    ``box_x[m]`` where each joint that words name has a goal or an effort, and the model has no joint without one.

    Args:
        columns: Those of the log.
        joints: Names of the model's joints.
        units: Of the positions of the model's joints; a length is no position of a robot that has no slide.
        passive: Number of the model's joints that no command drives.
    """
    found: dict[str, LogJoint] = {}
    said: set[str] = set()
    by_unit: set[str] = set()
    known = {"_".join(words_of(name)) for name in joints}
    fitting = {parse_unit(unit).quantity for unit in units}
    in_model = _as_in_model(columns, known)
    for column in columns:
        if not column.usable:
            continue
        role, label = role_of(column)
        own = known.intersection(words_of(column.name))
        label = own.pop() if not label and len(own) == 1 else label  # a joint may be called phi
        label = in_model.get(label, label)
        role = role if _fits(column, role, fitting) else None
        if role == "position" or label in known:
            said.add(label)
        if role is None:
            role = _role_by_unit(column, named=label in known) or ("position" if label in known else None)
            by_unit |= set() if role is None or label in known else {label}
        if role is not None and _fits(column, role, fitting):
            found.setdefault(label, LogJoint(label)).columns.setdefault(role, column)
    _take_states(columns, found)
    _join_goals(found)
    _join_by_units(found, by_unit)
    result = [joint for joint in found.values() if "position" in joint.columns]
    named = [joint for joint in result if joint.label in said]
    if joints and len(named) >= len(joints):
        return named
    if len(named) > 1 and all(DRIVEN & set(joint.columns) for joint in named):
        moved = [joint for joint in result if joint.label in said or DRIVEN & set(joint.columns)]
        loose = len(loose_goals(columns, result)) + len(loose_efforts(columns, result))
        if len(result) - len(moved) > passive + loose:
            return moved
    return result


def _take_states(columns: Sequence[ColumnSurvey], found: dict[str, LogJoint]) -> None:
    """Take `state_0`, `state_1` as positions where no name says a position, and each has its goal: `action_0`."""
    if any("position" in joint.columns for joint in found.values()):
        return
    words = {column.label: words_of(column.name) for column in columns if column.usable}
    states = {
        said[1]: column
        for column in columns
        if len(said := words.get(column.label, [])) == 2 and said[0] in MEASURED and said[1].isdecimal()
    }
    if states.keys() == {label for label, joint in found.items() if "goal" in joint.columns}:
        for label, column in states.items():
            found[label].columns["position"] = column


def _join_goals(found: dict[str, LogJoint]) -> None:
    """Give the columns of `q_d_0` and `tau_J_0` to the joint of `q_0`.

    A "d" in a name that is there without it too says "desired". A letter before a number says "joint".
    """
    for label, joint in list(found.items()):
        words = label.split("_")
        plain = "_".join(word for word in words if word != "d")
        if plain != label and plain in found and set(joint.columns) <= set(GOALS) & set(found[plain].columns):
            goals = found[plain].columns
            for role, column in joint.columns.items():
                goals.setdefault(GOALS[role], column)
            del found[label]
    for label, joint in list(found.items()):
        letter, _, number = label.partition("_")
        if len(letter) == 1 and number in found and number.isdecimal() and "position" not in joint.columns:
            for role, column in joint.columns.items():
                found[number].columns.setdefault(role, column)
            del found[label]


def _as_in_model(columns: Sequence[ColumnSurvey], known: set[str]) -> dict[str, str]:
    """Label -> name of the model's joint, which has a word more that says nothing: the 1 of `joint_1 position`."""
    found = {}
    said = [f"_{'_'.join(words_of(column.name))}_" for column in columns if column.usable]
    for name in known:
        label = "_".join(word for word in name.split("_") if word not in FILLER)
        if label != name and any(f"_{name}_" in words for words in said):
            found[label] = name
    return found


def _join_by_units(found: dict[str, LogJoint], by_unit: set[str]) -> None:
    """Give `Z_vitesse [mm/s]` and `Z_couple [Nm]` to the joint of `Z_pos`: units say what words do not.

    One word is more than the name of the joint has. Where two such columns have one role, the word tells two joints.
    """
    shorter: dict[str, list[str]] = {}
    for label in [label for label in found if label in by_unit]:
        words = label.split("_")
        for k in range(len(words)):
            if stem := "_".join(words[:k] + words[k + 1 :]):
                shorter.setdefault(stem, []).append(label)
    for stem, labels in shorter.items():
        own = [found[label] for label in labels if label in found]
        joint = found.get(stem, LogJoint(stem))
        roles = [role for other in (joint, *own) for role in other.columns]
        alone = all(len(other.columns) == 1 for other in own)
        if (
            not alone
            or len(own) + (stem in found) < 2
            or len(set(roles)) < len(roles)
            or "position" not in roles
        ):
            continue
        # The joint keeps the place of the first of its columns in the log.
        taken = {other.label for other in own} | {stem}
        for other in own:
            joint.columns |= other.columns
        kept = {
            stem if label in taken else label: joint if label in taken else j for label, j in found.items()
        }
        found.clear()
        found.update(kept)


def _fits(column: ColumnSurvey, role: str | None, fitting: set[str]) -> bool:
    """Whether the unit in a column's name, if there is one, is that of a position or a speed of the model's joints."""
    if column.hints.unit is None or role not in ("position", "speed", "goal speed"):
        return True
    quantity = parse_unit(column.hints.unit).quantity
    return quantity in (fitting if role == "position" else {RATES[own] for own in fitting})


def _role_by_unit(column: ColumnSurvey, *, named: bool = False) -> str | None:
    """Role that the unit in a column's name says; None where it says none.

    A voltage or a current may be that of a supply, so it drives a joint only where the column is ``named`` after one.
    """
    if column.hints.unit is None:
        return None
    quantity = parse_unit(column.hints.unit).quantity
    roles = {**dict.fromkeys(POSITIONS, "position"), **dict.fromkeys(SPEEDS, "speed")}
    return roles.get(quantity) or ("effort" if named or quantity in LOADS else None)


def loose_goals(columns: Sequence[ColumnSurvey], joints: Sequence[LogJoint]) -> list[ColumnSurvey]:
    """Columns of goals that belong to none of the joints by their names."""
    known = {column.label for joint in joints for column in joint.columns.values()}
    return [c for c in columns if c.usable and role_of(c)[0] == "goal" and c.label not in known]


def loose_efforts(columns: Sequence[ColumnSurvey], joints: Sequence[LogJoint]) -> list[ColumnSurvey]:
    """Columns of efforts that belong to none of the joints by their names, commanded ones first."""
    known = {column.label for joint in joints for column in joint.columns.values()}
    free = [c for c in columns if c.usable and c.label not in known]
    roles = [(c, role_of(c)[0] or _role_by_unit(c)) for c in free]
    return [c for role in ("goal effort", "effort") for c, own in roles if own == role]


def role_of(column: ColumnSurvey) -> tuple[str | None, str]:
    """What a column measures or commands, None if its name does not say it; and the name of the joint.

    The unit says what a goal is of: ``reach_cmd_Nm`` is an effort, and no position follows it.
    """
    role, label = role_in_name(column.name, column.topic)
    if column.hints.unit is None:
        return role, label
    quantity = parse_unit(column.hints.unit).quantity
    symbol, _, rest = label.partition("_")
    words = words_of(column.name)
    # `n_soll Lift [1/min]` and `i_q_X [A]` are of Lift and X, and `m_left_torque [Nm]` of a joint m_left.
    if rest and symbol in SYMBOLS.get(quantity, ()) and words[0] == symbol and words[1] in _ROLE_WORDS:
        label = rest
    if role == "position" and is_symbol_of(column):
        role = "effort"
    if role != "goal":
        return role, label
    return {**dict.fromkeys(SPEEDS, "goal speed"), **dict.fromkeys(EFFORTS, "goal effort")}.get(
        quantity, role
    ), label


def is_symbol_of(column: ColumnSurvey) -> bool:
    """Whether a name begins with the symbol of an effort in its unit: the q of ``i_q_X [A]`` is no position."""
    unit = column.hints.unit
    quantity = "" if unit is None else parse_unit(unit).quantity
    return quantity in EFFORTS and words_of(column.name)[:1] in ([own] for own in SYMBOLS.get(quantity, ()))


def role_in_name(name: str, topic: str = "") -> tuple[str | None, str]:
    """As :func:`role_of`, of a name in a table that is called ``topic``."""
    label = ""
    bracket = re.fullmatch(r"(.*)\[([^\[\]]*)\]", name)
    if bracket is not None and read_name(name).unit is None:
        name, label = bracket.group(1), bracket.group(2)
        if label.lower() in _ROLE_WORDS and (outer := re.search(r"\[([^\[\]]*)\]", name)) is not None:
            name, label = f"{name} {label}", outer.group(1)  # interface_values[shoulder].values[position]
    words = words_of(name)
    inner = words_of(label)
    if label:
        while len(inner) > 1 and inner[-1] in POSITION | SPEED | EFFORT:
            words.append(inner.pop())
    said = set(words)
    around = set(words_of(topic))
    goal = bool(said & GOAL) or (bool(around & GOAL) and not said & MEASURED and not around & MEASURED)
    if said & SPEED:
        role = "goal speed" if goal else "speed"
    elif said & EFFORT:
        role = "goal effort" if goal else "effort"
    elif goal:
        role = "goal"
    elif "cur" in said and not said & POSITION:
        role = "effort"  # a current; beside a position it is the present one
    else:
        role = "position" if said & (POSITION | {"observation"}) else None
    rest = inner if label else [word for word in words if word not in _ROLE_WORDS]
    kept = [word for word in rest if word not in FILLER] or rest
    return role, "_".join(kept)


def words_of(text: str) -> list[str]:
    """Words and numbers of a name in lower case, without a unit at its end."""
    plain = _without_unit(re.sub(r"\[[^\[\]]*\]", " ", text))
    spaced = re.sub(r"([a-z])([A-Z])", r"\1_\2", plain.replace("mNm", "mnm")).lower()
    words = [part for part in re.split(r"[^a-z0-9]+", spaced) if part]
    if len(words) > 1 and words[-1] in ("rad", "deg", "nm", "mnm", "rpm", "m", "mm", "cm"):
        words.pop()
    split: list[str] = []
    for word in words:
        match = re.fullmatch(r"([a-z]+)(\d+)", word)
        numbered = match is not None and match.group(1) in _ROLE_WORDS
        split += [match.group(1), match.group(2)] if match is not None and numbered else [word]
    return split


def _without_unit(name: str) -> str:
    """The name without the unit in which :func:`read_name` reads its column: ``pan_current_mA`` is of the joint pan.

    A letter may count joints: ``pos_a`` has no unit, and ``current_A`` is of a joint A. ``pan_current_A``, ``i_pan_A``
    and ``motor_x_A`` are in ampere, and ``cart_motor_cmd_N`` in newton.
    """
    parts = [part for part in re.split(r"[^A-Za-z0-9]+", name) if part]
    ahead, unit = unit_suffix(parts, name)
    end = {part.lower() for part in parts[len(ahead) :]}
    if unit is None or parse_unit(unit).quantity == "time" or end & _ROLE_WORDS:
        return name
    words = {part.lower() for part in ahead}
    letter = len(parts) - len(ahead) == 1 and max(map(len, end)) == 1
    quantity = parse_unit(unit).quantity
    electric = quantity in ELECTRIC and not words & (POSITION | SPEED)
    of_a_drive = {*MOTORS, *SYMBOLS.get(quantity, ())} if electric else set()
    if letter and (not words & (EFFORT | GOAL | of_a_drive) or words <= _ROLE_WORDS | of_a_drive):
        return name
    return "_".join(ahead)
