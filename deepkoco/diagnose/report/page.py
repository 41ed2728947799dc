"""Report page of a diagnosis: one self-contained HTML file."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Any

import jinja2

from deepkoco.diagnose.causes import CAUSES, kind_of
from deepkoco.diagnose.diagnosis import Diagnosis, Estimate, Finding
from deepkoco.diagnose.report.figures.layout import held_out_models
from deepkoco.diagnose.report.text import headline, lead, noise_of, spoken
from deepkoco.diagnose.report.unexplained_text import remains
from deepkoco.output.picture import Picture

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
    pictures: Sequence[Picture],
    desktop: Mapping[str, bytes],
    phone: Mapping[str, bytes],
) -> str:
    """Return the HTML of the page.

    Args:
        diagnosis: The diagnosis.
        pictures: Titles and captions, most informative first.
        desktop: Picture -> PNG for wide windows.
        phone: Picture -> PNG for narrow ones.
    """
    source = files("deepkoco.diagnose.report").joinpath("template.html").read_text(encoding="utf-8")
    template = jinja2.Environment(autoescape=True, trim_blocks=True).from_string(source)
    logs = [log["file"] or "a log" for log in diagnosis.data["logs"]]
    suffices = diagnosis.verdict != "insufficient"
    return template.render(
        title=", ".join(dict.fromkeys(logs)),
        system=diagnosis.model.name,
        tried=len(diagnosis.candidates) or len(CAUSES),
        headline=headline(diagnosis),
        noise=noise_of(diagnosis),
        lead=lead(diagnosis),
        tiles=_tiles(diagnosis),
        advice_title="What to record next" if suffices else "What is needed",
        advice=diagnosis.advice,
        warnings=[text for log in diagnosis.data["logs"] for text in log["warnings"]],
        pictures=[
            {
                "title": p.title,
                "caption": p.caption,
                "name": p.name,
                "alt": f"Figure: {p.title}. {p.caption.split('. ')[0]}.",
                "desktop": base64.b64encode(desktop[p.name]).decode(),
                "phone": base64.b64encode(phone[p.name]).decode(),
            }
            for p in pictures
        ],
        causes=[_cause(c) for c in diagnosis.causes],
        localisation=diagnosis.localisation,
        remains=remains(diagnosis),
        logs=logs,
        windows=diagnosis.windows,
        window_s=diagnosis.window_s,
        held=diagnosis.data["windows_held_out"],
        resting=diagnosis.data["windows_resting"],
        named=diagnosis.verdict in ("cause", "ambiguous"),
        before=f"{diagnosis.chi2_before:.3g}",
        after=f"{diagnosis.chi2_after:.3g}" if suffices else "",
        glossary=GLOSSARY,
        raw=json.dumps(diagnosis.to_json(), indent=1),
    )


def _cause(cause: Finding) -> dict[str, Any]:
    kind = kind_of(cause.name)
    return {
        "title": spoken(cause.name),
        "summary": CAUSES[kind].summary if kind in CAUSES else "",
        "members": ", ".join(spoken(n) for n in cause.members[1:]),
        "parameters": [
            {
                "name": spoken(name.rpartition(".")[2]),
                "value": f"{e.value:.4g}{_unit(e)}",
                "interval": f"{e.low:.4g} to {e.high:.4g}" if e.low < e.high else "chosen, not fitted",
            }
            for name, e in cause.parameters.items()
        ],
        "evidence": cause.evidence,
    }


def _tiles(diagnosis: Diagnosis) -> list[dict[str, str]]:
    tiles = []
    for cause in diagnosis.causes[:1]:
        for name, e in cause.parameters.items():
            short = spoken(name).replace(".", ": ")
            text = f"{short}, 95 % interval {e.low:.4g} to {e.high:.4g}{_unit(e)}"
            tiles.append({"value": f"{e.value:.3g}{_unit(e)}", "text": text})
    gain = diagnosis.gain
    if gain is not None and diagnosis.verdict in ("cause", "ambiguous"):
        text = (
            "less error than the refitted simulation, on held-out windows "
            f"(95 % interval {100 * gain.low:.0f} to {100 * gain.high:.0f} %)"
        )
        tiles.append({"value": f"{100 * gain.reduction:.0f} %", "text": text})
    if gain is not None:
        c = gain.channels[0]
        last = next(reversed(held_out_models(diagnosis).values()))
        text = f"error of {c.name} on held-out windows: simulation as given, and {last}"
        after = c.refit if gain.as_given else c.extended
        tiles.append({"value": f"{c.baseline:.3g} → {after:.3g} {c.unit}", "text": text})
    return tiles


def _unit(estimate: Estimate) -> str:
    return "" if estimate.unit == "1" else f" {estimate.unit}"
