"""Kill sweeps and go on with them: `python -m experiments.aborted_sweeps --launcher local ray slurm --out FOLDER`.

For each launcher four tiny trainings are swept. A worker is killed (SIGKILL) in the middle, then the launcher; then
the same command ends the sweep. All runs must end with the bytes of runs that nothing disturbed, and those that were
finished at a kill must not be touched again.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import os
import secrets
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from deepkoco.runs.sweep import LAUNCHERS
from experiments.provenance import as_markdown

SEEDS = (0, 1, 2, 3)
TRAINING = (
    "task=gymnasium_pendulum", "+task.kwargs.max_episode_steps=45", "agent.model.encoder_hidden=[8]",
    "agent.model.cost_hidden=[8]", "agent.first_episodes=4", "agent.first_epochs=2", "agent.iteration_episodes=2",
    "agent.total_episodes=100", "agent.evaluation_episodes=2", "agent.final_evaluation_episodes=3",
)  # fmt: skip
# How the process that trains is known; a launcher has processes beside it.
WORKERS = {"local": "loky", "ray": "ray::_run_job", "slurm": "submitit.core._submit"}
LIMIT = 300.0  # [s]
MARK = "DEEPKOCO_ABORTED_SWEEP"
COLUMNS = ("launcher", "killed", "status", "finished", "unfinished", "touched_again", "seconds")


def command(launcher: str | None, folder: Path) -> list[str]:
    """The sweep's command; without a launcher one run after the other."""
    line = [sys.executable, "-m", "experiments.train", "-m", f"seed={','.join(map(str, SEEDS))}", *TRAINING]
    line += [f"run={folder}/seed_${{seed}}", f"hydra.sweep.dir={folder}/hydra", "existing=resume"]
    return line if launcher is None else [*line, f"hydra/launcher={launcher}"]


def finished(folder: Path) -> dict[int, tuple[str, int]]:
    """Seed -> digest of the model and metrics, and when the model was written, of the finished runs."""
    found = {}
    for seed in SEEDS:
        run = folder / f"seed_{seed}"
        weights = run / "model" / "model.safetensors"
        if weights.exists():
            lines = (run / "metrics.csv").read_text().splitlines()
            times = lines[0].split(",").index("seconds")
            metrics = [[*row[:times], *row[times + 1 :]] for row in (line.split(",") for line in lines)]
            digest = hashlib.sha256(weights.read_bytes() + repr(metrics).encode()).hexdigest()
            found[seed] = digest, weights.stat().st_mtime_ns
    return found


def begun(folder: Path) -> bool:
    """Whether a run is in the middle: it has a checkpoint and no model."""
    runs = [folder / f"seed_{seed}" for seed in SEEDS]
    return any((run / "checkpoint.pt").exists() and not (run / "model").exists() for run in runs)


def workers(launcher: str, mark: str) -> list[int]:
    """Processes that train for a call of this study, which all have its mark in their environment."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            line = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
            marked = f"{MARK}={mark}".encode() in (entry / "environ").read_bytes().split(b"\0")
        except OSError:
            continue
        if marked and WORKERS[launcher] in line:
            found.append(int(entry.name))
    return found


def wait_for(condition: Callable[[], object], process: subprocess.Popen | None = None) -> None:
    """Wait until a condition holds, or a process has ended.

    Raises:
        TimeoutError: That takes too long.
    """
    end = time.monotonic() + LIMIT
    while not condition() and (process is None or process.poll() is None):
        if time.monotonic() > end:
            raise TimeoutError(f"nothing happened within {LIMIT:.0f} s")
        time.sleep(0.05)


def busiest(pids: Sequence[int]) -> int | None:
    """The process with the most processor time, if there is one: what trains, not what waits or watches."""
    times = {}
    for pid in pids:
        try:
            fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
        except OSError:
            continue
        times[pid] = int(fields[11]) + int(fields[12])
    return max(times, key=lambda pid: times[pid]) if times else None


def study(launcher: str, folder: Path, reference: dict[int, tuple[str, int]]) -> list[dict]:
    """Kill a worker, then the launcher, then let the sweep end.

    Args:
        launcher: A name of `LAUNCHERS`.
        folder: Of the runs; new.
        reference: `finished` of the undisturbed runs.

    Returns:
        One row per call of the command.

    Raises:
        AssertionError: A run ended otherwise than the undisturbed one.
    """
    rows, before = [], finished(folder)
    for victim in ("worker", "launcher", "nobody"):
        mark, start = secrets.token_hex(8), time.monotonic()
        process = subprocess.Popen(
            command(launcher, folder), stderr=subprocess.PIPE, text=True, env={**os.environ, MARK: mark}
        )
        if victim != "nobody":
            wait_for(lambda: begun(folder), process)
            if victim == "launcher":  # once something is finished, so that there is something to redo
                wait_for(lambda: finished(folder), process)
            pid = process.pid if victim == "launcher" else busiest(workers(launcher, mark))
            if pid is not None and process.poll() is None:
                os.kill(pid, signal.SIGKILL)
        errors = process.communicate()[1]
        after = finished(folder)
        touched = [seed for seed, (_, written) in before.items() if after[seed][1] != written]
        told = [line for line in errors.splitlines() if line.startswith(("error", "  seed"))]
        print(f"{launcher}, killed: {victim}, status {process.returncode}", *told, sep="\n  ", flush=True)
        rows.append(
            {
                "launcher": launcher,
                "killed": victim,
                "status": process.returncode,
                "finished": len(after),
                "unfinished": len(SEEDS) - len(after),
                "touched_again": len(touched),
                "seconds": round(time.monotonic() - start, 1),
            }
        )
        before = after
    digests = {seed: digest for seed, (digest, _) in before.items()}
    assert digests == {seed: digest for seed, (digest, _) in reference.items()}, (launcher, digests)
    assert not any(row["touched_again"] for row in rows), rows
    return rows


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(description="Kill sweeps and go on with them.")
    parser.add_argument("--launcher", nargs="+", choices=sorted(LAUNCHERS), default=["local"])
    parser.add_argument("--out", type=Path, required=True, help="folder for aborted_sweeps.csv; new")
    args = parser.parse_args(arguments)
    if args.out.exists():
        print(f"error: {args.out}: exists already; choose another --out", file=sys.stderr)
        return 2
    rows = []
    with tempfile.TemporaryDirectory() as base:
        undisturbed = Path(base) / "undisturbed"
        subprocess.run(command(None, undisturbed), check=True, stdout=subprocess.DEVNULL)
        for launcher in args.launcher:
            rows += study(launcher, Path(base) / launcher, finished(undisturbed))
    args.out.mkdir(parents=True)
    with (args.out / "aborted_sweeps.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(rows)
    (args.out / "PROVENANCE.md").write_text(as_markdown() + "\n", encoding="utf-8")
    print("all runs ended with the bytes of undisturbed ones; no finished run was touched again")
    return 0


if __name__ == "__main__":
    sys.exit(main())
