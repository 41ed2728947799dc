"""What became of the runs of a sweep, whichever launcher ran them."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from deepkoco.extras import install_command
from deepkoco.runs.settings import ExperimentError

# hydra/launcher=NAME -> (the plugin's module, the extra that installs it). A new launcher is one line and
# one file in configs/hydra/launcher.
LAUNCHERS = {
    "local": ("hydra_plugins.hydra_joblib_launcher", "sweep"),
    "ray": ("hydra_plugins.hydra_ray_launcher", "ray"),
    "slurm": ("hydra_plugins.hydra_submitit_launcher", "slurm"),
}
_OPTION = "hydra/launcher="


@dataclass(frozen=True)
class Failure:
    """A run that did not come to its end.

    Attributes:
        reason: One line for the user.
        refused: Whether its settings or folder were wrong; else it crashed.
    """

    reason: str
    refused: bool = False


class SweepFailed(SystemExit):
    """Runs of a sweep failed: status 2 where all of these were refused, else 1."""


def check_launcher(arguments: Sequence[str]) -> None:
    """Check that the launcher of a command line is installed.

    Args:
        arguments: Of the command.

    Raises:
        ExperimentError: It is not; names the extra.
    """
    for name in (a.removeprefix(_OPTION) for a in arguments if a.startswith(_OPTION)):
        module, extra = LAUNCHERS.get(name, (None, ""))
        if module is not None and not _installed(module):
            raise ExperimentError(f"{_OPTION}{name} is not installed; {install_command(extra)}")


def _installed(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:
        return False


def conclude(
    jobs: Sequence[Sequence[str]],
    outcomes: Sequence[object] | None,
    finished: Callable[[Sequence[str]], bool],
    stopped: Exception | None = None,
) -> None:
    """List the runs of a sweep that failed, if any.

    Args:
        jobs: What each run was called with.
        outcomes: What each run gave back, a `Failure` or anything else; None where the launcher broke off.
        finished: Whether the run of a job is finished, judged by its folder.
        stopped: Why the launcher broke off.

    Raises:
        SweepFailed: A run failed.
    """
    failed: list[tuple[Sequence[str], Failure]] = []
    if outcomes is not None:
        pairs = zip(jobs, outcomes, strict=True)
        failed = [(job, outcome) for job, outcome in pairs if isinstance(outcome, Failure)]
    elif stopped is not None:
        failed = [(job, Failure("not finished")) for job in jobs if not finished(job)]
        reason = " ".join(str(stopped).split())
        print(f"error: the sweep was broken off: {type(stopped).__name__}: {reason[:300]}", file=sys.stderr)
    if not failed:
        if stopped is not None:
            raise SweepFailed(1)
        return
    shared = set(jobs[0]).intersection(*jobs[1:]) if len(jobs) > 1 else set()
    print(f"error: {len(failed)} of {len(jobs)} runs failed:", file=sys.stderr)
    for job, failure in failed:
        print(f"  {' '.join(x for x in job if x not in shared)}: {failure.reason}", file=sys.stderr)
    print("The same command with existing=resume goes on with the sweep.", file=sys.stderr)
    raise SweepFailed(2 if all(failure.refused for _, failure in failed) else 1)
