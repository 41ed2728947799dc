"""When everything happens: from rates and delays, drawn or recorded, to a computation graph."""

from deepkoco.graph.timing.draw import TimingError, draw_timing, extend_timing

__all__ = ["TimingError", "draw_timing", "extend_timing"]
