"""What is kept of many is bounded, even, and begins at the beginning."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from semgraph.errors import InputError
from semgraph.thinning import Thinned


@given(st.integers(1, 20), st.integers(0, 300))
def test_what_is_kept_is_bounded_and_even(capacity: int, count: int) -> None:
    thinned: Thinned[int] = Thinned(capacity)
    for k in range(count):
        thinned.add(k)
    assert thinned.count == count
    assert thinned.kept == tuple(range(0, count, thinned.stride))
    assert min(count, capacity // 2) <= len(thinned.kept) <= capacity
    assert (thinned.stride == 1) is (count <= capacity)


@given(st.integers(0, 40), st.integers(1, 12))
def test_a_choice_holds_first_and_last(count: int, wanted: int) -> None:
    thinned: Thinned[int] = Thinned(100)
    for k in range(count):
        thinned.add(k)
    chosen = thinned.spread(wanted)
    assert len(chosen) == min(count, wanted)
    assert list(chosen) == sorted(set(chosen))
    if count and wanted > 1:
        assert (chosen[0], chosen[-1]) == (0, count - 1)
    if len(chosen) > 2:
        assert np.ptp(np.diff(chosen)) <= 1
    assert thinned.spread(0) == ()


def test_none_is_no_capacity() -> None:
    with pytest.raises(InputError, match="at least one"):
        Thinned(0)
