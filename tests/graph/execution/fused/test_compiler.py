"""Kernels are compiled once; without a compiler the eager executor runs."""

import ctypes

import numpy as np
import pytest
import torch

from deepkoco.graph import BatchedRuntime, draw_timing
from deepkoco.graph.execution.fused import compiler
from experiments.benchmarks.rollout_work import make_graph, make_parameters

SOURCE = 'extern "C" int answer() { return %d; }'


def test_a_library_is_made_once_for_the_same_source(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert compiler.load(SOURCE % 7).answer() == 7
    (library,) = compiler.cache_folder().iterdir()
    made = library.stat().st_mtime_ns
    assert compiler.load(SOURCE % 7).answer() == 7
    assert compiler.load(SOURCE % 8).answer() == 8
    assert library.stat().st_mtime_ns == made
    assert len(list(compiler.cache_folder().iterdir())) == 2
    assert isinstance(compiler.load(SOURCE % 7), ctypes.CDLL)


def test_where_the_cache_cannot_be_used_kernels_live_as_long_as_the_process(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert compiler.load(SOURCE % 9).answer() == 9
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "broken"))
    assert compiler.load(SOURCE % 10).answer() == 10
    (library,) = compiler.cache_folder().iterdir()
    library.unlink()
    library.write_text("no library")
    assert compiler.load(SOURCE % 10).answer() == 10


def test_a_source_that_does_not_compile_is_an_error():
    with pytest.raises(compiler.CompilerError, match="fails"):
        compiler.load("nonsense")
    assert not any("kernel.so" in path.name for path in compiler.cache_folder().rglob("*"))


def test_without_a_compiler_the_eager_executor_runs_and_says_so_once(monkeypatch, recwarn):
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CXX", raising=False)
    graph = make_graph()
    runtime = BatchedRuntime(graph, draw_timing(graph, np.random.default_rng(0), 3, 2), executor="fused")
    state, inputs = runtime.reset(make_parameters(), torch.Generator())
    assert runtime.executor == "eager"
    state, _ = runtime.reset(make_parameters(), torch.Generator())
    state, _ = runtime.step(state, torch.zeros(2, 1))
    assert inputs["sensor"].data.shape == (2, 2, 2)
    messages = [str(w.message) for w in recwarn if w.category is RuntimeWarning]
    assert len(messages) == 1
    assert "no C++ compiler" in messages[0]
