"""All figures of the detectors, section by section: `semgraph bench detectors`."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from evaluation.benches import bench_rocks, bench_runs, bench_trees_2d, bench_trees_3d
from evaluation.benches.bench import Section
from evaluation.benches.bench_markers import optical_markers
from evaluation.benches.bench_reflectors import reflectors_car_park, reflectors_simulated
from evaluation.benches.bench_table import Row
from semgraph.errors import InputError

if TYPE_CHECKING:
    pass

CAR_PARK: Final = "car_park"


def _of_seeds(figures: bench_trees_3d.Figures, num_rings: int, seeds: Sequence[int]) -> list[Row]:
    return figures(num_rings, seeds)


_CLOUDS: Final = tuple(
    partial(_of_seeds, figures, num_rings)
    for num_rings in bench_trees_3d.DEVICES
    for figures in bench_trees_3d.FIGURES
)
SECTIONS: Final[tuple[Section, ...]] = (
    Section("trees in laser scans", bench_trees_2d.FIGURES, 45.0),
    Section("trees in clouds", _CLOUDS, 45.0),
    Section("rocks in depth images", bench_rocks.FIGURES, 180.0),
    Section("optical markers in images", (optical_markers,), 27.0),
    Section("reflectors in laser scans", (reflectors_simulated,), 1.0),
    Section("whole runs", bench_runs.FIGURES, 1500.0),
)


def car_park(data: Path | None) -> Section:
    """The real car park, in `data` or in its folder `car_park`; seeds do not matter to it."""

    def figures(_: Sequence[int]) -> list[Row]:
        if data is None:
            raise InputError("name the folder of the real recordings by --data DIR")
        inside = data / CAR_PARK
        return reflectors_car_park(inside if inside.is_dir() else data)

    return Section("reflectors in the real car park", (figures,), 1.0)
