"""Traces take down what a function does, and refuse what they cannot follow."""

import pytest
import torch

from deepkoco.graph.execution.fused.trace import Ref, TraceError, trace


def test_what_does_not_depend_on_the_inputs_is_a_constant():
    scale = torch.tensor([2.0, 3.0])

    def function(tensors):
        return {"y": tensors["x"] * torch.exp(scale), "one": torch.ones(1)}

    found = trace(function, {"x": torch.zeros(1, 2), "unused": torch.zeros(1)})
    assert [call.name for call in found.calls] == ["aten.mul.Tensor"]
    assert torch.equal(found.calls[0].arguments[1], torch.exp(scale))
    assert isinstance(found.outputs["y"], Ref)
    assert torch.equal(found.outputs["one"], torch.ones(1))
    assert found.used() == {"x"}


def test_a_tensor_handed_on_is_the_input_itself():
    found = trace(lambda t: {"x": t["x"], "y": t["x"] + 1}, {"x": torch.zeros(1)})
    assert found.outputs["x"] is found.inputs["x"]


def test_writing_into_a_view_becomes_new_tensors():
    def function(tensors):
        y = tensors["x"].clone()
        y[:, 0] = 7.0
        y += 1
        return {"y": y}

    x = torch.tensor([[1.0, 2.0]])
    found = trace(function, {"x": x})
    assert found.outputs["y"].example.tolist() == [[8.0, 3.0]]
    assert x.tolist() == [[1.0, 2.0]]
    assert not any(call.function._schema.is_mutable for call in found.calls)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda t: {"y": t["x"] if t["x"].sum() > 0 else -t["x"]}, "torch.where instead of if"),
        (lambda t: {"y": t["x"] * float(t["x"][0])}, "takes a value out"),
        (lambda t: {"y": torch.from_numpy(t["x"].numpy()) + 1}, r"Tensor.numpy\(\)"),
        (lambda t: {"y": t["x"] + torch.tensor(t["x"].tolist())}, r"Tensor.tolist\(\)"),
        (lambda t: {"y": t["x"] + torch.rand(1)}, "draws random numbers"),
        (lambda t: {"y": t["x"].add_(1)}, "writes into an input"),
    ],
)
def test_what_a_trace_cannot_follow_is_named(function, message):
    with pytest.raises(TraceError, match=message):
        trace(function, {"x": torch.ones(1)})
