"""From commands to efforts, and from states to measurements."""

from __future__ import annotations

import torch
from torch import Tensor

from deepkoco.systems.channel import Channel
from deepkoco.systems.dry_friction import Levels
from deepkoco.systems.motion import CommandTiming, Delivery, Timing
from deepkoco.systems.parameter import Parameters


class SignalPath:
    """What actuators make of commands and sensors of states: all as it is for a plain system.

    `ExtendedSystem` puts effects of actuators, sensors and time here.

    Attributes:
        joints: How many joints.
        commands: The command channels, M of them.
        command_joints: Joint that each command drives.
        measurements: The measurement channels, N of them.
        state_names: Names of the S states.
    """

    joints: int
    commands: tuple[Channel, ...]
    command_joints: tuple[int, ...]
    measurements: tuple[Channel, ...]
    state_names: tuple[str, ...]

    def effort_of(self, commands: Tensor) -> Tensor:
        """Commands (..., M) in the shape that `actuate` and `derivative` take: the same, or (...) for one command."""
        return commands[..., 0] if len(self.commands) == 1 else commands

    def actuate(self, command: Tensor, parameters: Parameters) -> Tensor:
        """Effort that answers a command of its shape, without dynamics: the command itself for a plain system."""
        return command

    def delivery(self, parameters: Parameters) -> Delivery | None:
        """What actuators deliver, for each command that drives a joint; None where it is the effort itself."""
        return None

    @property
    def delivered_scales(self) -> tuple[tuple[float, str], ...]:
        """Size and unit of what the actuator of each driving command delivers at most, or typically."""
        driving = self.commands[: len(self.command_joints)]
        return tuple((max(abs(c.low), abs(c.high)), c.unit) for c in driving)

    @property
    def drive_parameters(self) -> tuple[tuple[str, ...], ...]:
        """Parameters to which the force of each driving command's drive is proportional, all taken together.

        Empty where a drive delivers its command, or where a system does not tell.
        """
        return ((),) * len(self.command_joints)

    def shape_command(self, index: int, value: Tensor, t: Tensor, parameters: Parameters) -> Tensor:
        """Effort that answers the log of one command, before lag and delay.

        Args:
            index: Which command.
            value: (n, 1) or (n, L).
            t: (n,) stamps [s].
            parameters: Named values, scalar or (L,).

        Returns:
            (n, L), or (n, 1) where no parameter has lanes.
        """
        return value

    def command_timing(self, index: int, parameters: Parameters) -> CommandTiming:
        """Delay, lags and clock of one command; none for a plain system."""
        zero = torch.zeros((), dtype=torch.float64)
        return CommandTiming(zero, (), zero)

    def timing(self, parameters: Parameters) -> Timing:
        """Delays of command and measurements: zero for a plain system."""
        zero = torch.zeros((), dtype=torch.float64)
        return Timing(zero, zero, zero)

    @property
    def measured_states(self) -> tuple[int, ...]:
        """State that each measurement shows: the one of its name; else the first, the second, and so on."""
        names = [channel.name for channel in self.measurements]
        if set(names) <= set(self.state_names):
            return tuple(self.state_names.index(name) for name in names)
        return tuple(range(len(names)))

    @property
    def shows_states(self) -> bool:
        """Whether sensors without any error show states as they are, also where a class says so in its own words."""
        if type(self).ideal_measurement is SignalPath.ideal_measurement:
            return True
        state = torch.arange(1.0, len(self.state_names) + 1.0, dtype=torch.float64).sqrt()
        shown = [k for k in self.measured_states if k < len(state)]
        return torch.equal(self.ideal_measurement(state), state[shown])

    @property
    def speeds_of_positions(self) -> tuple[tuple[str, str], ...] | None:
        """Channels of which the second is the derivative of the first; None where channels do not show states."""
        if not self.shows_states:
            return None
        names = dict(zip(self.measured_states, (c.name for c in self.measurements), strict=True))
        pairs = ((names.get(j), names.get(j + self.joints)) for j in range(self.joints))
        return tuple((a, b) for a, b in pairs if a is not None and b is not None)

    @property
    def free_commands(self) -> dict[str, float] | None:
        """Commands of a free motion by name, in their units: their defaults; None unless every one has a default."""
        found = {c.name: c.default for c in self.commands if c.default is not None}
        return found if len(found) == len(self.commands) else None

    def ideal_measurement(self, state: Tensor) -> Tensor:
        """What sensors without any error measure (..., N) of a state (..., S): by default the `measured_states`."""
        shown = self.measured_states
        if shown == tuple(range(state.shape[-1])):
            return state
        return torch.stack([state[..., index] for index in shown], -1)

    def measure(self, state: Tensor, parameters: Parameters) -> Tensor:
        """Noise-free measurements (..., N) of a state (..., S), in the order of ``measurements``."""
        return self.ideal_measurement(state)

    def measure_shown(self, shown: Tensor, parameters: Parameters) -> Tensor:
        """As :meth:`measure`, of a state (..., S) with the positions and speeds behind the :meth:`output_play`."""
        return self.measure(shown, parameters)

    def measure_at(self, state: Tensor, time: Tensor, parameters: Parameters) -> Tensor:
        """As :meth:`measure` along a log, ``time`` (...) since its first command [s]."""
        return self.measure(state, parameters)

    def command_lags(self, parameters: Parameters) -> Tensor:
        """Time constants of the first-order answers (...) of one actuator, (..., M) of several [s]; 0 for none."""
        lag = self.timing(parameters).lag
        return lag if len(self.commands) == 1 else lag.unsqueeze(-1)

    def further_delays(self, parameters: Parameters) -> tuple[Tensor, ...] | None:
        """Delay of each command beyond that of :meth:`timing` [s]; None where all act at the same time."""
        return None

    def sensor_filter(self, parameters: Parameters) -> Tensor:
        """Time constant of a first-order filter behind all sensors [s]; 0 for a plain system."""
        return torch.zeros((), dtype=torch.float64)

    def channel_delays(self, parameters: Parameters) -> dict[int, Tensor]:
        """Channel -> delay of its measurements beyond that of all sensors (...) [s]; empty for a plain system.

        Along a log the state is the one that the latest channel shows: :meth:`command_timing` holds its delay.
        """
        return {}

    def output_play(self, parameters: Parameters) -> Levels:
        """Half of the play between each joint and its sensors (J), in its unit; None for none, as in a plain system."""
        return (None,) * self.joints
