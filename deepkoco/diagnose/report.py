"""Write a diagnosis to a folder: report.html, report.json, figures with their tables, model.yaml."""

from __future__ import annotations

import base64
import io
import json
from importlib.resources import files
from pathlib import Path

import jinja2
from matplotlib.backends.backend_agg import FigureCanvasAgg

from deepkoco.diagnose.causes import CAUSES, kind_of
from deepkoco.diagnose.diagnosis import Diagnosis
from deepkoco.diagnose.figures import draw_all
from deepkoco.diagnose.words import headline, lead
from deepkoco.new_folder import new_folder
from deepkoco.picture import Picture
from deepkoco.systems import save_model


def write_report(diagnosis: Diagnosis, out_dir: str | Path) -> Path:
    """Write everything about a diagnosis into a new folder; it appears whole or not at all.

    Args:
        diagnosis: What to write.
        out_dir: Folder that does not exist yet.

    Returns:
        Path of report.html.

    Raises:
        FolderExistsError: The folder exists.
    """
    out = Path(out_dir)
    with new_folder(out) as partial:
        pictures = draw_all(diagnosis)
        images = {}
        for picture in pictures:
            images[picture.name] = _png(picture)
            (partial / f"{picture.name}.png").write_bytes(images[picture.name])
            picture.table.to_csv(
                partial / f"{picture.name}.csv", index=False, lineterminator="\n", float_format="%.8g"
            )
        (partial / "report.json").write_text(
            json.dumps(diagnosis.to_json(), indent=2) + "\n", encoding="utf-8"
        )
        if diagnosis.verdict != "insufficient":
            provenance = {
                "verdict": diagnosis.verdict,
                "causes": list(diagnosis.names),
                "logs": [log["file"] for log in diagnosis.data["logs"]],
                "deepkoco": diagnosis.versions["deepkoco"],
            }
            save_model(partial / "model.yaml", diagnosis.model, provenance)
        (partial / "report.html").write_text(_page(diagnosis, pictures, images), encoding="utf-8")
    return out / "report.html"


def _png(picture: Picture) -> bytes:
    buffer = io.BytesIO()
    FigureCanvasAgg(picture.figure)
    # Without the writer's version in it, the same diagnosis gives the same bytes.
    picture.figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()


def _page(diagnosis: Diagnosis, pictures: list[Picture], images: dict[str, bytes]) -> str:
    source = files("deepkoco.diagnose").joinpath("template.html").read_text(encoding="utf-8")
    template = jinja2.Environment(autoescape=True).from_string(source)
    names = [log["file"] or "a log" for log in diagnosis.data["logs"]]
    return template.render(
        title=", ".join(names),
        headline=headline(diagnosis),
        lead=lead(diagnosis),
        tiles=_tiles(diagnosis),
        advice=diagnosis.advice,
        warnings=[text for log in diagnosis.data["logs"] for text in log["warnings"]],
        pictures=[
            {
                "title": p.title,
                "caption": p.caption,
                "name": p.name,
                "png": base64.b64encode(images[p.name]).decode(),
            }
            for p in pictures
        ],
        causes=[
            {
                "name": c.name,
                "summary": CAUSES[kind_of(c.name)].summary if kind_of(c.name) in CAUSES else "",
                "parameters": c.parameters,
                "evidence": c.evidence,
            }
            for c in diagnosis.causes
        ],
        localisation=diagnosis.localisation,
        windows=diagnosis.windows,
        window_s=diagnosis.window_s,
        held=diagnosis.data["windows_held_out"],
        resting=diagnosis.data["windows_resting"],
        before=f"{diagnosis.chi2_before:.3g}",
        after=f"{diagnosis.chi2_after:.3g}",
        raw=json.dumps(diagnosis.to_json(), indent=1),
    )


def _tiles(diagnosis: Diagnosis) -> list[dict[str, str]]:
    tiles = []
    for cause in diagnosis.causes[:1]:
        for name, e in cause.parameters.items():
            short = name.replace("_", " ").replace(".", ": ")
            text = f"{short}, 95 % interval {e.low:.3g} to {e.high:.3g} {e.unit}"
            tiles.append({"value": f"{e.value:.3g} {e.unit}", "text": text})
    gain = diagnosis.gain
    if gain is not None and diagnosis.verdict in ("cause", "ambiguous"):
        text = f"less held-out error than the refitted simulation ({100 * gain.low:.0f} to {100 * gain.high:.0f} %)"
        tiles.append({"value": f"{100 * gain.reduction:.0f} %", "text": text})
    if gain is not None:
        c = gain.channels[0]
        value = f"{c.baseline:.3g} → {c.extended:.3g} {c.unit}"
        tiles.append(
            {"value": value, "text": f"held-out error of {c.name}: simulation as given, and at the end"}
        )
    return tiles
