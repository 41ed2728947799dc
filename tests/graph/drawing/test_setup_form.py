"""The page of a graph edits its setup, and what it writes is read as what was entered."""

import json
from pathlib import Path

import pytest
import quickjs
import torch
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.graph import Connection, Gaussian, Graph, Supervisor
from deepkoco.graph.delay import LAWS, make_delay
from deepkoco.graph.drawing import make_page
from deepkoco.graph.drawing.setup_form import setup_form
from deepkoco.graph.episodes.storage import RecordedNode
from deepkoco.graph.setup import apply_setup, describe_setup

PAGES = Path(__file__).parents[3] / "deepkoco/graph/drawing/pages"
GRAPH = Graph(
    [
        RecordedNode("world", 100, kind="X", scheduling="phase"),
        RecordedNode("camera on", 30, kind="X", delay=Gaussian(0.02, 0.005)),
        Supervisor(rate=20, initial_action=torch.zeros(1)),
    ],
    [
        Connection("world", "camera on"),
        Connection("camera on", "agent", 0.03, window=2, blocking=True),
        Connection("agent", "world", skip=True, fifo=False),
    ],
)
PARAMETERS = {"world": {"mass": 1.5, "start": [[0.0, 1.0]]}}


@pytest.fixture(scope="module")
def script():
    context = quickjs.Context()
    text = (PAGES / "setup_yaml.html").read_text()
    context.eval(text[text.index("#}") + 2 :])

    def call(name, *values):
        written = ", ".join(json.dumps(value) for value in values)
        return json.loads(context.eval(f"JSON.stringify({name}({written}))"))

    return call


PLAIN = st.one_of(
    st.booleans(), st.none(), st.floats(-1e15, 1e15), st.sampled_from([1e300, -1e21, 5e-324]),
    st.integers(-(10**9), 10**9),
    st.text(st.characters(codec="utf-8", exclude_categories=["Cc", "Cs", "Zl", "Zp"]), max_size=12),
    st.sampled_from(["no", "1e3", "null", "a: b", "- x", "#", "world->agent", "0x1", "1_000", ".5", "~"]),
)  # fmt: skip
KEYS = st.text("abc: '\"", min_size=1, max_size=5)
VALUES = st.recursive(
    PLAIN, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner, max_size=3)
)
NAMES = st.sampled_from(["world", "agent->world", "a: b", "no", "camera on", "µ", "12"])


@settings(deadline=None, max_examples=200)
@given(st.dictionaries(NAMES, st.dictionaries(NAMES, VALUES, min_size=1, max_size=3), min_size=1, max_size=3))
def test_yaml_that_the_page_writes_is_read_as_the_values(script, entries):
    written = script("yamlOf", {"nodes": entries, "connections": {"x": {"delay": 1e-7}}})
    assert yaml.safe_load(written) == {"nodes": entries, "connections": {"x": {"delay": 1e-7}}}


def test_the_page_writes_what_differs_and_the_graph_takes_it(script):
    before = describe_setup(GRAPH, PARAMETERS)
    after = json.loads(json.dumps(before))
    assert script("changesBetween", before, after) == {}
    after["nodes"]["world"]["rate"] = 250
    after["connections"]["camera on->agent"] |= {
        "window": 4,
        "delay": {"law": "uniform", "low": 0.001, "high": 0.002},
    }
    after["parameters"]["world"]["mass"] = 2.5
    changes = yaml.safe_load(script("yamlOf", script("changesBetween", before, after)))
    assert changes["parameters"] == {"world": {"mass": 2.5}}
    taken = apply_setup(GRAPH, changes)
    assert describe_setup(taken, PARAMETERS | {"world": PARAMETERS["world"] | {"mass": 2.5}}) == after


def test_every_law_begins_as_one_that_loads(script):
    form = setup_form(GRAPH)
    assert set(form["laws"]) == set(LAWS)
    for name, entries in form["laws"].items():
        law = {"law": name} | {entry["name"]: entry["first"] for entry in entries}
        assert make_delay(law).law == name
        assert script("wrongDelay", law, form["laws"], True) == ""


@pytest.mark.parametrize(
    ("section", "name", "key", "value", "says"),
    [
        ("nodes", "world", "rate", 0, "more than 0 Hz"),
        ("nodes", "world", "rate", None, "more than 0 Hz"),
        ("nodes", "world", "delay", -0.1, "0 s or more"),
        ("nodes", "world", "delay", {"law": "lossy", "delay": 0.1, "probability": 0.1}, "only messages can get lost"),
        ("connections", "agent->world", "window", 1.5, "whole number"),
        ("connections", "agent->world", "delay", {"law": "gaussian", "loc": None, "scale": 1}, "loc: give a number"),
        ("connections", "agent->world", "delay", {"law": "empirical", "samples": []}, "samples: give numbers"),
        ("parameters", "world", "mass", None, "give a number"),
        ("parameters", "world", "start", [1, 2], "it has 1 x 2"),
        ("parameters", "world", "start", [[1, 2], [3]], "it has 1 x 2"),
    ],
)  # fmt: skip
def test_a_wrong_value_is_named_before_it_is_saved(script, section, name, key, value, says):
    form = setup_form(GRAPH, PARAMETERS)
    after = json.loads(json.dumps(form["setup"]))
    assert script("wrongIn", form["setup"], after, form["laws"]) == []
    after[section][name][key] = value
    (wrong,) = script("wrongIn", form["setup"], after, form["laws"])
    assert (wrong["section"], wrong["name"], wrong["key"]) == (section, name, key)
    assert says in wrong["text"]


def test_a_parameter_without_a_limit_is_no_mistake_and_is_written_as_yaml(script):
    form = setup_form(GRAPH, {"world": {"limit": float("inf"), "low": [0.0, float("-inf")]}})
    assert script("wrongIn", form["setup"], form["setup"], form["laws"]) == []
    written = script(
        "yamlOf", {"parameters": {"world": {"limit": float("inf"), "low": [0.5, float("-inf")]}}}
    )
    assert yaml.safe_load(written) == {
        "parameters": {"world": {"limit": float("inf"), "low": [0.5, float("-inf")]}}
    }


def test_changes_that_a_graph_came_with_are_saved_too(script):
    changed = apply_setup(GRAPH, {"nodes": {"world": {"rate": 200}}})
    form = setup_form(changed, PARAMETERS, describe_setup(GRAPH, PARAMETERS))
    assert script("changesBetween", form["setup"], form["start"]) == {"nodes": {"world": {"rate": 200}}}


def test_the_scripts_of_the_page_can_be_parsed():
    page = make_page(GRAPH, parameters=PARAMETERS)
    script = page[page.index("<script>") + 8 : page.index("</script>")]
    assert "parameters" in page[: page.index("<script>")]
    quickjs.Function("parse", "function parse(text) { new Function(text); return 1; }")(script)
