"""The CUDA executor: one supervisor step as a function of tensors, captured as a CUDA graph."""

from deepkoco.graph.execution.cuda.executor import TensorExecutor, cuda_executor

__all__ = ["TensorExecutor", "cuda_executor"]
