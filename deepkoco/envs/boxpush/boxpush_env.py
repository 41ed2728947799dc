"""An arm that pushes a box to a goal, as a Gymnasium environment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from torch import Tensor

from deepkoco.engines.boxpush.world import box_push_scene, box_state
from deepkoco.engines.model_parameters import check_names
from deepkoco.envs.boxpush.boxpush_graph import CONTROL_RATE, BoxPushOptions, box_push_graph, box_push_start
from deepkoco.envs.boxpush.homing import ArmState, Homing
from deepkoco.envs.boxpush.seat import BOUNDS
from deepkoco.envs.graph_env import FIRST_STEPS, GraphEnv
from deepkoco.envs.graph_vector_env import GraphVectorEnv
from deepkoco.envs.randomization import Randomize
from deepkoco.envs.settings import SettingsError
from deepkoco.graph.model.node import State
from deepkoco.suggestion import did_you_mean
from deepkoco.systems.boxpush.picture import draw_box_push

HISTORY = 4
FRICTIONS = (0.25, 0.55)
"""Of the box on the table, drawn for every episode."""
BOX_START = ((0.32, 0.38), (-0.12, 0.12), (-0.5, 0.5))
"""Of the box at the start: x, y [m] and turn [rad]."""
GOAL_ROOM = ((0.32, 0.50), (-0.25, 0.25))
"""Of the goal: x and y [m]."""
PUSH = (0.12, 0.20)
"""From the box to its goal [m]."""
RESETS = ("state", "drive")
OPTIONS = ("box", "goal", "initial")


class BoxPushVectorEnv(GraphVectorEnv):
    """Arms that push boxes, side by side; see `BoxPushSeat` for what is seen and paid.

    Actions (2,) in [-1, 1]: the velocity of the tool along x and y, of 0.2 m/s; without inverse kinematics (6,), the
    speeds of the joints, of 0.6 rad/s.

    Args:
        num_envs: Environments B.
        max_episode_steps: Steps of an episode, of 0.1 s each.
        inverse_kinematics: Actions are velocities of the tool.
        action_history: How many past actions are appended to the observation, newest first.
        noise: Encoders and camera have noise.
        friction: Of the box on the table, between these two, drawn for every episode; None: the nominal one.
        sensing_delay, camera_delay, decision_time, actuation_delay: As for `BoxPushOptions`: seconds, a law or its
            description.
        reset_by: "state": an episode begins with the arm at home. "drive": the arm drives home from where the episode
            before has left it, while the box is put back.
        randomize: As for :class:`GraphVectorEnv`, such as ``{"world.mass(box)": (0.2, 0.6)}`` or
            ``{"camera->agent": (0.05, 0.2)}``.
        threads: Of the physics; 0: that of the caller.
        render_mode: None or ``rgb_array``.
        render_size: Side of the pictures [pixels].
        delay_traces, executor, autoreset_mode: As for :class:`GraphVectorEnv`; a physics engine runs in the executor
            ``eager`` only.

    Raises:
        SettingsError: A setting is wrong.
    """

    metadata = {  # noqa: RUF012 - Gymnasium declares it so
        "render_modes": ["rgb_array"],
        "render_fps": round(CONTROL_RATE),
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int,
        max_episode_steps: int = 100,
        inverse_kinematics: bool = True,
        action_history: int = HISTORY,
        noise: bool = True,
        friction: Sequence[float] | None = FRICTIONS,
        sensing_delay: Any = None,
        camera_delay: Any = None,
        decision_time: Any = None,
        actuation_delay: Any = None,
        reset_by: str = "state",
        randomize: Randomize | None = None,
        threads: int = 0,
        render_mode: str | None = None,
        render_size: int = 256,
        delay_traces: int = 256,
        executor: str = "eager",
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        for name, number, least in (("action_history", action_history, 0), ("render_size", render_size, 16)):
            if not isinstance(number, int) or isinstance(number, bool) or number < least:
                raise SettingsError(f"{name} = {number!r}; give a whole number from {least} on")
        for name, choice in (("noise", noise), ("inverse_kinematics", inverse_kinematics)):
            if not isinstance(choice, bool):
                raise SettingsError(f"{name} = {choice!r}; give True or False")
        if reset_by not in RESETS:
            raise SettingsError(f'reset_by = "{reset_by}"; give one of {", ".join(RESETS)}')
        randomize = dict(randomize or {})
        if friction is not None:
            randomize.setdefault("world.friction(box)", tuple(friction))  # pyright: ignore[reportArgumentType]
        _check_world(randomize)
        given = {"sensing_delay": sensing_delay, "camera_delay": camera_delay}
        given |= {"decision_time": decision_time, "actuation_delay": actuation_delay}
        try:
            options = BoxPushOptions(
                inverse_kinematics=inverse_kinematics, history=action_history, noise=noise, threads=threads,
                **{name: value for name, value in given.items() if value is not None},
            )  # fmt: skip
            graph = box_push_graph(options)
        except ValueError as error:
            raise SettingsError(str(error)) from error
        self.render_mode, self.render_size = render_mode, render_size
        self._homing = Homing(options) if reset_by == "drive" else None
        bound = np.concatenate([BOUNDS, np.ones(options.entries * action_history)]).astype(np.float32)
        super().__init__(
            num_envs,
            graph,
            spaces.Box(-1.0, 1.0, (options.entries,), np.float32),
            spaces.Box(-bound, bound, dtype=np.float32),
            max_episode_steps,
            randomize=randomize,
            delay_traces=delay_traces,
            executor=executor,
            autoreset_mode=autoreset_mode,
        )

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Pictures of all environments, each uint8 (size, size, 3)."""
        if self.render_mode is None:
            gymnasium.logger.warn('render() without a render mode: pass render_mode="rgb_array" to make()')
            return None
        seen = box_state(self.state.nodes["world"]["seen"])
        place, angles, goal = (
            seen.place.numpy(),
            seen.angles.numpy(),
            self.state.nodes["agent"]["goal"].numpy(),
        )
        return tuple(
            draw_box_push(angles[b], place[b], float(seen.yaw[b]), goal[b], self.render_size)
            for b in range(self.num_envs)
        )

    def _start(self, batch: int, generator: torch.Generator) -> dict[str, State]:
        box, goal = draw_boxes(batch, generator)
        return self._begin(box, goal)

    def _begin(self, box: Tensor, goal: Tensor) -> dict[str, State]:
        """Start states with the arm at home, driven there where this is wanted and it is somewhere."""
        if self._homing is None or self._state is None or len(box) != self.num_envs:
            return box_push_start(self.graph, box, goal)
        seen = box_state(self._state.nodes["world"]["seen"])
        arm = ArmState(seen.angles, seen.speeds, self._state.nodes["guard"]["goals"])
        arm = self._homing.run(arm, torch.cat([seen.place[:, :2], seen.yaw[:, None]], -1), box)
        return box_push_start(self.graph, box, goal, arm.angles, arm.speeds, arm.goals)

    def _given(self, options: Mapping[str, Any]) -> Mapping[str, State]:
        """``options["box"]`` (B, 3), x, y [m] and turn [rad], and ``options["goal"]`` (B, 2), beside ``initial``."""
        if wrong := [name for name in options if name not in (*OPTIONS, "reset_mask")]:
            raise SettingsError(f'there is no option "{wrong[0]}"{did_you_mean(wrong[0], OPTIONS) or ""}')
        if options.get("box") is None and options.get("goal") is None:
            return super()._given(options)
        if options.get("box") is None or options.get("goal") is None:
            raise SettingsError("a start needs both box (x, y [m], turn [rad]) and goal (x, y [m])")
        return self._begin(self._numbers("box", options["box"], 3), self._numbers("goal", options["goal"], 2))

    def _numbers(self, name: str, value: Any, width: int) -> Tensor:
        try:
            given = np.broadcast_to(np.asarray(value, dtype=np.float64), (self.num_envs, width))
        except (TypeError, ValueError):
            given = np.full(1, np.nan)
        if not np.isfinite(given).all():
            raise SettingsError(f"{name} = {value!r}; give {width} numbers, or {self.num_envs} times {width}")
        return torch.tensor(given)

    def _command(self, actions: Any) -> np.ndarray:
        return np.clip(super()._command(actions), -1.0, 1.0)

    def command_of(self, actions: Tensor) -> Tensor:
        return super().command_of(actions).clamp(-1.0, 1.0)


def draw_boxes(batch: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Boxes (B, 3), place [m] and turn [rad], and goals (B, 2) [m] that are `PUSH` away, as far as there is room."""
    unit = torch.rand(batch, 5, generator=generator, dtype=torch.float64)
    low, high = torch.tensor(BOX_START, dtype=torch.float64).unbind(-1)
    box = low + (high - low) * unit[:, :3]
    length = PUSH[0] + (PUSH[1] - PUSH[0]) * unit[:, 3]
    # From one side over ahead to the other: the arm stands behind the box.
    angle = (unit[:, 4] - 0.5) * torch.pi
    goal = box[:, :2] + length[:, None] * torch.stack([torch.cos(angle), torch.sin(angle)], -1)
    low, high = torch.tensor(GOAL_ROOM, dtype=torch.float64).unbind(-1)
    return box, torch.minimum(torch.maximum(goal, low), high)


def _check_world(randomize: Randomize) -> None:
    """Refuse parameters that the model of the world has not.

    Raises:
        SettingsError: It has not.
    """
    names = [name.removeprefix("world.") for name in randomize if name.startswith("world.")]
    try:
        check_names(box_push_scene().model, names)
    except ValueError as error:
        raise SettingsError(str(error)) from error


class BoxPushEnv(GraphEnv):
    """One arm and box; see :class:`BoxPushVectorEnv` for the settings.

    It never cuts an episode: Gymnasium's own time limit does, as registered or as given to ``make``.

    Args:
        render_mode: None or ``rgb_array``.
        longest_episode: Steps for which delays are drawn; going on beyond them is an error. None: as many as
            turn out to be needed.
        **settings: As for :class:`BoxPushVectorEnv`.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": round(CONTROL_RATE)}  # noqa: RUF012 - as above

    def __init__(
        self, render_mode: str | None = None, longest_episode: int | None = None, **settings: Any
    ) -> None:
        steps = FIRST_STEPS if longest_episode is None else longest_episode
        self._use(BoxPushVectorEnv(1, steps, render_mode=render_mode, **settings), longest_episode)
        self.render_mode = render_mode
