"""How soon a loop is closed after its start is in sight again."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from evaluation.estimators.driving import LOOP_SCANS
from semgraph.arrays import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Closures:
    """Attributes: delays_s: (n,) of each return to a place, NaN where no loop was closed."""

    delays_s: FloatArray

    @property
    def share_closed(self) -> float:
        """How many of the returns were noticed."""
        return float(np.isfinite(self.delays_s).mean())


def compare_closures(
    closed_at_ns: Sequence[int], associations: Mapping[int, IntArray]
) -> Closures | None:
    """The delay from each return to the first loop closed after it; None without a return.

    A return begins where a true landmark is in sight that was not for more than 100 scans; what
    comes back within the next 100 belongs to it.

    Args:
        closed_at_ns: when an estimator closed a loop.
        associations: of the truth, by stamp in order.
    """
    returns_ns = _returns_ns(associations)
    if not returns_ns:
        return None
    closed = np.sort(np.array(closed_at_ns, dtype=np.int64))
    ends = [*returns_ns[1:], np.iinfo(np.int64).max]
    delays_s = []
    for start, end in zip(returns_ns, ends, strict=True):
        within = closed[(closed >= start) & (closed < end)]
        delays_s.append(1e-9 * float(within[0] - start) if len(within) else np.nan)
    return Closures(np.array(delays_s))


def _returns_ns(associations: Mapping[int, IntArray]) -> list[int]:
    last_scans: dict[int, int] = {}
    returns_ns: list[int] = []
    last_return = -LOOP_SCANS - 1
    for scan, (stamp_ns, rows) in enumerate(associations.items()):
        seen = rows[rows >= 0].tolist()
        if any(scan - last_scans.get(row, scan) > LOOP_SCANS for row in seen):
            if scan - last_return > LOOP_SCANS:
                returns_ns.append(stamp_ns)
            last_return = scan
        last_scans.update(dict.fromkeys(seen, scan))
    return returns_ns
