"""The last stage of every training, whatever its agent: compare, and write the comparison into the run's folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from gymnasium.vector import VectorEnv

from deepkoco.agent.references.files import write_comparison
from deepkoco.agent.references.measure import Trained, compare
from deepkoco.agent.references.same_starts import SameStarts
from deepkoco.agent.seeding import Purpose, derive_seed


def compare_run(
    trained: Callable[[], Trained],
    envs: Callable[[int], VectorEnv],
    evaluated: int,
    wanted: int,
    run_seed: int,
    folder: Path,
) -> dict[str, str]:
    """Compare a trained controller with references from start states of its final evaluation.

    Nothing is drawn from a generator of the training, so a run that was killed here does it again, with the same bytes.

    Args:
        trained: Puts the training together.
        envs: Environments of the evaluation, by their number.
        evaluated: Episodes of the final evaluation.
        wanted: Start states that are compared; 0 leaves the comparison out.
        run_seed: Seed of the run.
        folder: Of the run.

    Returns:
        What the exported model says of its training: `comparison`, the line; empty without a comparison.

    Raises:
        WriteError: The disk is full, or the place cannot be written.
    """
    if not wanted:
        return {}
    starts = SameStarts(envs, evaluated, wanted, derive_seed(run_seed, Purpose.FINAL_EVALUATION))
    comparison = compare(trained(), starts)
    write_comparison(folder, comparison)
    return {"comparison": comparison.line}
