"""Noise that remembers, and the path it is put on."""

import numpy as np

from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import InputError


def check_path(name: str, stamps_ns: IntArray, world_T_bases: FloatArray) -> None:
    """Nothing, for a path of stamps (n,) and poses (n, 3) with n >= 1.

    Raises:
        InputError: it is none.
    """
    n = len(stamps_ns)
    if n < 1 or world_T_bases.shape != (n, 3) or not np.isfinite(world_T_bases).all():
        raise InputError(
            f"simulated {name}: expected a finite pose x, y, theta for each of 1 stamp or more, "
            f"got {n} stamps and poses of shape {world_T_bases.shape}"
        )
    if (np.diff(stamps_ns) <= 0).any():
        raise InputError(f"simulated {name}: expected increasing stamps; sort the path by time")


def check_domain(name: str, settings: object, positive: tuple[str, ...] = ()) -> None:
    """Nothing, for settings whose slots are all finite and at least 0, `positive` above it.

    Raises:
        InputError: one is not.
    """
    for slot in type(settings).__dict__["__slots__"]:
        value = getattr(settings, slot)
        above = value > 0.0 if slot in positive else value >= 0.0
        if not (above and value < np.inf):
            limit = "above" if slot in positive else "of at least"
            raise InputError(f"simulated {name}: expected {slot} {limit} 0, got {value}")


def random_walk(
    seconds: FloatArray, start_sigma: float, sigma_per_sqrt_s: float, rng: np.random.Generator
) -> FloatArray:
    """(n,) at times (n,): its variance grows by the time that passes."""
    sigmas = sigma_per_sqrt_s * np.sqrt(np.diff(seconds))
    sigmas = np.concatenate([[start_sigma], sigmas])
    walk: FloatArray = np.cumsum(sigmas * rng.standard_normal(len(seconds)))
    return walk


def gauss_markov(
    seconds: FloatArray, sigma: float, correlation_s: float, num: int, rng: np.random.Generator
) -> FloatArray:
    """(n, num) stationary noise at times (n,), forgotten over `correlation_s` (> 0).

    Source: first-order Gauss-Markov process, exact for any spacing of the times.
    """
    kept = np.exp(-np.diff(seconds, prepend=-np.inf) / correlation_s)
    drawn = sigma * np.sqrt(1.0 - kept**2)[:, None] * rng.standard_normal((len(seconds), num))
    noise: FloatArray = drawn
    for k in range(1, len(seconds)):
        noise[k] += kept[k] * noise[k - 1]
    return noise
