"""The figures of trees in laser scans, measured on simulated scans of the seeds given.

The reliability of trees was fitted on other stands than any seed gives here.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from detectors.footprint_calibration import calibrate_footprint
from detectors.tree_settings import TreeSettings
from detectors.trees_2d import TreeDetector
from evaluation.benches.bench_statistics import mean, median_ms, worst_bin
from evaluation.benches.bench_table import Better, Row
from evaluation.benches.detector_trials import RELIABLE, Outcomes, judge_detector, stand_trials
from evaluation.benches.tree_figures import errors_between, nees_within, rates
from semgraph.geometry import Pose2
from sensors.simulation.lms151 import Lms151, Resolution
from sensors.simulation.world import FOREST, PARKLAND, Thing, World

TREES = (Thing.STEM, Thing.SAPLING)
DENSE = tuple(replace(FOREST, stems_per_ha=density) for density in (400.0, 700.0, 1000.0))
OPEN = tuple(replace(PARKLAND, stems_per_ha=density) for density in (30.0, 55.0, 80.0))
CLUTTERED = (replace(FOREST, clumps_per_stem=0.4, saplings_per_stem=0.3),)


def trees_quarter_degree(seeds: Sequence[int]) -> list[Row]:
    """Dense forest, 1081 beams."""
    outcomes = _forest(seeds, Resolution.QUARTER_DEGREE)
    name = "trees 0.25 deg"
    return [
        *rates(name, outcomes, 20.0, 3, (0.92, 0.96)),
        *errors_between(name, outcomes, (0.0, 5.0), (10.0, 15.0)),
        *errors_between(name, outcomes, (5.0, 10.0), (18.0, 28.0)),
        *errors_between(name, outcomes, (10.0, 20.0), (35.0, 55.0)),
        *nees_within(name, outcomes, 20.0, (2.0, 4.0)),
    ]


def trees_half_degree(seeds: Sequence[int]) -> list[Row]:
    """Dense forest, 541 beams."""
    outcomes = _forest(seeds, Resolution.HALF_DEGREE)
    name = "trees 0.5 deg"
    return [
        *rates(name, outcomes, 15.0, 3, (0.94, 0.96)),
        *errors_between(name, outcomes, (0.0, 5.0), (15.0, 22.0)),
        *errors_between(name, outcomes, (5.0, 10.0), (28.0, 45.0)),
        *errors_between(name, outcomes, (10.0, 15.0), (45.0, 80.0)),
        *nees_within(name, outcomes, 15.0, (2.0, 4.0)),
    ]


def trees_parkland(seeds: Sequence[int]) -> list[Row]:
    """Stems far apart, seen by a beam or two."""
    trials = list(stand_trials(seeds, Lms151(Resolution.HALF_DEGREE), OPEN))
    outcomes = judge_detector(trials, TreeDetector(TreeSettings()), TREES, 0.0)
    there = (
        (outcomes.thing_beams >= 1)
        & (outcomes.thing_distances_m >= 20.0)
        & (outcomes.thing_distances_m < 30.0)
    )
    recall = mean(outcomes.found[there])
    return [Row("trees parkland 20-30 m any-hit recall", recall, "", Better.HIGHER, 0.93)]


def tree_footprint(seeds: Sequence[int]) -> list[Row]:
    """The device's beam is 5 mrad narrower or wider than the settings say."""
    rows = []
    for divergence in (0.010, 0.020):
        device = Lms151(Resolution.QUARTER_DEGREE, beam_divergence=divergence)
        trials = list(stand_trials(seeds, device, DENSE))
        wrong = TreeSettings()
        right = calibrate_footprint([trial.scan for trial in trials[:60]], wrong)
        for name, settings, target in (("before", wrong, 50.0), ("after", right, 15.0)):
            outcomes = judge_detector(trials, TreeDetector(settings), TREES, RELIABLE)
            inside = outcomes.visible & (outcomes.ranges_m >= 5.0) & (outcomes.ranges_m < 20.0)
            bias_mm = 1e3 * abs(mean(outcomes.errors[inside, 2]))
            title = f"trees {1e3 * divergence:g} mrad beam, diameter bias {name} calibration"
            rows.append(Row(title, bias_mm, "mm", Better.LOWER, target))
    return rows


def tree_reliability(seeds: Sequence[int]) -> list[Row]:
    """Largest difference of predicted and observed, in bins of a tenth that hold 300 or more."""
    trials = [
        trial
        for resolution in Resolution
        for trial in stand_trials(seeds, Lms151(resolution), (FOREST, PARKLAND, *CLUTTERED))
    ]
    detector = TreeDetector(TreeSettings())
    outcomes = judge_detector(trials, detector, TREES, 0.0)
    worst = worst_bin(outcomes.reliabilities, outcomes.matched >= 0, 300)
    return [Row("trees reliability, worst bin", worst, "", Better.LOWER, 0.05)]


def tree_detector_time(seeds: Sequence[int]) -> list[Row]:
    """Median CPU time of a scan in dense forest."""
    rows = []
    for resolution, target in ((Resolution.HALF_DEGREE, 0.7), (Resolution.QUARTER_DEGREE, 0.8)):
        detector = TreeDetector(TreeSettings())
        scans = [trial.scan for trial in stand_trials(seeds, Lms151(resolution), DENSE)]
        milliseconds = median_ms([partial(detector.detect, scan) for scan in scans])
        title = f"trees CPU median, {resolution.num_beams} beams"
        rows.append(Row(title, milliseconds, "ms", Better.LOWER, target))
    return rows


def ray_casting_time(seeds: Sequence[int]) -> list[Row]:
    """Median CPU time of a simulated scan of 300 stems, with the beam's width."""
    rows = []
    for resolution in Resolution:
        device = Lms151(resolution)
        calls = []
        for seed in seeds:
            rng = np.random.default_rng(seed)
            world = World.of(
                Thing.STEM, rng.uniform(-40.0, 40.0, (300, 2)), rng.uniform(0.1, 0.6, 300), rng
            )
            calls.append(partial(device.scan, world, Pose2(), rng))
        title = f"LMS151 simulation, 300 stems, {resolution.num_beams} beams"
        rows.append(Row(title, median_ms(calls), "ms", Better.LOWER, 3.0))
    return rows


def _forest(seeds: Sequence[int], resolution: Resolution) -> Outcomes:
    trials = list(stand_trials(seeds, Lms151(resolution), DENSE))
    return judge_detector(trials, TreeDetector(TreeSettings()), TREES, RELIABLE)


Figures = Callable[[Sequence[int]], list[Row]]
FIGURES: tuple[Figures, ...] = (
    trees_quarter_degree,
    trees_half_degree,
    trees_parkland,
    tree_footprint,
    tree_reliability,
    tree_detector_time,
    ray_casting_time,
)
