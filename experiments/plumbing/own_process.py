"""Runs of a study, each in a process of its own with one thread, so that its processor time is all that it took."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from deepkoco.output.whole_file import write_whole_text
from deepkoco.runs.settings import ExperimentError
from experiments.plumbing.provenance import provenance


def run_once(module: str, method: str, seed: int, folder: Path, options: Sequence[str] = ()) -> None:
    """Run ``python -m MODULE METHOD SEED FILE OPTIONS``, unless that is done.

    Args:
        module: It writes its result to the file as JSON.
        method: First argument.
        seed: Second argument.
        folder: Where METHOD_SEED.json goes: the result, processor and wall-clock seconds, commit.
        options: Further arguments.

    Raises:
        ExperimentError: The run failed.
    """
    path = folder / f"{method}_{seed}.json"
    if path.exists():
        return
    unfinished = path.with_suffix(".part")
    command = [sys.executable, "-m", module, method, str(seed), str(unfinished), *options]
    started = time.perf_counter()
    process = subprocess.Popen(command, env={**os.environ, "OMP_NUM_THREADS": "1"})
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise ExperimentError(f"{method}, seed {seed}: the run ended with status {process.returncode}")
    measured = {
        "method": method,
        "seed": seed,
        "cpu_seconds": usage.ru_utime + usage.ru_stime,
        "wall_seconds": time.perf_counter() - started,
        "commit": provenance()["commit"],
        "options": " ".join(options),
    }
    write_whole_text(path, json.dumps({**measured, **json.loads(unfinished.read_text())}, indent=1))
    unfinished.unlink()
