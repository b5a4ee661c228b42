"""Landmarks become one, and two again: in the graph and in the registry alike.

What is proposed by gates, by a constellation or by the whole run is carried out here, weighed by
what the graph says after, and taken back where sightings contradict it.
"""

from collections.abc import Callable, Iterable, Sequence, Set
from typing import Final, final

import numpy as np

from semgraph.decisions import DecisionLog, What
from semgraph.graph.contradiction import log_odds_of_one
from semgraph.graph.drift import reach_of
from semgraph.graph.factor_graph import Checkpoint, FactorGraph
from semgraph.graph.landmark_registry import LandmarkRegistry, Merge
from semgraph.graph.loop_closure import (
    Closure,
    closures_across,
    density,
    duplicates,
    find_closures,
)
from semgraph.graph.recognition import Recognition, is_lost, recognise
from semgraph.measurement_model import CHI2_2DOF_999

# So many landmarks sighted from both sides hold a link.
_HELD_BY: Final = 3
# Fewer scans without a sighting are an interruption, not a loop.
_LOOP_SCANS: Final = 100
# What an outline seen from another side adds to the cost of a sighting at most.
_COST_A_SIGHTING: Final = 3.0


@final
class Merging:
    """Which landmarks are one.

    Args:
        graph: of these landmarks.
        registry: of what is known of them.
        decided: is told what is decided.
        closure_odds: how sure a closure is, and how sure a contradiction.
        duplicate_odds: how sure it is at the end that two are one.
    """

    def __init__(
        self,
        graph: FactorGraph,
        registry: LandmarkRegistry,
        decided: DecisionLog,
        closure_odds: float,
        duplicate_odds: float,
    ) -> None:
        self._graph = graph
        self._registry = registry
        self._decided = decided
        self._closure_log_odds = float(np.log(closure_odds))
        self._duplicate_log_odds = float(np.log(duplicate_odds))

    def close_loops(self, recent: Sequence[int], due: Set[int]) -> None:
        """Pairs by the gates; where these hold all and nothing, the place by its constellation."""
        graph, landmarks = self._graph, self._registry.landmarks
        odds = self._closure_log_odds
        if not is_lost(graph):
            self.close(find_closures(graph, landmarks, recent, odds, due))
        elif found := recognise(graph, landmarks, recent, odds):
            self._find_itself(found)

    def _find_itself(self, found: Recognition) -> None:
        """Brings all since the weakest link to where it was recognised, and closes the loop.

        From where it was believed no solver would find there. Without a weak link all of the way
        bends a little: carried, what was sighted across the link would be torn.
        """
        graph = self._graph
        before = self._checkpoint(found.closures)
        last = max(int(graph.sighted(pair.old).poses.max()) for pair in found.closures)
        link, num_across = graph.weakest_link(last)
        if num_across < _HELD_BY:
            graph.carry(found.correction, link)
        self.close(found.closures, before)

    def close(self, closures: Sequence[Closure], before: Checkpoint | None = None) -> None:
        """Makes each pair one; all are two again where the graph does not agree.

        A closure that is far off moves much of the graph. What it moves that far must not cost
        more than the pairs were said to be apart, and what an outline may do to their sightings.
        What is near moves little, and waits for the next update.
        """
        graph = self._graph
        is_far = any(graph.are_far_apart(each.recent, each.old) for each in closures)
        if is_far and before is None:
            before = self._checkpoint(closures)
        merged = self._merge(closures)
        if merged and before is not None:
            graph.update(relinearize=True)
            graph.settle()
            self._go_back_if_costly(merged, before)
            graph.knit()

    def _checkpoint(self, closures: Sequence[Closure]) -> Checkpoint:
        """Before these; of what they make one nothing rests."""
        return self._graph.checkpoint([k for each in closures for k in (each.recent, each.old)])

    def _go_back_if_costly(self, merged: Sequence[Closure], before: Checkpoint) -> bool:
        """Takes all of these back where the graph's cost rose by more than they explain.

        Step by step a graph that moved far can come to rest where sightings it lost hold it.

        Returns:
            whether it did.
        """
        graph = self._graph
        merges = [(each.old, self._registry.merges(each.old)[-1]) for each in merged]
        sightings = sum(
            int(np.isin(graph.sighted(landmark).tracks, list(merge.tracks)).sum())
            for landmark, merge in merges
        )
        most = 0.5 * CHI2_2DOF_999 * len(merged) + _COST_A_SIGHTING * sightings
        rise = graph.cost() - before.cost
        if rise > most and not graph.is_long:
            graph.optimize()
            rise = graph.cost() - before.cost
        if rise <= most:
            return False
        for landmark, merge in merges:
            why = f"the graph's cost rose by {rise:.0f}; {most:.0f} were to be expected"
            self._split(landmark, merge, why)
        graph.go_back(before)
        return True

    def close_gaps(self, within: int, note: Callable[[str], None]) -> None:
        """What too few landmarks hold together is held against all else, at the end.

        While the run went on that was done with what was in sight. What a gap's ends are to each
        other may be told by what followed only, so each gap that closes lets others be tried again.

        Args:
            within: poses, that a landmark is in sight for after it was sighted.
            note: told what is being done.
        """
        while closed := sum(
            self._close_gap(*gap, within) for gap in self._graph.gaps(_HELD_BY, within)
        ):
            note(f"settling, gaps closed by {closed} landmarks")

    def _close_gap(self, before: int, after: int, within: int) -> int:
        """How many landmarks sighted after a gap, and not before, are others."""
        graph = self._graph
        recent = graph.sighted_from(after, after + within - 1) - graph.sighted_from(0, before)
        if not recent:
            return 0
        reach_m = reach_of(graph.pose_covariance(after))
        closures = closures_across(
            graph, self._registry.landmarks, sorted(recent), reach_m, self._closure_log_odds
        )
        if not closures:
            return 0
        checkpoint = graph.checkpoint()
        merged = self._merge(closures)
        graph.polish()
        return 0 if self._go_back_if_costly(merged, checkpoint) else len(merged)

    def merge_duplicates(self, changed: set[int], note: Callable[[str], None]) -> None:
        """Until there are no more that involve what has changed."""
        while True:
            closures = duplicates(
                self._graph, self._registry.landmarks, changed, self._duplicate_log_odds
            )
            merged = self._merge(closures, What.DUPLICATE)
            if not merged:
                return
            note(f"settling, {len(merged)} pairs of landmarks found to be one")
            # Not only for the optimum: in a graph built anew, joint covariances cost a tenth.
            self._graph.polish()
            changed = {closure.old for closure in merged}

    def _merge(self, closures: Iterable[Closure], what: What | None = None) -> list[Closure]:
        """Makes each pair one landmark; everything else follows in the next solution."""
        merged = [closure for closure in closures if what or self._registry.may_merge(closure)]
        for closure in merged:
            recent, old = (self._registry.landmarks[each] for each in (closure.recent, closure.old))
            unseen = recent.scans.first - old.scans.last
            closed = What.LOOP_CLOSED if unseen > _LOOP_SCANS else What.RESUMED
            self._decided.add(
                what or closed,
                old.kind,
                closure.recent,
                closure.old,
                closure.log_odds,
                f"unseen for {unseen} scans" if unseen > 0 else "seen by turns",
            )
            self._graph.merge(closure.recent, closure.old)
            self._registry.merge(closure, self._decided.scan)
        return merged

    def take_back(self, merges: Iterable[tuple[int, Merge]]) -> int:
        """How many of these merges are taken back, since sightings now contradict them."""
        num_taken_back = 0
        for landmark, merge in merges:
            sightings = self._graph.sighted(landmark)
            is_theirs = np.isin(sightings.tracks, list(merge.tracks))
            theirs, others = sightings.some(is_theirs), sightings.some(~is_theirs)
            if not len(theirs) or not len(others):
                continue
            known = self._registry.landmarks[landmark]
            odds = log_odds_of_one(
                self._graph,
                theirs,
                others,
                2.0 * known.outline_sigma_m() ** 2,
                density(self._graph, landmark),
            )
            if odds < -self._closure_log_odds:
                why = f"taken for one with log odds {merge.log_odds:.1f}"
                self._split(landmark, merge, why, odds)
                num_taken_back += 1
        return num_taken_back

    def _split(self, landmark: int, merge: Merge, why: str, log_odds: float = float("nan")) -> None:
        """Makes two of one again."""
        known = self._registry.landmarks[landmark]
        self._graph.split(landmark, merge.tracks, merge.recent)
        alone = self._registry.split(landmark, merge)
        self._decided.add(What.TAKEN_BACK, known.kind, alone, landmark, log_odds, why)
