"""Write a diagnosis to a folder: report.html, report.json, figures with their tables, model.yaml."""

from __future__ import annotations

import io
import json
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image

from deepkoco.diagnose.diagnosis import Diagnosis
from deepkoco.diagnose.report.figures.all_figures import draw_all
from deepkoco.diagnose.report.figures.layout import DESKTOP, PHONE
from deepkoco.diagnose.report.page import render
from deepkoco.output.new_folder import new_folder
from deepkoco.output.picture import Picture
from deepkoco.systems import save_model

# Dots per inch. A phone shows two or three dots for each pixel of the page.
DESKTOP_DPI, PHONE_DPI = 130, 170
COLOURS_OF_A_PICTURE = 128  # enough for lines and text; the file is a third as large


def write_report(diagnosis: Diagnosis, out_dir: str | Path) -> Path:
    """Write a diagnosis into a new folder. The folder appears only when it is complete.

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
        pictures = draw_all(diagnosis, DESKTOP)
        desktop = {p.name: _png(p, DESKTOP_DPI) for p in pictures}
        phone = {p.name: _png(p, PHONE_DPI) for p in draw_all(diagnosis, PHONE)}
        for picture in pictures:
            (partial / f"{picture.name}.png").write_bytes(desktop[picture.name])
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
        page = render(diagnosis, pictures, desktop, phone)
        (partial / "report.html").write_text(page, encoding="utf-8")
    return out / "report.html"


def _png(picture: Picture, dpi: int) -> bytes:
    buffer = io.BytesIO()
    FigureCanvasAgg(picture.figure)
    picture.figure.savefig(buffer, format="png", dpi=dpi)
    image = Image.open(buffer).convert("RGB").quantize(COLOURS_OF_A_PICTURE, dither=Image.Dither.NONE)
    small = io.BytesIO()
    # Pillow writes no version into the file, so the same diagnosis gives the same bytes.
    image.save(small, format="PNG", optimize=True)
    return small.getvalue()
