"""Sentences about the residuals that no named cause explains."""

from __future__ import annotations

from typing import Any

from deepkoco.diagnose.diagnosis import Diagnosis
from deepkoco.diagnose.report.text import beside_causes, nearest_of, spoken
from deepkoco.diagnose.verdict.unknown import WORST

FEW_MOMENTS = 3.0  # kurtosis from which a few moments make up most of the missing load
CORRELATED = 0.3  # correlation of neighbouring residuals from which they are clearly not noise
RELATED = 0.3  # correlation with a term from which the term is reported


def remains(diagnosis: Diagnosis) -> list[str]:
    """Return sentences on where, when and how the simulation is still wrong; none if only noise is left."""
    left, beside = diagnosis.unexplained, beside_causes(diagnosis)
    if not left or (diagnosis.verdict != "unknown" and not beside):
        return []
    worst, kurtosis = left["worst"], left["kurtosis"]
    slides = "force_n" in worst
    position, speed, load = (worst[key] for key in WORST["force" if slides else "torque"])
    units = ("m", "m/s", "N") if slides else ("rad", "rad/s", "N m")
    result = [
        *([beside] if beside else []),
        f"The missing load is largest at {worst['time_s']:.2f} s: {load:.3g} {units[2]} are missing there on "
        f"{worst['joint_name']}, at position {position:.3g} {units[0]} and speed {speed:.3g} {units[1]}.",
        f"A few moments make up most of the missing load (kurtosis {kurtosis:.1f}; a normal distribution has 0). "
        "Look for pushes, contacts or lost samples there."
        if kurtosis > FEW_MOMENTS
        else f"The missing load is spread over the whole log (kurtosis {kurtosis:.1f}; a normal distribution has 0).",
    ]
    lag = left["lag_one"]
    if lag > CORRELATED:
        result.append(
            f"Neighbouring errors are correlated ({lag:.2f}), so the error comes from the motion, not from noise."
        )
    else:
        result.append(f"Neighbouring errors are hardly correlated ({lag:.2f}), as those of noise.")
    if (family := left.get("family")) is not None:
        result.append(nearest_of(family))
    result.append(_related(left["correlations"]))
    result += [signature["text"] for signature in left.get("signatures", [])]
    if (learned := left.get("residual_model")) is not None:
        result.append(_learned(learned))
    return result


def _related(correlations: dict[str, float]) -> str:
    name, value = max(correlations.items(), key=lambda item: abs(item[1]))
    if abs(value) < RELATED:
        return (
            "No simple term in position and speed is correlated with the missing load (the closest is "
            f"{name}, correlation {value:.2f})."
        )
    return f"The simple term with the highest correlation with the missing load is {name} ({value:.2f})."


def _learned(learned: dict[str, Any]) -> str:
    if not learned["accepted"]:
        return f"No learned load was added to the simulation: {learned['reason']}."
    terms = ", ".join(f"{t['weight']:.3g} {t['unit']} for {spoken(t['name'])}" for t in learned["terms"])
    gain = learned["reduction_vs_refit"]
    worth = "" if gain is None else f" It lowers the held-out error by {100 * gain:.0f} %."
    return f"A learned load was added to model.yaml: {terms}. It fits the log but names no physical cause.{worth}"
