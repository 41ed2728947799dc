"""A matplotlib figure as SVG inside a page: its colours and its letters are those of the page."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from xml.etree import ElementTree

import matplotlib
from markupsafe import Markup
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from deepkoco.output.picture import house_style, laid_out
from deepkoco.pages.colours import variable_of

_COLOUR = re.compile(r"#[0-9a-f]{6}\b")
_NUMBER = re.compile(r"(-?\d+\.\d{2})\d+")
_REFERENCE = re.compile(r"url\(#([^)]+)\)")
_GEOMETRY = ("d", "x", "y", "cx", "cy", "points", "transform", "width", "height")
_DROPPED = ("metadata", "style", "title")


def as_svg(figure: Figure, name: str, label: str) -> Markup:
    """Draw a figure as an ``<svg>`` element for a page.

    Text stays text and takes the page's font. Colours of `deepkoco.pages.colours` become CSS variables, so the
    figure follows the page when it turns dark. The same figure gives the same text.

    Args:
        figure: The figure; its size in inches gives the proportions.
        name: Unique on the page; identifiers inside the element begin with it.
        label: What a screen reader says.

    Returns:
        The element.
    """
    buffer = io.BytesIO()
    with (
        laid_out(figure),
        house_style(),
        matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": name}),
    ):
        FigureCanvasSVG(figure)
        figure.savefig(buffer, format="svg", dpi=160, metadata={"Date": None, "Creator": None})
    root = ElementTree.fromstring(buffer.getvalue())
    _strip_namespaces(root)
    _drop(root)
    _own_identifiers(root, name)
    for element in root.iter():
        _tidy(element)
    _style_groups(root)
    for attribute in ("width", "height", "version"):
        root.attrib.pop(attribute, None)
    root.attrib.update({"class": "plot", "role": "img", "aria-label": label})
    return Markup(ElementTree.tostring(root, encoding="unicode"))


def _strip_namespaces(root: ElementTree.Element) -> None:
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
        for key in [k for k in element.attrib if "}" in k]:
            element.set(key.rpartition("}")[2], element.attrib.pop(key))


def _drop(root: ElementTree.Element) -> None:
    """Take out what a page must not have twice: metadata, rules for all elements, the figure's own ground."""
    for parent in list(root.iter()):
        for child in [c for c in parent if c.tag in _DROPPED]:
            parent.remove(child)
        parent.tail = None if parent.tag not in ("tspan",) else parent.tail
        if parent.tag not in ("text", "tspan"):
            parent.text = None
    ground = root.find("./g/g/path")  # the figure's patch comes first
    if ground is not None and "#ffffff" in ground.get("style", ""):
        ground.set("style", "fill: none")


def _own_identifiers(root: ElementTree.Element, name: str) -> None:
    """Keep the identifiers that something refers to, under names that no other figure of the page has."""
    used = {reference for element in root.iter() for reference in _references(element)}
    for element in root.iter():
        identifier = element.attrib.pop("id", None)
        if identifier in used:
            element.set("id", f"{name}-{identifier}")
        for key, value in element.attrib.items():
            if key == "href" and value.startswith("#"):
                element.set(key, f"#{name}-{value[1:]}")
            else:
                element.set(key, _REFERENCE.sub(rf"url(#{name}-\1)", value))


def _references(element: ElementTree.Element) -> Iterator[str]:
    if (href := element.get("href", "")).startswith("#"):
        yield href[1:]
    for value in element.attrib.values():
        yield from _REFERENCE.findall(value)


def _tidy(element: ElementTree.Element) -> None:
    if "style" in element.attrib:
        element.set("style", _page_style(element.attrib["style"]))
    for key in _GEOMETRY:
        if key in element.attrib:
            element.set(key, _NUMBER.sub(r"\1", " ".join(element.attrib[key].split())))


def _page_style(style: str) -> str:
    """The same style with the page's colours, and without a font family."""
    kept = []
    for entry in style.split(";"):
        prop, _, value = (part.strip() for part in entry.partition(":"))
        if prop == "font":  # shorthand: weight and size, then the family
            size = re.search(r"[\d.]+px", value)
            kept += [f"font-size:{size.group()}"] if size else []
            kept += ["font-weight:700"] if re.search(r"\b(bold|[6-9]00)\b", value) else []
            kept += ["font-style:italic"] if re.search(r"\b(italic|oblique)\b", value) else []
        elif prop and prop != "font-family":
            kept.append(f"{prop}:{_COLOUR.sub(lambda m: variable_of(m.group()) or m.group(), value)}")
    return ";".join(kept)


def _style_groups(root: ElementTree.Element) -> None:
    """Give a style that all marks of a group share to the group: thousands of dots then say it once."""
    for group in root.iter("g"):
        marks = [child for child in group if child.tag == "use"]
        styles = {mark.get("style") for mark in marks}
        if len(marks) > 1 and len(marks) == len(group) and len(styles) == 1 and None not in styles:
            group.set("style", ";".join(filter(None, (group.get("style"), styles.pop()))))
            for mark in marks:
                del mark.attrib["style"]
