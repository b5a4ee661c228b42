"""The pictures of a run."""

from evaluation.figures.errors import draw_errors
from evaluation.figures.map import draw_map

__all__ = ["draw_errors", "draw_map"]
