"""Calibration of a force sensor: its bias, the tool's weight, and the compliance between tool and surface.

Both are found by moving the arm, as [L] 4.4 says: "calibration can simply be reached by moving the sensor and comparing
the sensor values with the simultaneously measured actual positions of the TCP".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from ideal_robot.arrays import GRAVITY, Array, G
from sensing import SensingError


@dataclass(frozen=True)
class ToolLoad:
    """Bias of a force sensor with the mass and the centre of mass of the tool on it.

    Attributes:
        bias: constant part of the wrench ``(6,)`` [N, N m].
        mass: of the tool [kg].
        com: its centre in the tool frame ``(3,)`` [m].
        residual: standard deviation of the residual, force [N] and moment [N m] ``(2,)``.
    """

    bias: Array
    mass: float
    com: Array
    residual: Array

    def contact(self, wrench: Array, rotation: Array) -> Array:
        """External wrench on the tool ``(6,)``: ``wrench (6,)`` without the tool's weight and the sensor's bias.

        ``rotation (3, 3)`` is the tool frame's in the base frame.
        """
        weight = rotation.T @ (self.mass * GRAVITY)
        (x, y, z), (a, b, c) = self.com, weight
        return wrench - self.bias - np.array([a, b, c, y * c - z * b, z * a - x * c, x * b - y * a])


def identify_tool(wrenches: Array, rotations: Sequence[Array]) -> ToolLoad:
    """Bias, mass and centre of the tool from ``wrenches (N, 6)`` in several orientations without contact.

        f = b_f + Rᵀ g m,        m = b_m + (m c) × Rᵀ g

    linear in bias, mass and the product of mass and centre; R ``(3, 3)`` of the tool frame in the base frame. Raises
    ``SensingError`` where there are too few orientations to separate bias and weight.
    """
    rows, values = [], []
    for wrench, rotation in zip(wrenches, rotations, strict=True):
        g = rotation.T @ GRAVITY
        block = np.zeros((6, 10))
        block[:, :6] = np.eye(6)
        block[:3, 6] = g
        # (m c) × g = −[g]× (m c)
        block[3:, 7:] = -np.array([[0.0, -g[2], g[1]], [g[2], 0.0, -g[0]], [-g[1], g[0], 0.0]])
        rows.append(block)
        values.append(wrench)
    W, Y = np.vstack(rows), np.concatenate(values)
    size = np.linalg.norm(W, axis=0)
    if len(rotations) < 3 or np.any(size == 0) or np.linalg.cond(W / size) > 1e4:
        raise SensingError("bias and weight of the tool cannot be separated: turn the tool into at least three "
                           "clearly different orientations")
    chi = np.linalg.lstsq(W, Y, rcond=None)[0]
    residual = (Y - W @ chi).reshape(-1, 2, 3)
    mass = float(chi[6])
    com = chi[7:] / mass if abs(mass) > 1e-3 else np.zeros(3)
    return ToolLoad(chi[:6], mass, com, np.std(residual, axis=(0, 2)))


UNEXPLAINED = 0.03
"""Share of the tool's weight that gears, links and a tool frame that is a little turned may leave unexplained."""
LIGHTEST = 0.01
"""Mass of the lightest tool [kg]."""
CLEARLY = 5.0
"""Standard deviations from which on something is there that noise does not make: once in a million times."""


def require_gravity(wrenches: Array, rotations: Sequence[Array], t: Array, sigma: Array) -> None:
    """Raises SensingError unless readings vary with the posture as a tool's weight does: f = b + Rᵀ g m, m > 0.

    A sensor without a load still has noise; only a real sensor shows a weight that turns with the posture. The message
    says what the readings look like instead.

    Args:
        wrenches: means at rest ``(N, 6)``.
        rotations: of the tool frame in the base frame, N of them ``(3, 3)``.
        t: times at which they were taken ``(N,)`` [s].
        sigma: standard deviation of their forces ``(3,)`` [N].
    """
    f, noise = wrenches[:, :3], float(np.sqrt(np.mean(np.square(sigma))))
    weights = np.array([rotation.T @ GRAVITY for rotation in rotations])
    spread = float(np.linalg.norm(weights - weights.mean(axis=0)))
    mass, residual = _weighed(f, weights, noise)
    if abs(mass) < max(CLEARLY * noise / spread, LIGHTEST) and residual <= 1.0:
        raise SensingError(f"the force sensor shows the same weight of the tool in {len(rotations)} postures (to "
                           f"{np.ptp(f, axis=0).max():.2g} N): it does not work, or has no load")
    if mass > 0 and residual <= 1.0:
        return
    if residual <= 1.0:
        raise SensingError(f"the force sensor shows a tool of {mass:.3g} kg: its forces have the wrong sign; a wrench "
                           "is what the environment does to the tool")
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        turned = f[:, order] * np.array(signs)
        turned_mass, unexplained = _weighed(turned, weights, noise)
        if turned_mass > 0 and unexplained <= 1.0:
            axes = ", ".join("-"[: sign < 0] + "xyz"[axis] for axis, sign in zip(order, signs, strict=True))
            raise SensingError("the force sensor's axes are not the tool's: a weight turns with the postures as "
                               f"({axes}) would; check how it is mounted and the order of its channels")
    drift = _drift(f, weights, t)
    if _weighed(f - np.outer(t - t.mean(), drift), weights, noise)[1] <= 1.0:
        raise SensingError(f"the force sensor drifts by {np.linalg.norm(drift):.2g} N/s; let it warm up, or check "
                           "its cable for tension")
    allowed = _allowed(noise, mass)
    raise SensingError("the sensed force does not turn with the postures as a weight does: "
                       f"{residual * allowed:.2g} N remain where {allowed:.2g} N may be; the sensor has jumped, or "
                       "the tool is in contact")


def _allowed(noise: float, mass: float) -> float:
    """Largest force that may be left of a tool's weight in any posture [N]."""
    return CLEARLY * noise + UNEXPLAINED * abs(mass) * G


def _weighed(f: Array, weights: Array, noise: float) -> tuple[float, float]:
    """Mass [kg] that explains forces ``(N, 3)`` best, and the largest force left as a share of what may be left."""
    g, f = weights - weights.mean(axis=0), f - f.mean(axis=0)
    mass = float(np.sum(g * f) / np.sum(g * g))
    return mass, float(np.linalg.norm(f - mass * g, axis=1).max()) / _allowed(noise, mass)


def _drift(f: Array, weights: Array, t: Array) -> Array:
    """Change of the bias ``(3,)`` [N/s] that, with a weight, explains forces ``(N, 3)`` best."""
    N, rows = len(t), []
    for weight, instant in zip(weights, t - t.mean(), strict=True):
        rows.append(np.column_stack([weight, np.eye(3), instant * np.eye(3)]))
    return np.asarray(np.linalg.lstsq(np.concatenate(rows), f.reshape(3 * N), rcond=None)[0][4:])


TOUCHING = 2.0
"""Force below which the tip may not be in touch [N]."""


@dataclass(frozen=True)
class ContactElasticity:
    """The elasticity E of [L] (3), contact force per displacement, and its standard deviation [N/m].

    The force begins at ``touch`` [m] along the direction of motion.
    """

    stiffness: float
    std: float
    touch: float


def identify_elasticity(position: Array, force: Array) -> ContactElasticity:
    """E by moving: normal ``force (N,)`` [N] against the simultaneous TCP ``position (N,)`` [m] ([L] 4.4).

    The position is along the surface's normal, larger further away. Raises ``SensingError`` where there are too few
    samples in touch, or no range of forces.
    """
    touching = force > TOUCHING
    if np.count_nonzero(touching) < 10 or np.ptp(force[touching]) < 2 * TOUCHING:
        raise SensingError("the tip must be pressed with clearly different forces to find its elasticity; press harder")
    x, f = position[touching], force[touching]
    W = np.column_stack([-x, np.ones(len(x))])
    chi, *_ = np.linalg.lstsq(W, f, rcond=None)
    rho = f - W @ chi
    covariance = rho @ rho / (len(f) - 2) * np.linalg.inv(W.T @ W)
    if chi[0] <= 0:
        raise SensingError("the force does not rise when the tip is pressed in; check the sensor's sign and the "
                           "direction")
    touch = float(chi[1] / chi[0])
    return ContactElasticity(float(chi[0]), float(np.sqrt(covariance[0, 0])), touch)
