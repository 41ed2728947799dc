"""Write a diagnosis to a folder: report.html, report.json, figures with their tables, model.yaml."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from datetime import date
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image

from deepkoco.diagnose.diagnosis import Diagnosis, saves_diagnoses
from deepkoco.diagnose.report.figures.all_figures import draw_all
from deepkoco.diagnose.report.figures.layout import DESKTOP, PHONE
from deepkoco.diagnose.report.page import render
from deepkoco.output.new_folder import new_folder
from deepkoco.output.picture import Picture, laid_out
from deepkoco.output.whole_file import write_whole_text
from deepkoco.pages.figures import show_both
from deepkoco.pages.links import Link
from deepkoco.systems import System, save_model
from deepkoco.systems.trees.robot_files import CHANGES_FILE, write_robot
from deepkoco.systems.trees.tree import TreeError
from deepkoco.systems.trees.write_back import from_model_file

DPI = 130  # of the picture files in the folder of the page
COLOURS_OF_A_PICTURE = 128  # enough for lines and text; the file is a third as large


@saves_diagnoses
def write_report(
    diagnosis: Diagnosis,
    out_dir: str | Path,
    shown_as: str | None = None,
    links: Sequence[Link] = (),
    made: date | None = None,
) -> Path:
    """Write a diagnosis into a new folder. The folder appears only when it is complete.

    Args:
        diagnosis: The diagnosis.
        out_dir: Folder that does not exist yet.
        shown_as: Name of the folder in the commands on the page; None takes ``out_dir``.
        links: Ways from the page to others.
        made: Day that the page says; None takes today's, or that of SOURCE_DATE_EPOCH.

    Returns:
        Path of report.html.

    Raises:
        FolderExistsError: The folder exists.
    """
    out = Path(out_dir)
    with new_folder(out) as partial:
        pictures, phone = draw_all(diagnosis, DESKTOP), draw_all(diagnosis, PHONE)
        shown = []
        for picture, small in zip(pictures, phone, strict=True):
            with laid_out(picture.figure):
                (partial / f"{picture.name}.png").write_bytes(_png(picture, DPI))
                shown.append(show_both(picture, f"{picture.name}.csv", small))
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
            _write_robot(diagnosis.model, partial, out)
        page = render(diagnosis, shown, shown_as or Path(out_dir).as_posix(), links, made)
        (partial / "report.html").write_text(page, encoding="utf-8")
    return out / "report.html"


def _write_robot(model: System, partial: Path, out: Path) -> None:
    """Write the mended file of a robot that was read from MJCF or URDF; nothing for other systems."""
    if not from_model_file(model):
        return
    try:
        write_robot(model, partial, out)
    except TreeError as error:
        # The diagnosis is complete without it: the given file may have gone in the meantime.
        write_whole_text(partial / CHANGES_FILE, f"The robot could not be written back: {error}.\n")


def _png(picture: Picture, dpi: int) -> bytes:
    buffer = io.BytesIO()
    FigureCanvasAgg(picture.figure)
    picture.figure.savefig(buffer, format="png", dpi=dpi)
    image = Image.open(buffer).convert("RGB").quantize(COLOURS_OF_A_PICTURE, dither=Image.Dither.NONE)
    small = io.BytesIO()
    # Pillow writes no version into the file, so the same diagnosis gives the same bytes.
    image.save(small, format="PNG", optimize=True)
    return small.getvalue()
