"""An arm that pushes a box to a goal: its graph, its agent's seat, its environment, and the start of a model."""

from deepkoco.envs.boxpush.boxpush_graph import BoxPushOptions, box_push_graph, box_push_start
from deepkoco.envs.boxpush.seat import BoxPushSeat

__all__ = ["BoxPushOptions", "BoxPushSeat", "box_push_graph", "box_push_start"]
