"""The fused executor: node functions traced, written as C++ and run as one kernel."""

from deepkoco.graph.execution.fused.executor import FusedExecutor

__all__ = ["FusedExecutor"]
