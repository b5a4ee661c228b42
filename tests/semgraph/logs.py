"""Small logs of drives past four landmarks."""

import numpy as np

from semgraph.estimates import Trajectory
from semgraph.files.run_log import RunLog
from semgraph.geometry import Pose2
from semgraph.landmarks import Kind, Perceptions
from sensors.views import View
from tests.semgraph.drives import LANDMARKS, NOISE, drive


def log(seed: int = 0, num_scans: int = 8, sighted_from: tuple[int, ...] | None = None) -> RunLog:
    """Every landmark is sighted from each scan, or from those in `sighted_from`."""
    made = drive(seed, num_scans)
    seen = [each for each in made.seen if sighted_from is None or each[0] - 1 in sighted_from]
    m = len(seen)
    poses, pose = [], Pose2()
    for motion in made.motions:
        pose = pose @ motion.pose
        poses.append(pose.as_array())
    return RunLog(
        Trajectory(np.arange(num_scans) * 100_000_000, np.array(poses)),
        made.start,
        np.array([motion.pose.as_array() for motion in made.motions]),
        np.array([motion.covariance for motion in made.motions]),
        Perceptions.from_arrays(
            0,
            Kind.TREE,
            np.array([range_m for _, _, range_m, _ in seen]),
            np.array([bearing for *_, bearing in seen]),
            np.broadcast_to(NOISE, (m, 2, 2)),
            diameters_m=np.full(m, 0.3),
            diameter_sigmas_m=np.full(m, 0.05),
            identities=np.array(["", "Eiche"])[np.arange(m) % 2],
        ),
        np.array([scan - 1 for scan, *_ in seen], dtype=np.int64),
        np.array([landmark for _, landmark, *_ in seen], dtype=np.int64),
        ((0, View(Pose2(0.1, 0.0, 0.2), -1.0, 0.5, np.array([3.0, 4.0, 0.0, 2.5]))),),
    )


def places() -> dict[int, np.ndarray]:
    """About where the landmarks are."""
    return {k: place + 0.2 for k, place in enumerate(LANDMARKS)}
