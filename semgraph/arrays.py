"""Arrays as values: checked once, copied, read-only."""

from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from semgraph.errors import InputError

FloatArray = NDArray[np.floating[Any]]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


def frozen_floats(
    name: str, values: ArrayLike, shape: tuple[int | None, ...], *, finite: bool = True
) -> FloatArray:
    """A read-only float copy of `values` with the shape asked for.

    Args:
        name: how the error calls the array.
        values: anything numpy takes.
        shape: expected shape; None stands for any length.
        finite: refuse NaN and infinity.

    Raises:
        InputError: another shape, no numbers, or not finite.
    """
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: expected numbers, got {error}") from error
    _check_shape(name, array, shape)
    if finite and not np.isfinite(array).all():
        raise InputError(f"{name}: expected finite numbers, got NaN or infinity")
    array.flags.writeable = False
    return array


def frozen_ints(name: str, values: ArrayLike, shape: tuple[int | None, ...]) -> IntArray:
    """A read-only int64 copy of `values` with the shape asked for.

    Raises:
        InputError: another shape, or not whole numbers.
    """
    array = np.array(values)
    if array.size and array.dtype.kind not in "iub":
        raise InputError(f"{name}: expected whole numbers, got {array.dtype}")
    array = array.astype(np.int64)
    _check_shape(name, array, shape)
    array.flags.writeable = False
    return array


def flattened(lists: NDArray[np.object_]) -> tuple[IntArray, IntArray]:
    """(k,) numbers of q lists of whole numbers, and (k,) what is in them, one after the other."""
    lengths = np.fromiter(map(len, lists), dtype=np.int64, count=len(lists))
    numbers = np.repeat(np.arange(len(lists)), lengths)
    return numbers, np.fromiter(chain.from_iterable(lists), dtype=np.int64, count=len(numbers))


def _check_shape(name: str, array: NDArray[Any], shape: tuple[int | None, ...]) -> None:
    fits = array.ndim == len(shape) and all(
        want is None or have == want for have, want in zip(array.shape, shape, strict=True)
    )
    if not fits:
        wanted = tuple("n" if size is None else size for size in shape)
        raise InputError(f"{name}: expected shape {wanted}, got {array.shape}")
