"""Takes a whole run's perceptions for landmarks anew, all of them together, and says how probable.

For few things that are alike, where many hypotheses were followed: what they came to hangs on their
random numbers, and of several outcomes the most probable one is the best guess.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from semgraph.files.run_log import RunLog
from semgraph.graph.smoother import SmootherSettings
from semgraph.measurement_model import CHI2_2DOF_999
from semgraph.offline.batch import Batch, Belief
from semgraph.offline.batch_graph import BatchGraph
from semgraph.offline.map_following import columns_of, followed
from semgraph.offline.reassociation import with_places, without_strays
from semgraph.offline.refinement import refine
from semgraph.offline.sight_habits import SightHabits

_PASSES: Final = 3


@dataclass(frozen=True, slots=True, eq=False)
class Resighted:
    """What a run came to.

    Attributes:
        batch: what was measured.
        belief: the optimum, and which perception is of which landmark.
        misfit: -2 ln of how probable that is, but for what all outcomes of one batch have in
            common.
        changes: how many perceptions each round took for something else.
    """

    batch: Batch
    belief: Belief
    misfit: float
    changes: tuple[int, ...]


def resighted(log: RunLog, settings: SmootherSettings, note: Callable[[str], None]) -> Resighted:
    """The optimum over all measurements of a run, each perception of what it most probably is.

    First by `refine`; then by turns the most probable associations in the map, and the optimum
    with them, which is a new map. The most probable of all these optima is kept: where the pose is
    unsure by metres, following leaves open what is the only thing to hold it.

    Raises:
        GraphError: the batch cannot be solved.
    """
    batch = Batch.of(log)
    begin = Belief(log.trajectory.map_T_bases, log.landmarks, {})
    belief, rounds = refine(batch, begin, settings, note)
    changes = list(rounds)
    best = Resighted(batch, belief, misfit(batch, belief), ())
    for _ in range(_PASSES):
        landmarks = without_strays(followed(batch, belief))
        changes.append(int((landmarks != belief.landmarks).sum()))
        if changes[-1] == 0:
            break
        belief = BatchGraph(batch, with_places(batch, belief, landmarks)).optimum()
        note(f"followed through the map, {changes[-1]} associations changed")
        passed = Resighted(batch, belief, misfit(batch, belief), ())
        best = min(best, passed, key=lambda each: each.misfit)
    return replace(best, changes=tuple(changes))


def misfit(batch: Batch, belief: Belief) -> float:
    """-2 ln of how probable an optimum is, but for what all of one batch have in common.

    Squared residuals, where a sighting that is left open or beyond the 99.9 % gate costs as much as
    the gate; how surprising each is by the habits of the run; and for each landmark two ln n,
    the price of its two coordinates.

    Source: Schwarz 1978 for the price.
    """
    ids, columns = columns_of(belief)
    fits = belief.fit(batch)[belief.assigned()]
    is_in = fits <= CHI2_2DOF_999
    open_or_beyond = len(columns) - int(is_in.sum())
    of_sightings = float(fits[is_in].sum()) + CHI2_2DOF_999 * open_or_beyond
    habits = SightHabits.of(batch, columns, len(ids)).total(batch, columns, len(ids))
    price = 2.0 * len(ids) * float(np.log(max(len(columns), 1)))
    return of_sightings + _of_motions(batch, belief) + habits + price


def _of_motions(batch: Batch, belief: Belief) -> float:
    """The squared residuals of all motions."""
    return 2.0 * BatchGraph(batch, belief, every_scan=True).cost_of_motions
