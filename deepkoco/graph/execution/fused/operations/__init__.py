"""What each aten operation is in C++."""

from deepkoco.graph.execution.fused.operations.lower import lower

__all__ = ["lower"]
