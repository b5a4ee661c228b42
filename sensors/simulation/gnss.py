"""A simulated GNSS receiver among trees."""

from dataclasses import dataclass

import numpy as np

from semgraph.arrays import BoolArray, FloatArray, IntArray
from semgraph.errors import InputError
from semgraph.geometry import transform_points
from sensors.measurements import GnssFix
from sensors.simulation.noise import check_domain, check_path, gauss_markov


@dataclass(frozen=True, slots=True)
class SimulatedGnss:
    """A single-frequency receiver; standard deviations are of one axis.

    Attributes:
        white_sigma_m: new in each fix.
        correlated_sigma_m: what atmosphere and canopy add, remembered over `correlation_s`.
        outlier_share: of fixes that a reflection displaces by `outlier_sigma_m` more; the receiver
            does not know of it.
        outages_per_hour: how often the sky is hidden, on average for `outage_s`.
    """

    white_sigma_m: float = 0.5
    correlated_sigma_m: float = 1.5
    correlation_s: float = 60.0
    outlier_share: float = 0.02
    outlier_sigma_m: float = 15.0
    outages_per_hour: float = 20.0
    outage_s: float = 10.0

    def __post_init__(self) -> None:
        check_domain("GNSS", self, positive=("white_sigma_m", "correlation_s", "outage_s"))
        if self.outlier_share > 1.0:
            raise InputError(f"simulated GNSS: expected a share up to 1, got {self.outlier_share}")

    @property
    def sigma_m(self) -> float:
        """What the receiver says of its fixes."""
        return float(np.hypot(self.white_sigma_m, self.correlated_sigma_m))


def simulate_gnss(
    stamps_ns: IntArray,
    world_T_bases: FloatArray,
    gnss: SimulatedGnss,
    rng: np.random.Generator,
    *,
    base_t_antenna: tuple[float, float] = (0.0, 0.0),
) -> list[GnssFix]:
    """The antenna's fixes at the stamps (n,) of a true path (n, 3); none during outages.

    Raises:
        InputError: shapes disagree, no stamp, or stamps that do not increase.
    """
    check_path("GNSS", stamps_ns, world_T_bases)
    n = len(stamps_ns)
    seconds = 1e-9 * (stamps_ns - stamps_ns[0])
    errors_m = gnss.white_sigma_m * rng.standard_normal((n, 2))
    errors_m += gauss_markov(seconds, gnss.correlated_sigma_m, gnss.correlation_s, 2, rng)
    displaced = rng.uniform(size=(n, 1)) < gnss.outlier_share
    errors_m += displaced * gnss.outlier_sigma_m * rng.standard_normal((n, 2))
    fixes = transform_points(world_T_bases, np.array(base_t_antenna)) + errors_m
    visible = ~_hidden(seconds, gnss, rng)
    return [
        GnssFix(stamp_ns, x_m, y_m, gnss.sigma_m)
        for stamp_ns, (x_m, y_m) in zip(
            stamps_ns[visible].tolist(), fixes[visible].tolist(), strict=True
        )
    ]


def _hidden(seconds: FloatArray, gnss: SimulatedGnss, rng: np.random.Generator) -> BoolArray:
    """(n,) whether a time falls into one of the outages, which come at random."""
    lasts_s = float(seconds[-1])
    num = int(rng.poisson(gnss.outages_per_hour * lasts_s / 3600.0))
    starts = np.sort(rng.uniform(0.0, lasts_s, num))
    ends = np.maximum.accumulate(starts + rng.exponential(gnss.outage_s, num))
    begun = np.searchsorted(starts, seconds, side="right")
    return np.asarray(seconds < np.append(-np.inf, ends)[begun])
