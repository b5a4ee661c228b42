"""What is near in the grid is what is near by all distances."""

import numpy as np
import pytest

from semgraph.point_grid import PointGrid


@pytest.mark.parametrize("radius_m", [0.0, 1.0, 7.0, 500.0])
@pytest.mark.parametrize("seed", range(5))
def test_everything_within_the_radius_is_found(seed: int, radius_m: float) -> None:
    rng = np.random.default_rng(seed)
    grid, points = PointGrid(3.0), rng.uniform(-40.0, 40.0, (200, 2))
    for name, point in enumerate(rng.uniform(-40.0, 40.0, (200, 2))):
        grid.put(name, point)
    for name, point in enumerate(points):
        grid.put(name, point)
    for name in range(0, 200, 3):
        grid.remove(name)
    centre = rng.uniform(-40.0, 40.0, 2)
    distances = np.linalg.norm(points - centre, axis=1)
    there = [name for name in range(200) if name % 3]
    found = grid.around(centre, radius_m)
    assert found == sorted(found)
    assert set(found) >= {name for name in there if distances[name] <= radius_m}
    assert all(distances[name] <= radius_m * 2**0.5 + 3.0 * 2**0.5 for name in found)
    assert len(grid) == len(there)
    assert 1 in grid
    assert 3 not in grid
