"""What a user's system has to declare: completed where a default makes sense, checked when the system is made."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

from deepkoco.systems.channel import Channel
from deepkoco.systems.named_joints import COMMON, UNREADABLE
from deepkoco.systems.parameter import Parameter

COORDINATES = ("rad", "m")
EXAMPLES = {
    "parameters": 'parameters = (Parameter("mass", 0.6, "kg", 0.1, 5.0, 0.02, "m"),)',
    "commands": 'commands = (Channel("force", "N", "command", -10.0, 10.0),)',
    "measurements": 'measurements = (Channel("position", "m", "measurement", noise_sd=1e-4),)',
    "inertia": "def inertia(self, parameters)",
    "torque_law": "def torque_law(self, parameters)",
    "command": 'command = Channel("torque", "N m", "command", -2.0, 2.0)',
}


class DeclarationError(ValueError):
    """A system declares too little, or what it declares does not go together; the message says what to write."""


def complete(system: Any) -> None:
    """Derive number of joints, states and name from what a system declares."""
    if not isinstance(getattr(system, "name", None), str):
        system.name = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", type(system).__name__).lower()
    given = getattr(system, "joint_units", None)
    units = (given,) if isinstance(given, str) else tuple(given or ())
    named = vars(type(system)).get("joint_names")
    if not hasattr(system, "joints"):
        if units:
            system.joints = len(units)
        elif hasattr(system, "state_units"):
            system.joints = len(system.state_units) // 2
        elif isinstance(named, tuple):
            system.joints = len(named)
    if units and not hasattr(system, "state_units"):
        system.state_units = (*units, *(f"{unit}/s" for unit in units))
    if hasattr(system, "state_units") and not hasattr(system, "state_names"):
        names = system.joint_names
        if len(system.state_units) == 2 * len(names):
            system.state_names = (*names, *(f"{name} speed" for name in names))


def check_declaration(system: Any) -> None:
    """Check that what a system declares goes together.

    Raises:
        DeclarationError: They do not; the message names class, joint, channel or parameter, and what to write.
    """
    who = type(system).__name__
    if not isinstance(getattr(system, "joints", None), int) or not hasattr(system, "state_units"):
        raise DeclarationError(
            f'{who}: say which joints it has: joint_units = ("m", "rad") for one that slides, one that turns'
        )
    for name, kind in (("parameters", Parameter), ("commands", Channel), ("measurements", Channel)):
        _check_tuple(who, name, getattr(system, name, None), kind)
    _check_states(who, system)
    _check_names(who, "parameters", system.parameters)
    _check_names(who, "channels", (*system.commands, *system.measurements))
    _check_commands(who, system)
    _check_measurements(who, system)


def lacks(who: str, name: str) -> str:
    """Return the sentence that says what a class lacks, with a line that declares it."""
    return f"{who} lacks {name}: write {EXAMPLES[name]}"


def _check_tuple(who: str, name: str, given: Any, kind: type) -> None:
    if given is None:
        raise DeclarationError(lacks(who, name))
    if isinstance(given, kind):
        raise DeclarationError(f"{who}: {name} is one {kind.__name__}, not a tuple: put a comma behind it")
    if not isinstance(given, Sequence) or not all(isinstance(each, kind) for each in given):
        raise DeclarationError(f"{who}: {name} = {given!r:.80}; give a tuple: {EXAMPLES[name]}")
    if not given and name == "measurements":
        raise DeclarationError(lacks(who, name))
    if not given and name == "commands":
        raise DeclarationError(
            f"{who}: commands is empty. For a body that swings freely, declare a push that logs do not show, "
            'commands = (Channel("push", "N m", "command", -1.0, 1.0, default=0.0),), and add it to the loads'
        )


def _check_states(who: str, system: Any) -> None:
    joints, names, units = system.joints, getattr(system, "state_names", ()), system.state_units
    if isinstance(system.joint_names, str) or len(system.joint_names) != joints:
        raise DeclarationError(
            f"{who}: joint_names = {system.joint_names!r}: give a tuple with a name for each of {joints} joints"
        )
    if joints < 1 or len(names) != len(units) or len(units) != 2 * joints:
        raise DeclarationError(
            f"{who}: {joints} joints, {len(names)} state_names and {len(units)} state_units: a state holds "
            "the position of each joint, then the speed of each"
        )
    system.at_joint("name", 0)
    for joint, (position, speed) in enumerate(zip(units[:joints], units[joints : 2 * joints], strict=True)):
        if position not in COORDINATES or speed != f"{position}/s":
            raise DeclarationError(
                f"{who}: {system.joint_names[joint]} has the units {position} and {speed}; a joint that "
                "turns has rad and rad/s, one that slides m and m/s; a log may use other units of them, and other "
                "quantities, such as a temperature or a pressure, are no joints"
            )


def _check_names(who: str, what: str, entries: Sequence[Any]) -> None:
    names = [entry.name for entry in entries]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise DeclarationError(f'{who}: two {what} are called "{twice[0]}"; give each a name of its own')


def _check_commands(who: str, system: Any) -> None:
    for command in system.commands:
        if command.kind != "command":
            raise DeclarationError(
                f'{who}: {command.name} is among the commands, and its kind is "{command.kind}"; write "command"'
            )
        if not (math.isfinite(command.low) and math.isfinite(command.high) and command.low < command.high):
            raise DeclarationError(
                f"{who}: {command.name} goes from {command.low:g} to {command.high:g} {command.unit}; give the "
                f'limits of the actuator: Channel("{command.name}", "{command.unit}", "command", LOW, HIGH)'
            )
    driven = system.command_joints
    if len(driven) > len(system.commands) or any(not 0 <= joint < system.joints for joint in driven):
        raise DeclarationError(
            f"{who}: {len(system.commands)} commands on {system.joints} joints, command_joints = {driven}: give "
            "the index of the joint that each command drives; two commands may drive one joint"
        )
    sharing = [c.name for c, joint in zip(system.commands, driven, strict=False) if driven.count(joint) > 1]
    if COMMON in sharing:
        raise DeclarationError(
            f'{who}: the command "{COMMON}" drives a joint together with another one; give it another name: '
            f'"gain({COMMON})" is the gain that all commands have in common'
        )
    unclear = [name for name in sharing if name in system.joint_names or set(name) & set(UNREADABLE)]
    if unclear:
        raise DeclarationError(
            f'{who}: the command "{unclear[0]}" drives a joint together with another one, so effects are named after '
            f"it; give it a name that no joint has, without {UNREADABLE}"
        )


def _check_measurements(who: str, system: Any) -> None:
    for channel in system.measurements:
        if channel.kind != "measurement":
            raise DeclarationError(
                f'{who}: {channel.name} is a measurement, and its kind is "{channel.kind}"; write "measurement"'
            )
        if not channel.noise_sd > 0:
            raise DeclarationError(
                f"{who}: {channel.name} has no noise; give the sensor's typical one: noise_sd=0.001 [{channel.unit}]"
            )
    if not system.shows_states:
        return  # its sensors show something of its own
    shown = system.measured_states
    known = all(isinstance(s, int) and 0 <= s < len(system.state_units) for s in shown)
    if len(shown) != len(system.measurements) or not known:
        raise DeclarationError(
            f"{who}: {len(system.measurements)} measurements, measured_states = {shown}, {len(system.state_units)} "
            "states: give the index of the state that each measurement shows"
        )
    for channel, state in zip(system.measurements, shown, strict=True):
        if channel.unit != system.state_units[state]:
            raise DeclarationError(
                f"{who}: {channel.name} is in {channel.unit}, and the state that it shows, "
                f"{system.state_names[state]}, in {system.state_units[state]}; give the unit in SI "
                "(a log may use another), or measured_states"
            )
