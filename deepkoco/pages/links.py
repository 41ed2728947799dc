"""Ways from one page to the others: demo, diagnosis, model, graph, sweep."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

from markupsafe import Markup, escape

from deepkoco.output.whole_file import write_whole_text

_NAVIGATION = re.compile(r"<nav[^>]*>.*?</nav>", re.DOTALL)


class Link(NamedTuple):
    """An entry of the navigation.

    Attributes:
        text: What it says.
        href: Where it goes, relative to the page; empty for the page itself.
    """

    text: str
    href: str


def relative(target: Path, page: Path) -> str:
    """The address of a file as it stands in a page.

    Args:
        target: What is linked.
        page: The file that has the link.
    """
    return quote(Path(os.path.relpath(target.absolute(), page.absolute().parent)).as_posix())


def links_between(page: Path, pages: Mapping[str, Path]) -> list[Link]:
    """The navigation of a page.

    Args:
        page: The page.
        pages: Name to file, the page itself among them; files that do not exist are left out.

    Returns:
        One link for each page that exists, in the order given.
    """
    found = []
    for name, path in pages.items():
        own = path.absolute() == page.absolute()
        if own or path.exists():
            found.append(Link(name, "" if own else relative(path, page)))
    return found


def navigation(links: list[Link]) -> Markup:
    """The navigation as it stands in a page; empty of links where there is only the page itself."""
    if len(links) < 2:
        return Markup('<nav class="pages" aria-label="Pages" hidden></nav>')
    entries = [
        f'<a href="{escape(link.href)}">{escape(link.text)}</a>'
        if link.href
        else f'<b aria-current="page">{escape(link.text)}</b>'
        for link in links
    ]
    return Markup(f'<nav class="pages" aria-label="Pages">{"".join(entries)}</nav>')


def link_pages(pages: Mapping[str, Path]) -> None:
    """Give each of these pages that exists a navigation to the others.

    Args:
        pages: Name to file; each was written by `render_page`. Nothing but its navigation changes.
    """
    for path in pages.values():
        if not path.exists():
            continue
        text = path.read_text(encoding="utf-8")
        own = str(navigation(links_between(path, pages)))
        changed = _NAVIGATION.sub(lambda _, own=own: own, text, count=1)
        if changed != text:
            write_whole_text(path, changed)
