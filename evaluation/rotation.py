"""How fast an estimate turns against how fast an inertial sensor says that base turns (Fig. 7)."""

from dataclasses import dataclass

import numpy as np

from evaluation.trajectory import MAX_GAP_NS
from semgraph.arrays import FloatArray, IntArray
from semgraph.estimates import Trajectory
from semgraph.files.yaw_rates import YawRates
from semgraph.geometry import wrap_angle


@dataclass(frozen=True, slots=True, eq=False)
class TurnRates:
    """Mean yaw rates in rad/s between consecutive poses.

    Attributes:
        stamps_ns: (n,) in the middle between two poses.
        estimated, measured: (n,) by the estimate, and by the inertial sensor over the same time.
    """

    stamps_ns: IntArray
    estimated: FloatArray
    measured: FloatArray

    @property
    def differences(self) -> FloatArray:
        """(n,) estimated less measured."""
        return self.estimated - self.measured

    @property
    def rms(self) -> float:
        """Of the differences."""
        return float(np.sqrt(np.mean(self.differences**2)))


def turn_rates(estimate: Trajectory, imu: YawRates) -> TurnRates | None:
    """Rates between consecutive poses for which there are samples; None where there are none.

    A sample counts for the time since the sample before. Where either says nothing for more than
    2 s, nothing is compared.
    """
    if len(estimate) < 2 or len(imu) < 2:
        return None
    starts_ns, ends_ns = estimate.stamps_ns[:-1], estimate.stamps_ns[1:]
    inside = (starts_ns >= imu.stamps_ns[0]) & (ends_ns <= imu.stamps_ns[-1])
    kept = inside & (ends_ns - starts_ns <= MAX_GAP_NS) & ~_hold_gaps(imu, starts_ns, ends_ns)
    if not kept.any():
        return None
    first_ns = imu.stamps_ns[0]
    seconds = 1e-9 * (imu.stamps_ns - first_ns)
    turned = np.concatenate([[0.0], np.cumsum(imu.rates[1:] * np.diff(seconds))])
    at_start, at_end = (
        np.interp(1e-9 * (stamps_ns[kept] - first_ns), seconds, turned)
        for stamps_ns in (starts_ns, ends_ns)
    )
    spans_s = 1e-9 * (ends_ns - starts_ns)[kept]
    headings = estimate.map_T_bases[:, 2]
    estimated = wrap_angle(np.diff(headings))[kept] / spans_s
    middles_ns = starts_ns + (ends_ns - starts_ns) // 2
    return TurnRates(middles_ns[kept], estimated, (at_end - at_start) / spans_s)


def _hold_gaps(imu: YawRates, starts_ns: IntArray, ends_ns: IntArray) -> np.ndarray:
    """(n,) whether the sensor was silent for more than 2 s somewhere between start and end."""
    gap_ends = np.flatnonzero(np.diff(imu.stamps_ns) > MAX_GAP_NS) + 1
    after_start = np.searchsorted(imu.stamps_ns[gap_ends], starts_ns, side="right")
    before_end = np.searchsorted(imu.stamps_ns[gap_ends - 1], ends_ns, side="left")
    return np.asarray(after_start < before_end)
