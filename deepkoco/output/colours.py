"""The colours of the analyses: one per method and one map per kind of quantity, in every figure."""

COLOURS = {
    "DeepKoCo": "#e4572e",
    "EDMDc": "#3b7dd8",
    "reference": "#2f9e6e",
    "measured": "#222222",
    "muted": "#9a9a9a",
}
SIGNED = "RdBu_r"
MAGNITUDE = "viridis"
PHASE = "twilight"
