"""Sets of scan numbers behave as Python's."""

import numpy as np
import pytest

from semgraph.scan_set import ScanSet


@pytest.mark.parametrize("seed", range(20))
def test_it_is_a_set(seed: int) -> None:
    rng = np.random.default_rng(seed)
    one, other = (rng.integers(0, 40, rng.integers(0, 12)).tolist() for _ in range(2))
    first, second = ScanSet(), ScanSet(other)
    for scan in one:
        first.add(scan)
    assert list(first) == sorted(set(one))
    assert len(first) == len(set(one))
    assert first.isdisjoint(second) == set(one).isdisjoint(other)
    assert second.isdisjoint(first) == first.isdisjoint(second)
    for low in range(0, 40, 7):
        assert first.touches(low, low + 3) == any(low <= scan <= low + 3 for scan in one)
        assert (low in first) == (low in one)
    first.update(second)
    assert list(first) == sorted({*one, *other})
    for _ in range(2):
        first.difference_update(one[::2])
    assert list(first) == sorted({*one, *other} - set(one[::2]))
    first.update(ScanSet(one))
    if one or other:
        assert (first.first, first.last) == (min([*one, *other]), max([*one, *other]))


def test_an_empty_one_has_no_first() -> None:
    with pytest.raises(IndexError):
        _ = ScanSet().first
