"""The rock detector's figures, measured on simulated terrain of the seeds given.

Recall is of the rocks of 0.3 m and more, up to 10 m away, that are *visible*: they answer 60 pixels
of the 640 x 480 or more, and at least 60 % of the pixels that they would answer if nothing stood
before them and the image were larger. A rock must be found within its radius, or 0.3 m if that is
more, by a perception of its own. Precision is of all perceptions up to 10 m that are reliable by
0.7 or more; one is right if there is a rock of 0.1 m or more that is seen at all, and again of
those only that say 0.3 m or more. Smooth ground has the targets of medium ground. The detector
was fitted on the seeds 1 to 20.
"""

from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Final

import numpy as np

from detectors.rock_settings import RockSettings
from detectors.rocks import RockDetector
from evaluation.benches.bench_statistics import mean, median_ms, worst_bin
from evaluation.benches.bench_table import Better, Row
from evaluation.benches.detector_trials import RELIABLE
from evaluation.benches.rock_trials import RockOutcomes, judge_rocks, rock_trials
from semgraph.arrays import BoolArray
from sensors.simulation.depth_camera import DepthCamera, Stereo, TimeOfFlight
from sensors.simulation.terrain import MEDIUM, ROUGH, SMOOTH, TerrainSettings

LARGE_M: Final = 0.3
WITHIN_M: Final = 10.0
NEAR_M: Final = 6.0
_SMALL_BASELINE_M: Final = 0.12
_MIN_IN_BIN: Final = 100


def rocks_on_smooth_ground(seeds: Sequence[int]) -> list[Row]:
    """Stereo of 0.24 m."""
    return _figures("rocks smooth", _stereo(seeds, SMOOTH), 0.92, 0.96)


def rocks_on_medium_ground(seeds: Sequence[int]) -> list[Row]:
    """Stereo of 0.24 m."""
    return _figures("rocks medium", _stereo(seeds, MEDIUM), 0.92, 0.96)


def rocks_on_rough_ground(seeds: Sequence[int]) -> list[Row]:
    """Stereo of 0.24 m."""
    return _figures("rocks rough", _stereo(seeds, ROUGH), 0.83, 0.91)


def rocks_of_other_cameras(seeds: Sequence[int]) -> list[Row]:
    """Medium ground: half the baseline, and time of flight."""
    narrow = DepthCamera(noise=Stereo(baseline_m=_SMALL_BASELINE_M))
    settings = RockSettings(baseline_m=_SMALL_BASELINE_M)
    found, _ = _outcomes(tuple(seeds), MEDIUM, narrow, settings)
    rows = _rates("rocks medium, b = .12", found, (0.84, 0.90))
    noise = TimeOfFlight()
    settings = RockSettings(
        disparity_sigma_px=0.0,
        depth_sigma_m=noise.sigma_m,
        depth_sigma_per_m=noise.sigma_per_m,
    )
    found, _ = _outcomes(tuple(seeds), MEDIUM, DepthCamera(noise=noise), settings)
    return rows + _figures("rocks medium, time of flight", found, 0.92, 0.96)


def rock_reliability(seeds: Sequence[int]) -> list[Row]:
    """Largest difference of predicted and observed, in bins of a tenth that hold 100 or more."""
    device, settings = DepthCamera(), RockSettings()
    everything = RockOutcomes.union(
        [_outcomes(tuple(seeds), ground, device, settings)[1] for ground in (SMOOTH, MEDIUM, ROUGH)]
    )
    worst = worst_bin(everything.reliabilities, everything.right, _MIN_IN_BIN)
    return [Row("rocks reliability, worst bin", worst, "", Better.LOWER, 0.05)]


def rock_detector_time(seeds: Sequence[int]) -> list[Row]:
    """Median CPU time of an image of 640 x 480, on the terrain of the first three seeds."""
    detector = RockDetector(RockSettings())
    rows = []
    for name, ground in (("medium", MEDIUM), ("rough", ROUGH)):
        images = [trial.image for trial in rock_trials(seeds[:3], ground, DepthCamera())]
        milliseconds = median_ms([partial(detector.detect, image) for image in images])
        title = f"rocks CPU median, {name}, 640 x 480"
        rows.append(Row(title, milliseconds, "ms", Better.LOWER, 22.0))
    return rows


def _stereo(seeds: Sequence[int], ground: TerrainSettings) -> RockOutcomes:
    """What is reliable, of the camera that the detector expects."""
    return _outcomes(tuple(seeds), ground, DepthCamera(), RockSettings())[0]


@cache
def _outcomes(
    seeds: tuple[int, ...], ground: TerrainSettings, device: DepthCamera, settings: RockSettings
) -> tuple[RockOutcomes, RockOutcomes]:
    """Of what is reliable, and of everything."""
    detector = RockDetector(settings)
    reliable, everything = [], []
    for trial in rock_trials(seeds, ground, device):
        reliable.append(judge_rocks(trial, detector, RELIABLE))
        everything.append(judge_rocks(trial, detector, 0.0))
    return RockOutcomes.union(reliable), RockOutcomes.union(everything)


def _figures(name: str, outcomes: RockOutcomes, recall: float, precision: float) -> list[Row]:
    whole = outcomes.whole & (outcomes.ranges_m < WITHIN_M)
    nees = mean(outcomes.nees[whole])
    large = whole & (outcomes.true_diameters_m >= LARGE_M)
    near = large & (outcomes.ranges_m < NEAR_M)
    return [
        *_rates(name, outcomes, (recall, precision)),
        Row(f"{name} centre RMSE to 6 m", _centre_mm(outcomes, near), "mm", Better.LOWER, 65.0),
        Row(f"{name} centre RMSE to 10 m", _centre_mm(outcomes, large), "mm", Better.LOWER, 120.0),
        Row(f"{name} NEES of 2", nees, "", Better.HIGHER, 1.3),
        Row(f"{name} NEES of 2", nees, "", Better.LOWER, 2.7),
    ]


def _rates(name: str, outcomes: RockOutcomes, targets: tuple[float, float]) -> list[Row]:
    there = (
        outcomes.visible
        & (outcomes.rock_diameters_m >= LARGE_M)
        & (outcomes.rock_distances_m < WITHIN_M)
    )
    near = outcomes.ranges_m < WITHIN_M
    large = near & (outcomes.diameters_m >= LARGE_M)
    recall, precision = targets
    return [
        Row(f"{name} recall", mean(outcomes.found[there]), "", Better.HIGHER, recall),
        Row(f"{name} precision", mean(outcomes.right[near]), "", Better.HIGHER, precision),
        Row(f"{name} precision of .3 m", mean(outcomes.right[large]), "", Better.HIGHER, precision),
    ]


def _centre_mm(outcomes: RockOutcomes, chosen: BoolArray) -> float:
    """RMSE; NaN for none."""
    along_m, across = outcomes.errors[chosen, 0], outcomes.errors[chosen, 1]
    squares = along_m**2 + (across * outcomes.ranges_m[chosen]) ** 2
    return 1e3 * float(np.sqrt(mean(squares)))


Figures = Callable[[Sequence[int]], list[Row]]
FIGURES: Final[tuple[Figures, ...]] = (
    rocks_on_smooth_ground,
    rocks_on_medium_ground,
    rocks_on_rough_ground,
    rocks_of_other_cameras,
    rock_reliability,
    rock_detector_time,
)
