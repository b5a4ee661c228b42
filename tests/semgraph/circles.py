"""Drives on a circle through a stand, perceived without noise, and followed."""

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest

from semgraph.arrays import FloatArray
from semgraph.fast_estimator import FastEstimator, FastSettings, FastStep
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.landmarks import Kind, Perceptions, polar_covariances
from semgraph.measurement_model import predict

SCAN_NS = 100_000_000
START = Pose2(2.0, -1.0, 0.5)
BEST = FastSettings.model_validate({"rules": "best"})
PAPER = FastSettings.model_validate({"rules": "paper"})
BOTH_RULES = pytest.mark.parametrize("settings", [BEST, PAPER])


def arc(num_scans: int, radius_m: float = 12.0, turn: float = 0.02) -> list[Pose2]:
    """Poses counter-clockwise on a circle that begins at START."""
    step = Pose2(radius_m * math.sin(turn), radius_m * (1.0 - math.cos(turn)), turn)
    poses = [START]
    while len(poses) < num_scans:
        poses.append(poses[-1] @ step)
    return poses


def stand(seed: int = 0) -> FloatArray:
    """Trees (n, 2) at least 2 m apart, around the circle of `arc`."""
    rng = np.random.default_rng(seed)
    axis = np.arange(-28.0, 29.0, 4.0)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    return START.transform(grid + rng.uniform(-1.0, 1.0, grid.shape) + (0.0, 12.0))


def seen(k: int, map_T_base: Pose2, trees: FloatArray, reach_m: float = 12.0) -> Perceptions:
    """Scan k without any noise, of all trees in reach."""
    polar = predict(map_T_base, trees)
    polar = polar[polar[:, 0] < reach_m]
    sigmas = np.tile([0.03, 0.005], (len(polar), 1))
    return Perceptions.from_arrays(
        k * SCAN_NS, Kind.TREE, polar[:, 0], polar[:, 1], polar_covariances(*sigmas.T)
    )


def exact_wheels(poses: Sequence[Pose2]) -> list[UncertainPose2]:
    covariance = np.diag([1e-2**2, 1e-2**2, 5e-3**2])
    still = UncertainPose2(Pose2(), 1e-12 * np.eye(3))
    return [still, *(UncertainPose2(a.between(b), covariance) for a, b in pairwise(poses))]


def followed(
    settings: FastSettings,
    scans: Sequence[Perceptions],
    wheels: Sequence[UncertainPose2] | None = None,
    start: Pose2 = START,
) -> tuple[list[FastStep], FastEstimator]:
    estimator = FastEstimator(settings, start)
    motions = [None] * len(scans) if wheels is None else wheels
    steps = [estimator.step(scan, wheel) for scan, wheel in zip(scans, motions, strict=True)]
    return steps, estimator


def errors(steps: Sequence[FastStep], poses: Sequence[Pose2]) -> FloatArray:
    """(n, 3) of the estimates, in their own frames."""
    return np.array(
        [
            step.map_T_base.pose.between(pose).as_array()
            for step, pose in zip(steps, poses, strict=True)
        ]
    )
