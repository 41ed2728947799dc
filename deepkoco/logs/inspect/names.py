"""Read the name of a column: quantity, unit, joint, and whether it is a command, a goal or a measurement."""

from __future__ import annotations

import re
from dataclasses import dataclass

from deepkoco.logs.units import UnitError, known_units, parse_unit, usual_spelling

# Evidence of a word for a quantity [nats].
WORDS: dict[str, dict[str, float]] = {
    "angle": {
        **dict.fromkeys(("theta", "angle", "jpos", "qpos", "winkel"), 3.0),
        **dict.fromkeys(("pos", "position", "q", "phi", "alpha", "encoder", "enc", "th", "positions"), 2.0),
        **dict.fromkeys(("beta", "psi", "pitch", "roll", "yaw", "joint", "rot", "rotation"), 1.0),
        **dict.fromkeys(("gamma", "delta", "tilt", "lean", "heading"), 1.0),
    },
    "angular velocity": {
        **dict.fromkeys(
            ("omega", "vel", "velocity", "speed", "dq", "qdot", "qvel", "jvel", "velocities"), 3.0
        ),
        **dict.fromkeys(("dtheta", "thetadot", "angvel", "qd", "gyro", "gyr", "dphi", "dalpha", "dpos"), 3.0),
        **dict.fromkeys(("drehzahl", "winkelgeschwindigkeit"), 3.0),
        **dict.fromkeys(("rate", "w", "spd"), 1.0),
    },
    "angular acceleration": dict.fromkeys(("acc", "accel", "acceleration", "ddq", "qdd", "ddtheta"), 3.0),
    "torque": {
        **dict.fromkeys(("torque", "tau", "trq", "drehmoment"), 3.0),
        **dict.fromkeys(("effort", "moment", "tq", "efforts"), 2.0),
        **dict.fromkeys(("u", "input", "command", "cmd", "action", "control", "data", "t", "m"), 1.0),
    },
    "voltage": {
        **dict.fromkeys(("voltage", "volt", "volts", "spannung"), 3.0),
        **dict.fromkeys(("u", "input", "command", "cmd", "action", "control", "pwm", "data"), 1.0),
        "v": 0.5,
    },
    # "cur" is also the present one: `cur_pos` is a position.
    "current": {
        **dict.fromkeys(("current", "curr", "amps", "strom"), 3.0),
        **dict.fromkeys(("i", "cur"), 1.0),
    },
    "force": {
        **dict.fromkeys(("force", "thrust", "kraft"), 3.0),
        **dict.fromkeys(("u", "input", "command", "cmd", "f"), 1.0),
    },
    "ratio": {
        **dict.fromkeys(("throttle", "duty", "pwm", "dutycycle"), 3.0),
        **dict.fromkeys(("u", "input", "command", "cmd", "action", "control", "data"), 1.0),
    },
    "length": {
        **dict.fromkeys(("x", "y", "z", "height", "altitude", "pos", "position", "weg", "hub"), 2.0),
        **dict.fromkeys(("travel", "stroke", "displacement"), 2.0),
    },
    "velocity": dict.fromkeys(("vx", "vy", "vz", "vel", "velocity", "speed", "geschwindigkeit"), 2.0),
    # No channel of a robot: what a recorder writes beside the motion.
    "another": {
        **dict.fromkeys(
            ("temp", "temperature", "temperatur", "humidity", "pressure", "battery", "akku"), 3.0
        ),
        **dict.fromkeys(("soc", "cpu", "rssi", "celsius", "degc"), 3.0),
    },
    "time": {
        **dict.fromkeys(("time", "timestamp", "stamp", "t", "ts", "datetime", "date", "zeit"), 3.0),
        **dict.fromkeys(
            ("sec", "secs", "seconds", "clock", "ms", "msec", "millis", "us", "usec", "micros"), 2.0
        ),
        **dict.fromkeys(("ns", "nsec", "nanos", "uptime", "elapsed"), 2.0),
    },
}
CLEAR = 2.0  # evidence from which a word says a quantity whatever the other words are [nats]
_NO_TIMES = tuple(name for name in WORDS if name != "time")
COMMANDED = (
    "cmd",
    "command",
    "commanded",
    "con",
    "ctrl",
    "control",
    "action",
    "input",
    "u",
    "demand",
    "applied",
    "plant",
)
WANTED = (
    "des",
    "desired",
    "ref",
    "reference",
    "target",
    "goal",
    "setpoint",
    "set",
    "soll",
    "sollwert",
    "sp",
    "feedforward",
    "ff",
    "error",
    "err",
)
MEASURED = (
    "meas", "measured", "act", "actual", "fb", "feedback", "est", "state", "states", "filt", "ist", "istwert",
    "present",
)  # fmt: skip
COUNTING = ("episode", "seq", "index", "frame", "row", "step", "run", "trial", "unnamed", "iteration")
# Units at the end of a name.
SUFFIXES = {
    "rad": "rad", "deg": "deg", "degrees": "deg", "grad": "deg", "rad_s": "rad/s", "rad_per_s": "rad/s",
    "radps": "rad/s", "rads": "rad/s",
    "deg_s": "deg/s", "deg_per_s": "deg/s", "dps": "deg/s", "degps": "deg/s", "rpm": "rpm", "nm": "N m", "n_m": "N m",
    "mnm": "mN m", "s": "s", "sec": "s", "secs": "s", "seconds": "s", "ms": "ms", "msec": "ms", "millis": "ms",
    "us": "us",
    "usec": "us", "micros": "us", "ns": "ns", "nsec": "ns", "nanos": "ns", "volt": "V", "volts": "V", "mv": "mV",
    "v": "V", "m": "m", "mm": "mm", "cm": "cm", "um": "um", "pct": "%", "percent": "%",
    "mm_s": "mm/s", "mmps": "mm/s", "cm_s": "cm/s", "m_s": "m/s", "mps": "m/s", "cmps": "cm/s", "kmh": "km/h",
    "ma": "mA", "turns": "rev",
    "rev": "rev",
}  # fmt: skip


def said_by(quantity: str) -> set[str]:
    """Words that clearly say a quantity."""
    return {word for word, evidence in WORDS[quantity].items() if evidence >= CLEAR}


@dataclass(frozen=True)
class NameHints:
    """Parts of the name of a column.

    Attributes:
        words: its words in lower case, without unit and numbers.
        unit: unit in the name, None if there is none.
        number: number of the joint, None if there is none.
        joint: text in the last brackets, if it is not a unit.
        commanded, wanted, measured, counting: whether a word means a command, a goal, a measurement or a counter.
    """

    words: tuple[str, ...]
    unit: str | None
    number: int | None
    joint: str | None
    commanded: bool
    wanted: bool
    measured: bool
    counting: bool

    def speaks_for(self, quantity: str) -> float:
        """Evidence of the words for a quantity [nats]; negative if another quantity fits better.

        A time always grows, which the values show. So a word for it speaks for no column that is not asked for a time:
        the t of ``t_steer`` may be a torque.
        """
        scores = {name: self._score(name) for name in WORDS if name in (quantity, *_NO_TIMES)}
        others = max((score for name, score in scores.items() if name != quantity), default=0.0)
        own = scores.get(quantity, 0.0)
        return own if own >= others else own - others

    def _score(self, quantity: str) -> float:
        table = WORDS[quantity]
        score = max((table.get(word, 0.0) for word in self.words), default=0.0)
        derived = {"dot", "dt", "d", "derivative"} & set(self.words)
        if derived and quantity in ("angle", "length"):
            return 0.0
        if derived and quantity in ("angular velocity", "velocity"):
            base = "angle" if quantity == "angular velocity" else "length"
            return max(score, max((WORDS[base].get(word, 0.0) for word in self.words), default=0.0))
        return score


def read_name(name: str) -> NameHints:
    """Split a name such as `theta_deg`, `pos [rad]`, `tau_meas1` or `position[shoulder]` into its parts."""
    unit, joint, rest = None, None, name
    bracket = re.search(r"[\[(]([^\[\])(]*)[\])]\s*$", name)
    if bracket is not None:
        rest = name[: bracket.start()]
        inside = bracket.group(1).strip()
        # Text in brackets that is a known unit is taken as the unit, not as the name of a joint.
        if _known(inside) and not inside.isdecimal():
            unit = usual_spelling(inside)
        else:
            joint = inside
    parts = [part for part in re.split(r"[^A-Za-z0-9°%]+", rest) if part]
    if unit is None and joint is None:
        # Before words are split at capitals: "mNm" is a unit, not m and Nm.
        parts, unit = unit_suffix(parts, rest)
    parts = [word for part in parts for word in re.sub(r"([a-z])([A-Z])", r"\1_\2", part).split("_")]
    if unit is None and joint is None:
        parts, unit = unit_suffix(parts, rest)
    words: list[str] = []
    number = int(joint) if joint is not None and joint.isdecimal() else None
    for part in parts:
        match = re.fullmatch(r"([A-Za-z]*)(\d+)", part)
        if match is not None:
            number = int(match.group(2)) if number is None else number
            part = match.group(1)
        if part:
            words.append(part.lower())
    if unit is None and len(parts) == 1 and words == [parts[0].lower()] and _is_time(SUFFIXES.get(words[0])):
        unit = SUFFIXES[words[0]]  # a column that is called "ms" and nothing else
    found = set(words) if name.strip() else {"index"}  # a column without a name counts the rows
    return NameHints(
        tuple(words),
        unit,
        number,
        joint,
        *(bool(found & set(group)) for group in (COMMANDED, WANTED, MEASURED, COUNTING)),
    )


def unit_suffix(parts: list[str], name: str) -> tuple[list[str], str | None]:
    """The parts of a name without the unit that they end in, and that unit; None where they end in none."""
    for length in (3, 2, 1):
        if len(parts) > length:
            text = "_".join(parts[-length:])
            # "v_rev/s" and "v_rev_s": whatever stands between the two has been taken for a separator.
            spelled = (text, "/".join(parts[-length:]))
            unit = SUFFIXES.get(text.lower()) or next((t for t in spelled if t in known_units()), None)
            if unit is not None and not _another(unit, parts[:-length], name):
                return parts[:-length], unit
    return parts, None


def _another(unit: str, ahead: list[str], name: str) -> bool:
    """Whether the end of a name that is spelled as a unit means something else.

    A number counts joints, it is no ratio. "min" is a minimum, but after a slash, and in the name of a time.
    """
    minimum = unit.endswith("min") and not name.rstrip().endswith("/min")
    return unit.isdecimal() or (minimum and not {word.lower() for word in ahead} & set(WORDS["time"]))


def _is_time(unit: str | None) -> bool:
    return unit is not None and unit != "s" and parse_unit(unit).quantity == "time"


def _known(text: str) -> bool:
    try:
        parse_unit(text)
    except UnitError:
        return False
    return bool(text)
