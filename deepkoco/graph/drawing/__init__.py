"""Pictures of graphs, of what ran when, of supergraphs and delays; one interactive page."""

from deepkoco.graph.drawing.computation import draw_computation_graph, draw_supergraph
from deepkoco.graph.drawing.delays import draw_delays
from deepkoco.graph.drawing.graph_picture import draw_graph
from deepkoco.graph.drawing.page import make_page, write_page
from deepkoco.graph.drawing.signals import draw_signals
from deepkoco.graph.drawing.style import DrawingError, Picture
from deepkoco.graph.drawing.timeline import draw_timeline

__all__ = [
    "DrawingError",
    "Picture",
    "draw_computation_graph",
    "draw_delays",
    "draw_graph",
    "draw_signals",
    "draw_supergraph",
    "draw_timeline",
    "make_page",
    "write_page",
]
