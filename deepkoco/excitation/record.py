"""Record a unit: drive it with an excitation, and log commands and measurements with their real times."""

from __future__ import annotations

import gc
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from deepkoco.excitation.excitation import make_excitation
from deepkoco.excitation.signal import Excitation
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import one_joint
from deepkoco.unit.messages import SensorMessage, UnitError
from deepkoco.unit.process import Unit
from deepkoco.unit.simulated import SimulatedUnit
from deepkoco.unit.spec import UnitSpec

DEFAULT_RATE = 50.0  # rate of the commands [Hz]
CLOCKS: dict[str, type[Unit] | type[SimulatedUnit]] = {"wall": Unit, "simulated": SimulatedUnit}


class RecordError(ValueError):
    """The clock, the length or the control rate of a recording is wrong, or a command is not finite."""


def record(
    spec: UnitSpec,
    excitation: str | Excitation,
    seconds: float,
    *,
    control_rate: float | None = None,
    clock: str = "wall",
    seed: int = 0,
    amplitude: float | None = None,
    meta: dict[str, Any] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Recording:
    """Drive a unit and record it.

    Each measurement gets the time at which it is received. If a control tick is due then, a command is sent and gets
    the time at which it is sent. The first command is zero.

    Args:
        spec: The unit.
        excitation: Name of an excitation, or (time [s], measurement) -> command.
        seconds: Length of the log [s].
        control_rate: Commands per second [Hz]; None takes 50, or the sensor's rate if that is smaller.
        clock: ``"wall"`` runs the unit in its own process in real time. ``"simulated"`` runs it in virtual time,
            with exact times and without waiting.
        seed: Seed of the excitation.
        amplitude: Largest command of a named excitation; None takes the system's limit.
        meta: Further facts for the log.
        progress: Called with the time recorded so far [s], after each measurement.

    Returns:
        The log, in the units of the system's channels; its time starts at the reset of the unit.

    Raises:
        ExcitationError: The excitation is unknown or too large.
        UnitError: The unit died, or stopped itself because commands came too late.
        RecordError: The clock is unknown, the length or the control rate does not fit the unit, or the excitation
            gives a command that is not finite.
    """
    if clock not in CLOCKS:
        raise RecordError(f'unknown clock "{clock}"; known: {", ".join(CLOCKS)}')
    if not 0.0 < seconds < math.inf:
        raise RecordError(
            f"seconds: {seconds:g} s is not the length of a log; give a positive number of seconds"
        )
    sensor_rate = spec.sensor.rate_hz
    rate = min(DEFAULT_RATE, sensor_rate) if control_rate is None else control_rate
    if not 1.0 / spec.heartbeat < rate <= sensor_rate:
        raise RecordError(
            f"control rate {rate:g} Hz does not suit the unit: give at most {sensor_rate:g} Hz (its sensor) "
            f"and more than {1.0 / spec.heartbeat:g} Hz (its heartbeat)"
        )
    named = excitation if isinstance(excitation, str) else "given"
    drive = (
        make_excitation(excitation, spec.system, seconds, seed, amplitude)
        if isinstance(excitation, str)
        else excitation
    )
    with _no_collection(), CLOCKS[clock](spec) as unit:
        messages, sent = _drive(unit, drive, seconds, rate, progress)
    if messages[-1].stops:
        raise UnitError(
            f'unit "{spec.name}" stopped itself {messages[-1].stops} times: no command came within '
            f"{spec.heartbeat:g} s, so the log is not valid; stop other programs or raise the heartbeat"
        )
    facts = {
        "clock": clock,
        "excitation": named,
        "seed": seed,
        "control_rate_hz": rate,
        "sensor_rate_hz": sensor_rate,
        "samples_lost": messages[-1].seq - messages[0].seq + 1 - len(messages),
    }
    return _recording(spec, messages, sent, {**facts, **(meta or {})})


def _drive(
    unit: Unit | SimulatedUnit,
    excitation: Excitation,
    seconds: float,
    rate: float,
    progress: Callable[[float], None] | None,
) -> tuple[list[SensorMessage], list[tuple[float, float]]]:
    # A tick is due half a sensor period early, so that jitter does not change the measurement that triggers it.
    early = 0.5 / unit.spec.sensor.rate_hz
    message = unit.reset()
    start = message.t_received
    messages, sent = [message], [(unit.send(0.0), 0.0)]
    tick = 1
    while True:
        message = unit.receive()
        if message.t_received > seconds:
            break
        messages.append(message)
        due = start + tick / rate - early
        if message.t_received >= due:
            command = excitation(message.t_received, message.values)
            if not math.isfinite(command):
                raise RecordError(
                    f"the excitation gives the command {command} at {message.t_received:.3f} s, which is not a finite "
                    f"number, for the measurement {message.values}"
                )
            sent.append((unit.send(command), command))
            tick = int((message.t_received - start + early) * rate + 1e-9) + 1
        if progress is not None:
            progress(message.t_received)
    unit.send(0.0)
    return messages, sent


@contextmanager
def _no_collection() -> Iterator[None]:
    """Switch off Python's garbage collector, whose pauses of tens of milliseconds would change the timing."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def _recording(
    spec: UnitSpec, messages: list[SensorMessage], sent: list[tuple[float, float]], meta: dict[str, Any]
) -> Recording:
    system = one_joint(spec.system)
    received = np.array([m.t_received for m in messages])
    values = np.array([m.values for m in messages])
    commands = np.array(sent)
    channels = {
        channel.name: Series(received, values[:, i], channel.unit, "measurement")
        for i, channel in enumerate(system.measurements)
    }
    command = Series(commands[:, 0], commands[:, 1], system.command.unit, "command")
    return Recording({system.command.name: command, **channels}, None, spec.system, meta)
