"""Which tracks are which landmark: what was made one, and can be made two again."""

import copy
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from semgraph.arrays import IntArray
from semgraph.graph.graph_landmark import GraphLandmark
from semgraph.graph.loop_closure import Closure
from semgraph.graph.tracks import Track
from semgraph.landmarks import Kind, Perceptions

# So many scans after a merge it is looked at again; after that only at the end of the run.
_SECOND_LOOKS: Final = (10, 25, 60)


@dataclass(slots=True, eq=False)
class Merge:
    """These tracks were found to be a landmark that others had shown before.

    Attributes:
        recent: what the tracks' landmark was called.
        tracks: their numbers.
        log_odds: how sure it was.
        due: scans at which to look again whether it still holds.
    """

    recent: int
    tracks: frozenset[int]
    log_odds: float
    due: list[int] = field(default_factory=list)


class LandmarkRegistry:
    """Tracks by the tracker's number, the landmark of each, and what is known of it."""

    def __init__(self) -> None:
        self.landmarks: dict[int, GraphLandmark] = {}
        self._by_tracker_id: dict[int, Track] = {}
        self._in_sight: dict[int, Track] = {}
        self._tracks: dict[int, list[Track]] = {}
        self._merges: dict[int, list[Merge]] = {}
        self._refused: set[frozenset[int]] = set()
        self._by_identity: dict[tuple[Kind, str], Track] = {}
        self._by_number: list[Track] = []

    def track(self, tracker_id: int, perceptions: Perceptions, row: int) -> Track:
        """The track that goes on; or a new one, of a landmark that may be new as well."""
        track = self._by_tracker_id.get(tracker_id)
        if track is None:
            track = self._begin(perceptions, row)
            self._by_tracker_id[tracker_id] = track
        self._in_sight[tracker_id] = track
        return track

    def _begin(self, perceptions: Perceptions, row: int) -> Track:
        kind, identity = Kind(perceptions.kinds[row]), str(perceptions.identities[row])
        number = len(self._by_number)
        named = self._by_identity.get((kind, identity)) if identity else None
        if named is None:
            track = Track(number, number, GraphLandmark(kind, identity), perceptions.stamp_ns)
        else:
            track = Track(number, named.landmark, named.known, perceptions.stamp_ns)
            for other in self._tracks[named.landmark]:
                other.part()
            track.join()
            track.known.num_tracks += 1
        if identity:
            self._by_identity[(kind, identity)] = track
        self._by_number.append(track)
        self._tracks.setdefault(track.landmark, []).append(track)
        return track

    def tracks(self, landmark: int) -> tuple[Track, ...]:
        """All tracks of a landmark."""
        return tuple(self._tracks[landmark])

    def in_sight(self, since_scan: int, now_ns: int) -> list[Track]:
        """The tracks sighted in that scan or later, of what does not move."""
        for tracker_id, track in list(self._in_sight.items()):
            if 0 <= track.last_scan < since_scan and track.rest(now_ns):
                del self._in_sight[tracker_id]
        return [
            track
            for track in self._in_sight.values()
            if track.last_scan >= since_scan and not track.is_moving
        ]

    def landmark_ids(
        self, tracker_ids: IntArray, instead: Mapping[int, int] | None = None
    ) -> IntArray:
        """(n,) the landmark of each track (n,); -1 stays -1, and of what was dropped it is -1.

        Args:
            tracker_ids: (n,) of a scan.
            instead: by the number of a track, that of the one whose landmark its sighting in this
                scan was of; -1 for none.
        """
        instead = instead or {}
        found = np.full(len(tracker_ids), -1)
        for row in np.flatnonzero(tracker_ids >= 0).tolist():
            number = self._by_tracker_id[int(tracker_ids[row])].number
            number = instead.get(number, number)
            landmark = self._by_number[number].landmark if number >= 0 else -1
            found[row] = landmark if landmark in self.landmarks else -1
        return found

    def may_merge(self, closure: Closure) -> bool:
        """Whether it was not taken back before."""
        return frozenset((closure.recent, closure.old)) not in self._refused

    def merge(self, closure: Closure, scan: int) -> None:
        """Both are `closure.old` from now on."""
        joining, old = self._tracks.pop(closure.recent), self.landmarks[closure.old]
        for track in (*joining, *self._tracks[closure.old]):
            track.part()
        old.absorb(self.landmarks.pop(closure.recent))
        for track in joining:
            track.landmark, track.known = closure.old, old
        self._tracks[closure.old] += joining
        merge = Merge(
            closure.recent,
            frozenset(track.number for track in joining),
            closure.log_odds,
            [scan + later for later in _SECOND_LOOKS],
        )
        merges = self._merges.setdefault(closure.old, [])
        merges += [*self._merges.pop(closure.recent, []), merge]

    def merges(self, landmark: int) -> tuple[Merge, ...]:
        """Of a landmark, those that stand."""
        return tuple(self._merges.get(landmark, ()))

    def due(self, landmarks: Iterable[int], scan: int) -> list[tuple[int, Merge]]:
        """Merges of these landmarks that are to be looked at again; then they are not."""
        found = []
        for landmark in landmarks:
            for merge in self._merges.get(landmark, ()):
                if merge.due and merge.due[0] <= scan:
                    merge.due = [later for later in merge.due if later > scan]
                    found.append((landmark, merge))
        return found

    def split(self, landmark: int, merge: Merge) -> int:
        """Takes a merge back for good; the number of the landmark that stands alone again."""
        leaving = [track for track in self._tracks[landmark] if track.number in merge.tracks]
        self._tracks[landmark] = [
            track for track in self._tracks[landmark] if track.number not in merge.tracks
        ]
        self._tracks[merge.recent] = leaving
        existence = self.landmarks[landmark].existence
        for each in (landmark, merge.recent):
            self._know_again(each)
            self.landmarks[each].existence = copy.deepcopy(existence)
        standing = [each for each in self._merges[landmark] if each is not merge]
        inner = [each for each in standing if each.tracks < merge.tracks]
        self._merges[merge.recent] = inner
        self._merges[landmark] = [each for each in standing if each not in inner]
        self._refused.add(frozenset((landmark, merge.recent)))
        return merge.recent

    def drop(self, track: Track) -> bool:
        """Forgets the landmark of what turned out to move; not one that other tracks show too."""
        known = self.landmarks.get(track.landmark)
        if known is not track.known or known.num_tracks != 1:
            return False
        self._by_identity.pop((known.kind, known.identity), None)
        del self.landmarks[track.landmark]
        return True

    def _know_again(self, landmark: int) -> None:
        """All that its tracks say of a landmark, and no more."""
        first, *others = self._tracks[landmark]
        known = copy.deepcopy(first.own)
        for other in others:
            known.absorb(other.own)
        self.landmarks[landmark] = known
        for track in self._tracks[landmark]:
            track.landmark, track.known = landmark, known
