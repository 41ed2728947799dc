"""The process of a unit: its physics in wall-clock time between a command and a sensor channel.

Started by :class:`deepkoco.unit.process.Unit` as ``python -m deepkoco.unit.server COMMAND SENSOR`` with the
descriptors of two connected sockets, and the spec as JSON on standard input.
"""

from __future__ import annotations

import gc
import math
import select
import socket
import sys
import time

from deepkoco.unit.messages import COMMAND_FRAME, FrameReader, Order, sensor_frame
from deepkoco.unit.plant import Plant
from deepkoco.unit.spec import UnitSpec


class SensorChannel:
    """Sends measurements and never waits: what does not fit into the channel is lost."""

    def __init__(self, channel: socket.socket) -> None:
        channel.setblocking(False)
        self._channel = channel
        self._rest = b""  # end of a frame that was sent in part

    def send(self, frame: bytes) -> None:
        """Send one frame, or lose it.

        Raises:
            OSError: The other side is gone.
        """
        try:
            if self._rest:
                self._rest = self._rest[self._channel.send(self._rest) :]
            if not self._rest:
                self._rest = frame[self._channel.send(frame) :]
        except BlockingIOError:
            return


def serve(spec: UnitSpec, commands: socket.socket, sensor: SensorChannel) -> None:
    """Run the unit until the other side closes the command channel.

    The schedule is absolute: sample k is due at k/rate after the last reset, however late the one
    before it was. A sample is taken when the loop wakes and shows the state at that moment, as an
    encoder does that is polled; a tick that has passed altogether is skipped and leaves a gap in the
    sample numbers.
    """
    reader = FrameReader(COMMAND_FRAME)
    frame = sensor_frame(len(spec.sensor.noise_sd))
    period = 1.0 / spec.sensor.rate_hz
    epoch, tick = 0, 0
    plant, origin = Plant(spec), time.monotonic_ns()
    while True:
        now = (time.monotonic_ns() - origin) * 1e-9
        wake = min(tick * period, plant.next_departure)
        ready, _, _ = select.select([commands], [], [], max(0.0, wake - now))
        now = (time.monotonic_ns() - origin) * 1e-9
        plant.advance(now)
        if ready:
            data = commands.recv(4096)
            if not data:
                return
            for order, number, first, second in reader.feed(data):
                if order == Order.COMMAND:
                    plant.send(first)
                    continue
                if not (math.isfinite(first) and math.isfinite(second)):
                    plant.refuse()
                    continue
                state = None if order == Order.HOME else (first, second)
                plant, origin = Plant(spec, state, stream=number), time.monotonic_ns()
                epoch, tick, now = number, 0, 0.0
            plant.advance(now)
        if now >= tick * period:
            tick = max(tick, int(now / period))
            plant.sample(tick)
            tick += 1
        for seq, values in plant.take():
            sensor.send(frame.pack(epoch, plant.stops, seq, *values))


def main(arguments: list[str]) -> int:
    """Run the unit whose channels the arguments name."""
    command_fd, sensor_fd = (int(text) for text in arguments)
    spec = UnitSpec.from_json(sys.stdin.read())
    gc.disable()  # nothing here makes reference cycles, and a collection would delay a sample
    commands = socket.socket(fileno=command_fd)
    sensor = SensorChannel(socket.socket(fileno=sensor_fd))
    try:
        serve(spec, commands, sensor)
    except ConnectionError:
        return 0  # the other side is gone
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
