"""Frames and trees: what is sent is what comes, and anything else is refused."""

import contextlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hn

from deepkoco.graph.net.wire import FrameReader, Kind, WireError, frame, pack, unpack

ARRAYS = hn.arrays(
    st.sampled_from(["float64", "float32", "int64", "int8", "uint8", "bool"]),
    hn.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4),
)
LEAVES = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text() | ARRAYS
TREES = st.recursive(
    LEAVES, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4)
)


def assert_same(one, other):
    if isinstance(one, np.ndarray):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)
    elif isinstance(one, dict):
        assert list(one) == list(other)
        for key in one:
            assert_same(one[key], other[key])
    elif isinstance(one, list):
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            assert_same(a, b)
    else:
        assert one == other
        assert type(one) is type(other)


@given(TREES)
def test_a_tree_comes_back_as_it_was(tree):
    assert_same(tree, unpack(pack(tree)))


@given(TREES, st.data())
def test_bytes_that_are_cut_off_are_no_tree(tree, data):
    whole = pack(tree)
    cut = data.draw(st.integers(0, len(whole) - 1))
    with pytest.raises(WireError):
        unpack(whole[:cut])


@given(st.binary(max_size=200))
def test_any_bytes_are_a_tree_or_refused(data):
    with contextlib.suppress(WireError):
        unpack(data)


def test_what_is_no_plain_number_does_not_travel():
    for wrong in (np.array([object()]), object(), {1: 2}, {"a": b"bytes"}):
        with pytest.raises(WireError, match="does not travel"):
            pack(wrong)


@given(st.lists(st.tuples(st.sampled_from(list(Kind)), st.binary(max_size=50)), max_size=8), st.data())
def test_frames_come_whole_however_the_network_cuts_them(frames, data):
    stream, reader, came = b"".join(frame(kind, body) for kind, body in frames), FrameReader(), []
    while stream:
        size = data.draw(st.integers(1, len(stream)))
        came += reader.feed(stream[:size])
        stream = stream[size:]
    assert came == frames


def test_a_stranger_is_no_frame():
    with pytest.raises(WireError, match="no frame"):
        list(FrameReader().feed(b"GET / HTTP/1.1\r\n"))
