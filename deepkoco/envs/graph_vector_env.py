"""Gymnasium environments from a graph, a batch at once."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from torch import Tensor

from deepkoco.envs.actions import check_finite_action, check_shape
from deepkoco.envs.delay_traces import DelayTraces
from deepkoco.envs.episode_draws import EpisodeDraws
from deepkoco.envs.randomization import GraphRandomization, Randomization, Randomize, Values
from deepkoco.envs.readings import check_readings, further_readings
from deepkoco.envs.restarts import reset_mask
from deepkoco.envs.rollouts import Outcome, Policy
from deepkoco.envs.seeds import Seeds, split_seeds
from deepkoco.envs.settings import SettingsError
from deepkoco.envs.steps_ahead import CommandedPolicy, StepsAhead
from deepkoco.graph import BatchedRuntime, Graph, GraphError, RuntimeState, Supervisor, extend_timing
from deepkoco.graph.delay import RecordedDelays
from deepkoco.graph.model.node import State


class GraphVectorEnv(VectorEnv):
    """Environments that step together on one graph, whose supervisor is the agent.

    An action is the supervisor's output; what an environment returns is what the supervisor's `observe`
    reads: ``observation`` (B, ...), ``reward`` (B,) and, where episodes can end, ``terminated`` (B,) bool.
    Further readings (B, ...) go to ``info`` under their names. The readings of a step are those of the
    transition that ends there: a reward of the state before keeps that state in the supervisor's own.

    Environments end independently of each other and start anew as ``autoreset_mode`` says. Each draws delays
    and randomized parameters of its own at each episode; delays come from a pool of ``delay_traces``
    schedules that all share (:class:`DelayTraces`), so that thousands of environments need no more memory
    for them than hundreds.

    Args:
        num_envs: Environments B.
        graph: Nodes and connections; the supervisor overrides `observe`.
        action_space: Of one environment; an action has the size of the supervisor's output.
        observation_space: Of one environment, a Box.
        max_episode_steps: Steps after which an episode is cut (``truncated``).
        parameters: Values of parameters by node and name.
        randomize: ``"node.parameter"``, ``"sender->receiver"`` or ``"node"`` (a delay [s]) -> (low, high),
            drawn uniformly for every episode and environment; a delay may also be the description of a law
            with (low, high) in the place of some of its numbers.
        delay_traces: Most schedules held at once.
        executor: ``eager``, ``fused``, ``cuda``, or ``auto``: compiled (``fused``) where there is a C++ compiler
            and every node can be compiled, else ``eager``.
        autoreset_mode: When an environment that has ended starts anew, as Gymnasium defines it.
        recorded_delays: Measured delays that are played in the place of the laws of their channels.

    Raises:
        ValueError: A setting is wrong; the message says which and what it may be.
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(
        self,
        num_envs: int,
        graph: Graph,
        action_space: spaces.Space,
        observation_space: spaces.Box,
        max_episode_steps: int,
        parameters: Values | None = None,
        randomize: Randomize | None = None,
        delay_traces: int = 256,
        executor: str = "auto",
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        recorded_delays: RecordedDelays | None = None,
    ) -> None:
        for name, number in (
            ("num_envs", num_envs),
            ("max_episode_steps", max_episode_steps),
            ("delay_traces", delay_traces),
        ):
            if number < 1:
                raise SettingsError(f"{name} = {number}; give 1 or more")
        supervisor = graph.node(graph.supervisor)
        if not isinstance(supervisor, Supervisor) or type(supervisor).observe is Supervisor.observe:
            raise GraphError(
                f'supervisor "{graph.supervisor}" reads nothing: override `observe` of Supervisor to return '
                "observation and reward"
            )
        self.num_envs, self.graph = num_envs, graph
        self.single_action_space, self.single_observation_space = action_space, observation_space
        self.action_space = batch_space(action_space, num_envs)
        self.observation_space = batch_space(observation_space, num_envs)
        self._mode = AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self._mode}
        self._randomization = self._make_randomization(parameters or {}, randomize or {})
        ranges, timed = self._randomization.ranges, self._randomization.timed
        self._traces = DelayTraces(
            graph, max_episode_steps, num_envs, delay_traces,
            {name: span for name, span in ranges.items() if name in timed},
            self._randomization.delays, recorded_delays,
        )  # fmt: skip
        self._draws = EpisodeDraws(ranges, self._traces)
        self.plan_episodes(max_episode_steps)
        self._single, self._given_shape = False, self.action_space.shape
        self._action_shape = (num_envs, *supervisor.initial_action.shape)
        self._action_type = supervisor.initial_action.numpy().dtype
        self._generator = torch.Generator()
        self._quiet = executor == "auto"
        if executor == "auto":
            executor = "fused" if all(node.pure for node in graph.nodes) else "eager"
        self._runtime = BatchedRuntime(graph, executor=executor)
        self._state: RuntimeState | None = None
        self._ahead = StepsAhead()
        self._elapsed = np.zeros(num_envs, np.int64)
        self._ended = np.zeros(num_envs, bool)

    @property
    def drawn(self) -> dict[str, np.ndarray]:
        """What the environments have drawn for their episodes from the ranges of ``randomize``, (B,) each."""
        return {name: value.numpy().copy() for name, value in self._draws.values.items()}

    @property
    def dt(self) -> float:
        """Time between two steps of the agent [s]."""
        return float(1 / self.graph.node(self.graph.supervisor).rate)

    @property
    def executor(self) -> str:
        """What runs the graph, known after the first reset."""
        return self._runtime.executor

    @property
    def state(self) -> RuntimeState:
        """What the graph remembers now.

        Raises:
            ResetNeeded: Before the first reset.
        """
        if self._state is None:
            raise gymnasium.error.ResetNeeded("step before reset: call reset first")
        return self._state

    def reset(self, *, seed: Seeds = None, options: Mapping[str, Any] | None = None):  # pyright: ignore[reportIncompatibleMethodOverride]
        """Start new episodes.

        Args:
            seed: Seed of every draw; None goes on with the draws of before. A list has one for each environment:
                its episode is that of a single environment with this seed, whatever the others are. None in it
                goes on with the draws of before. Later episodes follow from all seeds together. Random delays
                of those in a `reset_mask` are a schedule of the pool, chosen by the seed.
            options: ``reset_mask`` (B,) bool: who starts anew, by default all; ``initial``: by node name,
                states (B, ...) that replace those of the nodes' `init`.

        Raises:
            ValueError: A list of seeds has another length than there are environments.
        """
        mask = reset_mask((options or {}).get("reset_mask"), self.num_envs)
        joint, own = split_seeds(seed, self.num_envs, mask)
        new_traces = joint is not None
        if joint is None and self._np_random is None:
            joint = int(np.random.SeedSequence().generate_state(1)[0])
        return self.begin(joint, options or {}, new_traces, own)

    def begin(
        self,
        seed: int | None,
        options: Mapping[str, Any],
        new_traces: bool,
        own_seeds: Mapping[int, int] | None = None,
    ):
        """:meth:`reset`, with a say in whether its seed also draws the pool of delay traces anew.

        Args:
            seed: Of all draws but those of `own_seeds`.
            options: As for `reset`.
            new_traces: Draw the pool anew.
            own_seeds: By place in the batch, seeds of those that have one of their own.
        """
        if seed is not None:
            super().reset(seed=seed)
        mask = reset_mask(options.get("reset_mask"), self.num_envs)
        if mask is not None and self._state is None:
            raise gymnasium.error.ResetNeeded("reset_mask: the first reset starts all environments")
        self._restart(mask, options, new_traces and mask is None, own_seeds)
        return self._observation(), self._info()

    def step(self, actions: Any):
        """Give the actions (B, ...) and go on to the agent's next step.

        Raises:
            ValueError: The actions have another shape than the action space.
            ResetNeeded: Before the first reset, or without autoreset after an end.
        """
        state, waiting = self.state, self._ended
        if waiting.any() and self._mode == AutoresetMode.DISABLED:
            raise gymnasium.error.ResetNeeded(
                f"environment {np.flatnonzero(waiting)[0]} has ended: reset it with reset_mask first"
            )
        if waiting.all():
            self._restart(None)
            nothing = np.zeros(self.num_envs, bool)
            return self._observation(), np.zeros(self.num_envs), nothing, nothing.copy(), self._info()
        self._state, _ = self._runtime.step(state, self._command(actions))
        self._elapsed += 1
        if waiting.any():
            self._restart(waiting)
        return self._outcome(waiting)

    def step_ahead(
        self,
        policy: Policy,
        steps: int,
        parameters: Mapping[str, Tensor],
        signals: Mapping[str, Tensor],
    ) -> tuple[np.ndarray, np.ndarray, Outcome]:
        """:meth:`step` with a policy's actions until an episode ends, inside of what runs the graph.

        Args:
            policy: From its parameters and what it sees, ``observation`` (B, ...) and the signals of the step, to
                actions (B, ...). The executor compiles it once for the same object.
            steps: Most steps.
            parameters: Of the policy.
            signals: What it is shown beside the observation, (steps, B, ...) by name.

        Returns:
            Observations (n, B, ...) and rewards (n, B) float64 after each of n >= 1 steps, and what the last of as
            many calls of `step` would have returned.

        Raises:
            ResetNeeded: Before the first reset, or where an environment waits for its reset.
            ActionError: An action is no finite number.
        """
        start = self.state
        if self._ended.any():
            raise gymnasium.error.ResetNeeded(
                "step_ahead: an environment has ended, which only `step` starts anew"
            )
        shown = _torch_type(self.single_observation_space.dtype)
        after, taken = self._ahead.take(
            self._runtime,
            start,
            CommandedPolicy(self, policy, shown),
            min(steps, self.max_episode_steps - int(self._elapsed.max())),
            parameters,
            signals,
        )
        commands = taken["action"].cpu().numpy()
        check_finite_action(commands.reshape(-1, *commands.shape[2:]))
        self._state = after
        self._elapsed += len(commands)
        observations = taken["observation"].cpu().numpy().astype(self.single_observation_space.dtype)
        rewards = taken["reward"].cpu().numpy().astype(np.float64)
        return observations, rewards, self._outcome(np.zeros(self.num_envs, bool))

    def _outcome(self, waiting: np.ndarray) -> Outcome:
        """What a step returns, of which those ``waiting`` (B,) only started anew; others start anew as they must."""
        readings = self.state.readings
        reward = readings["reward"].cpu().numpy().astype(np.float64)
        terminated = np.zeros(self.num_envs, bool)
        if "terminated" in readings:
            terminated = readings["terminated"].cpu().numpy().astype(bool) & ~waiting
        reward[waiting] = 0.0
        truncated = self._elapsed >= self.max_episode_steps
        self._ended = ended = terminated | truncated
        observation, info = self._observation(), self._info()
        if self._mode == AutoresetMode.SAME_STEP and ended.any():
            final = {"final_obs": _rows(observation, ended), "_final_obs": ended.copy()}
            final |= {"final_info": info, "_final_info": ended.copy()}
            self._restart(None if ended.all() else ended)
            observation, info = self._observation(), self._info() | final
        return observation, reward, terminated, truncated, info

    def advance(self, action: Any) -> dict[str, np.ndarray]:
        """:meth:`step` for the only environment, and no more than that: it goes on where the episode has ended.

        Returns:
            The readings by name, without the batch; not to be written into.
        """
        self._state, _ = self._runtime.step(self.state, self._command(action))
        return self._state.first_readings()

    def take_single_actions(self) -> None:
        """Take the actions of the only environment without the batch."""
        self._single, self._given_shape = True, self.single_action_space.shape

    def plan_episodes(self, steps: int) -> None:
        """Set how many steps the episodes to come have."""
        self.max_episode_steps = steps
        # One step more than an episode has: those that start anew at the next step take it in vain.
        self._traces.steps = steps + 1

    def prolong(self, steps: int, actions: Sequence[Any]) -> None:
        """Draw delays for longer episodes and go through the present one again, which stays as it was.

        Args:
            steps: Of an episode from now on.
            actions: Of all environments since the last reset of all of them; none has ended.
        """
        self.plan_episodes(steps)
        parameters, random, initial = self._begun
        self._generator.set_state(random)
        timing, row = extend_timing(self.state.schedule.timing, steps + 1), self.state.row
        self._state, _ = self._runtime.reset(parameters, self._generator, initial, timing=timing, rows=row)
        for action in actions:
            self._state, _ = self._runtime.step(self._state, self._command(action))

    def _restart(
        self,
        mask: np.ndarray | None,
        options: Mapping[str, Any] | None = None,
        new_traces: bool = False,
        own_seeds: Mapping[int, int] | None = None,
    ) -> None:
        """Start the environments in ``mask``, or all, anew, some of them with seeds of their own."""
        generator = self._generator.manual_seed(int(self.np_random.integers(2**62)))
        running = None if mask is None else self.state.row
        timing, rows, own = self._draws.draw(generator, mask, running, new_traces, own_seeds or {})
        with warnings.catch_warnings():
            if self._quiet:
                warnings.filterwarnings("ignore", ".*runs with the eager executor", RuntimeWarning)
            parameters = self._randomization.parameters(self._draws.values)
            start = self._start(self.num_envs, generator)
            for place, single in own.items():
                for node, state in self._start(1, single).items():
                    for name, value in state.items():
                        start[node][name][place] = value[0]
            initial = {**start, **self._given(options or {})}
            self._begun = parameters, generator.get_state(), initial
            self._state, _ = self._runtime.reset(
                parameters,
                [own[b] if b in own else _branch(generator) for b in range(self.num_envs)]
                if own
                else generator,
                initial,
                timing=timing,
                rows=rows,
                state=self._state,
                mask=mask,
            )
        if mask is None:
            shape = self.single_observation_space.shape or ()
            check_readings(self._state.readings, self.graph.supervisor, self.num_envs, shape)
            mask = np.ones(self.num_envs, bool)
        self._elapsed = np.where(mask, 0, self._elapsed)
        self._ended = self._ended & ~mask

    def _make_randomization(self, parameters: Values, randomize: Randomize) -> Randomization:
        """What the names in ``randomize`` mean."""
        return GraphRandomization(self.graph, parameters, randomize)

    def _start(self, batch: int, generator: torch.Generator) -> dict[str, State]:
        """Start states (B, ...) by node that are drawn in the place of those of `init`."""
        return {}

    def _given(self, options: Mapping[str, Any]) -> Mapping[str, State]:
        """Start states (B, ...) by node that the caller wants."""
        return options.get("initial") or {}

    def _command(self, actions: Any) -> np.ndarray:
        """The supervisor's output (B, ...) for actions (B, ...)."""
        given = np.asarray(actions, self._action_type)
        if given.shape != self._given_shape:
            check_shape(given, self._given_shape, None if self._single else self.num_envs)
        command = given.reshape(self._action_shape)
        check_finite_action(command, batched=True)
        return command

    def command_of(self, actions: Tensor) -> Tensor:
        """The supervisor's output (B, ...) for actions (B, ...), as `step` has it, in operations of torch."""
        given = actions.to(_torch_type(self.single_action_space.dtype)).to(_torch_type(self._action_type))
        # An infinite number less itself is none, which no limit hides afterwards.
        return (given + (given - given)).reshape(len(given), *self._action_shape[1:])

    def _observation(self) -> np.ndarray:
        space = self.single_observation_space
        return self.state.readings["observation"].cpu().numpy().astype(space.dtype)

    def _info(self) -> dict[str, Any]:
        return further_readings(self.state.readings, self.num_envs)


def _torch_type(dtype: Any) -> torch.dtype:
    return torch.from_numpy(np.empty(0, dtype)).dtype


def _branch(generator: torch.Generator) -> torch.Generator:
    return torch.Generator().manual_seed(int(torch.randint(2**62, (), generator=generator)))


def _rows(observations: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Copies of the rows ``where`` as an array of objects, None elsewhere."""
    result = np.empty(len(where), dtype=object)
    for i in np.flatnonzero(where):
        result[i] = observations[i].copy()
    return result
