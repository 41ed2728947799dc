"""Write the result of a fit to a folder, and print it in the terminal."""

from __future__ import annotations

import json
from importlib.metadata import version
from math import floor, log10
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from deepkoco.fit.delays.hidden_delay import HiddenDelays
from deepkoco.fit.figures import draw_all
from deepkoco.fit.identification import Estimate, Identification
from deepkoco.output.new_folder import new_folder
from deepkoco.systems import save_model

SURE = 10.0  # evidence above which the data show that a delay varies


def write_identification(found: Identification, out: str | Path, hidden: HiddenDelays | None = None) -> Path:
    """Write identify.json, model.yaml and the pictures with their tables into a new folder.

    Args:
        found: Result of a fit.
        out: New folder. After an error it does not exist.
        hidden: Distribution of the commands' delays, if it was fitted.

    Raises:
        FolderExistsError: The folder exists.
    """
    out = Path(out)
    with new_folder(out) as folder:
        text = json.dumps(as_json(found, hidden), indent=2)
        (folder / "identify.json").write_text(text + "\n", encoding="utf-8")
        # The delay of a channel is no parameter of the system, so the model stores it as provenance.
        late = [f"{found.system.measurements[c].name}.delay" for c in found.request.problem().late]
        provenance = {
            "identified": list(found.estimates),
            "logs": list(found.logs),
            "deepkoco": version("deepkoco"),
            **{name: found.estimates[name].value for name in late},
        }
        save_model(folder / "model.yaml", found.system, provenance)
        for picture in draw_all(found, hidden):
            FigureCanvasAgg(picture.figure)
            # A file without the version of matplotlib has the same bytes for the same fit.
            picture.figure.savefig(folder / f"{picture.name}.png", metadata={"Software": None})
            picture.table.to_csv(
                folder / f"{picture.name}.csv", index=False, lineterminator="\n", float_format="%.8g"
            )
    return out


def as_json(found: Identification, hidden: HiddenDelays | None = None) -> dict[str, Any]:
    """Content of identify.json."""
    return found.to_json() | ({} if hidden is None else {"hidden_delays": hidden.to_json()})


def terminal_report(found: Identification, hidden: HiddenDelays | None = None) -> RenderableType:
    """Table of parameters with intervals, simulation errors before and after the fit, and notes on both."""
    table = Table(box=None, padding=(0, 2, 0, 0), title=f"{found.system.name}", title_justify="left")
    table.add_column("parameter")
    table.add_column("before", justify="right")
    table.add_column("fitted", justify="right", style="bold")
    table.add_column("95 % interval")
    table.add_column("unit")
    for estimate in (*found.estimates.values(), *found.of_logs, *found.zeros):
        table.add_row(*_row(estimate))
    lines = [f"{n}: {b:.4g} {u} before, {a:.4g} {u} after" for n, (b, a, u) in found.rms.items()]
    notes = ["simulation error (rms): " + "; ".join(lines)]
    chi2, correlated = found.dispersion.chi2_per_sample, found.dispersion.correlation
    notes.append(f"error / noise variance: {chi2:.3g} (1 is sensor noise)")
    if chi2 * correlated > 2.0:
        notes.append(
            "the residuals of the fitted system are larger than sensor noise, and the intervals are widened for it; "
            '"deepkoco diagnose" searches for the effect that is missing'
        )
    notes += [f"assumed: {text}" for text in found.warnings]
    notes += [f"not identified: {text}" for text in found.loose_in_words()]
    at_bound = [e.name for e in (*found.estimates.values(), *found.of_logs) if e.at_bound]
    if at_bound:
        notes.append(
            f"at or beyond a bound: {', '.join(at_bound)}; if the bound is not a physical limit, widen it"
        )
    if hidden is not None:
        notes += _delay_notes(hidden)
    record = found.convergence
    state = "converged" if record.converged else f"NOT converged ({record.reason})"
    notes.append(f"{record.method}: {state}, {record.simulations} simulations, {record.seconds:.1f} s")
    return Group(table, *(Text(note) for note in notes))


def _delay_notes(hidden: HiddenDelays) -> list[str]:
    low, high = (1e3 * x for x in hidden.mean_interval)
    lines = [
        f"delay of the commands, message by message: mean {1e3 * hidden.mean:.3g} ms ({low:.3g} to {high:.3g}), "
        f"standard deviation {1e3 * hidden.spread:.3g} ms, from {len(hidden.sent)} messages"
    ]
    if hidden.evidence < SURE:
        lines.append(
            f"the data do not show that the delay varies: evidence {hidden.evidence:.3g}, "
            f"clear above {SURE:g}"
        )
    if len(hidden.means) > 1:
        each = zip(hidden.weights, hidden.means, hidden.spreads, strict=True)
        lines.append(
            "components: " + ", ".join(f"{w:.0%} at {1e3 * m:.3g} +- {1e3 * s:.2g} ms" for w, m, s in each)
        )
    return lines


def _row(e: Estimate) -> tuple[str, ...]:
    digits = max(4, _figures(e))
    return (
        e.name,
        f"{e.start:.4g}",
        f"{e.value:.{digits}g}",
        f"{e.low:.{digits}g} to {e.high:.{digits}g}",
        e.unit,
    )


def _figures(e: Estimate) -> int:
    """Number of significant digits of the value that shows two digits of its standard deviation."""
    if e.sd <= 0 or e.value == 0:
        return 4
    return min(floor(log10(abs(e.value))) - floor(log10(e.sd)) + 2, 9)
