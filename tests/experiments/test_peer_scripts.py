"""Scripts of the peers run by their path, in environments that have nothing of ours."""

import ast
from pathlib import Path

import pytest

from experiments.benchmarks import identify_peer, rollout_speed, supergraph_efficiency

PEERS = Path(rollout_speed.__file__).parent / "peers"
SCRIPTS = sorted(path for path in PEERS.glob("*.py") if path.name != "__init__.py")


@pytest.mark.parametrize("benchmark", [identify_peer, rollout_speed, supergraph_efficiency])
def test_the_script_that_a_benchmark_starts_is_there(benchmark):
    assert benchmark.PEER_SCRIPT in SCRIPTS


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_a_script_of_a_peer_imports_nothing_of_ours(script):
    named = {
        name
        for node in ast.walk(ast.parse(script.read_text()))
        for name in (
            [a.name for a in node.names]
            if isinstance(node, ast.Import)
            else [node.module or "."]
            if isinstance(node, ast.ImportFrom)
            else []
        )
    }
    assert not {name.split(".")[0] for name in named} & {"deepkoco", "experiments", ""}
