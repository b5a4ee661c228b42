"""Reads named arrays from MATLAB 5 files; whatever is wrong with one is an `InputError`.

It takes real numbers and cells of them, which is all that the recordings hold. scipy's `loadmat`
takes more, but ends the process (segmentation fault) on about one of a hundred damaged files.

Source: MathWorks, MAT-File Format, level 5.
"""

import math
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from semgraph.arrays import FloatArray
from semgraph.errors import InputError
from sensors.files import read_bytes
from sensors.text_table import LARGEST

MAX_MAT_BYTES = 64 * 2**20
MAX_EXPANDED_BYTES = 256 * 2**20

MatArray = FloatArray | tuple[FloatArray, ...]

_INT32, _UINT32, _MATRIX, _COMPRESSED = 5, 6, 14, 15
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8"}
_NUMBERS[13] = "u8"
_CELL_CLASS, _NUMBER_CLASSES = 1, range(6, 16)
_COMPLEX_FLAG = 0x0800
_EMPTY = np.zeros((0, 0))


@dataclass(frozen=True, slots=True)
class _Element:
    """A data element: its type and where its bytes lie, in the byte order of the file."""

    path: Path
    order: str
    kind: int
    body: memoryview

    def refusal(self, reason: str) -> InputError:
        return InputError(f"{self.path}: damaged MATLAB file: {reason}")

    def parts(self) -> Iterator["_Element"]:
        """The elements within this one."""
        at, end = 0, len(self.body)
        while at < end:
            if at + 8 > end:
                raise self.refusal("an element is cut off")
            kind, size = struct.unpack_from(self.order + "II", self.body, at)
            start = at + 8
            if kind >> 16:  # a small element holds size and data in its tag
                kind, size, start = kind & 0xFFFF, kind >> 16, at + 4
                at += 8
            else:
                at = start + size + (0 if kind == _COMPRESSED else -size % 8)
            if start + size > min(at, end):
                raise self.refusal("an element reaches beyond the end")
            yield _Element(self.path, self.order, kind, self.body[start : start + size])

    def values(self, kinds: tuple[int, ...]) -> FloatArray:
        """(n,) the numbers, if the type is one of `kinds`."""
        if self.kind not in kinds:
            raise self.refusal(f"an element of type {self.kind} where numbers should be")
        dtype = np.dtype(self.order + _NUMBERS[self.kind])
        if len(self.body) % dtype.itemsize:
            raise self.refusal("a number is cut off")
        return np.frombuffer(self.body, dtype=dtype).astype(np.float64)


@dataclass(frozen=True, slots=True)
class _Matrix:
    """An array with its name; the parts of its content are not looked at yet."""

    element: _Element
    flags: int
    shape: tuple[int, ...]
    name: str
    content: Iterator[_Element]

    @classmethod
    def of(cls, element: _Element) -> "_Matrix":
        if element.kind != _MATRIX:
            raise element.refusal(f"an element of type {element.kind} where an array should be")
        parts = element.parts()
        head = list(islice(parts, 3))
        if len(head) < 3:
            raise element.refusal("an array without flags, size or name")
        flags = head[0].values((_UINT32,))
        shape = tuple(int(size) for size in head[1].values((_INT32,)))
        if not len(flags) or not 2 <= len(shape) <= 8 or min(shape) < 0:
            raise element.refusal(f"an array of size {shape}")
        return cls(element, int(flags[0]), shape, bytes(head[2].body).decode("latin-1"), parts)

    def numbers(self) -> FloatArray:
        """The real numbers, in the array's shape."""
        if self.flags & 0xFF not in _NUMBER_CLASSES or self.flags & _COMPLEX_FLAG:
            raise self.element.refusal("expected real numbers, or cells of them")
        part = next(self.content, None)
        values = part.values(tuple(_NUMBERS)) if part is not None else np.zeros(0)
        if len(values) != math.prod(self.shape):
            raise self.element.refusal(f"{len(values)} numbers in an array of size {self.shape}")
        return values.reshape(self.shape, order="F")

    def value(self) -> MatArray:
        """The numbers, or those of each cell."""
        if self.flags & 0xFF != _CELL_CLASS:
            return self.numbers()
        cells = [_Matrix.of(cell).numbers() if len(cell.body) else _EMPTY for cell in self.content]
        if len(cells) != math.prod(self.shape):
            raise self.element.refusal(f"{len(cells)} cells in an array of size {self.shape}")
        return tuple(cells)


def load_mat(path: Path, names: tuple[str, ...]) -> dict[str, MatArray]:
    """The arrays of these names, in their order: numbers, or a tuple of numbers for cells.

    Raises:
        InputError: the file is missing, damaged, not MATLAB 5, too big when expanded, or lacks
            one of the names.
    """
    content = read_bytes(path, MAX_MAT_BYTES)
    order = {b"IM": "<", b"MI": ">"}.get(content[126:128])
    if order is None or not content.startswith(b"MATLAB 5.0"):
        raise InputError(f"{path}: expected a MATLAB 5 file, got another or a truncated one")
    found = {}
    left = MAX_EXPANDED_BYTES
    for element in _Element(path, order, _MATRIX, memoryview(content)[128:]).parts():
        matrices = [element] if element.kind != _COMPRESSED else _expanded(element, left)
        left -= sum(len(matrix.body) for matrix in matrices)
        for matrix in map(_Matrix.of, matrices):
            if matrix.name in names:
                found[matrix.name] = matrix.value()
    for name in names:
        if name not in found:
            raise InputError(f"{path}: expected an array named {name}, there is none")
    return {name: found[name] for name in names}


def _expanded(element: _Element, max_bytes: int) -> list[_Element]:
    unpacker = zlib.decompressobj()
    try:
        content = unpacker.decompress(element.body, max_bytes + 1)
    except zlib.error as error:
        raise element.refusal(str(error)) from error
    if len(content) > max_bytes:
        limit = MAX_EXPANDED_BYTES / 2**20
        raise InputError(f"{element.path}: expected at most {limit:g} MiB when expanded, got more")
    if not unpacker.eof:
        raise element.refusal("a packed array is cut off")
    whole = _Element(element.path, element.order, _MATRIX, memoryview(content))
    return list(whole.parts())


def numbers(path: Path, name: str, array: MatArray, shape: tuple[int, ...]) -> FloatArray:
    """The array as finite floats of `shape`, where -1 stands for any length.

    Raises:
        InputError: cells, not finite, or another shape.
    """
    if isinstance(array, tuple):
        raise InputError(f"{path}: {name}: expected numbers, got cells")
    fits = array.ndim == len(shape) and all(
        want in (-1, have) for have, want in zip(array.shape, shape, strict=True)
    )
    if not fits:
        wanted = " x ".join("n" if size == -1 else str(size) for size in shape)
        raise InputError(f"{path}: {name}: expected {wanted} numbers, got shape {array.shape}")
    bad = np.argwhere(~(np.abs(array) <= LARGEST))
    if len(bad):
        raise InputError(
            f"{path}: {name}: expected finite numbers up to {LARGEST:g}, "
            f"record {bad[0][0] + 1} holds {array[tuple(bad[0])]:g}"
        )
    return array


def vector(path: Path, name: str, array: MatArray) -> FloatArray:
    """The (n,) finite floats of a row or a column.

    Raises:
        InputError: as `numbers`.
    """
    is_vector = not isinstance(array, tuple) and array.ndim == 2 and 1 in array.shape
    return numbers(path, name, np.ravel(array) if is_vector else array, (-1,))
