"""After seconds without any motion known, the robot finds itself by the trees around."""

from dataclasses import replace

import numpy as np
import pytest

from evaluation.metrics import judge
from semgraph.constellations.constellation import Placement
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.graph.recognition import _unlike_others
from semgraph.perceiving import Perceiver
from semgraph.pipeline import run
from semgraph.progress import Silence
from semgraph.settings import Settings
from sensors.simulation.courses.perceptions import CourseOptions, read

COURSE = CourseOptions(
    scan_rate_hz=4.0,
    num_trees=80,
    track_radius_m=15.0,
    lap_s=60.0,
    overlap_s=12.0,
    max_range_m=12.0,
    clutter=0.5,
    missed=0.1,
)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_robot_that_drove_on_unseen_finds_itself(seed: int) -> None:
    """Ten seconds without wheels and perceptions: where it is then, nobody can say to 20 m."""
    source = read("course:perceptions", COURSE.model_copy(update={"seed": seed}))
    measurements = list(source.recording.measurements)
    seconds = np.array([each.stamp_ns - measurements[0].stamp_ns for each in measurements]) * 1e-9
    is_kept = (seconds < 20.0) | (seconds >= 30.0)
    kept = tuple(each for each, is_in in zip(measurements, is_kept, strict=True) if is_in)
    recording = replace(source.recording, measurements=kept, num_scans=len(kept))
    settings = Settings()
    result = run(recording, settings, Perceiver(recording, settings), Silence(), {})
    figures = {metric.name: metric.value for metric in judge(result, source.truth)}
    assert figures["trajectory_rmse_m"] < 0.1
    assert figures["landmarks_duplicate"] == 0
    assert figures["num_loop_closures"] > 5


def placed(num_pairs: int) -> Placement:
    rows = np.arange(num_pairs)
    return Placement(UncertainPose2(Pose2(), np.eye(3)), rows, rows, 10.0)


@pytest.mark.parametrize(
    ("num_pairs", "is_found"),
    [((), False), ((20,), True), ((20, 16), False), ((20, 8), True), ((4, 3), False)],
)
def test_what_fits_somewhere_else_as_well_is_nowhere(
    num_pairs: tuple[int, ...], *, is_found: bool
) -> None:
    placements = tuple(map(placed, num_pairs))
    assert (_unlike_others(placements) is not None) == is_found
