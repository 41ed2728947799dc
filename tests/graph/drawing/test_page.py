"""The page holds every node, connection and step, and needs nothing from outside."""

import base64
import io
import json
import re
from dataclasses import replace
from html import escape
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest
import torch

from deepkoco.graph import Connection, Gaussian, Graph, Supervisor, draw_timing
from deepkoco.graph.drawing import DrawingError, draw_signals, make_page, page, write_page
from deepkoco.graph.episodes.episode import episode_of_timing
from deepkoco.graph.episodes.storage import RecordedNode
from deepkoco.graph.episodes.storage.summary import summarise_episodes

GRAPH = Graph(
    [
        RecordedNode("</script><b>world", 100, kind="X", scheduling="phase"),
        RecordedNode("camera", 30, kind="X", delay=Gaussian(0.02, 0.005)),
        Supervisor(rate=20, initial_action=torch.zeros(1)),
    ],
    [
        Connection("</script><b>world", "camera"),
        Connection("camera", "agent", 0.03, window=2, blocking=True),
        Connection("agent", "</script><b>world", skip=True, fifo=False),
        Connection("camera", "camera", skip=True),
    ],
)


class Elements(HTMLParser):
    """Collects tags with their attributes, and the text of scripts."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.script, self._inside = "", False
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs)))
        self._inside = tag == "script"

    def handle_endtag(self, tag):
        self._inside &= tag != "script"

    def handle_data(self, data):
        self.script += data if self._inside else ""

    def of_class(self, name):
        return [a for _, a in self.found if name in (a.get("class") or "").split()]

    @property
    def data(self):
        return json.loads(re.search(r"const data = (.*);", self.script).group(1))


def test_every_node_and_connection_is_there_and_reached_by_keyboard():
    elements = Elements(make_page(GRAPH))
    nodes, edges = elements.of_class("node"), elements.of_class("edge")
    assert [n["data-name"] for n in nodes] == list(GRAPH.index)
    assert [e["data-key"] for e in edges] == [c.key for c in GRAPH.connections[:3]]
    assert all(element["tabindex"] == "0" and element["aria-label"] for element in nodes + edges)
    assert [e["class"] for e in edges] == ["edge", "edge blocking", "edge skip"]
    assert "agent" in [n["data-name"] for n in elements.of_class("supervises")]


def test_hovering_tells_rate_delay_window_scheduling_and_phase():
    data = Elements(make_page(GRAPH)).data
    camera = dict(data["nodes"][1]["facts"])
    assert camera["rate"] == "30 Hz"
    assert camera["computation"] == "20 (12–28) ms"
    assert dict(data["nodes"][0]["facts"])["scheduling"] == "phase"
    assert dict(data["nodes"][2]["facts"])["first tick at"] == "50 ms"
    edge = dict(data["edges"][1]["facts"])
    assert (edge["delay"], edge["window"], edge["the receiver"]) == (
        "30 ms", "last 2", "waits for it (blocking)",
    )  # fmt: skip
    assert "may overtake" in dict(data["edges"][2]["facts"])["order"]


@pytest.mark.parametrize("with_episode", [False, True])
def test_nothing_comes_from_outside(with_episode):
    timing = draw_timing(GRAPH, np.random.default_rng(0), 5, batch=1)
    text = make_page(GRAPH, episode_of_timing(GRAPH, timing) if with_episode else None)
    elements = Elements(text)
    assert not {"link", "img", "iframe", "object"} & {tag for tag, _ in elements.found}
    addresses = {value for _, attributes in elements.found for name, value in attributes.items()
                 if name in {"src", "href", "xlink:href", "srcset"}}  # fmt: skip
    assert all(address.startswith(("data:", "#")) for address in addresses)
    outside = set(re.findall(r"\w+://[^\s\"'<>]*", text))
    assert outside <= {"http://www.w3.org/2000/svg"}  # the name of SVG, which is not fetched
    assert not re.search(r"@import|url\((?!#)|fetch\(|XMLHttpRequest|import\(", text)
    assert "prefers-color-scheme: dark" in text
    assert 'name="viewport"' in text
    assert ("timeline" in [a.get("id") for _, a in elements.found]) == with_episode


def with_outputs(episode):
    """The world sends two numbers a step, the camera pictures."""
    steps = len(episode.t_end["</script><b>world"])
    outputs = {
        "</script><b>world": np.stack([np.arange(steps), -np.arange(steps)], axis=1).astype(np.float32),
        "camera": np.zeros((len(episode.t_end["camera"]), 8, 8, 3), np.uint8),
    }
    return replace(episode, outputs=outputs)


def test_the_page_has_the_rates_delays_and_losses_of_the_episode():
    timing = draw_timing(GRAPH, np.random.default_rng(0), 5, batch=1)
    episode = episode_of_timing(GRAPH, timing)
    text = make_page(GRAPH, episode)
    summary = summarise_episodes(GRAPH, [episode])
    for node in summary.nodes:
        row = next(line for line in text.splitlines() if f"<td>{escape(node.name)}</td>" in line)
        cells = re.findall(r"<td[^>]*>([^<]*)</td>", row)
        assert cells[1] == str(node.steps)
        assert float(cells[2]) == node.rate_hz
        assert [int(c) for c in cells[-2:]] == [node.overruns, node.late]
    row = next(line for line in text.splitlines() if "<td>camera-&gt;agent</td>" in line)
    assert ">30.00</td>" in row
    assert "Rates and delays" not in make_page(GRAPH)


def test_signals_are_those_of_nodes_that_send_few_numbers_and_go_with_the_page(tmp_path):
    episode = with_outputs(episode_of_timing(GRAPH, draw_timing(GRAPH, np.random.default_rng(0), 5, batch=1)))
    drawn = draw_signals(GRAPH, episode)
    assert set(drawn.table["node"]) == {"</script><b>world"}
    first = drawn.table[drawn.table["entry"] == 0]
    np.testing.assert_array_equal(first["value"], np.arange(len(first)))
    np.testing.assert_allclose(first["t_s"], episode.t_end["</script><b>world"])
    text = make_page(GRAPH, episode)
    assert text.count("<svg viewBox=") == 2  # wide and for a phone
    assert not {"b", "i"} & {tag for tag, _ in Elements(text).found}
    encoded = re.search(r'href="data:text/csv;base64,([^"]+)"', text).group(1)
    table = pd.read_csv(io.BytesIO(base64.b64decode(encoded)))
    assert len(table) == len(drawn.table)
    with pytest.raises(DrawingError, match="no signal"):
        draw_signals(
            GRAPH, episode_of_timing(GRAPH, draw_timing(GRAPH, np.random.default_rng(0), 5, batch=1))
        )


def test_the_page_leads_to_the_pages_that_are_there(tmp_path):
    (tmp_path / "index.html").write_text("")
    pages = {"Demo": tmp_path / "index.html", "Model": tmp_path / "model.html"}
    text = write_page(tmp_path / "graph.html", GRAPH, pages=pages).read_text()
    assert '<a href="index.html">Demo</a><b aria-current="page">Graph</b>' in text
    assert "model.html" not in text


def test_names_do_not_break_out_of_the_page():
    elements = Elements(make_page(GRAPH, title="<i>&"))
    assert not {"b", "i"} & {tag for tag, _ in elements.found}
    assert [tag for tag, _ in elements.found].count("script") == 1


def test_the_timeline_has_every_step_and_what_it_saw():
    timing = draw_timing(GRAPH, np.random.default_rng(0), 5, batch=1)
    episode = episode_of_timing(GRAPH, timing)
    lanes = {lane["name"]: lane for lane in Elements(make_page(GRAPH, episode)).data["timeline"]["lanes"]}
    for name in GRAPH.index:
        np.testing.assert_allclose(lanes[name]["start"], episode.t_start[name], atol=1e-7)
        np.testing.assert_allclose(lanes[name]["end"], episode.t_end[name], atol=1e-7)
    saw = lanes["agent"]["inputs"][0]
    assert saw["windows"] == episode.windows["camera->agent"].tolist()
    known = len(saw["sent"])
    assert known == episode.windows["camera->agent"].max() + 1
    np.testing.assert_allclose(saw["received"], episode.t_received["camera->agent"][:known], atol=1e-7)


def test_a_long_episode_is_cut_and_says_so(monkeypatch):
    monkeypatch.setattr(page, "MOST_STEPS", 10)
    timing = draw_timing(GRAPH, np.random.default_rng(0), 5, batch=1)
    text = make_page(GRAPH, episode_of_timing(GRAPH, timing))
    lanes = Elements(text).data["timeline"]["lanes"]
    assert sum(len(lane["start"]) for lane in lanes) in (11, 12, 13)
    assert "Timeline (the first " in text


def test_a_page_is_never_written_over_another_file(tmp_path):
    path = write_page(tmp_path / "graph.html", GRAPH)
    with pytest.raises(DrawingError, match="exists"):
        write_page(path, GRAPH)
    assert [p.name for p in tmp_path.iterdir()] == ["graph.html"]
