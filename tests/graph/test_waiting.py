"""Schedules that take long to draw show how far they are, and nothing else changes."""

import io
import sys

import numpy as np
import pytest
import torch

from deepkoco.graph import Connection, Gaussian, Graph, Node, Stalls, Supervisor, draw_timing
from deepkoco.graph.timing import draw as timing
from deepkoco.graph.timing import waiting


class Echo(Node):
    def initial_output(self, parameters, state, batch):
        return torch.zeros(batch, 1)

    def step(self, parameters, state, inputs):
        return state, inputs["agent"].data[:, -1]


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def draw(rows: int = 7, **options):
    graph = Graph(
        [Echo("echo", 50), Supervisor("agent", 20, initial_action=torch.zeros(1))],
        [Connection("agent", "echo", Gaussian(0.02, 0.01), skip=True), Connection("echo", "agent")],
        **options,
    )
    return draw_timing(graph, np.random.default_rng(0), 30, rows)


@pytest.mark.parametrize(
    "options", [{}, {"stalls": [Stalls(rate=3.0, duration=0.05)]}], ids=["plain", "stalls"]
)
def test_schedules_do_not_depend_on_how_many_are_worked_out_at_once(monkeypatch, options):
    whole = draw(**options)
    monkeypatch.setattr(timing, "_AT_ONCE", 1)
    parts = draw(**options)
    for name in ("t_start", "t_end", "t_received", "windows", "boundary"):
        assert np.array_equal(getattr(whole, name), getattr(parts, name)), name


def shown(monkeypatch, stream: io.StringIO, patience: float) -> str:
    monkeypatch.setattr(timing, "_AT_ONCE", 1)
    monkeypatch.setattr(waiting, "PATIENCE", patience)
    monkeypatch.setattr(sys, "stderr", stream)
    draw()
    return stream.getvalue()


def test_a_terminal_is_shown_how_far_the_schedules_are(monkeypatch):
    text = shown(monkeypatch, Terminal(), patience=0.0)
    assert "drawing schedules" in text
    assert "/7" in text


def test_what_is_no_terminal_stays_quiet(monkeypatch):
    assert shown(monkeypatch, io.StringIO(), patience=0.0) == ""


def test_short_work_shows_nothing(monkeypatch):
    assert shown(monkeypatch, Terminal(), patience=60.0) == ""
