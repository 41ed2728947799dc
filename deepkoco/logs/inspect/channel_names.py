"""Evidence that a column is named after a channel: words that tell this channel from the others of its kind."""

from __future__ import annotations

import re
from collections.abc import Sequence

from deepkoco.logs.inspect.joints.match import words_alike
from deepkoco.logs.inspect.names import COMMANDED, MEASURED, WANTED, WORDS
from deepkoco.logs.inspect.survey import ColumnSurvey
from deepkoco.logs.units import parse_unit
from deepkoco.systems import Channel

OWN_WORDS = 3.0  # evidence of a column with all words of a channel [nats]; less those of another channel
# These say what is measured, which the evidence of quantities counts already.
_GENERAL = {w for table in WORDS.values() for w, weight in table.items() if weight >= 2.0}
_GENERAL |= {*COMMANDED, *WANTED, *MEASURED}


def named_after(column: ColumnSurvey, channel: Channel, channels: Sequence[Channel]) -> float:
    """Evidence of the words in a column's name for a channel [nats], against the other channels of its kind.

    ``position[load]`` is the angle of the load and not that of the motor; ``throttle_L`` is the left throttle.
    """
    said = _words(" ".join((*column.hints.words, column.hints.joint or "")))
    alike = [c for c in channels if c.kind == channel.kind and _quantity(c) == _quantity(channel)]
    own = {c.name: _words(c.name) for c in alike}
    # Between channels of one kind, a general word tells them apart as well as any other: "sway_x" from "sway_y".
    common = set.intersection(*own.values()) if len(alike) > 1 else _GENERAL
    shares = {name: _share(words - common, said) for name, words in own.items()}
    mine = shares.pop(channel.name)
    return OWN_WORDS * (mine - max(shares.values(), default=0.0))


def is_commanded(column: ColumnSurvey) -> bool:
    """Whether the name of a column, or of its topic where the column says nothing, means a command or a goal."""
    hints = column.hints
    if hints.commanded or hints.wanted:
        return hints.commanded or not hints.measured
    topic = _words(column.topic)
    return not hints.measured and bool(topic & {*COMMANDED, *WANTED}) and not topic & {*MEASURED}


def _share(words: set[str], said: set[str]) -> float:
    if not words or not said:
        return 0.0
    return sum(max(words_alike(word, other) for other in said) for word in words) / len(words)


def _words(text: str) -> set[str]:
    spaced = re.sub(r"([a-z])([A-Z])", r"\1_\2", text).lower()
    words = {part for part in re.split(r"[^a-z]+", spaced) if part}
    return words | {word[:-1] for word in words if word in ("commands", "goals", "targets")}


def _quantity(channel: Channel) -> str:
    return parse_unit(channel.unit).quantity
