"""Circles fitted to range and edges of many scan segments at once, through a beam with a width.

The spot of a laser is wider than the beams are apart. A trunk therefore looks wider than it is by
nearly the whole beam, and its edges nearer than they are; both are modelled, not corrected after.
"""

from dataclasses import dataclass

import numpy as np

from detectors.scan_segments import Segments
from detectors.tree_settings import TreeSettings
from semgraph.arrays import BoolArray, FloatArray, IntArray

NUM_ITERATIONS = 3
_BLUR = (0.35, 0.2)
_MAX_STEP_M, _MAX_TURN = 0.25, 0.04
# At least a sliver of each beam is taken as lit, in half widths of the trunk.
_LIT_MIN, _LIT_MAX = np.array([[-0.999], [-0.949]]), np.array([[0.949], [0.999]])
_FLOOR = np.diag([0.005**2, 0.0, 0.0025**2])


@dataclass(frozen=True, slots=True, eq=False)
class Circles:
    """Fitted circles (k of them), relative to the laser.

    Attributes:
        distances_m, bearings, radii_m: (k,) of the centre, bearing from the first beam.
        covariances: (k, 3, 3) of these three.
        misfits: (k,) chi-square per residual.
    """

    distances_m: FloatArray
    bearings: FloatArray
    radii_m: FloatArray
    covariances: FloatArray
    misfits: FloatArray


def beam_widths(ranges_m: FloatArray, beam: TreeSettings) -> FloatArray:
    """Angle that the footprint covers at a range."""
    return beam.beam_divergence + beam.beam_exit_m / ranges_m


def edge_offsets(ranges_m: FloatArray, beam: TreeSettings) -> FloatArray:
    """How much wider than it is a thing looks, rad: the beam, but for the share that must be lit.

    The farther, the larger the share of the beam that a thing must fill to be seen.
    """
    growing = np.minimum(beam.edge_share_per_m2 * ranges_m**2, beam.edge_share_max)
    shares = np.maximum(beam.edge_share, growing)
    return np.asarray(beam_widths(ranges_m, beam) * (1.0 - 2.0 * shares))


def apparent_diameters(segments: Segments, increment: float, beam: TreeSettings) -> FloatArray:
    """(k,) m, from the number of beams and the nearest range alone."""
    fronts_m = np.minimum.reduceat(segments.ranges_m, segments.starts)
    halves = 0.5 * (segments.counts * increment - edge_offsets(fronts_m, beam))
    sines = np.sin(np.clip(halves, 1e-3, 0.8))
    return 2.0 * fronts_m * sines / (1.0 - sines)


def fit_circles(
    segments: Segments,
    free: BoolArray,
    diameters_m: FloatArray,
    increment: float,
    beam: TreeSettings,
) -> Circles:
    """Gauss-Newton on (distance, bearing, radius) of every segment at once.

    Args:
        segments: at least one.
        free: (2, k) edges that show the thing's own outline; at least one of each segment.
        diameters_m: (k,) to start from.
        increment: rad between beams, positive.
        beam: the device.
    """
    problem = _Problem.of(segments, free, increment, beam)
    state = problem.start(segments, 0.5 * diameters_m)
    for _ in range(NUM_ITERATIONS):
        terms = problem.normal_equations(state)
        inverse, gradients = _inverse(terms[:6]), terms[6:9]
        wanted = (inverse * gradients).sum(axis=1)
        limits = problem.limits(state[2])
        steps = np.minimum(np.maximum(wanted, -limits), limits)
        state = state + steps
        state[2] = np.minimum(np.maximum(state[2], 0.01), 1.0)
        state[0] = np.maximum(state[0], 1.05 * state[2] + 0.05)
    # The last step's gain is the one predicted: another evaluation would cost a quarter more.
    gains = (gradients * steps).sum(axis=0)
    misfits = np.maximum(terms[9] - gains, 0.0) / problem.counts
    return Circles(state[0], state[1], state[2], inverse.transpose(2, 0, 1) + _FLOOR, misfits)


def _inverse(upper: FloatArray) -> FloatArray:
    """(3, 3, k) inverses of symmetric positive definite matrices, upper triangles (6, k).

    By cofactors: numpy's own takes three times as long for matrices this small.
    """
    a, b, c, d, e, f = upper
    inverse = np.empty((3, 3, upper.shape[1]))
    inverse[0, 0] = d * f - e * e
    inverse[0, 1] = inverse[1, 0] = c * e - b * f
    inverse[0, 2] = inverse[2, 0] = b * e - c * d
    inverse[1, 1] = a * f - c * c
    inverse[1, 2] = inverse[2, 1] = b * c - a * e
    inverse[2, 2] = a * d - b * b
    inverse /= a * inverse[0, 0] + b * inverse[0, 1] + c * inverse[0, 2]
    return inverse


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """What stays the same over the iterations: n beams and k segments."""

    starts: IntArray
    owners: IntArray
    angles: FloatArray
    ranges_m: FloatArray
    half_widths: FloatArray
    edges: FloatArray
    free: BoolArray
    offsets: FloatArray
    edge_information: float
    counts: IntArray
    beam: TreeSettings

    @classmethod
    def of(
        cls, segments: Segments, free: BoolArray, increment: float, beam: TreeSettings
    ) -> "_Problem":
        fronts_m = np.minimum.reduceat(segments.ranges_m, segments.starts)
        owners = np.repeat(np.arange(len(segments.starts)), segments.counts)
        angles = np.asarray(segments.beams * increment, dtype=np.float64)
        first = angles[segments.starts]
        last = angles[segments.starts + segments.counts - 1]
        return cls(
            segments.starts,
            owners,
            angles,
            segments.ranges_m,
            np.maximum(0.5 * beam_widths(fronts_m, beam), 1e-4)[owners],
            np.stack([first - 0.5 * increment, last + 0.5 * increment]),
            free,
            0.5 * edge_offsets(fronts_m, beam),
            1.0 / (increment**2 / 12.0 + beam.edge_sigma**2),
            segments.counts + free.sum(axis=0),
            beam,
        )

    def start(self, segments: Segments, radii_m: FloatArray) -> FloatArray:
        """(3, k) from the apparent width; a hidden edge lies where the free one says."""
        radii_m = np.where(self.free.all(axis=0), radii_m, np.maximum(radii_m, 0.08))
        fronts_m = np.minimum.reduceat(segments.ranges_m, segments.starts)
        distances_m = fronts_m + radii_m
        halves = np.arcsin(radii_m / distances_m) + self.offsets
        bearings = np.where(
            self.free.all(axis=0),
            0.5 * (self.edges[0] + self.edges[1]),
            np.where(self.free[0], self.edges[0] + halves, self.edges[1] - halves),
        )
        return np.stack([distances_m, bearings, radii_m])

    def limits(self, radii_m: FloatArray) -> FloatArray:
        """(3, k) longest step of distance, bearing and radius."""
        limits = np.empty((3, len(radii_m)))
        limits[0], limits[1], limits[2] = _MAX_STEP_M, _MAX_TURN, 0.5 * radii_m
        return limits

    def normal_equations(self, state: FloatArray) -> FloatArray:
        """(10, k) at (3, k) distance, bearing, radius: upper J'WJ, J'We, and chi-square."""
        n, k = len(self.angles), len(self.starts)
        # One array for all beams, then the first edges, then the last ones: one pass over it.
        jacobian = np.empty((3, n + 2 * k))
        residuals, information = np.empty((2, n + 2 * k))
        halves = np.arcsin(state[2] / state[0])
        self._put_ranges(state, halves, jacobian[:, :n], residuals[:n], information[:n])
        self._put_edges(
            state,
            halves,
            jacobian[:, n:].reshape(3, 2, k),
            residuals[n:].reshape(2, k),
            information[n:].reshape(2, k),
        )
        products = _products(jacobian, residuals, information)
        terms = np.add.reduceat(products[:, :n], self.starts, axis=1)
        terms += products[:, n : n + k]
        terms += products[:, n + k :]
        mean_m, sigma_m = self.beam.radius_prior_m
        terms[5] += sigma_m**-2
        terms[8] += (mean_m - state[2]) / sigma_m**2
        return terms

    def _put_ranges(
        self,
        state: FloatArray,
        halves: FloatArray,
        jacobian: FloatArray,
        residuals: FloatArray,
        information: FloatArray,
    ) -> None:
        """The ranges, each averaged over the lit part of its footprint.

        With t = sin(offset) distance / radius a half chord is radius sqrt(1 - t^2): its mean and
        that of its inverse, which the derivatives need, are closed integrals.
        """
        distances_m, bearings, radii_m, alphas = np.vstack([state, halves]).take(
            self.owners, axis=1
        )
        middles = self.angles - bearings
        lit = np.empty((2, len(middles)))
        np.subtract(middles, self.half_widths, out=lit[0])
        np.add(middles, self.half_widths, out=lit[1])
        lit /= alphas
        np.minimum(np.maximum(lit, _LIT_MIN, out=lit), _LIT_MAX, out=lit)
        asin = np.arcsin(lit)
        areas = lit * np.sqrt(1.0 - lit * lit) + asin
        widths = lit[1] - lit[0]
        half_chords = 0.5 * (areas[1] - areas[0]) / widths * radii_m
        inverse_chords = (asin[1] - asin[0]) / widths

        sines = np.sin(0.5 * alphas * (lit[0] + lit[1]))
        cosines = np.sqrt(1.0 - sines * sines)
        along = distances_m * cosines
        across = distances_m * sines
        steepness = across * inverse_chords / radii_m
        slopes = along * steepness - across
        # Toward an edge the range depends on how evenly the beam is lit.
        unlit = self.half_widths - 0.5 * alphas * widths
        blur = slopes * (_BLUR[0] * unlit + _BLUR[1] * self.half_widths)
        np.add(cosines, steepness * sines, out=jacobian[0])
        np.negative(slopes, out=jacobian[1])
        np.negative(inverse_chords, out=jacobian[2])
        np.add(self.ranges_m - along, half_chords, out=residuals)
        np.divide(1.0, self.beam.range_sigma_m**2 + blur * blur, out=information)

    def _put_edges(
        self,
        state: FloatArray,
        halves: FloatArray,
        jacobian: FloatArray,
        residuals: FloatArray,
        information: FloatArray,
    ) -> None:
        """Both edges; a hidden one counts only where it would have to be seen."""
        distances_m, bearings, radii_m = state
        outward = 1.0 / np.sqrt(distances_m * distances_m - radii_m * radii_m)
        seen = halves + self.offsets
        np.subtract(self.edges, bearings, out=residuals)
        residuals[0] += seen
        residuals[1] -= seen
        needed = self.free.copy()
        needed[0] |= residuals[0] < 0.0
        needed[1] |= residuals[1] > 0.0
        np.multiply(needed, self.edge_information, out=information)
        np.multiply(radii_m / distances_m, outward, out=jacobian[0, 0])
        np.negative(jacobian[0, 0], out=jacobian[0, 1])
        jacobian[1] = 1.0
        np.negative(outward, out=jacobian[2, 0])
        jacobian[2, 1] = outward


def _products(jacobian: FloatArray, residuals: FloatArray, information: FloatArray) -> FloatArray:
    """(10, n): the six of J'WJ, the three of J'We and e'We, robustly weighted."""
    z = np.abs(residuals) * np.sqrt(information)
    weighted = jacobian * (information / np.maximum(1.0, 0.4 * z))
    products = np.empty((10, jacobian.shape[1]))
    np.multiply(weighted[0], jacobian, out=products[:3])
    np.multiply(weighted[1], jacobian[1:], out=products[3:5])
    np.multiply(weighted[2], jacobian[2], out=products[5])
    np.multiply(weighted, residuals, out=products[6:9])
    np.multiply(z, np.minimum(z, 10.0), out=products[9])
    return products
