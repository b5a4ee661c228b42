"""The loop that online estimators share: moment by moment, each one timed."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from evaluation.estimators.estimate import Estimate
from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import InputError
from semgraph.estimates import Trajectory
from semgraph.files.yaw_rates import YawRateLog
from semgraph.first_motion import tell_first_motion
from semgraph.geometry import UncertainPose2
from semgraph.landmarks import Landmark, Perceptions
from semgraph.moments import Moment, moments
from semgraph.ordering import InOrder
from semgraph.perceiving import Perceiver
from semgraph.settings import Settings
from sensors.measurements import Recording
from sensors.truth import Source

# A landmark that was not sighted for more scans than these closes a loop, as for the smoother.
LOOP_SCANS: Final = 100


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """What an estimator says after a moment.

    Attributes:
        map_T_base: the pose.
        landmark_ids: (n,) the landmark of each perception, -1 for none.
    """

    map_T_base: UncertainPose2
    landmark_ids: IntArray


@dataclass(slots=True)
class Drive:
    """All that an online estimator said."""

    stamps_ns: list[int] = field(default_factory=list)
    steps: list[Step] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    perceptions: list[Perceptions] = field(default_factory=list)

    def estimate(
        self,
        landmarks: tuple[Landmark, ...] = (),
        *,
        has_covariances: bool = True,
        nis: FloatArray | None = None,
    ) -> Estimate:
        """As it was said at the time.

        Args:
            landmarks: its map in the end.
            has_covariances: whether those of the poses are relative to the start, not merely to
                the landmarks around.
            nis: normalised squares of the innovations, where it has them.
        """
        stamps_ns = np.array(self.stamps_ns, dtype=np.int64)
        poses = np.array([step.map_T_base.pose.as_array() for step in self.steps])
        covariances = np.array([step.map_T_base.covariance for step in self.steps])
        trajectory = Trajectory(stamps_ns, poses)
        return Estimate(
            trajectory,
            covariances if has_covariances else np.empty((0, 3, 3)),
            landmarks,
            {
                stamp_ns: step.landmark_ids
                for stamp_ns, step in zip(self.stamps_ns, self.steps, strict=True)
            },
            np.array(self.seconds),
            self._closed_at_ns(),
            np.zeros(0) if nis is None else nis,
            trajectory,
            tuple(self.perceptions),
        )

    def _closed_at_ns(self) -> tuple[int, ...]:
        """When something was taken for a landmark that had not been seen for long."""
        last_scans: dict[int, int] = {}
        closed = []
        for scan, step in enumerate(self.steps):
            seen = set(step.landmark_ids[step.landmark_ids >= 0].tolist())
            if any(scan - last_scans.get(landmark, scan) > LOOP_SCANS for landmark in seen):
                closed.append(self.stamps_ns[scan])
            last_scans.update(dict.fromkeys(seen, scan))
        return tuple(closed)


def drive(source: Source, settings: Settings, step: Callable[[Moment], Step]) -> Drive:
    """What an estimator says of each moment of a source; only its own time is measured.

    Raises:
        InputError: a measurement without a detector, or no scans at all.
    """
    recording = in_order(source.recording)
    perceiver, said = Perceiver(recording, settings), Drive()
    tell_first_motion(recording, perceiver, settings.fast)
    for moment in moments(recording, perceiver, YawRateLog()):
        before = time.perf_counter()
        now = step(moment)
        said.seconds.append(time.perf_counter() - before)
        stamp_ns = moment.perceptions.stamp_ns
        if said.steps:
            moved = said.steps[-1].map_T_base.pose.between(now.map_T_base.pose)
            perceiver.moved(moved, 1e-9 * (stamp_ns - said.stamps_ns[-1]))
        said.stamps_ns.append(stamp_ns)
        said.steps.append(now)
        if recording.detectors:
            said.perceptions.append(moment.perceptions)
    if not said.steps:
        raise InputError(f"{recording.name}: expected scans or perceptions, there are none")
    return said


def in_order(recording: Recording) -> Recording:
    """The same without measurements whose times do not run forwards, as for every run."""
    return replace(recording, measurements=InOrder(recording.measurements))


def start_of(recording: Recording, settings: Settings) -> UncertainPose2:
    """Where the run starts, as surely as the graph is told."""
    return settings.smoother.start(recording.map_T_start)
