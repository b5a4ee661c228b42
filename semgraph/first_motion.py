"""How base moves at the start of a run: what its first scans are deskewed by."""

from dataclasses import replace
from itertools import islice

from semgraph.fast_estimator import FastEstimator, FastSettings
from semgraph.files.yaw_rates import YawRateLog
from semgraph.moments import moments
from semgraph.ordering import InOrder
from semgraph.perceiving import Perceiver
from sensors.measurements import Recording


def tell_first_motion(recording: Recording, perceiver: Perceiver, settings: FastSettings) -> None:
    """Tells the perceiver how base moves between the first two moments, if its filters ask for it.

    A scan is deskewed by the motion before it. Before the first two there is none, and left as they
    are they turn all that follows by a milliradian against the start. Both are skewed alike, so
    what they show tells the motion between them.

    Args:
        recording: whose first measurements are perceived for this alone.
        perceiver: of the run that is about to begin.
        settings: of the estimator that finds the motion.

    Raises:
        InputError: measurements without a detector.
    """
    if not perceiver.deskews:
        return
    ordered = replace(recording, measurements=InOrder(recording.measurements))
    beginning = islice(moments(ordered, perceiver, YawRateLog()), 2)
    estimator = FastEstimator(settings, recording.map_T_start)
    steps = [estimator.step(each.perceptions, each.odometry) for each in beginning]
    if len(steps) == 2:
        first, second = steps
        moved = first.map_T_base.pose.between(second.map_T_base.pose)
        perceiver.moved(moved, 1e-9 * (second.stamp_ns - first.stamp_ns))
