"""Runtimes with the CUDA executor: captured on a CUDA device, and the same function uncaptured elsewhere."""

import pytest
import torch

from deepkoco.graph import BatchedRuntime, Graph
from deepkoco.graph.execution.cuda import TensorExecutor

needs_cuda = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
DEVICES = ["cpu", pytest.param("cuda", marks=needs_cuda)]


def make_runtime(graph: Graph, timing, device: str) -> BatchedRuntime:
    """The CUDA executor on CUDA; elsewhere its function without the capture."""
    if device == "cuda":
        return BatchedRuntime(graph, timing, executor="cuda")
    runtime = BatchedRuntime(graph, timing, device)
    runtime._executor = TensorExecutor(graph, torch.device(device), capture=False)
    return runtime


def assert_same(found: torch.Tensor, expected: torch.Tensor) -> None:
    """Bitwise on one device; to rounding on two, whose functions are not the same."""
    if found.device == expected.device:
        assert found.dtype == expected.dtype
        assert torch.equal(found, expected)
        return
    tolerance = 1e-4 if expected.dtype == torch.float32 else 1e-10
    torch.testing.assert_close(found.cpu(), expected, rtol=tolerance, atol=tolerance)


def assert_same_inputs(found, expected) -> None:
    assert list(found) == list(expected)
    for name, seen in expected.items():
        for part, value in zip(found[name], seen, strict=True):
            assert_same(part, value)


def assert_same_state(found, expected) -> None:
    assert found.row.tolist() == expected.row.tolist()
    assert found.step.tolist() == expected.step.tolist()
    assert found.time.tolist() == expected.time.tolist()
    assert found.readings.keys() == expected.readings.keys()
    for name, value in expected.readings.items():
        assert_same(found.readings[name], value)
    for name, values in expected.nodes.items():
        assert found.nodes[name].keys() == values.keys()
        for key, value in values.items():
            assert_same(found.nodes[name][key], value)
