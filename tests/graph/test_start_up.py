"""What a new graph imports before its first step: waiting for anything else is time lost at every start."""

import subprocess
import sys

NEEDLESS = (
    "cv2",
    "gymnasium",
    "matplotlib",
    "mcap",
    "networkx",
    "pandas",
    "pyarrow",
    "sympy",
    "torch._dynamo",
)

PROGRAM = f"""
import sys
import numpy as np
import torch
from deepkoco.graph import BatchedRuntime, draw_timing
from experiments.benchmarks import rollout_work as work

graph = work.make_graph()
timing = draw_timing(graph, np.random.default_rng(0), 5, 2, rows=2)
runtime = BatchedRuntime(graph, timing, executor="fused")
state, _ = runtime.reset(work.make_parameters(), torch.Generator().manual_seed(0), rows=np.zeros(2, int))
runtime.step(state, torch.zeros(2, 1))
print(runtime.executor, *sorted(set({NEEDLESS}) & set(sys.modules)))
"""


def test_the_first_step_of_a_graph_imports_no_tables_pictures_or_compilers() -> None:
    run = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["fused"]
