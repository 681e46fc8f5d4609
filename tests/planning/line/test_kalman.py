"""The own Kalman filter against the library's."""

import numpy as np
from filterpy.kalman import KalmanFilter as Peer

from planning.line.kalman import KalmanFilter


def test_the_same_numbers_as_filterpy_bit_for_bit() -> None:
    rng = np.random.default_rng(1)
    x, root = rng.standard_normal(7), rng.standard_normal((7, 7))
    own, peer = KalmanFilter(x.copy(), root @ root.T), Peer(dim_x=7, dim_z=1)
    peer.x, peer.P = x.copy(), root @ root.T
    for m in (1, 3, 5, 1, 2):
        F, Q = np.eye(7) + 0.1 * rng.standard_normal((7, 7)), 0.01 * np.eye(7)
        z, H, noise = rng.standard_normal(m), rng.standard_normal((m, 7)), rng.standard_normal((m, m))
        R = np.eye(m) + noise @ noise.T
        for each in (own, peer):
            each.predict(F=F, Q=Q)
            each.update(z, R=R, H=H)
        np.testing.assert_array_equal(own.x, peer.x)
        np.testing.assert_array_equal(own.P, peer.P)
