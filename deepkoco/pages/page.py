"""Render a page from its template and the one that all pages share."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping, Sequence
from datetime import UTC, date, datetime
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from typing import Any

import jinja2
from markupsafe import Markup

import deepkoco
from deepkoco.pages.colours import colour_css
from deepkoco.pages.links import Link, navigation


def made_on() -> date:
    """The day that a page says it was made on: today, or that of SOURCE_DATE_EPOCH, for pages that are made again."""
    seconds = os.environ.get("SOURCE_DATE_EPOCH")
    return datetime.now(UTC).date() if seconds is None else datetime.fromtimestamp(int(seconds), UTC).date()


def software(*packages: str) -> dict[str, str]:
    """Versions of this package, of Python and of others that are installed.

    Args:
        packages: Names of the others.
    """
    found = {"deepkoco": deepkoco.__version__, "python": platform.python_version()}
    for name in packages:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def render_page(
    package: str,
    template: str,
    *,
    title: str,
    versions: Mapping[str, str],
    made: date | None = None,
    links: Sequence[Link] = (),
    **content: Any,
) -> str:
    """Render a page.

    Args:
        package: Where its template lies, such as ``deepkoco.diagnose.report``.
        template: File there; it extends ``base.html``.
        title: Of the window.
        versions: Name to version of what made the page.
        made: Day it was made; None takes `made_on`.
        links: Navigation.
        content: What the template shows.

    Returns:
        The page as text; it needs no other file.
    """
    shared = files("deepkoco.pages")
    loader = jinja2.ChoiceLoader(
        [
            jinja2.DictLoader(
                {name: shared.joinpath(name).read_text("utf-8") for name in ("base.html", "parts.html")}
            ),
            jinja2.FunctionLoader(lambda name: files(package).joinpath(name).read_text("utf-8")),
        ]
    )
    environment = jinja2.Environment(
        loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    style = shared.joinpath("style.css").read_text("utf-8")
    return environment.get_template(template).render(
        title=title,
        style=Markup(style + colour_css()),
        navigation=navigation(list(links)),
        made=(made or made_on()).isoformat(),
        versions=", ".join(
            f"{name} {versions[name]}" for name in sorted(versions, key=lambda n: n != "deepkoco")
        ),
        **content,
    )
