"""What no cause of the catalogue explains, in sentences."""

from __future__ import annotations

from typing import Any

from deepkoco.diagnose.diagnosis import Diagnosis
from deepkoco.diagnose.report.text import beside_causes, spoken
from deepkoco.diagnose.verdict.unknown import WORST

RARE = 3.0  # kurtosis from which a few moments make up most of what is missing
ALIKE = 0.3  # correlation of neighbouring residuals from which they are plainly no noise
RELATED = 0.3  # correlation with a term from which it is worth telling


def remains(diagnosis: Diagnosis) -> list[str]:
    """Sentences on where, when and how the simulation is still wrong; none where that is noise."""
    left, beside = diagnosis.unexplained, beside_causes(diagnosis)
    if not left or (diagnosis.verdict != "unknown" and not beside):
        return []
    worst, kurtosis = left["worst"], left["kurtosis"]
    slides = "force_n" in worst
    position, speed, load = (worst[key] for key in WORST["force" if slides else "torque"])
    units = ("m", "m/s", "N") if slides else ("rad", "rad/s", "N m")
    result = [
        *([beside] if beside else []),
        f"It is largest at {worst['time_s']:.2f} s: {load:.3g} {units[2]} are missing there on {worst['joint_name']}, "
        f"at position {position:.3g} {units[0]} and speed {speed:.3g} {units[1]}.",
        f"A few moments make up most of it (kurtosis {kurtosis:.1f}; 0 is normal): look for pushes, contacts or lost "
        "samples there."
        if kurtosis > RARE
        else f"It is spread over the log, not a matter of a few moments (kurtosis {kurtosis:.1f}; 0 is normal).",
    ]
    lag = left["lag_one"]
    if lag > ALIKE:
        result.append(
            f"Neighbouring errors are alike (correlation {lag:.2f}): it is something in the motion, not noise."
        )
    else:
        result.append(f"Neighbouring errors are hardly alike (correlation {lag:.2f}): it looks like noise.")
    result.append(_related(left["correlations"]))
    result += [signature["text"] for signature in left.get("signatures", [])]
    if (learned := left.get("residual_model")) is not None:
        result.append(_learned(learned))
    return result


def _related(correlations: dict[str, float]) -> str:
    name, value = max(correlations.items(), key=lambda item: abs(item[1]))
    if abs(value) < RELATED:
        return f"No simple term of position and speed follows it (the closest is {name}, correlation {value:.2f})."
    return f"Of simple terms, {name} follows it best (correlation {value:.2f})."


def _learned(learned: dict[str, Any]) -> str:
    if not learned["accepted"]:
        return f"No learned load was added to the simulation: {learned['reason']}."
    terms = ", ".join(f"{t['weight']:.3g} {t['unit']} for {spoken(t['name'])}" for t in learned["terms"])
    gain = learned["reduction_vs_refit"]
    worth = "" if gain is None else f" It takes {100 * gain:.0f} % off the held-out error."
    return f"A learned load was added to model.yaml, marked as such; it fits and explains nothing: {terms}.{worth}"
