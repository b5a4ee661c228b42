"""What growing a given map gains on simulated drives, and what true matches would."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from evaluation.benches.bench_table import Better, Row
from evaluation.benches.bench_workers import each_seed
from evaluation.benches.localization_runs import NEAR_M, NEAR_RAD, Trial, pose_error
from evaluation.benches.localization_trials import Mapped, Moment, Stand, drive, mapped
from semgraph.arrays import FloatArray
from semgraph.estimates import Trajectory
from semgraph.files.run_log import RunLog
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.graph.smoother import SmootherSettings
from semgraph.landmarks import concatenate
from semgraph.localizer import Localizer, LocalizerSettings, Start
from semgraph.offline.batch import Batch, Belief, Prior
from semgraph.offline.batch_graph import BatchGraph
from semgraph.offline.map_growth import START_COVARIANCE, Stretches, grow
from semgraph.offline.reassociation import with_places
from semgraph.settings import Settings

_FAR_M: Final = 1.0


def growth(file: Path, trial: Trial, target: float, seeds: Sequence[int]) -> list[Row]:
    """After 10 m driven from an unknown start, the map grown by all that was seen."""
    grown, limit = np.array(each_seed(partial(grown_and_limit, file, trial), seeds)).swapaxes(0, 1)
    rms = [float(np.sqrt(np.mean(each[grown[:, 0] <= _FAR_M, 0] ** 2))) for each in (grown, limit)]
    return [
        Row("grown: within 0.3 m and 1 deg after 10 m", _right(grown), "", Better.HIGHER, target),
        Row("grown: the same with true matches, the limit", _right(limit), "", Better.HIGHER, 0.0),
        Row("grown: RMSE / that with true matches", rms[0] / rms[1], "", Better.LOWER, 1.15),
    ]


def _right(errors: FloatArray) -> float:
    return float(np.mean((errors[:, 0] <= NEAR_M) & (errors[:, 1] <= NEAR_RAD)))


def grown_and_limit(
    file: Path, trial: Trial, seed: int
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Errors (m, rad) of the last pose, of the grown map and with true matches."""
    rng = np.random.default_rng(seed)
    stand = Stand.read(file)
    with_map = mapped(stand, trial.errors, rng)
    moments = drive(stand, trial.num_scans, rng, diameters=trial.errors.diameters)
    localizer = Localizer(with_map.fixed_map, LocalizerSettings(seed=seed), Start())
    stretches = Stretches(Settings().tracker)
    last = Pose2()
    for moment in moments:
        found = localizer.step(moment.perceptions, moment.odometry)
        stretches.add(moment.perceptions, moment.odometry, (), found)
        last = found.map_T_base.pose
    landmarks = with_map.fixed_map.landmarks()
    grown = grow(landmarks, stretches.logs(), SmootherSettings(), lambda _: None)
    if grown is not None and grown.trajectory.stamps_ns[-1] == moments[-1].perceptions.stamp_ns:
        last = Pose2.from_array(grown.trajectory.map_T_bases[-1])
    true = moments[-1].world_T_base
    return pose_error(last, true), pose_error(by_true_matches(with_map, moments), true)


def by_true_matches(with_map: Mapped, moments: Sequence[Moment]) -> Pose2:
    """The last pose at the optimum of the whole drive and the map, begun at the truth."""
    log = _true_log(moments)
    seen = np.unique(log.landmarks[log.landmarks >= 0])
    known = seen[with_map.rows[seen] >= 0]
    fixed_map, rows = with_map.fixed_map, with_map.rows[known]
    priors = tuple(
        Prior(int(stem), fixed_map.map_t_landmarks[row], fixed_map.covariances[row])
        for stem, row in zip(known, rows, strict=True)
    )
    batch = Batch.of(log)
    belief = Belief(log.trajectory.map_T_bases, log.landmarks, {}, priors)
    optimum = BatchGraph(batch, with_places(batch, belief, log.landmarks)).optimum()
    return Pose2.from_array(optimum.map_T_bases[-1])


def _true_log(moments: Sequence[Moment]) -> RunLog:
    """A drive with wheels, with its true poses and associations."""
    motions = [moment.odometry or UncertainPose2(Pose2(), np.eye(3)) for moment in moments]
    poses = np.array([moment.world_T_base.as_array() for moment in moments])
    stamps_ns = np.array([moment.perceptions.stamp_ns for moment in moments])
    return RunLog(
        Trajectory(stamps_ns, poses),
        UncertainPose2(moments[0].world_T_base, START_COVARIANCE),
        np.array([each.pose.as_array() for each in motions]),
        np.array([each.covariance for each in motions]),
        concatenate(0, [moment.perceptions for moment in moments]),
        np.repeat(np.arange(len(moments)), [len(moment.stems) for moment in moments]),
        np.concatenate([moment.stems for moment in moments]),
    )
