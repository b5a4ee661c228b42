"""Figures of the offline refinement: `semgraph bench refine`.

The batch optimum beside GTSAM's own optimizer; and a prior map that is half a metre off, with
trees that are not there and without some that are, beside the optimum with true associations.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from evaluation.benches.bench import Section
from evaluation.benches.bench_runs import known, run_course
from evaluation.benches.bench_table import Better, Row
from evaluation.benches.bench_workers import each_seed
from evaluation.landmarks import compare_map, match
from evaluation.oracle import true_belief
from evaluation.trajectory import compare_path, rmse
from semgraph.arrays import BoolArray, FloatArray, IntArray
from semgraph.estimates import Trajectory
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.graph.smoother import SmootherSettings
from semgraph.landmarks import Kind
from semgraph.offline.batch import Batch, Belief, Prior
from semgraph.offline.batch_graph import BatchGraph
from semgraph.offline.map_changes import Fate, changes
from semgraph.offline.map_update import START_COVARIANCE, update_map
from semgraph.offline.prior_map import PriorMap
from semgraph.offline.reassociation import with_places
from semgraph.offline.refinement import Refined, refine, refined
from semgraph.progress import Silence
from semgraph.results import RunResult
from sensors.truth import Source
from sensors.views import View

_COURSE: Final = "course:paper"
_SETTINGS: Final = SmootherSettings()
_PRIOR_SIGMA_M: Final = 0.5
_WRONG_SHARE: Final = 0.1
# A tree that is not there stands apart from those that are.
_FALSE_FROM_TREES_M: Final = 2.0
# Seen in so many looks 0.3 m apart, a tree or its absence was visible.
_VISIBLE_LOOKS: Final = 5
_REACH_M: Final = 15.0
_DIAMETER_SIGMA: Final = 0.1
_TIMES: Final = 5
_SAME_M: Final = 0.6


@dataclass(frozen=True, slots=True)
class Solved:
    """The final graph of a refined run, solved from where the run ended.

    Attributes:
        excess: cost above the optimum's, relative.
        time_ratio: CPU time by that of GTSAM's Levenberg-Marquardt on the same graph.
        path_ratio, map_ratio: RMSE of the refinement by the run's, rigidly aligned.
        is_settled: whether associations stayed in the end.
    """

    excess: float
    time_ratio: float
    path_ratio: float
    map_ratio: float
    is_settled: bool


@dataclass(frozen=True, slots=True)
class Updated:
    """A run beside a prior map that is wrong in part.

    Attributes:
        map_ratio: RMSE of the landmarks in the prior's frame, by the oracle's of the same.
        num_false, named_false: trees of the prior map that are not there and were visible, and how
            many of them are gone.
        num_missing, named_missing: trees missing in it that were visible, and how many were added.
        num_lost: trees that are there and were taken for gone.
        num_extra: added where there is no tree, beyond what the run already had there (bushes).
    """

    map_ratio: float
    num_false: int
    named_false: int
    num_missing: int
    named_missing: int
    num_lost: int
    num_extra: int


def refined_runs(seeds: Sequence[int]) -> list[Row]:
    """Cost and time beside GTSAM's, what refining gains, and what is made of a prior map."""
    trials = each_seed(trial, seeds)
    return [*solved_rows([one for one, _ in trials]), *updated_rows([two for _, two in trials])]


def trial(seed: int) -> tuple[Solved, Updated]:
    """The figures of one course."""
    source, result = run_course(_COURSE, seed=seed)
    batch = Batch.of(known(result.log))
    begin = Belief(known(result.log).trajectory.map_T_bases, known(result.log).landmarks, {})
    belief, rounds = refine(batch, begin, _SETTINGS, Silence().note)
    best = refined(batch, belief, _SETTINGS, rounds)
    return solved(source, result, best), updated(source, result, best, seed)


def solved_rows(trials: Sequence[Solved]) -> list[Row]:
    """The worst cost; medians of the rest."""
    ratio, path, of_map = (
        float(np.median([getattr(each, name) for each in trials]))
        for name in ("time_ratio", "path_ratio", "map_ratio")
    )
    excess = max(each.excess for each in trials)
    settled = float(np.mean([each.is_settled for each in trials]))
    return [
        Row("cost above the batch optimum, the worst run", 100.0 * excess, "%", Better.LOWER, 0.01),
        Row("CPU time / GTSAM's LM on the same graph, median", ratio, "", Better.LOWER, 1.3),
        Row("path, RMSE refined / run, median", path, "", Better.LOWER, 1.0),
        Row("map, RMSE refined / run, median", of_map, "", Better.LOWER, 1.0),
        Row("runs in which associations settled", settled, "", Better.HIGHER, 1.0),
    ]


def updated_rows(trials: Sequence[Updated]) -> list[Row]:
    """The median ratio; shares of all trees of all runs together."""
    sums = {
        name: sum(getattr(each, name) for each in trials)
        for name in (
            *("num_false", "named_false", "num_missing", "named_missing"),
            *("num_lost", "num_extra"),
        )
    }
    ratio = float(np.median([each.map_ratio for each in trials]))
    false = sums["named_false"] / max(sums["num_false"], 1)
    missing = sums["named_missing"] / max(sums["num_missing"], 1)
    return [
        Row("map, RMSE / oracle's with the prior, median", ratio, "", Better.LOWER, 1.1),
        Row("false trees that were visible, named", false, "", Better.HIGHER, 0.95),
        Row("missing trees that were visible, named", missing, "", Better.HIGHER, 0.95),
        Row("standing trees taken for gone, all runs", sums["num_lost"], "", Better.LOWER, 0.0),
        Row(
            "trees added where none is, beyond the run's, all runs",
            sums["num_extra"],
            "",
            Better.LOWER,
            0.0,
        ),
    ]


def solved(source: Source, result: RunResult, best: Refined) -> Solved:
    """The figures of one refined run."""
    begin = Belief(result.smoothed.map_T_bases, best.belief.landmarks, {})
    begin = with_places(best.batch, begin, best.belief.landmarks)
    graphs = [BatchGraph(best.batch, begin) for _ in range(_TIMES)]
    optimum = graphs[0].cost_by_gtsam(1e-13)
    theirs = _cpu_seconds(lambda _: graphs[0].cost_by_gtsam())
    ours = _cpu_seconds(lambda k: graphs[k].optimum())
    path = known(source.truth.path)
    smoothed = Trajectory(best.batch.stamps_ns, best.belief.map_T_bases)
    run, after = (known(compare_path(each, path)) for each in (result.smoothed, smoothed))
    run_map, best_map = (
        known(compare_map(landmarks, source.truth, compared.world_T_map))
        for landmarks, compared in ((result.landmarks, run), (best.landmarks, after))
    )
    return Solved(
        graphs[0].cost / optimum - 1.0,
        ours / theirs,
        rmse(after.distances) / rmse(run.distances),
        _rms(best_map.errors) / _rms(run_map.errors),
        best.is_settled,
    )


def updated(source: Source, result: RunResult, best: Refined, seed: int) -> Updated:
    """The figures of one refined run beside a prior map made of its truth."""
    rng = np.random.default_rng(seed)
    landmarks = known(source.truth.landmarks)
    trees, wide_m = landmarks.world_t_landmarks, landmarks.diameters_m
    true = true_belief(source, best.batch, ())
    num_wrong = round(_WRONG_SHARE * len(trees))
    is_missing = np.zeros(len(trees), dtype=np.bool_)
    is_missing[rng.choice(len(trees), num_wrong, replace=False)] = True
    false = _false_trees(trees, num_wrong, rng)
    places = np.vstack([trees[~is_missing], false])
    thick_m = rng.choice(wide_m, len(false))
    prior = _prior_map(places, np.concatenate([wide_m[~is_missing], thick_m]), rng)
    start = Pose2.from_array(true.map_T_bases[0]) @ result.smoothed.pose(0).inverse()
    new = update_map(best, prior, _SETTINGS, Silence().note, start)
    told = changes(new.batch, new.belief, new.landmarks, new.tentative, prior)
    num_true = len(trees) - num_wrong
    gone = np.array([change.fate is Fate.GONE for change in told[: len(prior)]])
    views = known(result.log).views
    # What is not there is where the map says that it is.
    stated = prior.map_t_landmarks[num_true:]
    false_shown = _is_visible(views, true.map_T_bases, stated, thick_m)
    missing_shown = is_missing & _is_visible(views, true.map_T_bases, trees, wide_m)
    added = [change.map_t_landmark for change in told if change.fate is Fate.ADDED]
    pairs = _pairs(source, np.array(added).reshape(-1, 2))
    return Updated(
        _map_ratio(source, new, true, prior, np.flatnonzero(~is_missing)),
        int(false_shown.sum()),
        int(gone[num_true:][false_shown].sum()),
        int(missing_shown.sum()),
        int(missing_shown[pairs[:, 1]].sum()),
        int(gone[:num_true].sum()),
        max(len(added) - len(pairs) - _num_false(source, best, true), 0),
    )


def _map_ratio(
    source: Source, new: Refined, true: Belief, prior: PriorMap, rows: IntArray
) -> float:
    """RMSE in the frame of the prior map, of the landmarks that both have.

    Args:
        source: with its truth.
        new: refined beside the prior map.
        true: poses and associations of the oracle.
        prior: its first landmarks are those of `rows`.
        rows: of the true landmarks.
    """
    priors = tuple(
        Prior(row, prior.map_t_landmarks[k], prior.covariances[k])
        for k, row in enumerate(rows.tolist())
        if row in true.map_t_landmarks
    )
    start = UncertainPose2(new.batch.starts[0].pose, START_COVARIANCE)
    batch = replace(new.batch, starts=(start,))
    oracle = BatchGraph(batch, replace(true, priors=priors)).optimum().map_t_landmarks
    pairs = _pairs(source, np.array([each.map_t_landmark for each in new.landmarks]))
    trees = known(source.truth.landmarks).world_t_landmarks
    both = [(column, row) for column, row in pairs.tolist() if row in oracle]
    own = np.array([new.landmarks[column].map_t_landmark - trees[row] for column, row in both])
    best = np.array([oracle[row] - trees[row] for _, row in both])
    return _rms(own) / _rms(best)


def _num_false(source: Source, best: Refined, true: Belief) -> int:
    """Landmarks of a map before the prior that are no trees."""
    world_T_map = (
        Pose2.from_array(true.map_T_bases[0])
        @ Pose2.from_array(best.belief.map_T_bases[0]).inverse()
    )
    places = np.array([each.map_t_landmark for each in best.landmarks])
    return len(places) - len(_pairs(source, world_T_map.transform(places)))


def _pairs(source: Source, places: FloatArray) -> IntArray:
    """(k, 2) rows of places and of true landmarks that are one."""
    true = known(source.truth.landmarks)
    return match(places, np.full(len(places), Kind.TREE), true, _SAME_M)


def _false_trees(trees: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
    """(count, 2) places among the trees, apart from them."""
    low, high = trees.min(axis=0), trees.max(axis=0)
    places = rng.uniform(low, high, (100 * count, 2))
    apart_m: FloatArray = np.linalg.norm(places[:, None] - trees[None], axis=2).min(axis=1)
    apart: FloatArray = places[apart_m > _FALSE_FROM_TREES_M]
    return apart[:count]


def _prior_map(places: FloatArray, diameters_m: FloatArray, rng: np.random.Generator) -> PriorMap:
    """As somebody may have measured it: positions roughly, diameters to a tenth."""
    k = len(places)
    measured_m = diameters_m * np.exp(rng.normal(0.0, _DIAMETER_SIGMA, k))
    return PriorMap(
        tuple(str(number) for number in range(k)),
        np.full(k, Kind.TREE),
        places + rng.normal(0.0, _PRIOR_SIGMA_M, places.shape),
        np.broadcast_to(_PRIOR_SIGMA_M**2 * np.eye(2), (k, 2, 2)),
        measured_m,
        _DIAMETER_SIGMA * measured_m,
        ("",) * k,
    )


def _is_visible(
    views: Sequence[tuple[int, View]],
    world_T_bases: FloatArray,
    places: FloatArray,
    diameters_m: FloatArray,
) -> BoolArray:
    """(n,) whether a tree at each place would have shown in five looks or more."""
    looks = np.zeros(len(places), dtype=np.int64)
    for scan, view in views:
        pose = Pose2.from_array(world_T_bases[scan])
        apart = places - (pose.x, pose.y)
        near = np.hypot(apart[:, 0], apart[:, 1]) <= _REACH_M
        looks[near] += view.sees(pose, places[near], diameters_m[near])
    return looks >= _VISIBLE_LOOKS


def _rms(errors: FloatArray) -> float:
    return rmse(np.linalg.norm(errors, axis=1))


def _cpu_seconds(call: Callable[[int], object]) -> float:
    """The least of several calls."""
    seconds = []
    for k in range(_TIMES):
        started = time.process_time()
        call(k)
        seconds.append(time.process_time() - started)
    return min(seconds)


SECTIONS: Final = (Section("paper, from scans", (refined_runs,), 1.0),)
