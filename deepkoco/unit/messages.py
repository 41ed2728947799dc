"""What passes between a unit and its user, as objects and as frames on the two channels."""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import NamedTuple


class UnitError(RuntimeError):
    """The unit does not answer, has died or cannot be started."""


class SensorMessage(NamedTuple):
    """One measurement as it reached the user of the unit."""

    values: tuple[float, ...]  # in the order of the system's measurements
    seq: int  # number of the sample since the last reset; a gap means that samples were lost
    t_received: float  # when the user's side took it [s], on the clock of the unit's `now`
    stops: int  # how often the unit has stopped itself since the last reset: no heartbeat, or a command not finite


class Order(IntEnum):
    """What a frame on the command channel asks for."""

    COMMAND = 0
    RESET = 1
    HOME = 2  # reset to the initial state of the unit


COMMAND_FRAME = struct.Struct("<BIdd")  # order, epoch, (command, unused) or (angle, speed)


def sensor_frame(measurements: int) -> struct.Struct:
    """Frame of the sensor channel: epoch, stops, sample number, values.

    The epoch counts resets: a message from before a reset is known by it and dropped.
    """
    return struct.Struct(f"<IIQ{measurements}d")


class FrameReader:
    """Cuts the byte stream of one channel into frames."""

    def __init__(self, frame: struct.Struct) -> None:
        self._frame = frame
        self._rest = b""

    @property
    def missing(self) -> int:
        """Bytes that complete the next frame."""
        return self._frame.size - len(self._rest)

    def feed(self, data: bytes) -> list[tuple]:
        """Frames completed by ``data``, oldest first."""
        data = self._rest + data
        whole = len(data) - len(data) % self._frame.size
        self._rest = data[whole:]
        return list(self._frame.iter_unpack(data[:whole]))
