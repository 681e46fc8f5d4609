"""Inertias that real bodies can have, closest to identified base parameters.

A body's mass, first moments and inertia are possible exactly if its pseudo-inertia matrix ::

    P = [ tr(I)/2 · 1 - I    m c ]
        [ (m c)ᵀ             m   ]   with I about the link frame's origin

is positive definite (Wensing, Kim and Slotine 2018). The nearest possible parameters are a semidefinite program; it
is solved with Clarabel.
"""

from __future__ import annotations

from dataclasses import dataclass

import clarabel
import numpy as np
from scipy import sparse

from ideal_robot.arrays import Array
from ideal_robot.bounded_values import kept_words
from ideal_robot.dynamics.base_parameters import BaseParameters, FullLayout
from ideal_robot.errors import IdealRobotError
from ideal_robot.tolerances import LEAST_EIGENVALUE, NOMINAL_WEIGHT

LINK, BODY = 0.10, 0.05
"""By what links of one type of arm differ: each as a whole, and each of its ten parameters of its scale."""


@dataclass(frozen=True)
class Consistency:
    """Physically possible full parameters and their agreement with the identified base parameters.

    Attributes:
        full: possible parameters ``(p,)``: links, rotor inertias, offsets.
        deviation: possible minus identified base parameters in their standard deviations ``(b,)``.
        smallest_eigenvalue: of each link's pseudo-inertia matrix before and after ``(links, 2)``; before belongs to the
            full parameters nearest the nominal ones that have exactly the identified base parameters.
        was_consistent: whether those were possible already.
    """

    full: Array
    deviation: Array
    smallest_eigenvalue: Array
    was_consistent: bool


def pseudo_inertia(link: Array) -> Array:
    """Pseudo-inertia matrix ``(4, 4)`` of ten link parameters in Pinocchio's order."""
    return np.einsum("i,iab->ab", np.asarray(link, dtype=float), _BASIS)


def consistent_parameters(base: BaseParameters, values: Array, covariance: Array, nominal: Array,
                          rotors: Array | None = None) -> Consistency:
    """The physically possible full parameters closest to identified base parameters.

    Args:
        base: grouping of the parameters.
        values, covariance: identified base parameters ``(b,)``, and theirs ``(b, b)``; closeness is measured in it.
        nominal: full parameters ``(p,)``, physically possible, to which undetermined parameters stay near.
        rotors: standard deviations of the rotor inertias from the nominal ones ``(n,)`` [kg m²]; the size of their
            links' if None.

    Raises:
        IdealRobotError: the solver finds no solution, or the covariance is none.
    """
    layout = base.layout
    scale = parameter_scales(nominal, layout)
    # Whitened distance to the base parameters; a floor on the variances keeps the problem well conditioned.
    std = np.sqrt(np.diag(covariance))
    size = np.maximum(np.abs(values), 1e-3 * np.max(np.abs(values)))
    floor = np.where(std > 0, np.maximum(std, 1e-4 * size), 1e-2 * size)
    correlation = covariance / np.outer(np.maximum(std, 1e-100), np.maximum(std, 1e-100))
    correlation = 0.999 * np.where(np.outer(std > 0, std > 0), correlation, 0.0)
    np.fill_diagonal(correlation, 1.0)
    try:
        whiten = np.linalg.inv(np.linalg.cholesky(correlation + 1e-9 * np.eye(len(std)))) / floor
    except np.linalg.LinAlgError:
        raise IdealRobotError("the identified parameters have no usable standard deviations, so the nearest "
                              "physically possible inertias cannot be computed; check masses, lengths and inertias of "
                              "the robot description for impossible numbers") from None
    # Unknowns are the full parameters in units of their scales.
    spread = scale.copy()
    if rotors is not None:
        spread[layout.rotors] = rotors
    near = np.sqrt(NOMINAL_WEIGHT) * scale / spread
    A = np.vstack([whiten @ base.grouping * scale, np.diag(near)])
    b = np.concatenate([whiten @ values, near * nominal / scale])
    solved = _solve(A, b, scale, nominal, layout)
    full = solved * scale
    exact = base.nearest_full(values, nominal)
    eigenvalues = np.array([[np.linalg.eigvalsh(pseudo_inertia(p[layout.link(i)]))[0] for p in (exact, full)]
                            for i in range(layout.bodies)])
    possible = bool(np.all(eigenvalues[:, 0] > 0) and np.all(exact[layout.rotors] >= 0))
    return Consistency(full, (base.of(full) - values) / floor, eigenvalues, possible)


def _solve(A: Array, b: Array, scale: Array, nominal: Array, layout: FullLayout) -> Array:
    """Minimum of ‖A x - b‖² subject to positive pseudo-inertias and rotor inertias.

    Solved for the difference from the nearest unconstrained point: with precise recordings ‖b‖² is so large that the
    solver's relative tolerance would swallow what keeps the parameters that cannot be seen at their nominal values.
    """
    start = np.linalg.lstsq(A, b, rcond=None)[0]
    gram = 2.0 * A.T @ A
    size = 1.0 / np.sqrt(np.diag(gram))
    P = sparse.csc_matrix(np.triu(gram * np.outer(size, size)))
    q = np.zeros(A.shape[1])
    rows, rhs, cones = [], [], []
    n = len(layout.own)
    for i in range(layout.bodies):
        span = layout.link(i)
        block = np.zeros((10, len(nominal)))
        # Clarabel's cone: s = rhs - G x in the upper triangle, column by column, off-diagonals times √2. Scaling
        # rows and columns of the matrix alike does not change its definiteness.
        body = pseudo_inertia(nominal[span])
        shrink = 1.0 / np.sqrt(np.maximum(np.diag(body), 1e-6))
        block[:, span] = np.array([_triangle(shrink[:, None] * _BASIS[k] * shrink) * scale[span][k]
                                   for k in range(10)]).T
        rows.append(-block)
        rhs.append(-LEAST_EIGENVALUE * _triangle(np.eye(4)))
        cones.append(clarabel.PSDTriangleConeT(4))
    rotor = np.zeros((n, len(nominal)))
    rotor[:, layout.rotors] = -np.eye(n)
    rows.append(rotor)
    rhs.append(np.zeros(n))
    cones.append(clarabel.NonnegativeConeT(n))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    # The term for undetermined parameters is small, so the solver's gap has to be smaller still.
    settings.tol_gap_abs = settings.tol_gap_rel = 1e-13
    G = np.vstack(rows)
    solver = clarabel.DefaultSolver(P, q, sparse.csc_matrix(G * size), np.concatenate(rhs) - G @ start, cones, settings)
    try:
        with kept_words():
            result = solver.solve()
    except BaseException as error:
        # If the eigenvalues of an iterate do not converge, Clarabel raises a panic of Rust, whose class cannot be
        # imported and is no Exception.
        if type(error).__name__ != "PanicException":
            raise
        raise _none_found(str(error)) from None
    if str(result.status) not in ("Solved", "AlmostSolved"):
        raise _none_found(str(result.status))
    return np.asarray(start + size * np.array(result.x))


def _none_found(why: str) -> IdealRobotError:
    return IdealRobotError(f"no physically possible inertias found near the identified ones ({why}); check the "
                           "warnings about excitation")


def _triangle(matrix: Array) -> Array:
    weights = np.sqrt(2.0) * np.ones((4, 4)) + (1.0 - np.sqrt(2.0)) * np.eye(4)
    return np.array([matrix[i, j] * weights[i, j] for j in range(4) for i in range(j + 1)])


def parameter_scales(nominal: Array, layout: FullLayout) -> Array:
    """Typical size of each full parameter ``(p,)``, from those of the nominal arm ``(p,)``."""
    scale = np.ones(len(nominal))
    mass = max(1e-3, float(np.mean(np.abs(nominal[layout.links][::10]))))
    for i in range(layout.bodies):
        link = nominal[layout.link(i)]
        m = max(abs(link[0]), 0.02 * mass)
        length = max(0.05, float(np.sqrt(np.trace(pseudo_inertia(link)[:3, :3]) / m)))
        scale[layout.link(i)] = [m, *[m * length] * 3, *[m * length**2] * 6]
    # A joint's rotor is compared with the moments of inertia of its own link.
    scale[layout.rotors] = [scale[10 * i + 4] for i in layout.own]
    return scale


def _basis() -> Array:
    """Derivative of the pseudo-inertia with respect to each of the ten parameters ``(10, 4, 4)``."""
    basis = np.zeros((10, 4, 4))
    basis[0, 3, 3] = 1.0
    for a in range(3):
        basis[1 + a, a, 3] = basis[1 + a, 3, a] = 1.0
    for k, (a, c) in zip((4, 5, 6, 7, 8, 9), ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)), strict=True):
        inertia = np.zeros((3, 3))
        inertia[a, c] = inertia[c, a] = 1.0
        basis[k, :3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    return basis


_BASIS = _basis()
