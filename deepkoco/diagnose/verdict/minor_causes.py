"""Significant causes that are not named: their sizes, and why they are not named."""

from __future__ import annotations

from typing import Any

from deepkoco.diagnose.evidence.selected import Selected
from deepkoco.diagnose.verdict.findings import estimates


def minor_causes(found: Selected) -> list[dict[str, Any]]:
    """Return each cause under the keys of report.json: name, share, parameters, and why it is not named.

    Args:
        found: The selection.
    """
    result = []
    for minor in found.minor:
        # Their priors are as wide as they are, so what these count hardly matters.
        sizes = estimates(found.acting, minor.fit, minor.cause.sizes, minor.deflation, minor.deflation)
        result.append(
            {
                "name": minor.cause.name,
                "share": minor.share,
                "parameters": {n: vars(e) for n, e in sizes.items()},
                "text": _why(minor.cause.name, minor.share, found),
            }
        )
    return result


def _why(name: str, share: float | None, found: Selected) -> str:
    if found.usual:
        return (
            f"{name} is significant beside the refit, but parameters and small effects as any unit has them weigh more "
            "as an explanation, so it is not named."
        )
    if share is None or not found.accepted:
        return f"{name} is significant, but no larger than on any healthy machine, so it is not named."
    first = found.accepted[0].name
    return (
        f"{name} is significant, but explains only {100.0 * share:.2g} % of the error beside {first}. This is the form "
        f"of {first} rather than a second cause, so it is not named."
    )
