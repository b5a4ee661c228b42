"""Only measurements out of order are left out, wherever the clock jumps."""

import numpy as np
import pytest

from semgraph.ordering import InOrder
from sensors.measurements import ImuSample, Measurement

STEP_NS = 100_000_000
DAY_NS = 86_400_000_000_000


def samples(stamps_ns: list[int]) -> list[Measurement]:
    return [ImuSample(stamp_ns, yaw_rate=0.0) for stamp_ns in stamps_ns]


def kept(stamps_ns: list[int]) -> tuple[list[int], InOrder]:
    ordered = InOrder(samples(stamps_ns))
    return [each.stamp_ns for each in ordered], ordered


@pytest.mark.parametrize("count", [0, 1, 2, 15, 16, 17, 100])
def test_what_is_in_order_passes_whole(count: int) -> None:
    stamps_ns = [k // 2 * STEP_NS for k in range(count)]
    found, ordered = kept(stamps_ns)
    assert found == stamps_ns
    assert ordered.events == ()


def test_a_long_pause_is_no_fault() -> None:
    stamps_ns = [k * STEP_NS + (DAY_NS if k >= 50 else 0) for k in range(100)]
    assert kept(stamps_ns)[0] == stamps_ns


@pytest.mark.parametrize("offset_ns", [DAY_NS, -DAY_NS, -3 * STEP_NS])
@pytest.mark.parametrize("seed", range(10))
def test_clocks_that_jump_for_a_moment_cost_only_that(seed: int, offset_ns: int) -> None:
    """A fifth of the stamps are wrong, some next to each other; at the end witnesses are few."""
    rng = np.random.default_rng(seed)
    is_wrong = rng.random(200) < 0.2
    is_wrong[0] = False
    stamps_ns = [1_000 * DAY_NS + k * STEP_NS + int(offset_ns * is_wrong[k]) for k in range(200)]
    found, ordered = kept(stamps_ns)
    assert found == sorted(found)
    right = {stamp_ns for stamp_ns, wrong in zip(stamps_ns, is_wrong, strict=True) if not wrong}
    assert len(right.intersection(found)) >= len(right) - 5
    assert ordered.num_left_out == 200 - len(found)
    assert "times that do not run forwards" in ordered.events[0]
