"""Tells of each landmark of a run what was decided of it: a story in lines."""

from collections.abc import Iterator, Sequence

from semgraph.decisions import MADE_ONE, Decision, What
from semgraph.errors import InputError
from semgraph.landmarks import Landmark
from semgraph.results import RunResult


def explain(result: RunResult, landmark: int | None = None) -> Iterator[str]:
    """What was decided in a run, or all that concerns one landmark.

    Args:
        result: of the run.
        landmark: its id in the map, or a number that it went by before it was found to be another.

    Raises:
        InputError: nothing is known of such a landmark.
    """
    if landmark is None:
        yield from _summary(result)
        return
    mapped = {each.id: each for each in result.landmarks}
    story = _story(result.decisions, landmark)
    if landmark not in mapped and not story:
        raise InputError(f"landmark {landmark}: neither in the map nor ever decided of")
    yield _headline(landmark, mapped.get(landmark))
    yield from (f"  {_when(result, each)}  {each}" for each in story)
    if landmark in mapped and not story:
        yield "  seen in one stretch, and never found to be another"


def _summary(result: RunResult) -> Iterator[str]:
    """How often what was decided, then every decision in order."""
    for what in What:
        count = sum(each.what is what for each in result.decisions)
        if count:
            yield f"{what.value}: {count}"
    yield from (f"{_when(result, each)}  {each}" for each in result.decisions)


def _headline(landmark: int, mapped: Landmark | None) -> str:
    if mapped is None:
        return f"landmark {landmark}: not in the map"
    x, y = mapped.map_t_landmark.tolist()
    return (
        f"{mapped.semantics.kind.label} {landmark} at ({x:.2f}, {y:.2f}) m: "
        f"{mapped.num_sightings} sightings, reliability {mapped.reliability:.2f}"
    )


def _story(decisions: Sequence[Decision], landmark: int) -> list[Decision]:
    """All decisions of the landmark and of those that became it, in order."""
    names = {landmark}
    story = []
    for each in reversed(decisions):
        if each.what in MADE_ONE and each.other in names:
            names.add(each.landmark)
        if names & {each.landmark, each.other}:
            story.append(each)
    return story[::-1]


def _when(result: RunResult, decision: Decision) -> str:
    stamps_ns = result.smoothed.stamps_ns
    if not 0 <= decision.scan < len(stamps_ns):
        return "        "
    return f"{(stamps_ns[decision.scan] - stamps_ns[0]) * 1e-9:7.1f} s"
