"""The images `depth.npz` and `images.npz` of a plain recording folder."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import InputError
from sensors.measurements import CameraGeometry, CameraImage, DepthImage, Measurement, Tilt
from sensors.npz_files import load_npz
from sensors.recorded import Recorded
from sensors.stamps import stamps_ns

DEPTH_FILE = "depth.npz"
IMAGES_FILE = "images.npz"
DEPTH_ARRAY = "depths_mm"
GREY_ARRAY = "grey"
_MM: Final = 1e-3
_LARGEST_TILT: Final = np.pi
Packed = tuple[int, NDArray[Any], Tilt]
"""Stamp in ns, pixels as the file has them, tilt."""


@dataclass(frozen=True, slots=True, eq=False)
class Images:
    """n images as a file has them: `measure(k)` is the k-th."""

    stamps_ns: IntArray
    measure: Callable[[int], DepthImage | CameraImage]


def read_depth_images(file: Path, camera: CameraGeometry) -> Images:
    """Those of stamp_s (n,), depths_mm (n, height, width) uint16, 0 for none, and perhaps tilt.

    `tilt` is (n, 2), roll and pitch of base in rad. Images are unpacked when they are asked for.

    Raises:
        InputError: damaged, too big, shapes or types disagree, or times that run back.
    """
    stamps, depths_mm, tilts = _arrays(file, DEPTH_ARRAY, np.uint16, camera)

    def measure(k: int) -> DepthImage:
        depths_m = np.where(depths_mm[k] > 0, _MM * depths_mm[k], np.nan)
        return DepthImage(int(stamps[k]), camera, depths_m, _tilt(tilts[k]))

    return Images(stamps, measure)


def read_camera_images(file: Path, camera: CameraGeometry) -> Images:
    """Those of stamp_s (n,), grey (n, height, width) uint8, and perhaps tilt (n, 2).

    Raises:
        InputError: as `read_depth_images`.
    """
    stamps, grey, tilts = _arrays(file, GREY_ARRAY, np.uint8, camera)
    return Images(stamps, lambda k: CameraImage(int(stamps[k]), camera, grey[k], _tilt(tilts[k])))


def with_images(samples: Sequence[Measurement], images: Sequence[Images]) -> Iterable[Measurement]:
    """All in the order of time; at one time the samples come first."""
    if not images:
        return samples
    stamps = np.concatenate([each.stamps_ns for each in images])
    owners = np.repeat(np.arange(len(images)), [len(each.stamps_ns) for each in images])
    rows = np.concatenate([np.arange(len(each.stamps_ns)) for each in images])
    order = np.argsort(stamps, kind="stable")
    return Recorded(
        samples, stamps[order], lambda k: images[owners[order[k]]].measure(int(rows[order[k]]))
    )


def packed_depth_image(image: DepthImage) -> Packed:
    """Depths in whole mm, 0 for none and for what is farther than 65.535 m."""
    depths_mm = np.rint(np.nan_to_num(image.depths_m, nan=0.0, posinf=0.0, neginf=0.0) / _MM)
    fits = (depths_mm > 0.0) & (depths_mm <= np.iinfo(np.uint16).max)
    return image.stamp_ns, np.where(fits, depths_mm, 0.0).astype(np.uint16), image.tilt


def write_images(file: Path, name: str, images: Sequence[Packed]) -> None:
    """Writes stamps in ns, pixels and tilts under the name that the pixels have in the file."""
    stamps, pixels, tilts = zip(*images, strict=True)
    arrays = {
        "stamp_s": np.array(stamps) / 1e9,
        name: np.array(pixels),
        "tilt": np.array([(tilt.roll, tilt.pitch) for tilt in tilts]),
    }
    np.savez_compressed(file, allow_pickle=False, **arrays)


def _arrays(
    file: Path, name: str, dtype: type[np.unsignedinteger[Any]], camera: CameraGeometry
) -> tuple[IntArray, NDArray[Any], FloatArray]:
    """Stamps (n,), pixels (n, height, width) and tilts (n, 2) of a file."""
    arrays = load_npz(file, ("stamp_s", name), ("tilt",))
    times, pixels = arrays["stamp_s"].astype(np.float64), arrays[name]
    n = len(times) if times.ndim == 1 else -1
    shape = (n, camera.height, camera.width)
    if n < 0 or pixels.shape != shape or pixels.dtype != dtype:
        raise InputError(
            f"{file}: expected stamp_s (n,) and {name} (n, {camera.height}, {camera.width}) of "
            f"{np.dtype(dtype)}, got {times.shape} and {pixels.shape} of {pixels.dtype}"
        )
    tilts = arrays.get("tilt", np.zeros((n, 2))).astype(np.float64)
    if tilts.shape != (n, 2) or not (np.abs(tilts) <= _LARGEST_TILT).all():
        raise InputError(
            f"{file}: expected tilt (n, 2), roll and pitch within {_LARGEST_TILT:.3f} rad"
        )
    return stamps_ns(file, "stamp_s", times), pixels, tilts


def _tilt(roll_pitch: FloatArray) -> Tilt:
    roll, pitch = roll_pitch.tolist()
    return Tilt(roll, pitch)
