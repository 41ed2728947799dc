"""Models given as MJCF or URDF."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deepkoco.engines.engine import EngineError
from deepkoco.engines.mujoco_world import import_mujoco


@dataclass(frozen=True)
class MjcfModel:
    """A robot or a thing given as MJCF or URDF: named joints, actuators and sensors.

    Attributes:
        model: Path of the file, or the MJCF text itself.
        measured: Names of what its sensor node puts out: ``q_JOINT``, ``dq_JOINT`` and the model's own sensors. None:
            all of them, in this order.
        keyframe: Keyframe of the model in which an episode starts; None: the model's reference pose at rest.
        position: Where it stands in a scene of several objects [m].
        rotation: How it is turned there, as a quaternion (w, x, y, z).
    """

    model: str | Path
    measured: tuple[str, ...] | None = None
    keyframe: str | None = None
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)

    @property
    def name(self) -> str:
        """The file's name without its ending, or the name in the text."""
        return self.spec().modelname if self._is_text else Path(self.model).stem

    def spec(self) -> Any:
        """The editable model.

        Raises:
            EngineError: It cannot be read.
        """
        mujoco = import_mujoco()
        try:
            if self._is_text:
                return mujoco.MjSpec.from_string(str(self.model))
            if not Path(self.model).is_file():
                raise EngineError(f"{self.model}: there is no such file")
            spec = mujoco.MjSpec.from_file(str(self.model))
        except (ValueError, RuntimeError) as error:
            raise EngineError(f"{self._where}: MuJoCo cannot read it: {one_line(error)}") from None
        if not len(spec.actuators) and _is_urdf(self.model):
            for joint in spec.joints:
                motor = spec.add_actuator(name=joint.name, target=joint.name)
                motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
        return spec

    @property
    def _is_text(self) -> bool:
        return str(self.model).lstrip().startswith("<")

    @property
    def _where(self) -> str:
        return "the MJCF text" if self._is_text else str(self.model)

    def compile(self) -> Any:
        """The compiled model of the object alone.

        Raises:
            EngineError: It is not valid.
        """
        spec = self.spec()
        try:
            return spec.compile()
        except (ValueError, RuntimeError) as error:
            if not self._is_text:
                from deepkoco.systems.trees.model_file import read_model
                from deepkoco.systems.trees.tree import TreeError

                try:
                    return read_model(self.model)[0]  # without geoms whose mesh is missing
                except TreeError as missing:
                    raise EngineError(str(missing)) from None
            raise EngineError(f"{self._where}: MuJoCo cannot read it: {one_line(error)}") from None


def _is_urdf(path: str | Path) -> bool:
    from deepkoco.systems.trees.model_file import is_urdf

    return is_urdf(path)


def one_line(error: Exception) -> str:
    """Return the message of an error in one line."""
    return "; ".join(line.strip() for line in str(error).splitlines() if line.strip())
