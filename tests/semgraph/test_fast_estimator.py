import numpy as np
import pytest

from semgraph.alignment import Alignment
from semgraph.estimates import NoEstimate, NoEstimateReason
from semgraph.fast_estimator import FastEstimator, FastSettings, Rules
from semgraph.geometry import Pose2
from semgraph.landmarks import Kind, Perceptions
from semgraph.motion_model import OdometryAccumulator
from sensors.measurements import OdometryNoise, WheelOdometry
from sensors.simulation.course import CourseOptions, read
from sensors.truth import Source


def follow(source: Source, settings: FastSettings) -> tuple[FastEstimator, np.ndarray]:
    """The estimator at the end, and its poses (n, 3)."""
    recording = source.recording
    estimator = FastEstimator(settings, recording.map_T_start)
    noise = recording.odometry_noise
    wheels = OdometryAccumulator(noise) if noise is not None else None
    poses = []
    for measurement in recording.measurements:
        if isinstance(measurement, WheelOdometry):
            assert wheels is not None
            wheels.add(measurement)
        elif isinstance(measurement, Perceptions):
            step = estimator.step(measurement, wheels.take() if wheels else None)
            poses.append(step.map_T_base.pose.as_array())
    return estimator, np.array(poses)


def path_errors(source: Source, poses: np.ndarray) -> np.ndarray:
    assert source.truth.path is not None
    offsets = poses[:, :2] - source.truth.path.world_t_reference
    return np.hypot(offsets[:, 0], offsets[:, 1])


@pytest.mark.parametrize("rules", Rules)
@pytest.mark.parametrize("odometry", [False, True])
def test_drift_stays_small_and_shrinks_when_the_start_is_seen_again(
    rules: Rules, *, odometry: bool
) -> None:
    source = read("paper", CourseOptions(seed=2, odometry=odometry))
    estimator, poses = follow(source, FastSettings(rules=rules))
    errors = path_errors(source, poses)
    assert errors.max() < 0.5
    assert errors[-1] < 0.5 * errors.max()
    assert len(estimator.navigation_map) == pytest.approx(120, abs=3)


def test_nearly_perfect_perceptions_are_followed_nearly_exactly() -> None:
    options = CourseOptions(
        seed=1,
        range_sigma_m=1e-5,
        bearing_sigma_rad=1e-6,
        missed=0.0,
        lap_s=20.0,
        scan_rate_hz=10.0,
    )
    source = read("paper", options)
    _, poses = follow(source, FastSettings())
    assert path_errors(source, poses).max() < 1e-3


def test_clutter_does_not_lead_astray() -> None:
    source = read("paper", CourseOptions(seed=4, clutter=3.0))
    _, poses = follow(source, FastSettings())
    assert path_errors(source, poses).max() < 0.5


def test_scans_without_perceptions_say_so_and_the_motion_model_carries_on() -> None:
    source = read("paper", CourseOptions(seed=3))
    estimator = FastEstimator(FastSettings(), source.recording.map_T_start)
    scans = [each for each in source.recording.measurements if isinstance(each, Perceptions)]
    for scan in scans[:20]:
        assert estimator.step(scan, None).map_T_base is not None
    nothing = scans[20].select(np.zeros(len(scans[20]), dtype=np.bool_))
    blind = estimator.step(nothing, None)
    assert blind.closed_form == NoEstimate(NoEstimateReason.NO_PERCEPTIONS)
    truth = source.truth.path
    assert truth is not None
    offset = blind.map_T_base.pose.as_array()[:2] - truth.world_t_reference[20]
    assert np.linalg.norm(offset) < 0.1
    assert isinstance(estimator.step(scans[21], None).closed_form, Alignment)


def test_moving_the_world_moves_the_estimate() -> None:
    source = read("paper", CourseOptions(seed=5, lap_s=10.0))
    scans = [each for each in source.recording.measurements if isinstance(each, Perceptions)][:40]
    world = Pose2(100.0, -50.0, 1.1)
    here = FastEstimator(FastSettings(), Pose2())
    there = FastEstimator(FastSettings(), world)
    for scan in scans:
        one = world @ here.step(scan, None).map_T_base.pose
        other = there.step(scan, None).map_T_base.pose
        np.testing.assert_allclose(one.between(other).as_array(), 0.0, atol=1e-6)


def test_a_short_memory_forgets_and_an_identity_does_not() -> None:
    def scan(stamp_ns: int, identity: str) -> Perceptions:
        return Perceptions.from_arrays(
            stamp_ns,
            Kind.MARKER,
            np.array([4.0]),
            np.array([0.0]),
            np.tile(np.diag([1e-4, 1e-6]), (1, 1, 1)),
            identities=np.array([identity], dtype=np.str_),
        )

    noise = OdometryAccumulator(OdometryNoise())
    for identity, same in (("", False), ("7", True)):
        estimator = FastEstimator(FastSettings(memory_m=1.0), Pose2())
        first = estimator.step(scan(0, identity), noise.take())
        noise.add(WheelOdometry(0, Pose2()))
        noise.add(WheelOdometry(1, Pose2(5.0, 0.0, 0.0)))
        away = scan(10**9, identity).select(np.zeros(1, dtype=np.bool_))
        estimator.step(away, noise.take())
        noise.add(WheelOdometry(2, Pose2()))
        again = estimator.step(scan(2 * 10**9, identity), noise.take())
        assert (first.landmark_ids[0] == again.landmark_ids[0]) == same
