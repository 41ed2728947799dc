"""Table of the simulation's own parameters, as given and in model.yaml, in readable units."""

from __future__ import annotations

from typing import NamedTuple

from deepkoco.diagnose.diagnosis import Diagnosis, Estimate
from deepkoco.diagnose.report.text import NOTABLE, spoken
from deepkoco.pages.units import in_one_unit, telling_digits


class ParameterRow(NamedTuple):
    """One parameter.

    Attributes:
        name: Name.
        given: Value of the simulation as given.
        final: Value in model.yaml.
        interval: Its 95 % interval.
        refit: Value of the refit without the named cause.
        notable: Whether the final value is far from the mean of its prior.
    """

    name: str
    given: str
    final: str
    interval: str
    refit: str
    notable: bool


def parameter_rows(diagnosis: Diagnosis) -> list[ParameterRow]:
    """Return a row for each of the simulation's own parameters; none without details."""
    details = diagnosis.details
    if details is None:
        return []
    rows = []
    for name, final in diagnosis.final.items():
        given, refit = details.system.parameter(name).value, diagnosis.refit[name].value
        texts, unit = in_one_unit([given, final.value, refit], final.unit, 4)
        centre, sd = details.priors[name]
        rows.append(
            ParameterRow(
                spoken(name),
                f"{texts[0]} {unit}".strip(),
                f"{texts[1]} {unit}".strip(),
                interval(final),
                f"{texts[2]} {unit}".strip(),
                abs(final.value - centre) > NOTABLE * sd,
            )
        )
    return rows


def interval(estimate: Estimate, fixed: str = "kept as given") -> str:
    """Return the 95 % interval of an estimate as text.

    Args:
        estimate: The estimate.
        fixed: Text for an interval without width.
    """
    if not estimate.low < estimate.high:
        return fixed
    digits = telling_digits(estimate.low, estimate.high)
    (low, high), unit = in_one_unit([estimate.low, estimate.high], estimate.unit, digits)
    return f"{low} to {high} {unit}".strip()
