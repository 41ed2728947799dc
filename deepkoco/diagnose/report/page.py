"""Report page of a diagnosis: one self-contained HTML file."""

from __future__ import annotations

import json
from collections.abc import Sequence
from datetime import date
from typing import Any

from deepkoco.diagnose.causes import CAUSES, kind_of
from deepkoco.diagnose.diagnosis import Diagnosis, Finding, Localisation
from deepkoco.diagnose.report.figures.layout import held_out_models
from deepkoco.diagnose.report.joint_rows import joint_rows, noise_by_channel
from deepkoco.diagnose.report.next_steps import next_steps
from deepkoco.diagnose.report.parameter_table import interval, parameter_rows
from deepkoco.diagnose.report.text import chances, headline, lead, noise_of, rival_of, spoken
from deepkoco.diagnose.report.unexplained_text import remains
from deepkoco.pages.figures import Shown
from deepkoco.pages.links import Link
from deepkoco.pages.page import render_page
from deepkoco.pages.units import in_one_unit, less, plain, readable, telling_digits
from deepkoco.systems.trees.write_back import tree_of

GLOSSARY = {
    "window": "A short part of the log, about one swing long. Each window is simulated separately.",
    "held-out window": "A window that no fit uses; it measures the error of the result. Where structure remains, "
    "held-out windows also decide whether causes or a learned load are kept. The measured error is then slightly "
    "optimistic.",
    "structure": "Errors that are larger or more correlated than noise.",
    "refitted simulation": "The simulation as given, with its own parameters fitted to the log. Each parameter stays "
    "near the value of its data sheet.",
    "extended simulation": "The refitted simulation with the named causes, or with a learned load.",
    "95 % interval": "Range that contains the true value in 95 of 100 such cases, if the model is right.",
    "sensor noise, noise variance": "Random error of the sensor, estimated from the log. A perfect simulation has a "
    "mean squared error of 1 noise variance.",
    "BIC": "Bayesian information criterion: misfit of a model plus a charge for each of its parameters. A fall of "
    "10 is already strong evidence.",
    "missing torque": "Torque (or force) from outside that would make the simulation follow the measurement.",
    "sd": "Standard deviation.",
    "null value": "Value of a cause's parameter at which the cause has no effect.",
}


def render(
    diagnosis: Diagnosis,
    pictures: Sequence[Shown],
    folder: str = "report",
    links: Sequence[Link] = (),
    made: date | None = None,
) -> str:
    """Return the HTML of the page.

    Args:
        diagnosis: The diagnosis.
        pictures: Pictures, most informative first.
        folder: Folder of the report, as commands on the page name it.
        links: Links to other pages.
        made: Day that the page is made; None takes today's.
    """
    logs = [log["file"] or "a log" for log in diagnosis.data["logs"]]
    suffices = diagnosis.verdict != "insufficient"
    system = diagnosis.model
    title = ", ".join(dict.fromkeys(logs))
    return render_page(
        "deepkoco.diagnose.report",
        "template.html",
        title=f"Diagnosis of {title}",
        versions=diagnosis.versions,
        made=made,
        links=links,
        logs_title=title,
        system=system.name,
        tried=len(diagnosis.candidates) or len(CAUSES),
        headline=headline(diagnosis),
        noise=noise_of(diagnosis),
        lead=lead(diagnosis),
        tiles=_tiles(diagnosis),
        joints=joint_rows(diagnosis),
        files=tree_of(diagnosis.model) is not None,
        steps=next_steps(diagnosis, folder),
        advice_title="What to record next" if suffices else "What is needed",
        advice=list(diagnosis.advice),
        warnings=[text for log in diagnosis.data["logs"] for text in log["warnings"]],
        model_notes=diagnosis.data.get("model", ()),
        pictures=pictures,
        causes=[_cause(c, diagnosis) for c in diagnosis.causes],
        rows=parameter_rows(diagnosis),
        localisation=[_place(p, logs) for p in diagnosis.localisation],
        missing=diagnosis.localisation[0].channel if diagnosis.localisation else "",
        remains=list(remains(diagnosis)),
        windows=diagnosis.windows,
        window_s=diagnosis.window_s,
        held=diagnosis.data["windows_held_out"],
        resting=diagnosis.data["windows_resting"],
        named=diagnosis.verdict in ("cause", "ambiguous"),
        before=plain(diagnosis.chi2_before),
        after=plain(diagnosis.chi2_after) if suffices else "",
        glossary=GLOSSARY,
        raw=json.dumps(diagnosis.to_json(), indent=1),
    )


def _cause(cause: Finding, diagnosis: Diagnosis) -> dict[str, Any]:
    kind = kind_of(cause.name)
    return {
        "title": spoken(cause.name),
        "summary": CAUSES[kind].summary if kind in CAUSES else "",
        "members": ", ".join(spoken(n) for n in cause.members[1:]),
        "chances": chances(cause.probabilities),
        "parameters": [
            {
                "name": spoken(name.rpartition(".")[2]),
                "value": readable(e.value, e.unit, telling_digits(e.low, e.high)),
                "interval": interval(e, "chosen, not fitted"),
            }
            for name, e in cause.parameters.items()
        ],
        "evidence": [e.text for e in cause.evidence],
    }


def _place(place: Localisation, logs: Sequence[str]) -> dict[str, str]:
    return {
        "log": logs[place.log],
        "from": f"{place.t0:.2f}",
        "to": f"{place.t1:.2f}",
        "mean": readable(place.size, place.unit),
    }


def _tiles(diagnosis: Diagnosis) -> list[dict[str, str]]:
    tiles = []
    for cause in diagnosis.causes[:1]:
        for name, e in cause.parameters.items():
            short = spoken(name).replace(".", ": ")
            text = (
                f"{short}, 95 % interval {interval(e)}" if e.low < e.high else f"{short}, chosen, not fitted"
            )
            tiles.append({"value": readable(e.value, e.unit), "text": text})
    gain = diagnosis.gain
    if gain is not None and diagnosis.verdict in ("cause", "ambiguous"):
        text = (
            f"less error than {rival_of(diagnosis)}, on held-out windows "
            f"(95 % interval {100 * gain.low:.0f} to {100 * gain.high:.0f} %)"
        )
        tiles.append({"value": f"{100 * gain.reduction:.0f} %", "text": text})
    if gain is not None:
        c = gain.channels[0]
        if diagnosis.model.own_joints > 1:
            # The joint that the simulation as given gets most wrong.
            sd = noise_by_channel(gain, diagnosis.model)
            c = max(gain.channels, key=lambda channel: channel.baseline / sd[channel.name])
        last = next(reversed(held_out_models(diagnosis).values()))
        after = c.refit if gain.as_given else c.extended
        (first, second), unit = in_one_unit([c.baseline, after], c.unit)
        text = (
            f"error of {c.name} on held-out windows: {first} {unit} with the simulation as given, "
            f"{second} {unit} with the {last}"
        )
        tiles.append({"value": f"{less(c.baseline, after)} error", "text": text})
    return tiles
