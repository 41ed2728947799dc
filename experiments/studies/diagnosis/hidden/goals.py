"""What the study has to reach, and whether rows reach it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple


class Goal(NamedTuple):
    """One line of the table of goals.

    Attributes:
        measure: Key of :func:`experiments.studies.diagnosis.hidden.measures.measures`.
        text: What is measured.
        least: Least share or value that is wanted, by condition; ``""`` is any other condition.
        most: Largest one.
    """

    measure: str
    text: str
    least: Mapping[str, float] = {}
    most: Mapping[str, float] = {}


GOALS: tuple[Goal, ...] = (
    Goal("false_alarms", "false alarms on controls", most={"": 2 / 60}),
    Goal("detected_ES_0.1_to_0.2", "detected, ES 0.1 to 0.2", {"": 0.85}),
    Goal("detected_ES_from_0.2", "detected, ES from 0.2", {"": 1.0}),
    Goal(
        "top_1_in_class",
        "true cause in the class of the first finding, ES from 0.3",
        {"": 0.9, "clean": 0.95},
    ),
    Goal("exact_top_1", "true cause is the first name, ES from 0.3", {"clean": 0.9}),
    Goal("true_cause_in_reported_set", "true cause in the reported set", {"": 0.95}),
    Goal("set_size", "mean size of the first class", most={"": 2.0}),
    Goal("pairs_both_named", "pairs, both named in class", {"": 0.85}),
    Goal("outside_called_unknown", "outside the catalogue: unknown, chi2/N above 1.2", {"": 0.9}),
    Goal("outside_named_wrongly", "outside the catalogue: a wrong name", most={"": 0.05}),
    Goal("parameter_error_median", "median error of a parameter, ES from 0.3", most={"": 0.05}),
    Goal("interval_coverage", "95 % intervals that cover the truth", {"": 0.9}, {"": 0.99}),
    Goal("held_out_gain_of_oracle", "held-out gain at least 95 % of the oracle's", {"": 0.95}),
    Goal("worse_than_given_by_2_percent", "over 2 % worse than the model as given", most={"": 0.0}),
    Goal("cpu_s", "median processor time of a diagnosis [s]", most={"": 5.0}),
)


def value_of(found: Mapping[str, Any]) -> float | None:
    """The share or the value of one measure."""
    return found.get("share", found.get("value"))


def bounds(goal: Goal, condition: str) -> tuple[float | None, float | None]:
    """Least and largest value that a goal allows under a condition."""
    return goal.least.get(condition, goal.least.get("")), goal.most.get(condition, goal.most.get(""))


def reached(goal: Goal, condition: str, found: Mapping[str, Any]) -> bool | None:
    """Whether a measure reaches its goal; None where there is no goal or there are no cases."""
    least, most = bounds(goal, condition)
    value = value_of(found)
    if value is None or (least is None and most is None):
        return None
    # Where a share has to lie between two ends, few cases cannot show that it is above the upper one.
    above = found.get("low", value) if least is not None else value
    return (least is None or value >= least - 1e-9) and (most is None or above <= most + 1e-9)
