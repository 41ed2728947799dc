"""Objects given as MJCF or URDF."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from deepkoco.engines.engine import EngineError
from deepkoco.engines.mjcf_model import MjcfModel
from deepkoco.engines.scene import Scene
from deepkoco.systems import Channel, System


@dataclass(frozen=True)
class MjcfObject(MjcfModel):
    """A robot or a thing of a simulation; its attributes are those of :class:`MjcfModel`."""

    @cached_property
    def scene(self) -> Scene:
        """The object alone."""
        return Scene({"": self})

    @property
    def actuators(self) -> tuple[Channel, ...]:
        """What takes commands."""
        return self.scene.commands[""]

    @property
    def sensors(self) -> tuple[Channel, ...]:
        """What is measured."""
        return self.scene.measurements[""]

    @property
    def dynamics(self) -> System:
        """Its equations of motion, where it is a tree of hinges and slides without contact."""
        from deepkoco.systems.trees import TreeSystem

        if self._is_text:
            raise EngineError("ode: equations are made from a file, not from MJCF text; give its path")
        return TreeSystem.from_file(self.model)
