"""Whether all trials of a study were measured by the same programs."""

from collections import Counter
from collections.abc import Iterable

from evaluation.studies.trial import Outcome


def mixed_versions(outcomes: Iterable[Outcome]) -> tuple[str, ...]:
    """Each package of which trials had several versions, with how many had which."""
    counts: dict[str, Counter[str]] = {}
    for outcome in outcomes:
        for package, version in outcome.versions:
            counts.setdefault(package, Counter())[version] += 1
    return tuple(
        f"{package} {', '.join(f'{version} ({count})' for version, count in sorted(its.items()))}"
        for package, its in counts.items()
        if len(its) > 1
    )
