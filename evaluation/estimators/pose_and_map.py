"""The state of EKF-SLAM: pose and landmarks as one Gaussian."""

from typing import Final, final

import numpy as np

from semgraph.arrays import FloatArray, IntArray
from semgraph.geometry import Pose2, UncertainPose2, rotation
from semgraph.measurement_model import jacobians, predict

_POSE: Final = slice(0, 3)


@final
class PoseAndMap:
    """A pose, landmarks (n, 2) in map, and the (3 + 2n, 3 + 2n) covariance of both together.

    The pose's errors are in its own frame, the landmarks' in map. All that is quadratic in the
    number of landmarks is a product of matrices.

    Source: Dissanayake et al. 2001; Thrun, Burgard and Fox 2005, section 10.2.
    """

    def __init__(self, map_T_start: UncertainPose2) -> None:
        self.pose = map_T_start.pose
        self.map_t_landmarks: FloatArray = np.zeros((0, 2))
        self.covariance: FloatArray = np.array(map_T_start.covariance)

    def __len__(self) -> int:
        return len(self.map_t_landmarks)

    @property
    def map_T_base(self) -> UncertainPose2:
        """The pose alone."""
        return UncertainPose2(self.pose, self.covariance[_POSE, _POSE])

    def landmark_covariances(self) -> FloatArray:
        """(n, 2, 2) of each alone."""
        n = len(self)
        blocks = self.covariance[3:, 3:].reshape(n, 2, n, 2)
        return blocks[np.arange(n), :, np.arange(n), :]

    def move(self, motion: UncertainPose2) -> None:
        """Goes on by last_T_current."""
        current_Ad_last = motion.pose.inverse().adjoint()
        P = self.covariance
        P[_POSE] = current_Ad_last @ P[_POSE]
        P[:, _POSE] = P[:, _POSE] @ current_Ad_last.T
        P[_POSE, _POSE] += motion.covariance
        self.pose = self.pose @ motion.pose

    def expected(self, rows: IntArray) -> tuple[FloatArray, FloatArray]:
        """(k, 2) range and bearing of landmarks, and (k, 2, 2) how unsure each is by itself."""
        by_pose, by_landmark = jacobians(self.pose, self.map_t_landmarks[rows])
        P, n = self.covariance, len(self)
        crosses = P[_POSE, 3:].reshape(3, n, 2)[:, rows].transpose(1, 0, 2)
        mixed = by_pose @ crosses @ by_landmark.transpose(0, 2, 1)
        covariances = by_pose @ P[_POSE, _POSE] @ by_pose.transpose(0, 2, 1)
        covariances += mixed + mixed.transpose(0, 2, 1)
        of_landmarks = self.landmark_covariances()[rows]
        covariances += by_landmark @ of_landmarks @ by_landmark.transpose(0, 2, 1)
        return predict(self.pose, self.map_t_landmarks[rows]), covariances

    def joint_covariance(self, rows: IntArray) -> FloatArray:
        """(2k, 2k) of the expected ranges and bearings of landmarks together."""
        H = _Jacobian(self.pose, self.map_t_landmarks, rows)
        return H.times(H.transposed_times(self.covariance))

    def correct(self, rows: IntArray, innovations: FloatArray, noise: FloatArray) -> None:
        """Takes in measurements of landmarks.

        Args:
            rows: (k,) of the landmarks, distinct.
            innovations: (k, 2) measured minus expected.
            noise: (2k, 2k) covariance of the measurements.
        """
        H = _Jacobian(self.pose, self.map_t_landmarks, rows)
        PHt = H.transposed_times(self.covariance)
        S = H.times(PHt) + noise
        K = np.linalg.solve(S, PHt.T).T
        # Joseph's form (I - KH) P (I - KH)^T + K R K^T: no rounding makes it indefinite.
        reduced = self.covariance - K @ PHt.T
        P = reduced - (H.transposed_times(reduced) - K @ noise) @ K.T
        self.covariance = 0.5 * (P + P.T)
        self._shift(K @ innovations.ravel())

    def add(self, ranges_m: FloatArray, bearings: FloatArray, noise: FloatArray) -> None:
        """New landmarks where they are measured from the pose; noise (k, 2, 2)."""
        k = len(ranges_m)
        unit = np.column_stack([np.cos(bearings), np.sin(bearings)])
        base_t_new = ranges_m[:, None] * unit
        map_R_base = rotation(self.pose.theta)
        across = np.stack([-base_t_new[:, 1], base_t_new[:, 0]], axis=1)
        moved = np.broadcast_to(np.eye(2), (k, 2, 2))
        by_pose = map_R_base @ np.concatenate([moved, across[:, :, None]], axis=2)
        by_measured = map_R_base @ np.stack([unit, across], axis=2)
        G = by_pose.reshape(2 * k, 3)
        crosses = G @ self.covariance[_POSE]
        corner = crosses[:, _POSE] @ G.T
        for each, own in enumerate(by_measured @ noise @ by_measured.transpose(0, 2, 1)):
            corner[2 * each : 2 * each + 2, 2 * each : 2 * each + 2] += own
        self.covariance = np.block([[self.covariance, crosses.T], [crosses, corner]])
        self.map_t_landmarks = np.vstack([self.map_t_landmarks, self.pose.transform(base_t_new)])

    def keep(self, rows: IntArray) -> None:
        """Forgets all landmarks but these."""
        kept = np.concatenate([np.arange(3), (3 + 2 * rows[:, None] + [0, 1]).ravel()])
        self.covariance = self.covariance[np.ix_(kept, kept)]
        self.map_t_landmarks = self.map_t_landmarks[rows]

    def _shift(self, correction: FloatArray) -> None:
        """Moves the mean; the pose's errors are from then on in the frame that it turned to."""
        self.pose = self.pose @ Pose2.from_array(correction[_POSE])
        self.map_t_landmarks = self.map_t_landmarks + correction[3:].reshape(-1, 2)
        new_R_old = rotation(-float(correction[2]))
        self.covariance[:2] = new_R_old @ self.covariance[:2]
        self.covariance[:, :2] = self.covariance[:, :2] @ new_R_old.T


@final
class _Jacobian:
    """H of (range, bearing) of some landmarks: full in the pose, and in one landmark each."""

    def __init__(self, pose: Pose2, map_t_landmarks: FloatArray, rows: IntArray) -> None:
        by_pose, self._by_landmark = jacobians(pose, map_t_landmarks[rows])
        self._by_pose = by_pose.reshape(-1, 3)
        self._columns = (3 + 2 * rows[:, None] + [0, 1]).ravel()

    def times(self, matrix: FloatArray) -> FloatArray:
        """H M (2k, m)."""
        k = len(self._by_landmark)
        picked = matrix[self._columns].reshape(k, 2, matrix.shape[1])
        product: FloatArray = self._by_pose @ matrix[_POSE]
        product += (self._by_landmark @ picked).reshape(product.shape)
        return product

    def transposed_times(self, matrix: FloatArray) -> FloatArray:
        """M H^T (m, 2k)."""
        return self.times(matrix.T).T
