"""Scenes: one or several MJCF objects in one compiled MuJoCo model, and where the parts of each of them lie."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from deepkoco.engines.engine import EngineError
from deepkoco.engines.mjcf_model import MjcfModel, one_line
from deepkoco.engines.mujoco_world import import_mujoco
from deepkoco.suggestion import did_you_mean
from deepkoco.systems import Channel

NOISE = {"rad": 1e-3, "m": 1e-4, "rad/s": 0.05, "m/s": 5e-3}  # of usual encoders
_UNITS = {
    "mjSENS_JOINTPOS": "",
    "mjSENS_GYRO": "rad/s",
    "mjSENS_ACCELEROMETER": "m/s2",
    "mjSENS_VELOCIMETER": "m/s",
    "mjSENS_FORCE": "N",
    "mjSENS_TORQUE": "N m",
    "mjSENS_TOUCH": "N",
    "mjSENS_FRAMEPOS": "m",
    "mjSENS_RANGEFINDER": "m",
    "mjSENS_SUBTREECOM": "m",
}


class Scene:
    """Objects in one MuJoCo model: they can touch each other.

    The options of the physics (time step, integrator, gravity, solver) are those of the first object. In a scene of
    several, everything of an object has its name in front: ``arm_shoulder``.

    Args:
        objects: By name; the name of a single one is empty.

    Attributes:
        model: The compiled model. What is no number stays so: MuJoCo does not put the state back.
        commands, measurements: By object, its channels.
        controls: By object, places of its commands among the controls.
        columns: By object, places of its measurements in the output of the world: positions, speeds, activations and
            sensors of the model.
        start: (nq + nv) positions and speeds in which an episode starts.
        places: By object, places of its positions and speeds in `start`.
        reads_sensors: Whether any measurement is a sensor of the model.

    Raises:
        EngineError: A model cannot be read, or has no such sensor or keyframe.
    """

    def __init__(self, objects: Mapping[str, MjcfModel]) -> None:
        self._mujoco = mujoco = import_mujoco()
        self.objects = dict(objects)
        self.model = self._compile()
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.commands: dict[str, tuple[Channel, ...]] = {}
        self.measurements: dict[str, tuple[Channel, ...]] = {}
        self.controls: dict[str, tuple[int, ...]] = {}
        self.columns: dict[str, tuple[int, ...]] = {}
        self.places: dict[str, tuple[int, ...]] = {}
        self.start = np.concatenate([self.model.qpos0, np.zeros(self.model.nv)])
        self.reads_sensors = False
        for name, each in self.objects.items():
            self._read(name, each)

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_mujoco": None}  # a module does not travel

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, _mujoco=import_mujoco())

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the entries of `start`: ``q_JOINT`` and ``dq_JOINT``, with a number where a joint has several."""
        model, names = self.model, []
        for prefix, widths in (("q", self._position_widths()), ("dq", self._speed_widths())):
            for j in range(model.njnt):
                joint = self._joint(j)
                names += (
                    [f"{prefix}_{joint}"]
                    if widths[j] == 1
                    else [f"{prefix}_{joint}[{i}]" for i in range(widths[j])]
                )
        return tuple(names)

    def _compile(self) -> Any:
        mujoco, objects = self._mujoco, self.objects
        if len(objects) == 1 and "" in objects:
            return objects[""].compile()
        whole = None
        for name, each in objects.items():
            spec = each.spec()
            if whole is None:
                whole = mujoco.MjSpec()
                whole.option = spec.option
                whole.compiler.degree = spec.compiler.degree
            for key in list(spec.keys):
                spec.delete(key)  # states of one object are no states of all
            frame = whole.worldbody.add_frame(pos=list(each.position), quat=list(each.rotation))
            whole.attach(spec, prefix=f"{name}_", frame=frame)
        if whole is None:
            raise EngineError("a scene needs at least one object")
        try:
            return whole.compile()
        except (ValueError, RuntimeError) as error:
            raise EngineError(f"{', '.join(objects)}: MuJoCo cannot join them: {one_line(error)}") from None

    def _read(self, name: str, each: MjcfModel) -> None:
        model, prefix = self.model, f"{name}_" if name else ""
        joints = [j for j in range(model.njnt) if self._owner(self._joint(j)) == name]
        actuators = [a for a in range(model.nu) if self._owner(self._actuator(a)) == name]
        self.controls[name] = tuple(actuators)
        self.commands[name] = tuple(self._command(a, prefix) for a in actuators)
        known = self._measurable(name, joints, prefix)
        wanted = tuple(known) if each.measured is None else each.measured
        channels, columns = [], []
        for entry in wanted:
            if entry not in known:
                raise EngineError(
                    f'{each.name}: there is no sensor "{entry}"{did_you_mean(entry, list(known))}'
                )
            for channel, column in known[entry]:
                channels.append(channel)
                columns.append(column)
        self.measurements[name], self.columns[name] = tuple(channels), tuple(columns)
        self.reads_sensors |= any(column >= model.nq + model.nv + model.na for column in columns)
        widths = self._position_widths(), self._speed_widths()
        positions = [model.jnt_qposadr[j] + i for j in joints for i in range(widths[0][j])]
        speeds = [model.nq + model.jnt_dofadr[j] + i for j in joints for i in range(widths[1][j])]
        self.places[name] = tuple(int(place) for place in (*positions, *speeds))
        if each.keyframe is not None:
            self._start_at(name, each, joints)

    def _start_at(self, name: str, each: MjcfModel, joints: list[int]) -> None:
        """Put an object's keyframe, which is in its own frame, into the start of the scene."""
        mujoco = self._mujoco
        alone = each.compile()
        names = [alone.key(k).name for k in range(alone.nkey)]
        if each.keyframe not in names:
            raise EngineError(
                f'{each.name}: there is no keyframe "{each.keyframe}"; it has {", ".join(names) or "none"}'
            )
        key = names.index(str(each.keyframe))
        position, speed = alone.key_qpos[key].copy(), alone.key_qvel[key]
        turn = np.array(each.rotation) / np.linalg.norm(each.rotation)
        for j in range(alone.njnt):
            if int(alone.jnt_type[j]) == int(mujoco.mjtJoint.mjJNT_FREE):
                at = alone.jnt_qposadr[j]
                moved, turned = np.zeros(3), np.zeros(4)
                mujoco.mju_rotVecQuat(moved, position[at : at + 3], turn)
                mujoco.mju_mulQuat(turned, turn, position[at + 3 : at + 7])
                position[at : at + 3] = moved + np.array(each.position)
                position[at + 3 : at + 7] = turned
        self.start[list(self.places[name])] = np.concatenate([position, speed])

    def _command(self, actuator: int, prefix: str) -> Channel:
        model, mujoco = self.model, self._mujoco
        low, high = (
            model.actuator_ctrlrange[actuator]
            if model.actuator_ctrllimited[actuator]
            else (-math.inf, math.inf)
        )
        joint = model.actuator_trnid[actuator, 0]
        on_joint = int(model.actuator_trntype[actuator]) == int(mujoco.mjtTrn.mjTRN_JOINT)
        slides = on_joint and int(model.jnt_type[joint]) == int(mujoco.mjtJoint.mjJNT_SLIDE)
        bias = model.actuator_biasprm[actuator]
        unit = ("N" if slides else "N m") if on_joint else ""
        if on_joint and bias[1] != 0.0:
            unit = "m" if slides else "rad"
        elif on_joint and bias[2] != 0.0:
            unit = "m/s" if slides else "rad/s"
        name = self._actuator(actuator).removeprefix(prefix)
        return Channel(name, unit, "command", float(low), float(high), description=f"actuator {name}")

    def _measurable(self, owner: str, joints: list[int], prefix: str) -> dict[str, list[tuple[Channel, int]]]:
        """By name, the channels that can be measured and their columns in the output of the world."""
        model, mujoco = self.model, self._mujoco
        found: dict[str, list[tuple[Channel, int]]] = {}
        kinds = {int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)}
        scalar = [j for j in joints if int(model.jnt_type[j]) in kinds]
        for kind, after, address in (("q", "", model.jnt_qposadr), ("dq", "/s", model.nq + model.jnt_dofadr)):
            for j in scalar:
                name = f"{kind}_{self._joint(j).removeprefix(prefix)}"
                slides = int(model.jnt_type[j]) == int(mujoco.mjtJoint.mjJNT_SLIDE)
                unit = ("m" if slides else "rad") + after
                angle = kind == "q" and not slides
                channel = Channel(
                    name, unit, "measurement", noise_sd=NOISE[unit], description=name, angle=angle
                )
                found[name] = [(channel, int(address[j]))]
        first = model.nq + model.nv + model.na
        for s in range(model.nsensor):
            whole = model.sensor(s).name
            if not whole or self._owner(whole) != owner:
                continue
            name, size = whole.removeprefix(prefix), int(model.sensor_dim[s])
            unit = _UNITS.get(mujoco.mjtSensor(model.sensor_type[s]).name, "")
            noise = float(model.sensor_noise[s])
            entries = [name] if size == 1 else [f"{name}[{i}]" for i in range(size)]
            found[name] = [
                (
                    Channel(entry, unit, "measurement", noise_sd=noise, description=f"sensor {name}"),
                    first + int(model.sensor_adr[s]) + i,
                )
                for i, entry in enumerate(entries)
            ]
        return found

    def _owner(self, name: str) -> str:
        """The object that something of the model belongs to: that with the longest name in front."""
        found = [each for each in self.objects if not each or name.startswith(f"{each}_")]
        return max(found, key=len, default="")

    def _joint(self, j: int) -> str:
        return self.model.joint(j).name or self.model.body(self.model.jnt_bodyid[j]).name or f"joint {j}"

    def _actuator(self, a: int) -> str:
        model, mujoco = self.model, self._mujoco
        if model.actuator(a).name:
            return model.actuator(a).name
        on_joint = int(model.actuator_trntype[a]) == int(mujoco.mjtTrn.mjTRN_JOINT)
        return self._joint(model.actuator_trnid[a, 0]) if on_joint else f"actuator {a}"

    def _position_widths(self) -> list[int]:
        return np.diff([*self.model.jnt_qposadr, self.model.nq]).tolist()

    def _speed_widths(self) -> list[int]:
        return np.diff([*self.model.jnt_dofadr, self.model.nv]).tolist()
