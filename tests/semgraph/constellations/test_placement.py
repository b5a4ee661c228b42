"""Which landmarks of a map are expected in sight, from where those that are seen stand."""

import numpy as np
from scipy.spatial import Delaunay

from semgraph.arrays import BoolArray, FloatArray
from semgraph.constellations.mapped_constellation import Constellation, MappedConstellation
from semgraph.constellations.placement import Likelihood
from semgraph.landmarks import Kind


def trees(positions: FloatArray) -> Constellation:
    """Without diameters."""
    n = len(positions)
    return Constellation(
        positions,
        np.tile(0.01 * np.eye(2), (n, 1, 1)),
        np.full(n, Kind.TREE),
        np.full(n, np.nan),
        np.full(n, np.nan),
        np.full(n, "", dtype=np.str_),
    )


def missed(seen: FloatArray, others: FloatArray) -> BoolArray:
    """(m,) of each of the other trees of a map alone, whether it speaks against the place."""

    def num_expected(mapped: FloatArray) -> int:
        likelihood = Likelihood(
            MappedConstellation.of(trees(mapped)), trees(seen), np.full(len(seen), 0.5)
        )
        scene = likelihood._scene(np.zeros((1, 3)), 0.0)
        return len(scene.expected)

    without = num_expected(seen)
    found = [num_expected(np.vstack([seen, other])) > without for other in others]
    return np.array(found)


def test_what_stands_between_those_seen_is_expected() -> None:
    rng = np.random.default_rng(1)
    seen, others = 8.0 * rng.standard_normal((25, 2)), 9.0 * rng.standard_normal((60, 2))
    seen -= seen.mean(axis=0)
    mesh = Delaunay(seen)
    a, b, c = (seen[mesh.simplices[:, k]] @ (1.0, 1.0j) for k in range(3))
    area = 0.5 * np.abs(np.imag(np.conj(b - a) * (c - a)))
    radii = np.abs(b - a) * np.abs(c - b) * np.abs(a - c) / (4.0 * area)
    triangles = mesh.find_simplex(others)
    within = np.linalg.norm(others, axis=1) <= np.linalg.norm(seen, axis=1).max()
    expected = (triangles >= 0) & (radii <= 2.0 * np.median(radii))[triangles] & within
    assert 5 < expected.sum() < 55
    assert (missed(seen, others) == expected).all()


def test_nothing_is_expected_of_trees_in_line() -> None:
    seen = np.column_stack([np.arange(-4.0, 5.0), np.zeros(9)])
    assert not missed(seen, np.array([[0.5, 0.0], [0.0, 1.0]])).any()
