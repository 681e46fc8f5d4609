"""One field as one measurement: the polynomial through its points, by its value and slope in their middle ([L] 5)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planning.line.fusion import Measurement
from sensing.camera.line_polynomial import LinePolynomial, fit_of_lowest_order


def polynomial_measurement(points: Measurement) -> tuple[Measurement, LinePolynomial]:
    r"""Value and slope of the deviation in the middle of a field, with their covariance.

    [L] 5: the line is "represented by a polynomial which is computed from 5 detected line points". Its coefficients
    are a linear combination of the points' deviations, c = A Δ, so everything that holds of the points carries over
    without approximation, also what the points have in common:

    .. math:: z = A \Delta,\quad H = A H_\Delta,\quad R = A R_\Delta A^T,\quad B = A B_\Delta

    with the first two rows of A, the value and the slope. The filter so compares the field's polynomial with the one
    that the same fit makes of its map: an order too low for the line leaves no bias in the map.

    Args:
        points: deviations of the single points, at least two, with the sensor's errors.

    Raises:
        SensingError: fewer than two usable points.
    """
    polynomial = fit_of_lowest_order(points.s, points.value, np.sqrt(np.diag(points.covariance)))
    A = polynomial.combination[:2] / np.array([1.0, polynomial.scale])[:, None]
    bias = None if points.bias is None else A @ points.bias
    measurement = replace(points, value=A @ points.value, covariance=A @ points.covariance @ A.T, bias=bias,
                          combination=A)
    return measurement, polynomial
