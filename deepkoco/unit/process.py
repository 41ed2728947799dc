"""A unit in a process of its own, in wall-clock time, reached only through its two channels."""

from __future__ import annotations

import math
import os
import select
import socket
import subprocess
import sys
import time
from collections import deque
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

from deepkoco.unit.messages import (
    COMMAND_FRAME,
    FrameReader,
    Order,
    SensorMessage,
    UnitError,
    sensor_frame,
)
from deepkoco.unit.spec import UnitSpec

START_TIMEOUT = 20.0  # a busy machine needs its time to start a process [s]


class Unit:
    """Client of a unit that runs in wall-clock time.

    The unit is reached as a robot is: commands go out on one channel, measurements come in on another.
    Time stamps are taken here, when a message really goes out or comes in. Where the client dies, closes
    or lets the heartbeat pass without a command, the unit sets its command to zero.

        with Unit(load_unit("UNIT.yaml")) as unit:
            unit.reset()
            message = unit.receive()
            unit.send(0.5)

    Args:
        spec: The unit.
        timeout: Longest wait for an answer [s].
    """

    clock = "wall"

    def __init__(self, spec: UnitSpec, timeout: float = 2.0) -> None:
        self.spec = spec
        self.timeout = timeout
        self._process: subprocess.Popen[bytes] | None = None
        self._epoch = 0

    def __getstate__(self) -> dict[str, Any]:
        if self._process is not None:
            raise TypeError(
                f'unit "{self.spec.name}" runs in real time: it cannot be copied or pickled; close it first'
            )
        return self.__dict__

    def __enter__(self) -> Unit:
        if self._process is not None:
            raise UnitError(f'unit "{self.spec.name}" is running already')
        commands, far_commands = socket.socketpair()
        sensor, far_sensor = socket.socketpair()
        far = (far_commands.fileno(), far_sensor.fileno())
        # The same package as here, whether or not it is installed; -P keeps the working folder out.
        path = (str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH"))
        # A process of its own group: Ctrl-C reaches the client alone, which then stops the unit.
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", "deepkoco.unit.server", *map(str, far)],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, path))},
            stdin=subprocess.PIPE,
            stderr=subprocess.PIPE,
            pass_fds=far,
            start_new_session=True,
        )
        far_commands.close()
        far_sensor.close()
        self._process, self._commands, self._sensor = process, commands, sensor
        self._reader = FrameReader(sensor_frame(len(self.spec.sensor.noise_sd)))
        self._received: deque[SensorMessage] = deque()
        self._epoch = 0
        self._origin = time.monotonic_ns()
        assert process.stdin is not None
        try:
            process.stdin.write(self.spec.to_json().encode())
            process.stdin.close()
            if self.poll(START_TIMEOUT) is None:
                raise UnitError(f'unit "{self.spec.name}" does not start within {START_TIMEOUT:g} s')
        except BrokenPipeError:
            error = self._death()
            self.close()
            raise error from None
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def pid(self) -> int | None:
        """Process of the unit, None where it is not running."""
        return None if self._process is None else self._process.pid

    def now(self) -> float:
        """Time since the last reset of the client's clock [s]."""
        return (time.monotonic_ns() - self._origin) * 1e-9

    def send(self, command: float) -> float:
        """Send a command.

        Args:
            command: In the command's unit; the unit cuts it to its limits.

        Returns:
            When it was sent [s].

        Raises:
            UnitError: The unit is gone or takes no commands.
            ValueError: The command is not finite.
        """
        if not math.isfinite(command):
            raise ValueError(f"command {command} is not finite")
        stamp = self.now()
        self._write(COMMAND_FRAME.pack(Order.COMMAND, self._epoch, command, 0.0))
        return stamp

    def receive(self, timeout: float | None = None) -> SensorMessage:
        """Wait for the next measurement, the oldest one not taken yet.

        Args:
            timeout: Longest wait [s]; None takes the unit's.

        Raises:
            UnitError: None came in time, or the unit has died.
        """
        limit = self.timeout if timeout is None else timeout
        message = self.poll(limit)
        if message is None:
            raise UnitError(f'unit "{self.spec.name}" sends no measurement within {limit:g} s')
        return message

    def poll(self, timeout: float) -> SensorMessage | None:
        """As :meth:`receive`, but None where no measurement comes within ``timeout`` [s].

        Raises:
            UnitError: The unit has died.
        """
        deadline = self.now() + timeout
        while not self._received:
            ready, _, _ = select.select([self._running()], [], [], max(0.0, deadline - self.now()))
            if not ready:
                return None
            self._read()
        return self._received.popleft()

    def reset(self, state: tuple[float, float] | None = None) -> SensorMessage:
        """Put the unit into a state, at zero command, and set its time and the client's to 0.

        Args:
            state: Angle [rad] and speed [rad/s]; None takes the initial state of the unit.

        Returns:
            First measurement after the reset.

        Raises:
            UnitError: The unit does not answer.
            ValueError: The state is not finite.
        """
        order = Order.HOME if state is None else Order.RESET
        theta, omega = (0.0, 0.0) if state is None else (float(state[0]), float(state[1]))
        if not (math.isfinite(theta) and math.isfinite(omega)):
            raise ValueError(f"state ({theta}, {omega}) is not finite")
        self._epoch += 1
        self._received.clear()
        self._origin = time.monotonic_ns()
        self._write(COMMAND_FRAME.pack(order, self._epoch, theta, omega))
        return self.receive()

    def close(self) -> None:
        """Stop the unit and its process; safe to call twice."""
        process, self._process = self._process, None
        if process is None:
            return
        self._commands.close()  # the unit takes this as the end
        self._sensor.close()
        try:
            process.wait(2.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        for stream in (process.stdin, process.stderr):
            if stream is not None and not stream.closed:
                with suppress(BrokenPipeError):  # it died before it read its spec
                    stream.close()

    def _running(self) -> socket.socket:
        if self._process is None:
            raise UnitError(f'unit "{self.spec.name}" is not running; use it as "with Unit(spec) as unit:"')
        return self._sensor

    def _write(self, frame: bytes) -> None:
        self._running()
        try:
            self._commands.settimeout(self.timeout)
            self._commands.sendall(frame)
        except TimeoutError:
            raise UnitError(f'unit "{self.spec.name}" takes no command within {self.timeout:g} s') from None
        except OSError:
            raise self._death() from None

    def _read(self) -> None:
        # One frame at a time, so that messages that have piled up each get a stamp of their own.
        try:
            data = self._sensor.recv(self._reader.missing)
        except OSError:
            data = b""
        stamp = self.now()
        if not data:
            raise self._death()
        for epoch, stops, seq, *values in self._reader.feed(data):
            if epoch == self._epoch:
                self._received.append(SensorMessage(tuple(values), seq, stamp, stops))

    def _death(self) -> UnitError:
        process = self._process
        assert process is not None
        try:
            code = process.wait(1.0)
        except subprocess.TimeoutExpired:
            return UnitError(f'unit "{self.spec.name}" has closed its channels')
        last = (process.stderr.read().decode(errors="replace").strip() if process.stderr else "").splitlines()
        return UnitError(
            f'unit "{self.spec.name}" has died (exit status {code})' + (f": {last[-1]}" if last else "")
        )
