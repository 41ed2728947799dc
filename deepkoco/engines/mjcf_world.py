"""World and sensor nodes of MJCF objects: any batch, run by `mujoco.rollout`."""

from __future__ import annotations

import copy
import math
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepkoco.engines.command_window import window_of_commands
from deepkoco.engines.engine import EngineError
from deepkoco.engines.hold import means_within_tick
from deepkoco.engines.model_parameters import changed_model, check_names
from deepkoco.engines.mujoco_world import import_mujoco
from deepkoco.engines.noise import draw_keys, normal
from deepkoco.engines.scene import Scene
from deepkoco.graph import Delay, Input, Node
from deepkoco.graph.model.node import State
from deepkoco.systems import Parameters

KEPT_MODELS = 4096  # compiled models with other parameters, for the environments that come
_CONTROL = 64  # mjtState.mjSTATE_CTRL


class MjcfWorld(Node):
    """The state of a scene in MuJoCo, one tick at a time, in any number of environments.

    Tick 0 puts out the start state; tick k runs the physics over (t_{k-1}, t_k]. Within a tick, each step of the
    physics has the time average of the commands that hold during it, so a delay may be finer than a tick. Where the
    model's time step does not divide the tick, the longest shorter one that does is taken. The output
    (B, nq + nv + na + sensors) is positions, speeds, activations and sensors at the tick.

    The node is a function of its arguments and remembers nothing between calls: its state is MuJoCo's, and the solver
    starts anew at every tick. An environment whose state or command is no number goes on as NaN. It runs in the eager
    executor, which takes as many environments as are asked for.

    Parameters of the node are those of the model (see `parameter_values`), each a number or (B,), and ``start``
    (1 or B, nq + nv), or ``start(OBJECT)`` for one object: positions and speeds in which the episode starts.

    Args:
        scene: The objects.
        rate: Ticks per second [Hz].
        threads: Threads of `mujoco.rollout`; 0: the caller's.
        command_limit: Largest command, in its own unit.
        name: Name of the node.
    """

    finite = False  # a diverged environment says so

    def __init__(
        self,
        scene: Scene,
        rate: float,
        threads: int = 0,
        command_limit: float = math.inf,
        name: str = "world",
    ) -> None:
        super().__init__(name, rate)
        self.scene, self.threads = scene, threads
        model = self.model = copy.copy(scene.model)  # another world of the scene may have another time step
        self.period = 1.0 / rate
        self.substeps = math.ceil(self.period / model.opt.timestep - 1e-6)
        model.opt.timestep = self.period / self.substeps
        self.ports = {name or "agent": name for name in scene.objects if scene.controls[name]}
        self.inputs = tuple(self.ports)  # pyright: ignore[reportAttributeAccessIssue]
        self.entries: dict[str, tuple[int, ...]] = {}
        """By object, which entries of a command are its own; of an object that is not named, all."""
        channels = {name: scene.commands[name] for name in scene.objects}
        self._limits = {
            name: torch.tensor(
                [[max(-command_limit, c.low), min(command_limit, c.high)] for c in channels[name]],
                dtype=torch.float64,
            ).reshape(-1, 2)
            for name in channels
        }
        self._size = model.nq + model.nv
        self._width = self._size + model.na + (model.nsensordata if scene.reads_sensors else 0)
        self._forget()

    def least_window(self, delay: Delay, sender: Node) -> int:
        """Of commands, those of a tick and the one before them."""
        return window_of_commands(self, delay, sender)

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_pool": None, "_datas": None, "_models": {}, "_last": ((), [])}

    def open(self) -> None:
        self._forget()

    def close(self) -> None:
        self._forget()

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        own = [name for name in parameters if not name.startswith("start")]
        check_names(self.model, own)
        begin = torch.from_numpy(self.scene.start).expand(batch, self._size).clone()
        for name, value in parameters.items():
            if name == "start" or name.startswith("start("):
                places = self._places(name)
                if value.shape[-1] != len(places):
                    names = ", ".join(self.scene.state_names[i] for i in places)
                    raise EngineError(f"{name} has {value.shape[-1]} entries; give {len(places)}: {names}")
                begin[:, places] = value.to(torch.float64).expand(batch, len(places))
        mujoco = import_mujoco()
        data = mujoco.MjData(self.model)
        physics = np.zeros(mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
        mujoco.mj_getState(self.model, data, physics, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        whole = np.tile(physics, (batch, 1))
        whole[:, 1 : 1 + self._size] = begin.numpy()
        idle = np.zeros((batch, 1, self.model.nu))
        seen = whole[:, 1 : 1 + self._size + self.model.na]
        if self.scene.reads_sensors:
            seen = np.concatenate([seen, self._roll(parameters, whole, idle)[1][:, 0]], 1)
        return {
            "physics": torch.from_numpy(whole),
            "seen": torch.from_numpy(seen.copy()),
            "started": torch.zeros(batch, dtype=torch.bool),
        }

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return state["seen"]

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Tensor]:
        started, begun = state["started"], torch.ones_like(state["started"])
        running = started.numpy()
        if not running.any():
            return {**state, "started": begun}, state["seen"]
        physics, seen = self._advance(
            parameters, state["physics"].numpy(), self._controls(inputs, len(running))
        )
        after, output = torch.from_numpy(physics), torch.from_numpy(seen)
        if not running.all():
            after = torch.where(started[:, None], after, state["physics"])
            output = torch.where(started[:, None], output, state["seen"])
        return {"physics": after, "seen": output, "started": begun}, output

    def _advance(
        self, parameters: Parameters, physics: np.ndarray, controls: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """State (B, n) and output (B, width) after a tick; NaN where the state or a command is no number."""
        good: Any = None
        # One sum costs a third of the exact check; only a sum that is no number needs it.
        if not math.isfinite(physics.sum() + controls.sum()):
            good = np.isfinite(physics).all(1) & np.isfinite(controls).all((1, 2))
            physics = np.where(good[:, None], physics, np.nan_to_num(physics[:1] * 0.0))
            controls = np.where(good[:, None, None], controls, 0.0)
        states, sensors = self._roll(parameters, physics, controls)
        after = states[:, self.substeps - 1]
        seen = after[:, 1 : 1 + self._size + self.model.na]
        if self.scene.reads_sensors:
            # MuJoCo's sensors belong to the state before a step: one more step shows those of the last state.
            seen = np.concatenate([seen, sensors[:, self.substeps]], 1)
        if good is not None and not good.all():
            after, seen = after.copy(), seen.copy()
            after[~good], seen[~good] = np.nan, np.nan
        return np.ascontiguousarray(after), np.ascontiguousarray(seen)

    def _controls(self, inputs: dict[str, Input], batch: int) -> np.ndarray:
        """Commands of all actuators in each step of the physics, (B, steps, nu)."""
        steps = self.substeps + self.scene.reads_sensors
        controls = np.zeros((batch, steps, self.model.nu))
        for port, name in self.ports.items():
            commands, places = inputs[port], self.scene.controls[name]
            sent = commands.data.to(torch.float64)
            if name in self.entries:
                sent = sent[..., self.entries[name]]
            if sent.shape[-1] != len(places):
                raise EngineError(
                    f"{name or 'the object'} has {len(places)} actuators, but the command has {sent.shape[-1]} entries"
                )
            limits = self._limits[name]
            cut = sent.clamp(limits[:, 0], limits[:, 1])
            means = means_within_tick(cut, commands, self.period, self.substeps)
            controls[:, : self.substeps, places] = means
            if steps > self.substeps:
                controls[:, self.substeps :, places] = cut[:, -1:].numpy()
        return controls

    def _roll(self, parameters: Parameters, physics: np.ndarray, controls: np.ndarray) -> tuple[Any, Any]:
        """States and sensors (B, steps, ...) of `mujoco.rollout`."""
        if self._pool is None:
            from mujoco import rollout

            mujoco = import_mujoco()
            self._pool = rollout.Rollout(nthread=self.threads)
            self._datas = [mujoco.MjData(self.model) for _ in range(max(1, self.threads))]
        batch, steps = controls.shape[:2]
        states = np.empty((batch, steps, physics.shape[1]))
        sensors = np.empty((batch, steps, self.model.nsensordata))
        # Without the checks, whose time grows with the number of models.
        return self._pool.rollout(
            self._models_for(parameters, batch),
            self._datas,
            np.ascontiguousarray(physics),
            np.ascontiguousarray(controls),
            control_spec=_CONTROL,
            skip_checks=True,
            nstep=steps,
            state=states,
            sensordata=sensors,
        )

    def _models_for(self, parameters: Parameters, batch: int) -> list[Any]:
        """A model for each environment; the same where no parameter is given."""
        names = [name for name in parameters if not name.startswith("start")]
        if not names:
            return [self.model] * batch
        values = tuple(parameters[name] for name in names)
        before, models = self._last
        same = len(before) == len(values) and all(a is b for a, b in zip(before, values, strict=True))
        if same and len(models) == batch:
            return models
        columns = [value.to(torch.float64).reshape(-1).expand(batch).numpy() for value in values]
        rows = [tuple(row) for row in np.stack(columns, 1).tolist()]
        while len(self._models) > KEPT_MODELS:
            del self._models[next(iter(self._models))]
        for row in rows:
            if (*names, row) not in self._models:
                self._models[(*names, row)] = changed_model(self.model, dict(zip(names, row, strict=True)))
        models = [self._models[(*names, row)] for row in rows]
        self._last = values, models
        return models

    def _places(self, name: str) -> list[int]:
        """Places in the start state that a parameter ``start`` or ``start(OBJECT)`` gives."""
        if name == "start":
            return list(range(self._size))
        own = name.removeprefix("start(").removesuffix(")")
        if own not in self.scene.places:
            raise EngineError(f'{name}: there is no object "{own}"; there are {", ".join(self.scene.places)}')
        return list(self.scene.places[own])

    def _forget(self) -> None:
        self._pool: Any = None
        self._datas: Any = None
        self._models: dict[Any, Any] = {}
        self._last: tuple[tuple[Tensor, ...], list[Any]] = ((), [])


class MjcfSensor(Node):
    """Measures one object of a scene: the channels (B, N) of the world's last output, with noise where it has any.

    Args:
        scene: The objects.
        object: Name of the one that is measured.
        rate: Measurements per second [Hz].
        noisy: Whether measurements carry the noise of their channels.
        name: Name of the node.
    """

    inputs = ("world",)
    finite = False
    free_rate = True

    def __init__(
        self, scene: Scene, object: str, rate: float, noisy: bool = False, name: str = "sensor"
    ) -> None:
        super().__init__(name, rate)
        self.channels = scene.measurements[object]
        self.columns = torch.tensor(scene.columns[object], dtype=torch.int64)
        spread = [channel.noise_sd if noisy else 0.0 for channel in self.channels]
        self.noise = torch.tensor(spread, dtype=torch.float64)
        self.noisy = bool((self.noise > 0.0).any())
        first = np.concatenate([scene.start, np.zeros(scene.model.na + scene.model.nsensordata)])
        self.first = torch.from_numpy(first)[self.columns]

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        if not self.noisy:
            return {}
        return {"key": draw_keys(batch, generator), "tick": torch.zeros(batch, dtype=torch.int64)}

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return self.first.expand(batch, len(self.channels))

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Tensor]:
        clean = inputs["world"].data[:, -1].index_select(-1, self.columns)
        if not self.noisy:
            return state, clean
        channel = torch.arange(len(self.channels))
        drawn = normal(state["key"][:, None], state["tick"][:, None], channel)
        return {**state, "tick": state["tick"] + 1}, clean + self.noise * drawn
