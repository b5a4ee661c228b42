"""Covariances out of pieces of a graph: a few condensed stretches, whatever else there is."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csc_matrix

from semgraph.arrays import BoolArray, FloatArray
from semgraph.errors import GraphError
from semgraph.graph.information import DenseInformation, Information

_WELL_KNOWN_M: Final = 0.5
# Columns from which on a sparse matrix is quicker.
_DENSE: Final = 600


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """A stretch between two poses of the graph, linearized and whitened.

    Attributes:
        first, last: its poses.
        landmarks: (n) that its things are; several may be one.
        by_first, by_last, by_things: (d, 3), (d, 3), (d, n, 2).
    """

    first: int
    last: int
    landmarks: tuple[int, ...]
    by_first: FloatArray
    by_last: FloatArray
    by_things: FloatArray


def covariance_by(
    pieces: Sequence[Piece], newest: Piece, landmarks: Sequence[int]
) -> FloatArray | None:
    """(2n, 2n) joint covariance of landmarks as if the newest piece's last pose were known.

    What all other factors know could only make it smaller. None where that is needed: where the
    pieces do not hold a landmark and the newest one together, to half a metre.
    """
    chosen = _connected(pieces, newest)
    if not {landmark for piece in chosen for landmark in piece.landmarks} >= set(landmarks):
        return None
    try:
        return _covariance(_without_lone(chosen, landmarks), newest, landmarks)
    except GraphError:
        # Pieces with one landmark in common turn about it as they like.
        return None


def _covariance(
    chosen: Sequence[Piece], newest: Piece, landmarks: Sequence[int]
) -> FloatArray | None:
    """None where it is not held to half a metre."""
    places = sorted({landmark for piece in chosen for landmark in piece.landmarks})
    poses = sorted({pose for piece in chosen for pose in (piece.first, piece.last)} - {newest.last})
    columns = {pose: 2 * len(places) + 3 * k for k, pose in enumerate(poses)}
    of = {landmark: 2 * k for k, landmark in enumerate(places)}
    asked = np.array([of[landmark] + k for landmark in landmarks for k in range(2)])
    covariance = _information(chosen, columns, of).covariance(asked)
    return covariance if np.diag(covariance).max() <= _WELL_KNOWN_M**2 else None


def _without_lone(pieces: Sequence[Piece], asked: Sequence[int]) -> list[Piece]:
    """The same of what several pieces or the asker know: nine things in ten hold nothing together.

    A landmark that is several things of one piece stays, for those move together.
    """
    counts = Counter(landmark for piece in pieces for landmark in piece.landmarks)
    counts.update(asked)
    return [
        _marginalized(piece, np.array([counts[k] == 1 for k in piece.landmarks], dtype=bool))
        for piece in pieces
    ]


def _marginalized(piece: Piece, is_lone: BoolArray) -> Piece:
    """What it says of all but some of its things: what no place of those could explain."""
    if not is_lone.any():
        return piece
    height, kept = len(piece.by_first), piece.by_things[:, ~is_lone]
    lone = piece.by_things[:, is_lone].reshape(height, -1)
    rest = np.hstack([kept.reshape(height, -1), piece.by_first, piece.by_last])
    try:
        rest = rest - lone @ cho_solve(cho_factor(lone.T @ lone), lone.T @ rest)
    except np.linalg.LinAlgError:
        raise GraphError("a stretch says next to nothing of a landmark") from None
    return Piece(
        piece.first,
        piece.last,
        tuple(k for k, lonely in zip(piece.landmarks, is_lone.tolist(), strict=True) if not lonely),
        rest[:, -6:-3],
        rest[:, -3:],
        rest[:, :-6].reshape(kept.shape),
    )


def _information(
    chosen: Sequence[Piece], columns: dict[int, int], of: dict[int, int]
) -> Information | DenseInformation:
    """All that the pieces say; as a dense matrix, unless it is large.

    Those of one place, from tracks that are one landmark, add up.
    """
    size = 2 * len(of) + 3 * len(columns)
    blocks = [_squared(piece, columns, of) for piece in chosen]
    if size > _DENSE:
        return Information(_together(blocks, size))
    information = np.zeros((size, size))
    for squared, where in blocks:
        if len(set(where)) == len(where):
            information[np.ix_(where, where)] += squared
        else:
            np.add.at(information, np.ix_(where, where), squared)
    return DenseInformation(information)


def _squared(
    piece: Piece, columns: dict[int, int], of: dict[int, int]
) -> tuple[FloatArray, list[int]]:
    """(k, k) information of a piece and the columns of it; what it says of a known pose is out."""
    by = [piece.by_things.reshape(len(piece.by_first), -1)]
    where = [of[landmark] + k for landmark in piece.landmarks for k in range(2)]
    for pose, by_pose in ((piece.first, piece.by_first), (piece.last, piece.by_last)):
        if pose in columns:
            by.append(by_pose)
            where += range(columns[pose], columns[pose] + 3)
    A = np.hstack(by)
    return A.T @ A, where


def _together(blocks: Sequence[tuple[FloatArray, list[int]]], size: int) -> csc_matrix:
    """All in one sparse matrix (size, size)."""
    values = np.concatenate([squared.ravel() for squared, _ in blocks])
    rows = np.concatenate([np.repeat(where, len(where)) for _, where in blocks])
    columns = np.concatenate([np.tile(where, len(where)) for _, where in blocks])
    return csc_matrix((values, (rows, columns)), shape=(size, size))


def _connected(pieces: Sequence[Piece], newest: Piece) -> list[Piece]:
    """Those that share poses or landmarks with the newest one, or with each other up to it."""
    chosen, left = [newest], list(pieces)
    poses, landmarks = {newest.first, newest.last}, set(newest.landmarks)
    while True:
        joining = [
            piece
            for piece in left
            if not poses.isdisjoint((piece.first, piece.last))
            or not landmarks.isdisjoint(piece.landmarks)
        ]
        if not joining:
            return chosen
        chosen += joining
        left = [piece for piece in left if piece not in joining]
        for piece in joining:
            poses |= {piece.first, piece.last}
            landmarks |= set(piece.landmarks)
