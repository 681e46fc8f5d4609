"""The two steps of a Kalman filter.

Own ones: the library at hand loads statistics and plots with it, 60 MB that a process that leads an arm need not hold.
"""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array


class KalmanFilter:
    """State and covariance; the law test holds them against ``filterpy``, bit for bit.

    Args:
        x: state ``(k,)``.
        P: its covariance ``(k, k)``.
    """

    def __init__(self, x: Array, P: Array) -> None:
        self.x, self.P = x, P
        self._unit = np.eye(len(x))

    def predict(self, F: Array, Q: Array) -> None:
        """One step, x ← F x, P ← F P Fᵀ + Q.

        Args:
            F: ``(k, k)``.
            Q: ``(k, k)``.
        """
        self.x = np.dot(F, self.x)
        self.P = np.dot(np.dot(F, self.P), F.T) + Q

    def update(self, z: Array, R: Array, H: Array) -> None:
        """Takes in a measurement; the covariance in the form of Joseph, which stays positive.

        Args:
            z: values ``(m,)``.
            R: their covariance ``(m, m)``.
            H: how they follow from the state ``(m, k)``.
        """
        innovation = z - np.dot(H, self.x)
        PHT = np.dot(self.P, H.T)
        K = np.dot(PHT, np.linalg.inv(np.dot(H, PHT) + R))
        self.x = self.x + np.dot(K, innovation)
        left = self._unit - np.dot(K, H)
        self.P = np.dot(np.dot(left, self.P), left.T) + np.dot(np.dot(K, R), K.T)
