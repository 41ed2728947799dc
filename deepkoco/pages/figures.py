"""A picture as it stands on a page: a wide and a narrow drawing, both light and dark, and the numbers behind it."""

from __future__ import annotations

from typing import NamedTuple

from markupsafe import Markup

from deepkoco.output.picture import Picture
from deepkoco.pages.reflow import narrow
from deepkoco.pages.svg import as_svg


class Shown(NamedTuple):
    """One picture of a page.

    Attributes:
        title: Heading.
        caption: How to read it.
        wide: Drawing for wide windows.
        narrow: Drawing for phones.
        numbers: File with the table behind it, relative to the page; empty where there is none.
    """

    title: str
    caption: str
    wide: Markup
    narrow: Markup
    numbers: str


def show_both(picture: Picture, numbers: str, phone: Picture | None = None) -> Shown:
    """Draw a picture for wide windows and for phones.

    Args:
        picture: The picture; without one of its own for phones, its figure is made narrow afterwards.
        numbers: File with its table, relative to the page.
        phone: The same, drawn for a phone.
    """
    label = f"Figure: {picture.title.rstrip('.?')}. {picture.caption.split('. ')[0].rstrip('.')}."
    wide = as_svg(picture.figure, f"{picture.name}-w", label)
    if phone is None:
        narrow(picture.figure)
        phone = picture
    return Shown(
        picture.title, picture.caption, wide, as_svg(phone.figure, f"{picture.name}-n", label), numbers
    )
