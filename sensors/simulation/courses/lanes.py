"""A wood driven lane by lane, as a lawn is mown; perceptions are made when they are asked for.

However long it is, it holds little: what grows in memory is the estimator's.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from pydantic import Field

from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import InputError
from semgraph.geometry import Pose2, wrap_angle
from semgraph.landmarks import Perceptions
from sensors.measurements import OdometryNoise, Recording
from sensors.recorded import Recorded
from sensors.simulation.courses.perceived_trees import PerceivedOptions, Stand, perceive
from sensors.simulation.courses.planting import apart, trunk_diameters_m
from sensors.simulation.wheels import simulate_wheels
from sensors.truth import Source, TruePath, Truth

if TYPE_CHECKING:
    from scipy.spatial import KDTree

_KEPT_FREE_M: Final = 1.5
_MAX_ROUNDS: Final = 200


class LanesOptions(PerceivedOptions):
    """Lanes of a square wood, there and back, `length_m` in all, with `trees_per_m` driven."""

    length_m: float = Field(2000.0, ge=100.0, le=100_000.0)
    trees_per_m: float = Field(1.0, gt=0.0, le=3.0)
    lane_m: float = Field(15.0, ge=6.0, le=100.0)
    speed: float = Field(2.0, ge=0.1, le=20.0)
    max_range_m: float = Field(10.0, gt=0.5, le=200.0)
    odometry: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """What is perceived at the k-th stamp, the same for the same k."""

    stamps_ns: IntArray
    poses: FloatArray
    stand: Stand
    tree: "KDTree"
    options: LanesOptions

    def __call__(self, k: int) -> Perceptions:
        """Of the trees in reach alone."""
        near = self.tree.query_ball_point(self.poses[k, :2], self.options.max_range_m)
        stand = self.stand.select(np.array(sorted(near), dtype=np.int64))
        rng = np.random.default_rng([self.options.seed, k])
        pose = Pose2.from_array(self.poses[k])
        return perceive(int(self.stamps_ns[k]), pose, stand, self.options, rng)[0]


def read(name: str, options: LanesOptions) -> Source:
    """The course of these options with its truth; which perception is which tree is not kept.

    Raises:
        InputError: the trees do not fit, or an option of `course:perceptions` that it lacks.
    """
    from scipy.spatial import KDTree

    if options.num_blind or options.moving:
        raise InputError(f"{name}: expected neither num_blind nor moving, it has none of them")
    rng = np.random.default_rng(options.seed)
    side_m = float(np.sqrt(options.length_m * options.lane_m))
    step_m = options.speed / options.scan_rate_hz
    along_m = step_m * np.arange(int(options.length_m / step_m) + 1)
    stamps_ns = np.round(along_m / options.speed * 1e9).astype(np.int64)
    poses = _poses(along_m, side_m, options.lane_m)
    stand = _plant(options, side_m, rng)
    noise = OdometryNoise() if options.odometry else None
    samples = simulate_wheels(stamps_ns, poses, noise, rng) if noise is not None else []
    seen = _Seen(stamps_ns, poses, stand, KDTree(stand.world_t_trees), options)
    recording = Recording(
        name=name,
        measurements=Recorded(samples, stamps_ns, seen),
        num_scans=len(stamps_ns),
        odometry_noise=noise,
        map_T_start=Pose2.from_array(poses[0]),
    )
    path = TruePath(stamps_ns, poses[:, :2], poses[:, 2])
    return Source(recording, Truth(path, stand.true_landmarks()))


def _poses(along_m: FloatArray, side_m: float, lane_m: float) -> FloatArray:
    """(n, 3) at distances (n,): up one lane, a half circle to the right, down the next."""
    radius_m = 0.5 * lane_m
    lanes, rest_m = np.divmod(along_m, side_m + np.pi * radius_m)
    turned = np.maximum(rest_m - side_m, 0.0) / radius_m
    y = np.minimum(rest_m, side_m) + radius_m * np.sin(turned)
    x = lanes * lane_m + radius_m * (1.0 - np.cos(turned))
    is_back = lanes % 2 == 1
    heading = np.where(is_back, turned - 0.5 * np.pi, 0.5 * np.pi - turned)
    return np.column_stack([x, np.where(is_back, side_m - y, y), wrap_angle(heading)])


def _plant(options: LanesOptions, side_m: float, rng: np.random.Generator) -> Stand:
    """Trees evenly over the wood and a lane around it, the lanes kept free."""
    count = round(options.trees_per_m * options.length_m)
    trees: FloatArray = np.zeros((0, 2))
    for _ in range(_MAX_ROUNDS):
        missing = count - len(trees)
        if missing == 0:
            return Stand(trees, trunk_diameters_m(count, rng))
        scattered = rng.uniform(-0.5 * options.lane_m, side_m + 0.5 * options.lane_m, (missing, 2))
        off_lane = np.abs(
            (scattered[:, 0] + 0.5 * options.lane_m) % options.lane_m - 0.5 * options.lane_m
        )
        trees = apart(np.vstack([trees, scattered[off_lane > _KEPT_FREE_M]]))
    raise InputError(f"course: {count} trees do not fit; take fewer (trees_per_m)")
