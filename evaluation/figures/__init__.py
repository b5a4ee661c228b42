"""The pictures of a run, and of what detectors found."""

from evaluation.figures.detections import draw_detections
from evaluation.figures.errors import draw_errors
from evaluation.figures.localization import draw_localization
from evaluation.figures.map import draw_map
from evaluation.figures.rotation import draw_rotation

__all__ = [
    "draw_detections",
    "draw_errors",
    "draw_localization",
    "draw_map",
    "draw_rotation",
]
