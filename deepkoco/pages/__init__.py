"""What all pages share: one template, one style sheet, figures for light and dark, for desktops and phones."""

from deepkoco.pages.figures import Shown, show_both
from deepkoco.pages.links import Link, link_pages, links_between
from deepkoco.pages.page import made_on, render_page, software
from deepkoco.pages.svg import as_svg
from deepkoco.pages.units import in_one_unit, less, readable

__all__ = [
    "Link",
    "Shown",
    "as_svg",
    "in_one_unit",
    "less",
    "link_pages",
    "links_between",
    "made_on",
    "readable",
    "render_page",
    "show_both",
    "software",
]
