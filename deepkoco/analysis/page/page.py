"""Write the page of an analysis and its tables, whole or not at all."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date
from pathlib import Path
from urllib.parse import quote

import numpy as np
import pandas as pd

from deepkoco.analysis.page.plan_film import PlanFilm
from deepkoco.envs.film import write_clip
from deepkoco.output.new_folder import check_writable, new_folder
from deepkoco.output.picture import Picture, as_png
from deepkoco.output.whole_file import whole_file
from deepkoco.pages.figures import show_both
from deepkoco.pages.links import links_between
from deepkoco.pages.page import render_page, software


class PageExistsError(FileExistsError):
    """The page, or the folder of its tables, is there already."""


@dataclass
class Page:
    """Everything on the page.

    Attributes:
        title, lead: Heading, and one or two sentences below it.
        tiles: Numbers to see first: value and text.
        pictures: In the order of the page.
        film: The clip with its caption; None leaves it out.
        notes: What is left out and why.
        facts: Name to value of the last section.
        settings: All settings as text.
        steps: What to do next: text and command.
        pages: Name to file of other pages that may be there, for the navigation.
    """

    title: str
    lead: str
    tiles: Sequence[tuple[str, str]]
    pictures: Sequence[Picture]
    film: tuple[PlanFilm, str] | None
    facts: Mapping[str, str]
    settings: str
    notes: Sequence[str] = field(default_factory=tuple)
    steps: Sequence[Mapping[str, str]] = field(default_factory=tuple)
    pages: Mapping[str, Path] = field(default_factory=dict)


def data_folder(page: Path) -> Path:
    """Folder of the tables and pictures of a page: beside it, named after it."""
    return page.with_name(f"{page.stem}_data")


def check_free(page: Path) -> None:
    """Refuse to overwrite.

    Raises:
        PageExistsError: The page or its folder exists, or something on the path is a file.
        WriteError: The disk is full, or the place cannot be written.
    """
    for target in (page, data_folder(page)):
        if target.exists():
            raise PageExistsError(f"{target}: exists; choose another name with --out or move it away")
    blocked = next((parent for parent in page.parents if parent.exists() and not parent.is_dir()), None)
    if blocked is not None:
        raise PageExistsError(f"{page}: {blocked} is no folder; choose another place with --out")
    check_writable(page)


def write_page(page: Page, path: Path, made: date | None = None) -> None:
    """Write PAGE.html, self-contained, and PAGE_data/ with every picture, its table and the clip.

    Args:
        page: The content.
        path: File that does not exist yet.
        made: Day that the page says; None takes today's, or that of SOURCE_DATE_EPOCH.

    Raises:
        PageExistsError: It exists.
        WriteError: The disk is full, or the place cannot be written.
        FilmError: The clip could not be written.
    """
    check_free(path)
    folder = data_folder(path)
    beside = quote(folder.name)
    with whole_file(path) as written, new_folder(folder) as partial:
        pictures = []
        for picture in page.pictures:
            (partial / f"{picture.name}.png").write_bytes(as_png(picture.figure))
            _write_table(picture.table, partial / f"{picture.name}.csv")
            pictures.append(
                {"name": picture.name, "shown": show_both(picture, f"{beside}/{picture.name}.csv")}
            )
        film = None
        if page.film is not None:
            clip, caption = page.film
            _write_table(clip.table, partial / "plan.csv")
            wide = _clip(partial / "plan.webm", clip.frames, clip.rate)
            tall = _clip(partial / "plan_phone.webm", clip.tall, clip.rate)
            film = {"clip": wide, "tall": tall, "caption": caption}
        html = render_page(
            "deepkoco.analysis.page",
            "page.html",
            title=page.title,
            versions=software("torch", "numpy", "gymnasium"),
            made=made,
            links=links_between(path, {**page.pages, "Model": path}),
            lead=page.lead,
            tiles=[{"value": value, "text": text} for value, text in page.tiles],
            pictures=pictures,
            film=film,
            notes=page.notes,
            steps=page.steps,
            facts=page.facts,
            settings=page.settings,
            folder=beside,
        )
        written.write_text(html, encoding="utf-8")


def _clip(path: Path, frames: Sequence[np.ndarray], rate: float) -> str:
    write_clip(path, frames, rate)
    return base64.b64encode(path.read_bytes()).decode()


def _write_table(table: pd.DataFrame, path: Path) -> None:
    table.to_csv(path, index=False, lineterminator="\n", float_format="%.6g")
