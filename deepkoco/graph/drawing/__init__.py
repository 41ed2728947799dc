"""Pictures of graphs, of what ran when, of supergraphs and delays; one interactive page."""

from deepkoco.graph.drawing.graph_picture import draw_graph
from deepkoco.graph.drawing.style import DrawingError, Picture
from deepkoco.graph.drawing.timeline import draw_timeline

__all__ = ["DrawingError", "Picture", "draw_graph", "draw_timeline"]
