"""MuJoCo's messages on invalid models as one sentence with the way out."""

from __future__ import annotations

import re

_PATTERNS = (
    (
        r"mass and inertia of moving bodies must be larger than mjMINVAL.*?name '(?P<name>[^']*)'",
        'the body "{name}" moves and has no mass or no inertia; give it an <inertial> or a geom with a mass',
    ),
    (
        r"repeated name '(?P<name>[^']*)' in (?P<kind>\w+)(?:.*?line (?P<line>\d+))?",
        'two elements of the kind {kind} are called "{name}"{at}; give each a name of its own',
    ),
    (
        r"unrecognized element.*?Element '(?P<name>[^']*)'(?:, line (?P<line>\d+))?",
        'there is no element "{name}" at that place{at}; correct its name, or take it out',
    ),
    (
        r"unrecognized attribute: '(?P<name>[^']*)'.*?Element '(?P<kind>[^']*)'(?:, line (?P<line>\d+))?",
        'the element "{kind}" has no attribute "{name}"{at}; correct its name, or take it out',
    ),
    (
        r"Error opening file '(?P<name>[^']*)'(?:.*?Element 'include', line (?P<line>\d+))?",
        'the file "{name}" that it names{at} is missing; put it there',
    ),
    (
        r"invalid joint type in URDF.*?(?:line (?P<line>\d+))",
        "a joint{at} has a type that URDF does not know; use revolute, continuous, prismatic or fixed",
    ),
    (
        r"inertia must satisfy A \+ B >= C.*?name '(?P<name>[^']*)'",
        'the inertia of the body "{name}" belongs to no body of matter: each principal moment must be at most the sum '
        "of the two others; correct it",
    ),
)


def in_one_sentence(message: str) -> str:
    """What is wrong with a model and how to mend it, without the path.

    Args:
        message: MuJoCo's message, of one or several lines.
    """
    text = " ".join(message.split())
    for pattern, sentence in _PATTERNS:
        if found := re.search(pattern, text):
            named = found.groupdict()
            at = f" in line {named['line']}" if named.get("line") else ""
            return sentence.format(**{**named, "at": at})
    lines = [line.strip().rstrip(".") for line in message.splitlines() if line.strip()]
    plain = [
        re.sub(r"^((XML|URDF)?\s*(parse )?error|schema violation)\s*:\s*", "", x, flags=re.I) for x in lines
    ]
    return f"MuJoCo cannot compile it: {'; '.join(x for x in plain if x)}"


def missing_file(message: str) -> str | None:
    """Name of the asset's file that MuJoCo could not open; None if the message is about something else."""
    found = re.search(r"Error opening file '([^']*)'", message)
    if found is None or "Element 'include'" in message:
        return None
    return found.group(1) if found.group(1) else None


def massless_body(message: str) -> str | None:
    """Name of the body that moves and has no mass or no inertia; None if the message is about something else."""
    found = re.search(_PATTERNS[0][0], " ".join(message.split()))
    return None if found is None else found["name"]
