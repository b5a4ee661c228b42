"""What errors that all sightings of a thing share add to the covariances of a graph.

A graph takes the error of every sighting for its own. A trunk that is taken for too thin is too
near in each of them, from whichever side, and that does not average out. A range error e common to
all sightings of a thing moves the estimate by H^-1 A^T e, with A the whitened Jacobian and H the
information. The covariance of that is added; the estimate stays as it is. Source: Bierman 1977,
chapter 8 (consider covariances); what is common counts in H once more, as its own.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import final

import numpy as np
from scipy.sparse import coo_matrix, csc_matrix

from semgraph.arrays import FloatArray, IntArray
from semgraph.graph.condensation import Stretch, whitened_sightings
from semgraph.graph.information import AT_ONCE, Information
from semgraph.landmarks import LEAST_RANGE_M


@dataclass(frozen=True, slots=True, eq=False)
class Ranges:
    """Sightings whose errors are in part common to all of a thing.

    Attributes:
        map_T_bases: (n, 3) poses.
        map_t_things: (m, 2).
        poses, things: (s,) of each sighting, rows of the above.
        polar: (s, 2) range and bearing.
        covariances: (s, 2, 2) of those.
        common_shares: (s,) of the range's variance, above 0.
    """

    map_T_bases: FloatArray
    map_t_things: FloatArray
    poses: IntArray
    things: IntArray
    polar: FloatArray
    covariances: FloatArray
    common_shares: FloatArray


@final
class CommonErrors:
    """How far errors that things have in common move everything.

    Args:
        information: of all variables of the graph.
        ranges: of the sightings in it.
        pose_columns: (n, 3) of the poses in the information.
        thing_columns: (m, 2) of the things.
    """

    def __init__(
        self,
        information: Information,
        ranges: Ranges,
        pose_columns: IntArray,
        thing_columns: IntArray,
    ) -> None:
        self._information = information
        self._pulls = _pulls(information.num_columns, ranges, pose_columns, thing_columns)

    def added(self, columns: IntArray) -> tuple[FloatArray, FloatArray]:
        """(k, d, d) to each variable's covariance, and to that with the next, 0 after the last.

        Args:
            columns: (k, d) of the variables.
        """
        own, crosses = (np.zeros((*columns.shape, columns.shape[1])) for _ in range(2))
        for shifts in self._shifts():
            moved = shifts[columns]
            own += np.einsum("nik,njk->nij", moved, moved)
            crosses[:-1] += np.einsum("nik,njk->nij", moved[:-1], moved[1:])
        return own, crosses

    def _shifts(self) -> Iterator[FloatArray]:
        """(size, b) of all variables by one sigma of each thing's common error, some at once."""
        for start in range(0, self._pulls.shape[1], AT_ONCE):
            yield self._information.solve(self._pulls[:, start : start + AT_ONCE].toarray())


def _pulls(
    size: int, ranges: Ranges, pose_columns: IntArray, thing_columns: IntArray
) -> csc_matrix:
    """(size, m) gradient at all variables by one sigma of the error of each of m things."""
    poses, things = ranges.poses, ranges.things
    stretch = Stretch(
        ranges.map_T_bases,
        np.zeros((0, 3)),
        np.zeros((0, 3, 3)),
        poses,
        things,
        ranges.polar,
        ranges.covariances,
        ranges.map_t_things,
    )
    by_pose, by_thing, _ = whitened_sightings(stretch, ranges.map_T_bases, ranges.map_t_things)
    # To be farther off is to lie further along the line of sight.
    sight = ranges.map_t_things[things] - ranges.map_T_bases[poses, :2]
    along = sight / np.maximum(np.linalg.norm(sight, axis=1, keepdims=True), LEAST_RANGE_M)
    sigmas_m = np.sqrt(ranges.common_shares * ranges.covariances[:, 0, 0])
    errors = np.einsum("sij,sj->si", by_thing, along) * sigmas_m[:, None]
    values = [np.einsum("sij,si->sj", by, errors) for by in (by_pose, by_thing)]
    rows = [pose_columns[poses], thing_columns[things]]
    columns = [np.repeat(things, 3), np.repeat(things, 2)]
    data, i, j = (
        np.concatenate([np.ravel(each) for each in parts]) for parts in (values, rows, columns)
    )
    return coo_matrix((data, (i, j)), shape=(size, len(thing_columns))).tocsc()
