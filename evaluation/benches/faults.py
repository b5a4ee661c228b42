"""Faults of sensors, detectors and drivers, put into a recording.

Each takes one measurement and gives what comes in its place. What the types refuse never gets to
an estimator: a driver drops it and goes on with the sound rest.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from semgraph.arrays import FloatArray
from semgraph.errors import SemgraphError
from semgraph.geometry import Pose2
from semgraph.landmarks import Kind, Perceptions, concatenate, polar_covariances
from sensors.measurements import Measurement, WheelOdometry

_HALF_STEP_NS: Final = 40_000_000
_DAY_NS: Final = 86_400_000_000_000


@dataclass(frozen=True, slots=True)
class ScanFault:
    """What becomes of a set of perceptions.

    `says_nothing`: the sound rest is whole, so that the result must be that without the fault.
    """

    name: str
    make: Callable[[Perceptions, np.random.Generator], Sequence[Perceptions]]
    says_nothing: bool = False


@dataclass(frozen=True, slots=True)
class WheelFault:
    """What becomes of a sample of the wheels."""

    name: str
    make: Callable[[WheelOdometry, np.random.Generator], Sequence[WheelOdometry]]
    says_nothing: bool = False


Fault = ScanFault | WheelFault


def inject(
    measurements: Sequence[Measurement], fault: Fault, share: float, rng: np.random.Generator
) -> tuple[list[Measurement], int]:
    """The measurements with a fault in a share of those it concerns, and in how many.

    The first scan stays whole: it is the start.
    """
    faulty: list[Measurement] = []
    count, first = 0, True
    for each in measurements:
        made = _made(fault, each, rng) if not first and rng.uniform() < share else None
        faulty += [each] if made is None else made
        count += made is not None
        first = first and not isinstance(each, Perceptions)
    return faulty, count


def _made(
    fault: Fault, sound: Measurement, rng: np.random.Generator
) -> Sequence[Measurement] | None:
    """What a fault makes of a measurement; the sound one where the types refuse that.

    None where it is not of the kind that the fault concerns.
    """
    try:
        if isinstance(sound, Perceptions) and isinstance(fault, ScanFault):
            return fault.make(sound, rng)
        if isinstance(sound, WheelOdometry) and isinstance(fault, WheelFault):
            return fault.make(sound, rng)
    except SemgraphError:
        return [sound]
    return None


def _one_more(
    range_m: float = 5.0,
    bearing: float = 0.3,
    covariance: FloatArray | None = None,
    reliability: float = 1.0,
    diameter_m: float = 0.3,
) -> Callable[[Perceptions, np.random.Generator], Sequence[Perceptions]]:
    """A fault that adds one perception with these values."""
    noise = np.diag([0.03, 0.005]) ** 2 if covariance is None else covariance

    def make(sound: Perceptions, rng: np.random.Generator) -> Sequence[Perceptions]:  # noqa: ARG001
        more = Perceptions.from_arrays(
            sound.stamp_ns,
            Kind.TREE,
            np.array([range_m]),
            np.array([bearing]),
            noise[None],
            diameters_m=np.array([diameter_m]),
            diameter_sigmas_m=np.array([0.1 * diameter_m]),
            reliabilities=np.array([reliability]),
        )
        return [concatenate(sound.stamp_ns, [sound, more])]

    return make


def _anywhere(sigma_m: float, sigma_rad: float) -> Callable[..., Sequence[Perceptions]]:
    """A fault that adds a perception somewhere, of these sigmas."""

    def make(sound: Perceptions, rng: np.random.Generator) -> Sequence[Perceptions]:
        covariance = polar_covariances(np.array([sigma_m]), np.array([sigma_rad]))[0]
        range_m, bearing = float(rng.uniform(2.0, 15.0)), float(rng.uniform(-2.0, 2.0))
        return _one_more(range_m, bearing, covariance)(sound, rng)

    return make


def _changed(
    change: Callable[[Perceptions, np.random.Generator], dict[str, object]],
) -> Callable[[Perceptions, np.random.Generator], Sequence[Perceptions]]:
    """A fault that changes some of a set's arrays."""

    def make(sound: Perceptions, rng: np.random.Generator) -> Sequence[Perceptions]:
        return [replace(sound, **change(sound, rng))]  # type: ignore[arg-type]

    return make


def _split(sound: Perceptions, rng: np.random.Generator) -> Sequence[Perceptions]:
    at = int(rng.integers(0, len(sound) + 1))
    rows = np.arange(len(sound))
    return [sound.select(rows[:at]), sound.select(rows[at:])]


def _empty_between(sound: Perceptions, rng: np.random.Generator) -> Sequence[Perceptions]:  # noqa: ARG001
    nothing = sound.select(np.zeros(0, dtype=np.int64))
    return [sound, replace(nothing, stamp_ns=sound.stamp_ns + _HALF_STEP_NS)]


def _mirrored(sound: Perceptions, rng: np.random.Generator) -> dict[str, object]:  # noqa: ARG001
    return {"bearings": -sound.bearings}


def _shuffled(sound: Perceptions, rng: np.random.Generator) -> dict[str, object]:
    return {"ranges_m": rng.permutation(sound.ranges_m)}


def _one_point(sound: Perceptions, rng: np.random.Generator) -> dict[str, object]:  # noqa: ARG001
    n = len(sound)
    return {"ranges_m": np.full(n, 4.0), "bearings": np.zeros(n)}


def _on_a_line(sound: Perceptions, rng: np.random.Generator) -> dict[str, object]:  # noqa: ARG001
    along_m = np.linspace(-6.0, 6.0, len(sound))
    return {"ranges_m": np.hypot(along_m, 3.0), "bearings": np.arctan2(3.0, along_m)}


def _on_a_ray(sound: Perceptions, rng: np.random.Generator) -> dict[str, object]:  # noqa: ARG001
    return {"bearings": np.zeros(len(sound))}


def _as_rocks(sound: Perceptions, rng: np.random.Generator) -> dict[str, object]:  # noqa: ARG001
    return {"kinds": np.full(len(sound), Kind.ROCK)}


def _scaled_noise(factor: float) -> Callable[..., Sequence[Perceptions]]:
    return _changed(lambda sound, _: {"covariances": factor * sound.covariances})


def _jump(reach_m: float) -> Callable[[WheelOdometry, np.random.Generator], list[WheelOdometry]]:
    """There and back again with the next sample."""

    def make(sound: WheelOdometry, rng: np.random.Generator) -> list[WheelOdometry]:
        x, y = rng.uniform(-reach_m, reach_m, 2).tolist()
        jump = Pose2(x, y, float(rng.uniform(-np.pi, np.pi)))
        return [WheelOdometry(sound.stamp_ns, jump @ sound.odom_T_base)]

    return make


def _not_finite(sound: WheelOdometry, rng: np.random.Generator) -> list[WheelOdometry]:  # noqa: ARG001
    return [WheelOdometry(sound.stamp_ns, Pose2(np.nan, 0.0, 0.0))]


_INDEFINITE: Final = np.array([[1e-3, 1e-2], [1e-2, 1e-3]])

FAULTS: Final[tuple[Fault, ...]] = (
    ScanFault("range NaN", _one_more(range_m=np.nan), says_nothing=True),
    ScanFault("range infinite", _one_more(range_m=np.inf), says_nothing=True),
    ScanFault("range negative", _one_more(range_m=-3.0), says_nothing=True),
    ScanFault("range of a nanometre", _one_more(range_m=1e-9), says_nothing=True),
    ScanFault("bearing NaN", _one_more(bearing=np.nan), says_nothing=True),
    ScanFault("covariance NaN", _one_more(covariance=np.full((2, 2), np.nan)), says_nothing=True),
    ScanFault("covariance zero", _one_more(covariance=np.zeros((2, 2))), says_nothing=True),
    ScanFault("covariance indefinite", _one_more(covariance=_INDEFINITE), says_nothing=True),
    ScanFault("reliability NaN", _one_more(reliability=np.nan), says_nothing=True),
    ScanFault("reliability above 1", _one_more(reliability=2.0), says_nothing=True),
    ScanFault("diameter infinite", _one_more(diameter_m=np.inf), says_nothing=True),
    WheelFault("wheels NaN", _not_finite, says_nothing=True),
    ScanFault("scan in two parts of one stamp", _split, says_nothing=True),
    # Without wheels the motion model counts from scan to scan: an empty one changes it a little.
    ScanFault("empty scan in between", _empty_between),
    ScanFault("perception of 10 km and any bearing", _anywhere(1e4, 1e3), says_nothing=True),
    ScanFault("scan empty", lambda sound, _: [sound.select(np.zeros(0, dtype=np.int64))]),
    ScanFault("scan lost", lambda _sound, _: []),
    ScanFault("scan twice", lambda sound, _: [sound, sound]),
    ScanFault(
        "stamp of the next day",
        lambda sound, _: [replace(sound, stamp_ns=sound.stamp_ns + _DAY_NS)],
    ),
    ScanFault("bearings mirrored", _changed(_mirrored)),
    ScanFault("ranges shuffled", _changed(_shuffled)),
    ScanFault("all at one point", _changed(_one_point)),
    ScanFault("all on a line", _changed(_on_a_line)),
    ScanFault("all on a ray", _changed(_on_a_ray)),
    ScanFault("all of another kind", _changed(_as_rocks)),
    ScanFault("sigmas a millionth", _scaled_noise(1e-12)),
    ScanFault("sigmas a million times", _scaled_noise(1e12)),
    ScanFault("range of 1000 km", _one_more(range_m=1e6)),
    ScanFault("bearing of a million turns", _one_more(bearing=6.3e6)),
    ScanFault("reliability zero", _one_more(reliability=0.0)),
    ScanFault("diameter of a kilometre", _one_more(diameter_m=1e3)),
    WheelFault("wheels jump 10 m", _jump(10.0)),
    WheelFault("wheels jump 1000 km", _jump(1e6)),
    WheelFault("wheels lost", lambda _sound, _: []),
)
