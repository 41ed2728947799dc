"""Objects and the engines that run them: one graph on equations, on MuJoCo or on a unit."""

from deepkoco.engines.assembly import ENGINES, command_window, find_engine, make_graph
from deepkoco.engines.engine import Engine, EngineError
from deepkoco.engines.reset import Drive, ResetError, ResetNode, Teleport, damp
from deepkoco.engines.robot import OBJECTS, RobotObject, find_object, register_object
from deepkoco.engines.simulated import MujocoEngine, OdeEngine
from deepkoco.engines.unit import UnitEngine

__all__ = [
    "ENGINES",
    "OBJECTS",
    "Drive",
    "Engine",
    "EngineError",
    "MujocoEngine",
    "OdeEngine",
    "ResetError",
    "ResetNode",
    "RobotObject",
    "Teleport",
    "UnitEngine",
    "command_window",
    "damp",
    "find_engine",
    "find_object",
    "make_graph",
    "register_object",
]
