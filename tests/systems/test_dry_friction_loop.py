"""The compiled sweeps of dry friction agree with those in torch, which gradients use."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.systems.creep import Creep
from deepkoco.systems.dry_friction import Rubbed, rubbed

H = 0.01


def case(seed: int, joints: int, rubbing: int, lanes: int = 5, windows: int = 3):
    draw = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=draw, dtype=torch.float64)

    root = normal(windows, lanes, joints, joints)
    mass = root @ root.mT + 0.3 * torch.eye(joints, dtype=torch.float64)
    inverse = tuple(tuple(row.unbind(-1)) for row in mass.inverse().unbind(-2))
    before = [
        normal(windows, lanes) * (torch.rand(windows, lanes, generator=draw) > 0.3) for _ in range(joints)
    ]
    after = [v + 0.2 * normal(windows, lanes) for v in before]
    # A level is the same for all windows, as parameters of a lane are.
    slide = [normal(lanes).abs() if j < rubbing else None for j in range(joints)]
    stick = [None if s is None else 1.3 * s for s in slide]
    applied = [None if s is None else -s * torch.sign(v) for s, v in zip(slide, before, strict=True)]
    return tuple(before), tuple(after), tuple(applied), tuple(slide), tuple(stick), inverse


def in_torch(values) -> Rubbed:
    """The same through torch: tensors that ask for gradients are left to it."""
    before, *rest = values
    return rubbed(tuple(v.clone().requires_grad_() for v in before), *rest, H)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), joints=st.integers(1, 5), share=st.floats(0.0, 1.0))
def test_compiled_sweeps_agree_with_those_in_torch(seed, joints, share):
    values = case(seed, joints, max(1, round(share * joints)))
    found, wanted = rubbed(*values, H), in_torch(values)
    for a, b in zip((*found.speed, *found.moved), (*wanted.speed, *wanted.moved), strict=True):
        torch.testing.assert_close(a, b.detach(), rtol=1e-5, atol=1e-6)
    for a, b in zip((*found.load, *found.hold), (*wanted.load, *wanted.hold), strict=True):
        assert (a is None) == (b is None)
        if a is not None:
            torch.testing.assert_close(a, b.detach(), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_compiled_sweeps_end_where_an_element_is_not_finite(bad):
    values = case(3, 3, 3)
    values[1][0][0, 0] = bad
    found, clean = rubbed(*values, H), rubbed(*case(3, 3, 3), H)
    for a, b in zip(found.speed, clean.speed, strict=True):
        torch.testing.assert_close(a[1:], b[1:])
        torch.testing.assert_close(a[0, 1:], b[0, 1:])
    # A motion that has run away is not one that rests.
    assert not all(bool(torch.isfinite(a[0, 0])) for a in found.speed)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10_000), joints=st.integers(1, 4), inertia=st.floats(0.1, 100.0))
def test_compiled_sweeps_agree_with_those_in_torch_where_friction_creeps(seed, joints, inertia):
    values = case(seed, joints, joints)
    creeps = tuple(Creep(torch.tensor(inertia, dtype=torch.float64), 100.0) for _ in range(joints))
    found = rubbed(*values, H, creeps)
    wanted = rubbed(tuple(v.clone().requires_grad_() for v in values[0]), *values[1:], H, creeps)
    for a, b in zip((*found.speed, *found.moved), (*wanted.speed, *wanted.moved), strict=True):
        torch.testing.assert_close(a, b.detach(), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("creeps", [False, True])
def test_an_element_does_not_depend_on_those_that_are_computed_with_it(creeps):
    """Whether a fit simulates a set of parameters alone or with others changes no bit of it."""
    values = case(7, 3, 3, lanes=9, windows=9)
    soft = tuple(Creep(torch.tensor(2.0, dtype=torch.float64), 100.0) for _ in range(3)) if creeps else None
    every = rubbed(*values, H, soft)
    for window, lane in ((0, 0), (3, 8), (8, 4)):
        inverse = tuple(tuple(w[window : window + 1, lane : lane + 1] for w in row) for row in values[5])
        before, after, applied = (
            tuple(v[window : window + 1, lane : lane + 1] for v in part) for part in values[:3]
        )
        slide, stick = (tuple(v[lane : lane + 1] for v in part) for part in values[3:5])
        alone = rubbed(before, after, applied, slide, stick, inverse, H, soft)
        for a, b in zip((*alone.speed, *alone.moved), (*every.speed, *every.moved), strict=True):
            assert torch.equal(a[0, 0], b[window, lane])
