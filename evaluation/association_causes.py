"""Where associations go wrong: in the tracker, or where tracks become one landmark."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from semgraph.arrays import IntArray
from semgraph.errors import InputError
from semgraph.estimates import Trajectory
from semgraph.files.yaw_rates import YawRateLog
from semgraph.graph.smoother import Smoother
from semgraph.moments import moments
from semgraph.perceiving import Perceiver
from semgraph.settings import Settings
from semgraph.tracking import tracker_of
from sensors.truth import Source

_NONE: Final = -1


@dataclass(frozen=True, slots=True, eq=False)
class Associations:
    """What a run took its perceptions for, beside the truth.

    Attributes:
        num_perceptions: of known true landmarks.
        num_left_out: of those, taken for nothing.
        num_tracks, num_landmarks: that they were taken for; tentative ones as well.
        wrong_in_tracks: perceptions in a track which mostly shows something else.
        wrong_in_landmarks: the same of landmarks; what exceeds the tracks' is the graph's doing.
        trajectory: smoothed.
    """

    num_perceptions: int
    num_left_out: int
    num_tracks: int
    num_landmarks: int
    wrong_in_tracks: int
    wrong_in_landmarks: int
    trajectory: Trajectory


def associations(
    source: Source, settings: Settings, longest_gap_s: float | None = None
) -> Associations:
    """Counts of a run by its tracker; or by true tracks, which shows what the graph alone does.

    Args:
        source: of perceptions whose landmarks are known.
        settings: of the run.
        longest_gap_s: a true track that is out of sight for longer ends; None for the tracker's.

    Raises:
        InputError: the truth does not tell what each perception is of.
    """
    recording, truth = source.recording, _truly(source)
    tracker = tracker_of(recording, settings.tracker)
    smoother = Smoother(settings.smoother, recording.map_T_start)
    true_tracks = _TrueTracks(np.inf if longest_gap_s is None else longest_gap_s)
    tracks: dict[int, IntArray] = {}
    for moment in moments(recording, Perceiver(recording, settings), YawRateLog()):
        step = tracker.step(moment.perceptions, moment.odometry)
        if longest_gap_s is not None:
            ids = true_tracks.continued(step.stamp_ns, truth[step.stamp_ns])
            step = replace(step, landmark_ids=ids)
        tracks[step.stamp_ns] = step.landmark_ids
        smoother.add(step, moment.perceptions, moment.views)
    if not tracks:
        raise InputError(f"{recording.name}: expected perceptions, there are none")
    smoother.finish(lambda _: None)
    rows = np.concatenate([truth[stamp_ns] for stamp_ns in tracks])
    of_track = np.concatenate(list(tracks.values()))
    of_landmark = np.concatenate([smoother.associations()[stamp_ns] for stamp_ns in tracks])
    return Associations(
        num_perceptions=int((rows >= 0).sum()),
        num_left_out=int(((rows >= 0) & (of_landmark < 0)).sum()),
        num_tracks=len(np.unique(of_track[of_track >= 0])),
        num_landmarks=len(np.unique(of_landmark[of_landmark >= 0])),
        wrong_in_tracks=num_wrong(of_track, rows),
        wrong_in_landmarks=num_wrong(of_landmark, rows),
        trajectory=smoother.trajectory(),
    )


def num_wrong(taken_for: IntArray, rows: IntArray) -> int:
    """How many perceptions are not of what most of their group are of.

    Args:
        taken_for: (n,) the group of each perception, -1 for none.
        rows: (n,) the true landmark of each, -1 for unknown.
    """
    counted = (taken_for >= 0) & (rows >= 0)
    if not counted.any():
        return 0
    pairs, counts = np.unique(
        np.column_stack([taken_for[counted], rows[counted]]), axis=0, return_counts=True
    )
    _, group = np.unique(pairs[:, 0], return_inverse=True)
    most = np.zeros(int(group.max()) + 1, dtype=np.int64)
    np.maximum.at(most, group, counts)
    return int(counts.sum() - most.sum())


@dataclass(slots=True)
class _TrueTracks:
    """Numbers true landmarks anew whenever they were out of sight for long."""

    longest_gap_s: float
    _numbers: dict[int, int] = field(default_factory=dict)
    _seen_ns: dict[int, int] = field(default_factory=dict)
    _num_tracks: int = 0

    def continued(self, stamp_ns: int, rows: IntArray) -> IntArray:
        """(n,) the track of each true landmark (n,) sighted now; -1 stays -1."""
        return np.array([self._track(stamp_ns, row) for row in rows.tolist()], dtype=np.int64)

    def _track(self, stamp_ns: int, row: int) -> int:
        if row < 0:
            return _NONE
        gap_ns = stamp_ns - self._seen_ns.get(row, stamp_ns)
        if row not in self._numbers or gap_ns > 1e9 * self.longest_gap_s:
            self._numbers[row] = self._num_tracks
            self._num_tracks += 1
        self._seen_ns[row] = stamp_ns
        return self._numbers[row]


def _truly(source: Source) -> Mapping[int, IntArray]:
    """By stamp, the true landmark of each perception."""
    known = source.truth.associations
    # Of raw measurements the truth tells what is in sight, not what was perceived.
    if known is None or source.recording.detectors:
        raise InputError(
            f"{source.recording.name}: expected the true landmark of each perception; "
            "take a recording of perceptions with truth"
        )
    return known
