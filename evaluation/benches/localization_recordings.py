"""Localization on real recordings: the car park, MRCLAM, Wild-Places."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from evaluation.alignment import Alignment
from evaluation.benches.bench_runs import known
from evaluation.benches.bench_table import Better, Row
from evaluation.benches.bench_workers import each_seed
from evaluation.trajectory import compare_path, rmse
from semgraph.arrays import FloatArray
from semgraph.estimates import Trajectory
from semgraph.files.yaw_rates import YawRateLog
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.graph.smoother import SmootherSettings
from semgraph.known_map.fixed_map import FixedMap
from semgraph.known_map.pose_likelihood import LikelihoodSettings, PoseLikelihood
from semgraph.landmarks import Kind, Perceptions
from semgraph.localizer import Localized, Localizer, LocalizerSettings, Start
from semgraph.moments import moments
from semgraph.offline.map_growth import Stretches, grow
from semgraph.particle_filter import FilterSettings, ParticleFilter
from semgraph.perceiving import Perceiver
from semgraph.settings import Settings
from sensors.catalog import open_source
from sensors.truth import Source, TrueLandmarks

_SURVEYED_SIGMA_M: Final = 0.02
_SURE: Final = 0.95
_ROBOTS: Final = range(1, 6)
# Of trees mapped from known poses: what belongs together, and how often it must be seen.
_SAME_TREE_M: Final = 0.4
_LEAST_SIGHTINGS: Final = 4
_REVISITED_M: Final = 5.0


def car_park(folder: Path, seeds: Sequence[int]) -> list[Row]:  # noqa: ARG001 - seeds: as all
    """The surveyed beacons are the map, the start is unknown; positions against GPS."""
    source = open_source(f"car-park:{folder}", {})
    landmarks = _surveyed(known(source.truth.landmarks))
    stretches = Stretches(Settings().tracker)
    found = _localized(source, stretches)
    errors_m, share = _errors(source, found)
    grown = grow(landmarks.landmarks(), stretches.logs(), SmootherSettings(), lambda _: None)
    path = known(compare_path(known(grown).trajectory, known(source.truth.path), Alignment.NONE))
    return [
        Row("RMSE against GPS, from where it is found", rmse(errors_m), "m", Better.LOWER, 0.07),
        Row("the same, median", float(np.median(errors_m)), "m", Better.LOWER, 0.07),
        Row("share of the drive found", share, "", Better.HIGHER, 0.95),
        Row("with --grow, RMSE of all poses", rmse(path.distances), "m", Better.LOWER, 0.07),
    ]


def mrclam(folder: Path, seeds: Sequence[int]) -> list[Row]:  # noqa: ARG001 - seeds: as all
    """Known landmarks without their names, robots 1 to 5, from an unknown start."""
    rows = []
    for robot, (error_m, share, wrong) in zip(
        _ROBOTS, each_seed(partial(_robot, folder), _ROBOTS), strict=True
    ):
        rows += [
            Row(f"robot {robot}, RMSE once found", error_m, "m", Better.LOWER, 0.1),
            Row(f"robot {robot}, share of sets found", share, "", Better.HIGHER, 0.9),
            Row(f"robot {robot}, confidently wrong", wrong, "", Better.LOWER, 0.005),
        ]
    return rows


def _robot(folder: Path, robot: int) -> tuple[float, float, float]:
    source = open_source(f"mrclam:{folder}", {"robot": robot, "identities": False})
    errors_m, share = _errors(source, _localized(source))
    return rmse(errors_m), share, float(np.mean(errors_m > 1.0))


def _localized(source: Source, stretches: Stretches | None = None) -> list[Localized]:
    """With the true landmarks as the map; gathers what it may grow by."""
    landmarks = known(source.truth.landmarks)
    localizer = Localizer(_surveyed(landmarks), LocalizerSettings(), Start())
    perceiver = Perceiver(source.recording, Settings())
    found: list[Localized] = []
    for moment in moments(source.recording, perceiver, YawRateLog()):
        found.append(localizer.step(moment.perceptions, moment.odometry))
        if stretches is not None:
            stretches.add(moment.perceptions, moment.odometry, moment.views, found[-1])
    return found


def _surveyed(landmarks: TrueLandmarks) -> FixedMap:
    m = len(landmarks.kinds)
    return FixedMap(
        landmarks.world_t_landmarks,
        np.tile(_SURVEYED_SIGMA_M**2 * np.eye(2), (m, 1, 1)),
        landmarks.kinds,
        landmarks.diameters_m,
        0.05 * landmarks.diameters_m,
        np.full(m, "", dtype=np.str_),
    )


def _errors(source: Source, found: list[Localized]) -> tuple[FloatArray, float]:
    """(n,) m, unaligned, of the sure poses; the share of those."""
    sure = [each for each in found if each.quality >= _SURE]
    trajectory = Trajectory(
        np.array([each.stamp_ns for each in sure]),
        np.array([each.map_T_base.pose.as_array() for each in sure]),
    )
    compared = known(compare_path(trajectory, known(source.truth.path), Alignment.NONE))
    return compared.distances, len(sure) / len(found)


@dataclass(frozen=True, slots=True, eq=False)
class _Frames:
    """Frames of trees with their true poses."""

    perceptions: list[Perceptions]
    poses: FloatArray


def wild_places(folder: Path, seeds: Sequence[int]) -> list[Row]:  # noqa: ARG001 - seeds: as all
    """The first half of the frames is the map, by true poses; later frames alone, anywhere."""
    frames = _frames(open_source(f"wild-places:{folder}", {}))
    half = len(frames.poses) // 2
    likelihood = PoseLikelihood(
        tree_map(frames.perceptions[:half], frames.poses[:half]), LikelihoodSettings()
    )
    near_m, _ = KDTree(frames.poses[:half, :2]).query(frames.poses[half:, :2])
    again = half + np.flatnonzero(near_m <= _REVISITED_M)
    errors, qualities, seconds = [], [], []
    still = UncertainPose2(Pose2(), np.zeros((3, 3)))
    particles = ParticleFilter(likelihood, FilterSettings(), np.random.default_rng(0))
    for k in again.tolist():
        particles.start_anywhere()
        before = time.process_time()
        belief = particles.step(frames.perceptions[k], still)
        seconds.append(time.process_time() - before)
        off = belief.map_T_base.pose.between(Pose2.from_array(frames.poses[k]))
        errors.append((float(np.hypot(off.x, off.y)), abs(off.theta)))
        qualities.append(belief.quality)
    errors_m, turned = np.array(errors).T
    right = (errors_m <= 0.5) & (turned <= np.radians(2.0))
    wrong = (np.array(qualities) > 0.9) & (errors_m > 1.0)
    sure = np.array(qualities) > 0.9
    return [
        Row("within 0.5 m and 2 deg", float(right.mean()), "", Better.HIGHER, 0.98),
        Row("sure frames", float(sure.mean()), "", Better.HIGHER, 0.9),
        Row("confidently wrong", float(wrong.sum()), "frames", Better.LOWER, 0.0),
        Row(
            "error of sure frames, median", float(np.median(errors_m[sure])), "m", Better.LOWER, 0.5
        ),
        Row("processor time a frame, median", float(np.median(seconds)), "s", Better.LOWER, 0.2),
    ]


def _frames(source: Source) -> _Frames:
    path = known(source.truth.path)
    perceptions = [each for each in source.recording.measurements if isinstance(each, Perceptions)]
    return _Frames(perceptions, np.column_stack([path.world_t_reference, known(path.headings)]))


def tree_map(perceptions: Sequence[Perceptions], poses: FloatArray) -> FixedMap:
    """A map of trees seen from known poses: what lies within 0.4 m is one, seen four times."""
    points = np.vstack(
        [
            Pose2.from_array(pose).transform(each.base_t_landmarks())
            for each, pose in zip(perceptions, poses, strict=True)
        ]
    )
    diameters_m = np.concatenate([each.diameters_m for each in perceptions])
    pairs = KDTree(points).query_pairs(_SAME_TREE_M, output_type="ndarray")
    n = len(points)
    joined = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    count, labels = connected_components(joined, directed=False)
    sightings = np.bincount(labels, minlength=count)
    places = [np.bincount(labels, axis, count) / sightings for axis in points.T]
    spread2 = sum(
        np.bincount(labels, (axis - mean[labels]) ** 2, count)
        for axis, mean in zip(points.T, places, strict=True)
    )
    measured = ~np.isnan(diameters_m)
    num_measured = np.bincount(labels[measured], minlength=count)
    sums = np.bincount(labels[measured], np.log(diameters_m[measured]), count)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean_m = np.exp(sums / num_measured)
        sigma_m = mean_m * 0.2 / np.sqrt(num_measured)
    kept = sightings >= _LEAST_SIGHTINGS
    variances = 0.5 * (spread2 / sightings)[kept]
    return FixedMap(
        np.column_stack(places)[kept],
        variances[:, None, None] * np.eye(2) + 1e-4 * np.eye(2),
        np.full(int(kept.sum()), int(Kind.TREE)),
        mean_m[kept],
        sigma_m[kept],
        np.full(int(kept.sum()), "", dtype=np.str_),
    )
