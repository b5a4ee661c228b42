"""Simulated depth images of rocks with their truth, and how a detector did on them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from detectors.detector import Detector
from semgraph.arrays import BoolArray, FloatArray, IntArray
from semgraph.geometry import Pose2, wrap_angle
from semgraph.landmarks import Perceptions
from sensors.measurements import CameraGeometry, DepthImage
from sensors.simulation.depth_camera import DepthCamera, Scene
from sensors.simulation.terrain import TerrainSettings, rough_terrain

IMAGES_PER_TERRAIN = 4
_PLACES_M = 4.0
_ROOM_M = 0.8
_MAX_MATCH_M = 0.3
_MIN_PIXELS = 60
_MIN_SHARE = 0.6


@dataclass(frozen=True, slots=True, eq=False)
class RockTrial:
    """An image and the m rocks of its terrain.

    Attributes:
        distances_m, bearings: (m,) of each rock's centre, from the camera's point in the plane.
        diameters_m: (m,).
        num_pixels: (m,) that each rock answers.
        visible_shares: (m,) of the pixels it would answer with nothing before it, were the image
            half as wide and high again; 0 where there are none.
    """

    image: DepthImage
    distances_m: FloatArray
    bearings: FloatArray
    diameters_m: FloatArray
    num_pixels: IntArray
    visible_shares: FloatArray

    @property
    def visible(self) -> BoolArray:
        """(m,) answers 60 pixels or more (of 307,200), and at most 40 % of it is hidden or cut."""
        return (self.num_pixels >= _MIN_PIXELS) & (self.visible_shares >= _MIN_SHARE)


@dataclass(frozen=True, slots=True, eq=False)
class RockOutcomes:
    """Of one trial or several: m rocks there were, n perceptions came.

    Attributes:
        rock_distances_m, rock_diameters_m: (m,).
        visible, found: (m,) as in `RockTrial`; a perception fell to it.
        ranges_m, diameters_m, reliabilities: (n,).
        right: (n,) it fell to a rock, of whatever size.
        errors: (n, 3) range m, bearing rad, log of the diameter; NaN where there is none.
        nees: (n,) of range and bearing.
        whole: (n,) the rock it fell to was visible.
        true_diameters_m: (n,) of that rock.
    """

    rock_distances_m: FloatArray
    rock_diameters_m: FloatArray
    visible: BoolArray
    found: BoolArray
    ranges_m: FloatArray
    diameters_m: FloatArray
    reliabilities: FloatArray
    right: BoolArray
    errors: FloatArray
    nees: FloatArray
    whole: BoolArray
    true_diameters_m: FloatArray

    @classmethod
    def union(cls, parts: Sequence["RockOutcomes"]) -> "RockOutcomes":
        """Those of several trials together."""
        return cls(
            *(np.concatenate([getattr(part, name) for part in parts]) for name in cls.__slots__)
        )


def rock_trials(
    seeds: Sequence[int], settings: TerrainSettings, device: DepthCamera
) -> Iterator[RockTrial]:
    """`IMAGES_PER_TERRAIN` images from random places on one terrain of each seed."""
    for seed in seeds:
        rng = np.random.default_rng(seed)
        scene = Scene(rough_terrain(settings, rng))
        for _ in range(IMAGES_PER_TERRAIN):
            yield look(scene, _free_place(scene, rng), device, rng)


def look(
    scene: Scene, world_T_base: Pose2, device: DepthCamera, rng: np.random.Generator
) -> RockTrial:
    """An image from one place with its truth."""
    view = scene.view(device.camera, world_T_base)
    image = device.measure(view, 0, rng)
    terrain = scene.terrain
    world_T_sensor = world_T_base @ image.base_T_sensor
    x, y = world_T_sensor.inverse().transform(terrain.world_t_rocks).T
    num_pixels = np.bincount(view.rocks[view.rocks >= 0], minlength=len(x))
    bare = 4 * scene.bare_pixels(_wide_and_coarse(device.camera), world_T_base)
    return RockTrial(
        image,
        np.hypot(x, y),
        np.arctan2(y, x),
        terrain.diameters_m,
        num_pixels,
        num_pixels / np.maximum(bare, 1),
    )


def judge_rocks(
    trial: RockTrial, detector: Detector[DepthImage], min_reliability: float
) -> RockOutcomes:
    """What became of every rock, and of every perception at least this reliable."""
    perceptions = detector.detect(trial.image)
    perceptions = perceptions.select(perceptions.reliabilities >= min_reliability)
    rows = match_rocks(perceptions, trial)
    right = rows >= 0
    errors = np.column_stack(
        [
            perceptions.ranges_m - trial.distances_m[rows],
            wrap_angle(perceptions.bearings - trial.bearings[rows]),
            np.log(perceptions.diameters_m / trial.diameters_m[rows]),
        ]
    )
    errors[~right] = np.nan
    polar = errors[:, :2]
    return RockOutcomes(
        trial.distances_m,
        trial.diameters_m,
        trial.visible,
        np.isin(np.arange(len(trial.distances_m)), rows),
        perceptions.ranges_m,
        perceptions.diameters_m,
        perceptions.reliabilities,
        right,
        errors,
        np.einsum("ni,nij,nj->n", polar, np.linalg.inv(perceptions.covariances), polar),
        trial.visible[rows] & right,
        np.where(right, trial.diameters_m[rows], np.nan),
    )


def match_rocks(perceptions: Perceptions, trial: RockTrial) -> IntArray:
    """(n,) rows of the rocks, -1 for none: one to one, nearest in sum.

    A perception may lie off by the rock's radius, or 0.3 m if that is more.
    """
    rocks = trial.distances_m[:, None] * np.column_stack(
        [np.cos(trial.bearings), np.sin(trial.bearings)]
    )
    apart_m = np.linalg.norm(perceptions.base_t_landmarks()[:, None] - rocks, axis=2)
    far = (apart_m > np.maximum(_MAX_MATCH_M, 0.5 * trial.diameters_m)) | (trial.num_pixels == 0)
    chosen, rows = linear_sum_assignment(np.where(far, 1e3, apart_m))
    matches = np.full(len(perceptions), -1)
    near = ~far[chosen, rows]
    matches[chosen[near]] = rows[near]
    return matches


def _wide_and_coarse(camera: CameraGeometry) -> CameraGeometry:
    """The same camera with half the pixels a radian and 1.5 times the field."""
    width, height = 3 * camera.width // 4, 3 * camera.height // 4
    centre_px = (0.5 * (width - 1), 0.5 * (height - 1))
    return CameraGeometry(width, height, 0.5 * camera.focal_px, centre_px, camera.mounting)


def _free_place(scene: Scene, rng: np.random.Generator) -> Pose2:
    """A pose near the middle, off the rocks."""
    terrain = scene.terrain
    while True:
        x, y, theta = rng.uniform(-1.0, 1.0, 3) * (_PLACES_M, _PLACES_M, np.pi)
        gaps_m = np.linalg.norm(terrain.world_t_rocks - (x, y), axis=1) - terrain.diameters_m / 2
        if gaps_m[terrain.diameters_m > 0.2].min(initial=np.inf) > _ROOM_M:
            return Pose2(x, y, theta)
