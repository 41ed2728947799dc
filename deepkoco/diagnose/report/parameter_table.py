"""The simulation's own parameters, as given and as model.yaml has them, in readable units."""

from __future__ import annotations

from typing import NamedTuple

from deepkoco.diagnose.diagnosis import Diagnosis, Estimate
from deepkoco.diagnose.report.text import spoken
from deepkoco.pages.units import in_one_unit

NOTABLE = 2.0  # standard deviations of the prior from which a change is set off


class ParameterRow(NamedTuple):
    """One parameter.

    Attributes:
        name: Name.
        given: Value of the simulation as given.
        final: Value in model.yaml.
        interval: Its 95 % interval.
        refit: Value of the refit without the named cause.
        notable: Whether the final value lies far from the one given.
    """

    name: str
    given: str
    final: str
    interval: str
    refit: str
    notable: bool


def parameter_rows(diagnosis: Diagnosis) -> list[ParameterRow]:
    """A row for each of the simulation's own parameters; none without details."""
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
    """The 95 % interval of an estimate in words.

    Args:
        estimate: The estimate.
        fixed: What is said of one without width.
    """
    if not estimate.low < estimate.high:
        return fixed
    (low, high), unit = in_one_unit([estimate.low, estimate.high], estimate.unit, 4)
    return f"{low} to {high} {unit}".strip()
