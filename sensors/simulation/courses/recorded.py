"""What the devices of a course record: large measurements are made anew whenever they are asked."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from semgraph.arrays import IntArray
from sensors.dead_reckoning import in_order_of_time
from sensors.measurements import Measurement, OdometryNoise, Raw
from sensors.simulation.courses.track import Drive
from sensors.simulation.imu import SimulatedImu, simulate_imu
from sensors.simulation.wheels import simulate_wheels
from sensors.truth import TruePath


@dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """Measurements in the order of time, that can be iterated again and are the same then.

    Attributes:
        samples: small ones, in the order of time.
        stamps_ns: (n,) of the large ones.
        measure: makes the k-th of them, always the same.
    """

    samples: Sequence[Measurement]
    stamps_ns: IntArray
    measure: Callable[[int], Raw]

    def __iter__(self) -> Iterator[Measurement]:
        """Samples of the same time come first."""
        done = 0
        stamps = np.array([sample.stamp_ns for sample in self.samples], dtype=np.int64)
        for k, end in enumerate(np.searchsorted(stamps, self.stamps_ns, side="right").tolist()):
            yield from self.samples[done:end]
            yield self.measure(k)
            done = end
        yield from self.samples[done:]


def motion_samples(
    way: Drive, noise: OdometryNoise | None, rng: np.random.Generator
) -> list[Measurement]:
    """What the IMU says at every tick, and the wheels where there is a noise of theirs."""
    wheels = simulate_wheels(way.stamps_ns, way.poses, noise, rng) if noise is not None else []
    imu = simulate_imu(way.stamps_ns, way.poses, SimulatedImu(), rng, tilts=way.tilts)
    return list(in_order_of_time(wheels, imu))


def true_path(way: Drive) -> TruePath:
    """Where base really is, at every tick."""
    return TruePath(way.stamps_ns, way.poses[:, :2], way.poses[:, 2])
