"""Objects and the engines that run them: one graph on equations, on MuJoCo or on a unit."""

from deepkoco.engines.assembly import ENGINES, find_engine, make_graph
from deepkoco.engines.command_window import command_window
from deepkoco.engines.engine import Engine, EngineError, EngineObject
from deepkoco.engines.mjcf_object import MjcfObject
from deepkoco.engines.mjcf_world import MjcfSensor, MjcfWorld
from deepkoco.engines.model_parameters import parameter_values
from deepkoco.engines.reset import Drive, ResetError, ResetNode, Teleport, damp
from deepkoco.engines.robot import OBJECTS, RobotObject, SystemObject, find_object, register_object
from deepkoco.engines.scene import Scene
from deepkoco.engines.simulated import MujocoEngine, OdeEngine
from deepkoco.engines.unit import UnitEngine

__all__ = [
    "ENGINES",
    "OBJECTS",
    "Drive",
    "Engine",
    "EngineError",
    "EngineObject",
    "MjcfObject",
    "MjcfSensor",
    "MjcfWorld",
    "MujocoEngine",
    "OdeEngine",
    "ResetError",
    "ResetNode",
    "RobotObject",
    "Scene",
    "SystemObject",
    "Teleport",
    "UnitEngine",
    "command_window",
    "damp",
    "find_engine",
    "find_object",
    "make_graph",
    "parameter_values",
    "register_object",
]
