"""Headline and lead of a diagnosis, and its table for the terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from rich.markup import escape
from rich.table import Table

from deepkoco.diagnose.causes import CAUSES, changed_parameter, kind_of
from deepkoco.diagnose.causes.parameter import SCALED
from deepkoco.diagnose.diagnosis import Diagnosis, Estimate, Finding, Moved
from deepkoco.diagnose.evidence.how_probable import UNKNOWN
from deepkoco.pages.units import in_one_unit, telling_digits
from deepkoco.systems.named_joints import COMMON

NOTABLE = 2.0  # standard deviations of the prior from which a changed parameter is pointed out
REFITTED = 3.0  # times the held-out error that the simulation as given has, from which a headline says so
LARGEST_FACTOR = 1000.0  # between two values of a parameter, for which the factor still says something


def spoken(name: str) -> str:
    """Return the name of a cause in the form for a sentence."""
    changed = changed_parameter(name)
    if changed is not None:
        return f"another value of {spoken(changed)}"
    kind, _, where = name.partition("(")
    if kind == SCALED.name:
        return f"common factor of all {spoken(where.rstrip(')'))}"
    if where == f"{COMMON})":
        return f"{spoken(kind)} (all actuators)"
    return name.replace("_", " ").replace("(", " (")


def headline(diagnosis: Diagnosis) -> str:
    """Return the verdict in one line."""
    named = _named(diagnosis.causes)
    explained = f"The simulation explains this log up to noise{_once_refitted(diagnosis)}"
    if diagnosis.moved:
        values = " and ".join(moved_value(m) for m in diagnosis.moved)
        explained = f"{values}. With this, the simulation explains the log up to noise"
    rest = "rest" if _once_refitted(diagnosis) else "difference"
    differs = f"no cause of the catalogue explains the {rest}"
    if (family := diagnosis.unexplained.get("family")) is not None:
        differs = f"most likely by {family['text']}"
    if (midway := diagnosis.unexplained.get("changed_midway")) is not None:
        differs = f"{midway['text']}: one set of parameters does not explain both parts"
    if diagnosis.left_out:
        differs = "the time did not suffice to say by what"
    if midway is not None:
        named = f"T{midway['text'][1:]}. Since then: {named.replace('The simulation', 'the simulation', 1)}"
    return {
        "cause": named,
        "ambiguous": f"{named} (or an equivalent)",
        "nothing": explained,
        "unknown": f"{_differs(diagnosis)}, and {differs}",
        "insufficient": "The data do not suffice",
    }[diagnosis.verdict]


def _differs(diagnosis: Diagnosis) -> str:
    """Return that the simulation differs from the log, after what its own parameters explain where that is most."""
    if refitted := _once_refitted(diagnosis):
        values = " and ".join(moved_value(m) for m in diagnosis.moved)
        text = f"The simulation explains most of the difference{refitted}; it still differs from this log"
        return f"{values}. {text}" if values else text
    return "The simulation differs from this log"


def _once_refitted(diagnosis: Diagnosis) -> str:
    """Return by how much the refit lowers the held-out error, where that is much: the values given are then off."""
    if diagnosis.gain is None or diagnosis.gain.as_given:
        return ""
    channels = [c for c in diagnosis.gain.channels if c.refit > 0.0]
    most = max(channels, key=lambda c: c.baseline / c.refit, default=None)
    if most is None or most.baseline < REFITTED * most.refit:
        return ""
    given = "as learned from healthy logs" if diagnosis.data.get("healthy") else "as given"
    return (
        f" once its own parameters are refitted: {given}, its held-out error of {most.name} is "
        f"{_times(most.baseline / most.refit)} as large"
    )


def _times(ratio: float) -> str:
    """Return a ratio with two digits in words that nobody has to decode: 150 times, not 1.5e+02."""
    two = float(f"{ratio:.2g}")
    return f"{two:,.0f} times" if two >= 10.0 else f"{two:.2g} times"


def nearest_of(family: Mapping[str, Any]) -> str:
    """Return a sentence about the cause of the catalogue that comes nearest to an unknown one of the same family."""
    return (
        f"{spoken(family['cause'])} explains {100 * family['share']:.0f} % of the difference; among all causes of the "
        f"catalogue its family ({family['name']}) has {100 * family['probability']:.0f} %."
    )


def moved_value(moved: Moved) -> str:
    """Return a moved parameter as a clause, and the sum of which it is a part if only that sum shows."""
    text = new_value(moved.name, moved.given, moved.estimate)
    for other in moved.instead:
        text += f", or instead {new_value(other.name, other.given, other.estimate)}, which this log cannot tell apart"
    if not moved.sum_with:
        return text
    sums = [moved.sum_given + moved.estimate.value - moved.given, moved.sum_given]
    (now, before), unit = in_one_unit(sums, moved.estimate.unit)
    parts = " and ".join(spoken(n) for n in (moved.name, *moved.sum_with))
    return f"{text}; only the sum of {parts} shows in the motion, it is {now} {unit}, not {before} {unit}"


def _named(causes: Sequence[Finding]) -> str:
    """Return the named causes in one line, the strongest first."""
    changed = [
        new_value(n, given, c.parameters[n]) for c in causes for n, given in c.given.items() if c.given
    ]
    lacking = [c for c in causes if not c.given]
    lacks = "he simulation lacks: " + " and ".join(_with_same(c) for c in lacking)
    if not changed:
        return f"T{lacks}"
    values = " and ".join(changed)
    if not lacking:
        return values
    return f"{values}, and t{lacks}" if causes[0].given else f"T{lacks}; and {values}"


def _with_same(cause: Finding) -> str:
    if not cause.same_as:
        return spoken(cause.name)
    same = " or ".join(new_value(m.name, m.given, m.estimate) for m in cause.same_as)
    return f"{spoken(cause.name)} (the same as: {same})"


def new_value(name: str, given: float, estimate: Estimate) -> str:
    """Return a changed parameter as a clause: "servo gain is 200, not 100 (x 2.00 [1.97, 2.03])"."""
    (now, before), unit = in_one_unit([estimate.value, given], estimate.unit)
    text = f"{spoken(name)} is {now} {unit}".rstrip() + f", not {before} {unit}".rstrip()
    if abs(given) * LARGEST_FACTOR <= abs(estimate.value):
        return text  # a fit that ends at 0 ends near it, so there is no factor
    factor, *ends = (v / given for v in (estimate.value, estimate.low, estimate.high))
    low, high = sorted(ends)
    # As many digits as the interval needs.
    digits = min(max(2, -math.floor(math.log10(high - low))) if 0.0 < high - low < math.inf else 2, 4)
    return f"{text} (x {factor:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}])"


def cut_short(diagnosis: Diagnosis) -> str:
    """Return a sentence that lists what was not checked because the time was over; empty where everything was."""
    if diagnosis.time_limit is None or not diagnosis.left_out:
        return ""
    return (
        f"The time limit of {diagnosis.time_limit:g} s ended this diagnosis early, so this is the best answer so far. "
        f"Not checked: {'; '.join(diagnosis.left_out)}."
    )


def lead(diagnosis: Diagnosis) -> str:
    """Return a few sentences that explain the verdict, and say what was not checked."""
    return " ".join(filter(None, (_explained(diagnosis), cut_short(diagnosis))))


def _explained(diagnosis: Diagnosis) -> str:
    """Return two or three sentences that explain the verdict."""
    if diagnosis.verdict == "insufficient":
        return " ".join(diagnosis.advice)
    if diagnosis.verdict == "nothing":
        doubts = "".join(f" {text}" for text in diagnosis.unexplained.get("doubts") or ())
        doubts += "".join(f" {text}" for text in _minor_texts(diagnosis))
        return (
            f"After a refit of the simulation's own parameters, only {noise_of(diagnosis)} is left. "
            f"No cause of the catalogue lowers the BIC enough to be named.{_farthest(diagnosis)}{doubts}"
        )
    if diagnosis.verdict == "unknown":
        doubts = diagnosis.unexplained.get("doubts") or ()
        best = [spoken(c.name) for c in diagnosis.candidates[:1]]
        if doubts:
            why = " ".join(doubts)
        else:
            why = f"The best candidate ({best[0]}) explains too little of it to be named." if best else ""
        missing = "force" if "force_n" in diagnosis.unexplained.get("worst", {}) else "torque"
        return (
            f"The mean squared error of the refitted simulation is {diagnosis.chi2_before:.2f} noise variances. {why} "
            f"The pictures show where {missing} is missing."
        )
    text = " ".join(CAUSES[kind_of(c.name)].summary for c in diagnosis.causes)
    for cause in diagnosis.causes:
        others = [spoken(n) for n in cause.members[1:]]
        if others:
            text += f" These data cannot distinguish {spoken(cause.name)} from {' or '.join(others)}."
            if len(cause.probabilities) > 1:
                text += f" Their probabilities: {chances(cause.probabilities)}."
    return " ".join([text, *_minor_texts(diagnosis), beside_causes(diagnosis)]).strip()


def chances(probabilities: Mapping[str, float]) -> str:
    """Return probabilities as a list: "payload 0.87, gain 0.08, something else 0.05".

    Args:
        probabilities: Of causes, of "nothing" and of "unknown", a cause outside of the catalogue.
    """
    return ", ".join(f"{candidate(n)} {p:.2f}" for n, p in probabilities.items())


def candidate(name: str) -> str:
    """Return what may stand in the place of a cause, in words.

    Args:
        name: A cause, "nothing" or "unknown".
    """
    return "something else" if name == UNKNOWN else spoken(name)


def _farthest(diagnosis: Diagnosis) -> str:
    """Return the parameter that is farthest from its prior: what a refit explains without a word might be a fault."""
    distances = diagnosis.prior_sds
    if not distances:
        return ""
    name = max(distances, key=lambda n: abs(distances[n]))
    assert diagnosis.details is not None
    mean, final = diagnosis.details.priors[name][0], diagnosis.final[name]
    (now, before), unit = in_one_unit([final.value, mean], final.unit)
    return (
        f" The refit moved {spoken(name)} farthest: {now} {unit}".rstrip()
        + f" instead of {before} {unit}".rstrip()
        + f", which is {abs(distances[name]):.1f} standard deviations of what is stated about it."
    )


def _minor_texts(diagnosis: Diagnosis) -> list[str]:
    """Return why significant causes are not named, one sentence or two for each."""
    return [
        spoken(minor["name"]) + minor["text"].removeprefix(minor["name"])
        for minor in diagnosis.unexplained.get("minor", ())
    ]


def noise_of(diagnosis: Diagnosis) -> str:
    """Return what counts as noise: sensor noise, or the residuals that healthy logs leave."""
    healthy = diagnosis.data.get("healthy")
    if healthy is None or healthy["chi2_per_sample"] <= 1.0:
        return "sensor noise"
    logs = "the healthy log" if healthy["logs"] == 1 else "the healthy logs"
    return f"the error that remains in {logs} ({healthy['chi2_per_sample']:.3g} times the variance of the sensor noise)"


def rival_of(diagnosis: Diagnosis) -> str:
    """Return with what the gain compares: a refit, in which changed parameters keep their values."""
    changed = [spoken(n) for c in diagnosis.causes for n in c.given]
    kept = f" with {' and '.join(changed)} as given" if changed else ""
    return f"the refitted simulation{kept}"


def beside_causes(diagnosis: Diagnosis) -> str:
    """Return a sentence if structure remains after the named causes; else, or if no cause is named, an empty text."""
    left = diagnosis.unexplained
    limits = left.get("limits")
    if diagnosis.verdict not in ("cause", "ambiguous") or limits is None:
        return ""
    # Large white residuals come from the sensors; noise causes explain them.
    if any(left[name] <= limits[name] for name in ("chi2_per_sample", "lag_one")):
        return ""
    return (
        f"The named causes do not explain everything: a mean squared error of {left['chi2_per_sample']:.3g} noise "
        f"variances remains, and noise alone stays below {limits['chi2_per_sample']:.3g}."
    )


def terminal_table(diagnosis: Diagnosis) -> Table:
    """Return verdict, causes, parameters and gain as a table for the terminal."""
    table = Table(
        title=escape(headline(diagnosis)),
        title_justify="left",
        box=None,
        show_header=False,
        padding=(0, 2, 0, 0),
    )
    table.add_column(style="bold")
    table.add_column()
    _add_row(table, "verdict", diagnosis.verdict)
    if diagnosis.probabilities:
        _add_row(table, "probability", chances(diagnosis.probabilities))
    for cause in diagnosis.causes:
        _add_cause(table, cause)
    gain = diagnosis.gain
    if gain is not None:
        for c in gain.channels:
            text = f"{c.baseline:.4g} as given, {c.refit:.4g} refitted, {c.extended:.4g} extended [{c.unit}]"
            _add_row(table, f"held-out error of {c.name}", text)
        if diagnosis.verdict in ("cause", "ambiguous"):
            text = f"{100 * gain.reduction:.1f} % ({100 * gain.low:.1f} to {100 * gain.high:.1f})"
            _add_row(table, "gain", f"{text} less error than {rival_of(diagnosis)}. {diagnosis.gain_note}")
        elif gain.as_given:
            _add_row(table, "gain", f"None. {diagnosis.gain_note}")
    if diagnosis.verdict != "insufficient":
        noise = noise_of(diagnosis)
        text = f"{diagnosis.chi2_before:.3g} refitted, {diagnosis.chi2_after:.3g} extended (1 is {noise})"
        _add_row(table, "error / noise variance", text)
    far = max(map(abs, diagnosis.prior_sds.values()), default=0.0) >= NOTABLE
    if diagnosis.verdict == "nothing" and far and not diagnosis.moved:
        _add_row(table, "parameters", _farthest(diagnosis).strip())
    if (family := diagnosis.unexplained.get("family")) is not None:
        _add_row(table, "nearest cause", nearest_of(family))
    if diagnosis.verdict == "unknown":
        for signature in diagnosis.unexplained.get("signatures") or ():
            _add_row(table, "seen", signature["text"])
    if more := beside_causes(diagnosis):
        _add_row(table, "unexplained", more)
    learned = diagnosis.unexplained.get("residual_model")
    if learned is not None:
        names = ", ".join(t["name"].split(".")[-1] for t in learned["terms"]) or "none"
        kept = "kept in model.yaml" if learned["accepted"] else "rejected"
        _add_row(table, "learned term", f"{names}; {kept}: {learned['reason']}")
    for text in diagnosis.data.get("model", ()):
        _add_row(table, "model file", text)
    for log in diagnosis.data["logs"]:
        for text in log["warnings"]:
            _add_row(table, "assumed", text)
    for text in diagnosis.advice:
        _add_row(table, "next experiment" if diagnosis.verdict != "insufficient" else "needed", text)
    if missing := cut_short(diagnosis):
        _add_row(table, "not checked", missing)
    _add_row(table, "time", f"{diagnosis.seconds:.1f} s")
    return table


def _add_cause(table: Table, cause: Finding) -> None:
    if cause.name == "unknown":
        return
    _add_row(table, "cause", f"{spoken(cause.name)} ({cause.family}), delta BIC {cause.delta_bic:.0f}")
    if len(cause.members) > 1:
        _add_row(table, "indistinguishable", ", ".join(spoken(n) for n in cause.members))
    if cause.probabilities:
        _add_row(table, "probability", chances(cause.probabilities))
    for name, e in cause.parameters.items():
        d = telling_digits(e.low, e.high)
        _add_row(table, f"  {name}", f"{e.value:.{d}g}  [{e.low:.{d}g}, {e.high:.{d}g}] {e.unit}")


def _add_row(table: Table, name: str, text: str) -> None:
    """Add a row; brackets around units and names of columns are no markup."""
    table.add_row(escape(name), escape(text))
