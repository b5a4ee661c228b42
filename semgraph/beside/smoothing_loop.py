"""What the graph's own process does: it works through the spool and tells how far it is."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing import parent_process
from multiprocessing.connection import wait
from typing import Any, Final

from semgraph.beside.graph_beside import GraphInProcess
from semgraph.beside.spool import Spool
from semgraph.errors import SemgraphError
from semgraph.fast_estimator import FastStep
from semgraph.geometry import Pose2
from semgraph.graph.smoother import SmootherSettings
from semgraph.landmarks import Perceptions
from semgraph.smoothed import Smoothed
from sensors.views import View

_LOOK_S: Final = 0.005
_ALIVE_S: Final = 0.5
# While it is behind; else it tells each scan.
_TELL_S: Final = 0.05


@dataclass(frozen=True, slots=True)
class Job:
    """What the first entry of the spool says: which graph to build."""

    settings: SmootherSettings
    map_T_start: Pose2


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """What `Smoother.add` takes."""

    step: FastStep
    perceptions: Perceptions
    views: tuple[View, ...]


@dataclass(frozen=True, slots=True)
class End:
    """No scan follows."""


@dataclass(frozen=True, slots=True)
class Taken:
    """The graph holds all scans up to this one.

    Attributes:
        scan: counted from 0.
        map_T_base: of that scan, smoothed.
        odom_T_base: the same by the tracker.
    """

    scan: int
    map_T_base: Pose2
    odom_T_base: Pose2

    @property
    def map_T_odom(self) -> Pose2:
        """What corrects the tracker's pose, now and until the next."""
        return self.map_T_base @ self.odom_T_base.inverse()


@dataclass(frozen=True, slots=True)
class Doing:
    """A sign of life, and what is being done."""

    text: str = ""


@dataclass(frozen=True, slots=True)
class Failed:
    """Why it cannot go on; `is_final` if it would fail again."""

    reason: str
    is_final: bool


def smooth(scans: Spool, answers: Spool) -> None:
    """Builds the graph of the spool's scans; appends to the answers how far it is, at last all."""
    teller = _Teller(answers)
    try:
        answers.append(_smoothed(scans, teller))
    except SemgraphError as error:
        answers.append(Failed(str(error), is_final=True))
    except Exception as error:  # noqa: BLE001  # whatever it is, the other process is to know
        answers.append(Failed(f"{type(error).__name__}: {error}", is_final=False))


def _smoothed(scans: Spool, teller: "_Teller") -> Smoothed:
    entries = _entries(scans, teller)
    job: Job = next(entries)
    graph = GraphInProcess(job.settings, job.map_T_start)
    for number, scan in enumerate(entries):
        graph.add(scan.step, scan.perceptions, scan.views)
        teller.took(Taken(number, graph.latest(), scan.step.map_T_base.pose))
    return graph.finish(teller.doing)


def _entries(scans: Spool, teller: "_Teller") -> Iterator[Any]:
    """The job, then each scan as soon as it is there, up to the end."""
    while not isinstance(entry := scans.read(), End):
        if entry is None:
            teller.idle()
            _end_with_parent(_LOOK_S)
        else:
            yield entry


def _end_with_parent(seconds: float = 0.0) -> None:
    """Waits, and ends this process if its parent has ended: nobody would take what it makes."""
    parent = parent_process()
    if parent is not None and wait([parent.sentinel], seconds):
        raise SystemExit(0)


class _Teller:
    """Tells each scan while the graph keeps up, and every so often when it is behind."""

    def __init__(self, answers: Spool) -> None:
        self._answers = answers
        self._untold: Taken | None = None
        self._told_s = -_ALIVE_S

    def took(self, taken: Taken) -> None:
        """One scan more."""
        _end_with_parent()
        self._untold = taken
        if time.monotonic() - self._told_s >= _TELL_S:
            self._tell(taken)

    def idle(self) -> None:
        """Nothing is to be done; what is untold is told, and else that this process lives."""
        if self._untold is not None:
            self._tell(self._untold)
        elif time.monotonic() - self._told_s >= _ALIVE_S:
            self._tell(Doing())

    def doing(self, text: str) -> None:
        """What is done in the end, after the last scan: what is untold is told before."""
        _end_with_parent()
        if self._untold is not None:
            self._tell(self._untold)
        self._tell(Doing(text))

    def _tell(self, answer: Taken | Doing) -> None:
        self._answers.append(answer)
        self._untold = None
        self._told_s = time.monotonic()
