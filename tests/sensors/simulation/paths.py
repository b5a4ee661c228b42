"""True paths that the tests of the small sensors share."""

import numpy as np

from semgraph.arrays import FloatArray, IntArray


def standing(seconds: float, rate_hz: float) -> tuple[IntArray, FloatArray]:
    stamps_ns = np.round(np.arange(int(seconds * rate_hz)) / rate_hz * 1e9).astype(np.int64)
    return stamps_ns, np.zeros((len(stamps_ns), 3))


def circling(seconds: float, rate_hz: float, speed: float = 1.0) -> tuple[IntArray, FloatArray]:
    """Counter-clockwise on a circle of 10 m."""
    stamps_ns, poses = standing(seconds, rate_hz)
    angles = speed * 1e-9 * stamps_ns / 10.0
    headings = (angles + np.pi / 2 + np.pi) % (2.0 * np.pi) - np.pi
    poses[:] = np.column_stack([10.0 * np.cos(angles), 10.0 * np.sin(angles), headings])
    return stamps_ns, poses
