"""A round course with a run over it, whose errors are drawn from the covariances it claims."""

from dataclasses import replace

import numpy as np

from semgraph.arrays import FloatArray
from semgraph.estimates import Trajectory
from semgraph.files.yaw_rates import YawRates
from semgraph.geometry import Pose2
from semgraph.landmarks import Kind, Landmark, semantic_object
from semgraph.results import RunResult
from sensors.simulation.imu import SimulatedImu, simulate_imu
from sensors.truth import TrueLandmarks, TruePath, Truth

START = Pose2(3.0, -2.0, 0.7)


def true_path(num_poses: int = 200, radius_m: float = 8.0, world_T_map: Pose2 = START) -> TruePath:
    turn = np.linspace(0.0, 1.9 * np.pi, num_poses)
    map_t_bases = radius_m * np.column_stack([np.sin(turn), 1.0 - np.cos(turn)])
    headings = (turn + world_T_map.theta + np.pi) % (2.0 * np.pi) - np.pi
    stamps_ns = 1_700_000_000_000_000_000 + np.arange(num_poses) * 200_000_000
    return TruePath(stamps_ns, world_T_map.transform(map_t_bases), headings)


def true_landmarks(
    rng: np.random.Generator, num_landmarks: int = 30, radius_m: float = 8.0
) -> TrueLandmarks:
    turn = rng.permutation(np.linspace(0.0, 2.0 * np.pi, num_landmarks, endpoint=False))
    out_m = radius_m * rng.choice([0.5, 1.4], num_landmarks)
    map_t_landmarks = np.column_stack([out_m * np.sin(turn), radius_m - out_m * np.cos(turn)])
    return TrueLandmarks(
        START.transform(map_t_landmarks),
        rng.integers(0, 3, num_landmarks),
        rng.uniform(0.1, 0.6, num_landmarks),
    )


def drawn_trajectory(
    rng: np.random.Generator, path: TruePath, covariances: FloatArray, world_T_map: Pose2 = START
) -> Trajectory:
    """The true poses, each moved in its own frame by an error drawn from its covariance."""
    assert path.headings is not None
    map_T_world = world_T_map.inverse()
    poses = []
    for (x, y), theta, covariance in zip(
        path.world_t_reference, path.headings, covariances, strict=True
    ):
        error = Pose2.from_array(rng.multivariate_normal(np.zeros(3), covariance))
        poses.append((map_T_world @ Pose2(float(x), float(y), float(theta)) @ error).as_array())
    return Trajectory(path.stamps_ns, np.array(poses))


def growing_covariances(num_poses: int, sigma_m: float) -> FloatArray:
    """(n, 3, 3) longer along the track than across, nearly nothing at the start."""
    growth = np.linspace(1e-9, 1.0, num_poses)
    body = np.array([[4.0, 0.5, 0.2], [0.5, 1.0, 0.1], [0.2, 0.1, 0.05]]) * sigma_m**2
    return growth[:, None, None] * body


def drawn_landmarks(
    rng: np.random.Generator, true: TrueLandmarks, sigma_m: float
) -> tuple[Landmark, ...]:
    covariance = sigma_m**2 * np.array([[2.0, 0.6], [0.6, 0.5]])
    positions = START.inverse().transform(true.world_t_landmarks)
    positions = positions + rng.multivariate_normal(np.zeros(2), covariance, len(positions))
    return tuple(
        Landmark(
            number,
            semantic_object(Kind(int(true.kinds[number])), true.diameters_m[number] + 0.02, 0.02),
            position,
            covariance,
            5,
            0.9,
        )
        for number, position in enumerate(positions)
    )


def make_run(seed: int, sigma_m: float = 0.05) -> tuple[RunResult, Truth]:
    rng = np.random.default_rng(seed)
    path, landmarks = true_path(), true_landmarks(rng)
    covariances = growing_covariances(len(path.stamps_ns), sigma_m)
    result = RunResult(
        name=f"course {seed}",
        smoothed=drawn_trajectory(rng, path, covariances),
        smoothed_covariances=covariances,
        fast=drawn_trajectory(rng, path, 9.0 * covariances),
        landmarks=drawn_landmarks(rng, landmarks, sigma_m),
        fast_seconds=rng.exponential(1e-3, len(path.stamps_ns)),
        wall_seconds=2.0,
        num_scans=len(path.stamps_ns),
        events=("loop closed at 35.0 s over 4 landmarks", "graph rebuilt"),
        settings={"seed": seed},
    )
    return result, Truth(path, landmarks)


def with_imu(result: RunResult, path: TruePath) -> RunResult:
    """The run with what a simulated inertial sensor measured on the true path, ten times as often.

    It turns evenly between two true poses.
    """
    assert path.headings is not None
    stamps_ns = np.arange(path.stamps_ns[0], path.stamps_ns[-1] + 1, 20_000_000)
    unwrapped = np.unwrap(path.headings)
    since_start = (path.stamps_ns - path.stamps_ns[0]).astype(float)
    headings = np.interp(stamps_ns - stamps_ns[0], since_start, unwrapped)
    poses = np.column_stack([np.zeros((len(stamps_ns), 2)), headings])
    samples = simulate_imu(stamps_ns, poses, SimulatedImu(), np.random.default_rng(0))
    rates = np.array([sample.yaw_rate for sample in samples])
    return replace(result, imu=YawRates(stamps_ns, rates))
