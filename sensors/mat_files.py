"""Reads named arrays from MATLAB 5 files; whatever is wrong with one is an `InputError`."""

import io
import struct
import warnings
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semgraph.arrays import FloatArray
from semgraph.errors import InputError
from sensors.files import read_bytes

MAX_MAT_BYTES = 64 * 2**20
MAX_EXPANDED_BYTES = 256 * 2**20

_MI_MATRIX, _MI_COMPRESSED = 14, 15
_MX_CELL, _MX_STRUCT, _MX_OBJECT, _MX_SPARSE = 1, 2, 3, 5


def load_mat(path: Path, names: tuple[str, ...]) -> dict[str, NDArray[Any]]:
    """The arrays of these names: numbers, or one level of cells of numbers (dtype object).

    Raises:
        InputError: the file is missing, damaged, not MATLAB 5, too big when expanded, or lacks
            one of the names.
    """
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError, MatReadWarning

    content = read_bytes(path, MAX_MAT_BYTES)
    _check_elements(path, content)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", MatReadWarning)
            arrays = loadmat(io.BytesIO(content), variable_names=names)
    except (
        *(MatReadError, MatReadWarning, zlib.error, struct.error, OSError, EOFError, MemoryError),
        *(ValueError, TypeError, LookupError, ArithmeticError, NotImplementedError),
        *(AssertionError, AttributeError),
    ) as error:
        reason = str(error).partition("\n")[0] or type(error).__name__
        raise InputError(f"{path}: damaged MATLAB file: {reason}") from error
    missing = [name for name in names if name not in arrays]
    if missing:
        raise InputError(f"{path}: expected an array named {missing[0]}, there is none")
    return {name: np.asarray(arrays[name]) for name in names}


def numbers(path: Path, name: str, array: NDArray[Any], shape: tuple[int, ...]) -> FloatArray:
    """The array as finite floats of `shape`, where -1 stands for any length.

    Raises:
        InputError: not numbers, not finite, another shape.
    """
    if array.dtype.kind not in "uif":
        raise InputError(f"{path}: {name}: expected numbers, got {array.dtype}")
    fits = array.ndim == len(shape) and all(
        want in (-1, have) for have, want in zip(array.shape, shape, strict=True)
    )
    if not fits:
        wanted = " x ".join("n" if size == -1 else str(size) for size in shape)
        raise InputError(f"{path}: {name}: expected {wanted} numbers, got shape {array.shape}")
    values = array.astype(np.float64)
    bad = np.flatnonzero(~np.isfinite(values).reshape(len(values), -1).all(axis=1))
    if len(bad):
        raise InputError(f"{path}: {name}: expected finite numbers, record {bad[0] + 1} has none")
    return values


def vector(path: Path, name: str, array: NDArray[Any]) -> FloatArray:
    """The (n,) finite floats of a row or a column.

    Raises:
        InputError: as `numbers`.
    """
    is_vector = array.ndim == 2 and 1 in array.shape
    return numbers(path, name, array.ravel() if is_vector else array, (-1,))


def _check_elements(path: Path, content: bytes) -> None:
    """Refuses what would expand without bounds, before scipy reads it."""
    if len(content) < 128 or not content.startswith(b"MATLAB 5.0"):
        raise InputError(f"{path}: expected a MATLAB 5 file, got another or a truncated one")
    order = {b"IM": "<", b"MI": ">"}.get(content[126:128])
    if order is None:
        raise InputError(f"{path}: expected a MATLAB 5 file, its byte order mark is damaged")
    left = MAX_EXPANDED_BYTES
    for kind, body in _elements(path, content[128:], order):
        matrix = body
        if kind == _MI_COMPRESSED:
            matrix = _expand(path, body, left)[8:]
            left -= len(matrix)
        if left <= 0:
            raise InputError(f"{path}: expands beyond {MAX_EXPANDED_BYTES / 2**20:g} MiB")
        _check_flat(path, matrix, order)


def _elements(path: Path, content: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Type and body of each element of a buffer."""
    at = 0
    while at + 8 <= len(content):
        kind, size = struct.unpack_from(order + "II", content, at)
        if kind >> 16:  # a small element holds its size and its data in the tag
            kind, size, body, at = kind & 0xFFFF, kind >> 16, at + 4, at + 8
        else:
            body = at + 8
            padding = 0 if kind == _MI_COMPRESSED else -size % 8
            at = body + size + padding
        if body + size > len(content):
            raise InputError(f"{path}: truncated: an element reaches beyond the end")
        yield kind, content[body : body + size]


def _expand(path: Path, packed: bytes, max_bytes: int) -> bytes:
    try:
        return zlib.decompressobj().decompress(packed, max_bytes + 8)
    except zlib.error as error:
        raise InputError(f"{path}: damaged MATLAB file: {error}") from error


def _array_class(matrix: bytes, order: str) -> int:
    """The mxCLASS of a matrix element, -1 where there is none."""
    return struct.unpack_from(order + "I", matrix, 8)[0] & 0xFF if len(matrix) >= 16 else -1


def _check_flat(path: Path, matrix: bytes, order: str) -> None:
    """Refuses structures and cells within cells, which scipy would follow to any depth."""
    array_class = _array_class(matrix, order)
    parts = _elements(path, matrix, order) if array_class == _MX_CELL else iter(())
    inner = {_array_class(body, order) for kind, body in parts if kind == _MI_MATRIX}
    if ({array_class} | inner) & {_MX_STRUCT, _MX_OBJECT, _MX_SPARSE} or _MX_CELL in inner:
        raise InputError(f"{path}: expected numbers or cells of numbers, got structures")
