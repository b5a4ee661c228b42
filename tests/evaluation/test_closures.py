import numpy as np
import pytest

from evaluation.closures import compare_closures
from semgraph.arrays import IntArray

SECOND_NS = 1_000_000_000


def seen(rows: dict[int, list[int]], num_scans: int) -> dict[int, IntArray]:
    """By stamp, one scan a second."""
    return {
        scan * SECOND_NS: np.array(rows.get(scan, []), dtype=np.int64) for scan in range(num_scans)
    }


def test_the_delay_of_each_return() -> None:
    true = seen({0: [4], 150: [4], 160: [4], 400: [4, 2], 401: [4]}, 500)
    closures = compare_closures([90 * SECOND_NS, 153 * SECOND_NS, 170 * SECOND_NS], true)
    assert closures is not None
    np.testing.assert_allclose(closures.delays_s, [3.0, np.nan])
    assert closures.share_closed == 0.5


def test_an_interruption_is_no_return() -> None:
    assert compare_closures([], seen({0: [4], 90: [4], 150: [4]}, 200)) is None


def test_things_that_come_back_one_after_the_other_are_one_return() -> None:
    true = seen({**{k: [k] for k in range(50)}, **{300 + k: [k] for k in range(50)}}, 400)
    closures = compare_closures([300 * SECOND_NS], true)
    assert closures is not None
    assert closures.delays_s == pytest.approx([0.0])
