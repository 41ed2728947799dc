"""Colours of figures on a page: each colour that a figure may use, and what it becomes on a dark page."""

from __future__ import annotations

# Colour of a matplotlib figure -> (name of the CSS variable, colour on a dark page). The light colour is the key.
ON_DARK = {
    "#222222": ("ink", "#ececec"),
    "#8a8a8a": ("muted", "#9aa0a8"),
    "#9a9a9a": ("faded", "#8f959d"),
    "#b9b9b9": ("faint", "#5c626b"),
    "#e6e6e6": ("grid", "#3a3e45"),
    "#ffffff": ("paper", "#212429"),
    "#3b7dd8": ("blue", "#7db2ff"),
    "#e4572e": ("orange", "#ff8f66"),
    "#2f9e6e": ("green", "#5fd0a0"),
    "#d62828": ("alarm", "#ff6b6b"),
    # Okabe and Ito's set and Tol's, of nodes and of runs; see deepkoco.graph.drawing.style.
    "#0072b2": ("sky", "#4fb3ee"),
    "#d55e00": ("vermilion", "#ff8a3c"),
    "#009e73": ("teal", "#34d3a5"),
    "#cc79a7": ("pink", "#e8a3c8"),
    "#e69f00": ("amber", "#f5bb3d"),
    "#56b4e9": ("azure", "#8fd0f7"),
    "#a89f00": ("olive", "#d0c638"),
    "#332288": ("indigo", "#a598f0"),
    "#882255": ("wine", "#de7fae"),
    "#44aa99": ("jade", "#76d6c6"),
    # The ten colours that matplotlib takes in turn.
    "#1f77b4": ("c0", "#63b1e5"),
    "#ff7f0e": ("c1", "#ff9e4a"),
    "#2ca02c": ("c2", "#5fd15f"),
    "#d62728": ("c3", "#ff7374"),
    "#9467bd": ("c4", "#bd98de"),
    "#8c564b": ("c5", "#c9978c"),
    "#e377c2": ("c6", "#f0a3da"),
    "#7f7f7f": ("c7", "#a8a8a8"),
    "#bcbd22": ("c8", "#dbdc4f"),
    "#17becf": ("c9", "#55dbe8"),
}
_BLACK = {"#000000", "#262626", "#1a1a1a"}  # of ticks, axes and text


def variable_of(colour: str) -> str | None:
    """The CSS value that stands for a colour of a figure; None for one that is the same on every page."""
    colour = "#222222" if colour in _BLACK else colour
    return f"var(--plot-{ON_DARK[colour][0]})" if colour in ON_DARK else None


def colour_css() -> str:
    """The style sheet of the variables, for light and for dark pages."""
    light = " ".join(f"--plot-{name}: {colour};" for colour, (name, _) in ON_DARK.items())
    dark = " ".join(f"--plot-{name}: {colour};" for name, colour in ON_DARK.values())
    return f":root {{ {light} }}\n@media (prefers-color-scheme: dark) {{ :root {{ {dark} }} }}\n"
