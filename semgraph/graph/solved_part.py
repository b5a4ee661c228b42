"""What of the log is in iSAM2, and where: all that does not rest, with what is condensed of it."""

import itertools
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple, final

import numpy as np

from semgraph.arrays import IntArray
from semgraph.graph.factors import (
    Hold,
    Sighting,
    condensed_factor,
    hold_factors,
    motion_factor,
    polar_factor,
    sighting_factor,
)
from semgraph.graph.graph_log import GraphLog
from semgraph.graph.graph_states import AllSlots
from semgraph.graph.incremental import Incremental
from semgraph.graph.last_read import LastRead
from semgraph.graph.resting import Resting
from semgraph.graph.windows import NONE, Windows

# What is held by what rests and has moved so far tears it.
_TORN_M: Final = 0.1


class InIsam(NamedTuple):
    """An iSAM2, and where everything is in there."""

    isam: Incremental
    slots: AllSlots


@final
class SolvedPart:
    """The part of a graph that is solved step by step.

    Args:
        log: all that was added.
        windows: what of it is condensed.
        resting: what of that is not solved at the moment.
        last_read: where all is.

    Attributes:
        now: the iSAM2.
        holds: what holds it in the map.
    """

    def __init__(
        self, log: GraphLog, windows: Windows, resting: Resting, last_read: LastRead
    ) -> None:
        self._log, self._windows = log, windows
        self._resting, self._last_read = resting, last_read
        self.now = InIsam(Incremental(), AllSlots())
        # Rows of sightings that hold without their kernel in the next update.
        self._firm: list[int] = []
        self.hold([Hold(0, log.start)])
        self._add_holds()
        self.now.isam.insert_pose(0, log.start.pose)

    def begin_anew(self, factorization: str | None = None) -> None:
        """All that does not rest waits for an update of a new iSAM2."""
        self.now = InIsam(Incremental(factorization or self.now.isam.factorization), AllSlots())
        self._add_all()

    def add_motions(self, poses: Sequence[int]) -> None:
        """With the next update the motions to these poses are in the graph."""
        motions = self._log.motions[poses]
        covariances = self._log.motion_covariances(poses)
        for pose, motion, covariance in zip(poses, motions, covariances, strict=True):
            factor = motion_factor(pose - 1, pose, motion, covariance)
            self.now.isam.add(factor, self.now.slots.motions, pose)

    def add_sighting(self, row: int, sighting: Sighting) -> None:
        """With the next update this row of the log is."""
        factor = sighting_factor(sighting, is_firm=row in self._firm)
        self.now.isam.add(factor, self.now.slots.sightings, row)

    def _add_logged(self, rows: Sequence[int]) -> None:
        """With the next update these rows are, as the log has them."""
        log, firm = self._log, set(self._firm)
        sightings = zip(
            rows,
            log.poses[rows].tolist(),
            log.landmarks[rows].tolist(),
            log.polar(rows).tolist(),
            log.covariances(rows),
            strict=True,
        )
        for row, pose, landmark, polar, covariance in sightings:
            factor = polar_factor(pose, landmark, polar, covariance, is_firm=row in firm)
            self.now.isam.add(factor, self.now.slots.sightings, row)

    def live(self, rows: IntArray) -> list[int]:
        """The sightings that are factors of their own."""
        poses = self._log.poses[rows]
        is_live = (self._windows.of_motions(poses) == NONE) & (poses > self._resting.since)
        live: list[int] = rows[is_live].tolist()
        return live

    def is_in(self, rows: IntArray) -> bool:
        """Whether all of these sightings are, as of the last update."""
        return all(self.now.slots.sightings[row] != NONE for row in rows.tolist())

    def waiting(self) -> list[int]:
        """Rows of the sightings that wait for an update."""
        return self.now.isam.waiting(self.now.slots.sightings)

    def take_out(self, rows: Iterable[int]) -> None:
        """With the next update these sightings are not in the graph."""
        for row in rows:
            self.now.isam.remove(self.now.slots.sightings, row)

    def take_out_motions(self, poses: Iterable[int]) -> None:
        """With the next update the motions to these poses are not."""
        for pose in poses:
            self.now.isam.remove(self.now.slots.motions, pose)

    def renew(self, rows: Iterable[int]) -> None:
        """With the next update these sightings are in there as the log has them now."""
        rows = list(rows)
        self.take_out(rows)
        self._add_logged(rows)

    def add_windows(self) -> None:
        """Those that are new or changed."""
        isam, slots = self.now
        for number in sorted(self._windows.changed.intersection(self._resting.numbers())):
            if slots.windows[number] != NONE:
                isam.remove(slots.windows, number)
            window = self._windows[number]
            factor = condensed_factor(window.condensed, window.first, window.last, window.landmarks)
            isam.add(factor, slots.windows, number)
        self._windows.changed.clear()

    def make_firm(self, rows: list[int]) -> None:
        """In the next update these sightings hold without their kernel."""
        self._firm += rows

    def let_go(self) -> list[int]:
        """What held firmly does so no more; its rows, to be made anew."""
        firm, self._firm = self._firm, []
        return firm

    def hold(self, holds: list[Hold]) -> None:
        """The next iSAM2 is to be held by these."""
        poses = [pose for hold in holds for pose in (hold.anchor, *hold.anchor_T_poses)]
        self.holds, self._held_at = holds, self._last_read.poses(poses)[:, :2]

    def is_torn(self) -> bool:
        """Whether something has moved off from where it is held."""
        poses = [pose for hold in self.holds for pose in (hold.anchor, *hold.anchor_T_poses)]
        now = np.array([self.now.isam.pose(pose).as_array() for pose in poses])
        off = now[:, :2] - self._held_at
        return bool(np.hypot(*off.T).max() > _TORN_M)

    def _add_all(self) -> None:
        """All that does not rest, with the last good value of each."""
        self._add_holds()
        live = range(max(self._resting.since, 0), self._log.num_poses)
        self.add_motions([pose for pose in live[1:] if self._windows.of_motion(pose) == NONE])
        self._add_logged(self.live(self._rows()))
        self._windows.changed.update(self._resting.numbers())
        self.add_windows()
        ends = () if self._resting.awake is None else self._resting.ends()
        for pose in sorted({*live, *ends}):
            if self._windows.of_pose(pose) == NONE:
                self.now.isam.insert_pose(pose, self._last_read.pose(pose))
        for landmark in self._landmarks():
            self.now.isam.insert_landmark(landmark, self._last_read.landmark(landmark))

    def _landmarks(self) -> Iterable[int]:
        """All that do not rest and were not only glimpsed."""
        is_whole = self._resting.awake is None
        names = self._last_read.landmarks() if is_whole else self._resting.landmarks()
        return (name for name in names if name not in self._windows.glimpsed)

    def _rows(self) -> IntArray:
        """Sightings among which those are that are factors of their own."""
        if self._resting.awake is not None:
            return self._resting.rows()
        rows = [self._log.rows(landmark) for landmark in self._log.names()]
        return np.concatenate([np.empty(0, dtype=np.int64), *rows])

    def _add_holds(self) -> None:
        for number, factor in enumerate(itertools.chain(*map(hold_factors, self.holds))):
            self.now.isam.add(factor, self.now.slots.holds, number)
