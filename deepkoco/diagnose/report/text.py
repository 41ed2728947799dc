"""A diagnosis in words and as a table for the terminal."""

from __future__ import annotations

from rich.table import Table

from deepkoco.diagnose.causes import CAUSES, kind_of
from deepkoco.diagnose.diagnosis import Diagnosis, Finding


def spoken(name: str) -> str:
    """Name of a cause as it is written in a sentence."""
    return name.replace("_", " ").replace("(", " (")


def headline(diagnosis: Diagnosis) -> str:
    """The verdict in one line."""
    names = " and ".join(spoken(n) for n in diagnosis.names)
    return {
        "cause": f"The simulation lacks: {names}",
        "ambiguous": f"The simulation lacks: {names} (or an equivalent)",
        "nothing": "The simulation misses nothing that this log shows",
        "unknown": "The simulation misses something that no known cause explains",
        "insufficient": "The data do not suffice",
    }[diagnosis.verdict]


def lead(diagnosis: Diagnosis) -> str:
    """What follows from the verdict, in two or three sentences."""
    if diagnosis.verdict == "insufficient":
        return " ".join(diagnosis.advice)
    if diagnosis.verdict == "nothing":
        doubts = "".join(f" {text}" for text in diagnosis.unexplained.get("doubts") or ())
        return (
            f"After refitting the parameters that the simulation already has, what remains is {noise_of(diagnosis)}; "
            f"no cause of the catalogue is worth its extra parameters.{doubts}"
        )
    if diagnosis.verdict == "unknown":
        doubts = diagnosis.unexplained.get("doubts") or ()
        best = [spoken(c.name) for c in diagnosis.candidates[:1]]
        if doubts:
            why = " ".join(doubts)
        else:
            why = f"The best candidate ({best[0]}) explains too little of that to be named." if best else ""
        missing = "force" if "force_n" in diagnosis.unexplained.get("worst", {}) else "torque"
        return (
            f"The refitted simulation leaves {diagnosis.chi2_before:.2f} noise variances per sample. {why} "
            f"The pictures show where it is missing {missing}."
        )
    text = " ".join(CAUSES[kind_of(c.name)].summary for c in diagnosis.causes)
    for cause in diagnosis.causes:
        others = [spoken(n) for n in cause.members[1:]]
        if others:
            text += f" These data do not tell {spoken(cause.name)} apart from {' or '.join(others)}."
    return f"{text} {beside_causes(diagnosis)}".strip()


def noise_of(diagnosis: Diagnosis) -> str:
    """What counts as noise: that of the sensors, or what healthy logs leave beside it."""
    healthy = diagnosis.data.get("healthy")
    if healthy is None or healthy["chi2_per_sample"] <= 1.0:
        return "sensor noise"
    logs = "a healthy log leaves" if healthy["logs"] == 1 else "the healthy logs leave"
    return f"what {logs}, {healthy['chi2_per_sample']:.3g} times the sensor noise's variance"


def beside_causes(diagnosis: Diagnosis) -> str:
    """That structure remains beside the named causes; nothing where it does not, or where none is named."""
    left = diagnosis.unexplained
    limits = left.get("limits")
    if diagnosis.verdict not in ("cause", "ambiguous") or limits is None:
        return ""
    # Large errors that are white are a matter of the sensors, which a scatter names.
    if any(left[name] <= limits[name] for name in ("chi2_per_sample", "lag_one")):
        return ""
    return (
        f"Something more is missing: {left['chi2_per_sample']:.3g} noise variances per sample remain beside what is "
        f"named, and noise alone stays below {limits['chi2_per_sample']:.3g}."
    )


def terminal_table(diagnosis: Diagnosis) -> Table:
    """Verdict, causes, parameters and gain as a small table."""
    table = Table(
        title=headline(diagnosis), title_justify="left", box=None, show_header=False, padding=(0, 2, 0, 0)
    )
    table.add_column(style="bold")
    table.add_column()
    table.add_row("verdict", diagnosis.verdict)
    for cause in diagnosis.causes:
        _add_cause(table, cause)
    gain = diagnosis.gain
    if gain is not None:
        for c in gain.channels:
            text = (
                f"{c.baseline:.4g} as given, {c.refit:.4g} refitted, {c.extended:.4g} at the end [{c.unit}]"
            )
            table.add_row(f"held-out error of {c.name}", text)
        if diagnosis.verdict in ("cause", "ambiguous"):
            text = f"{100 * gain.reduction:.1f} % ({100 * gain.low:.1f} to {100 * gain.high:.1f}) less than refitted"
            table.add_row("gain", f"{text}. {diagnosis.gain_note}")
        elif gain.as_given:
            table.add_row("gain", f"None. {diagnosis.gain_note}")
    if diagnosis.verdict != "insufficient":
        noise = noise_of(diagnosis)
        text = f"{diagnosis.chi2_before:.3g} refitted, {diagnosis.chi2_after:.3g} at the end (1 is {noise})"
        table.add_row("error / noise variance", text)
    if more := beside_causes(diagnosis):
        table.add_row("unexplained", more)
    learned = diagnosis.unexplained.get("residual_model")
    if learned is not None:
        names = ", ".join(t["name"].split(".")[-1] for t in learned["terms"]) or "none"
        kept = "kept in model.yaml" if learned["accepted"] else "rejected"
        table.add_row("learned term", f"{names}; {kept}: {learned['reason']}")
    for log in diagnosis.data["logs"]:
        for text in log["warnings"]:
            table.add_row("assumed", text)
    for text in diagnosis.advice:
        table.add_row("next experiment" if diagnosis.verdict != "insufficient" else "needed", text)
    table.add_row("time", f"{diagnosis.seconds:.1f} s")
    return table


def _add_cause(table: Table, cause: Finding) -> None:
    if cause.name == "unknown":
        return
    table.add_row("cause", f"{spoken(cause.name)} ({cause.family}), delta BIC {cause.delta_bic:.0f}")
    if len(cause.members) > 1:
        table.add_row("not told apart", ", ".join(spoken(n) for n in cause.members))
    for name, e in cause.parameters.items():
        table.add_row(f"  {name}", f"{e.value:.4g}  [{e.low:.4g}, {e.high:.4g}] {e.unit}")
