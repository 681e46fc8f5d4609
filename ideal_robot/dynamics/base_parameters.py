"""Base parameters: the smallest set of linear combinations that the joint torques can show ([G] 3.1.2).

Found numerically from the QR decomposition of the regressor at random states, for any serial arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import clarabel
import numpy as np
import pinocchio as pin
from scipy import linalg, sparse

from ideal_robot.arrays import Array
from ideal_robot.bounded_values import kept_words
from ideal_robot.dynamics.regressor import LINK_PARAMETERS, LINK_UNITS, regressor
from ideal_robot.errors import IdealRobotError
from ideal_robot.robots.robot import joint_units
from ideal_robot.tolerances import DEPENDENT, LEAST_EIGENVALUE, NOMINAL_WEIGHT

_PREFERENCE = ("Ixy", "Ixz", "Iyz", "Izz", "Ixx", "Iyy", "mx", "my", "mz", "m")
"""Which of several dependent link parameters stays in the base: what is usually named in print comes first."""

_CLEAR = 0.01
"""Share of a column, apart from those before it, from which on the preference decides. A column of which only a
thousandth is its own would be in the base for what another one shows plainly: no motion tells it in its numbers."""


@dataclass(frozen=True)
class BaseParameters:
    """Which parameters are in the base and how the others are grouped into them.

    Full parameters are, in this order: ten a link (``m_1 … Izz_n``), the rotor inertias reflected to the joint side
    ``Ia_1 … Ia_n`` and the constant torque offsets ``offset_1 … offset_n``; ``p = 12 n`` in all.

    Attributes:
        full_names: names of the full parameters.
        full_units: their units.
        independent: indices of the ``b`` columns that stay, in base order.
        grouping: matrix ``(b, p)`` from full to base parameters.
        gravitational: mask ``(b,)``: those that occur in g(q) are p_g, the others p_m ([G] (6)).
    """

    full_names: tuple[str, ...]
    full_units: tuple[str, ...]
    independent: tuple[int, ...]
    grouping: Array
    gravitational: tuple[bool, ...]

    @property
    def count(self) -> int:
        """Number of base parameters."""
        return len(self.independent)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the base parameters: that of the parameter the others are grouped into."""
        return tuple(self.full_names[i] for i in self.independent)

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the base parameters."""
        return tuple(self.full_units[i] for i in self.independent)

    @property
    def joints(self) -> tuple[int, ...]:
        """Joint, counted from 1, that each base parameter is named after."""
        return tuple(int(name.rsplit("_", 1)[1]) for name in self.names)

    def words(self) -> tuple[str, ...]:
        """Each base parameter as the sum it stands for, e.g. ``Izz_1 + Ia_1 + Iyy_2 + 0.09·m_2``."""
        return tuple(" ".join(self._terms(row)) for row in self.grouping)

    def _terms(self, row: Array) -> list[str]:
        own = int(np.flatnonzero(row == 1.0)[0]) if np.any(row == 1.0) else 0
        order = [own, *[int(i) for i in np.flatnonzero(np.abs(row) > 1e-7) if i != own]]
        terms: list[str] = []
        for i in order:
            size = abs(row[i])
            factor = "" if abs(size - 1.0) < 1e-7 else f"{size:.4g}·"
            sign = "-" if row[i] < 0 else ("+" if terms else "")
            terms.append(f"{sign} {factor}{self.full_names[i]}".strip())
        return terms

    def of(self, full: Array) -> Array:
        """Base parameters ``(b,)`` of full ones ``(p,)``."""
        return self.grouping @ full

    def nearest_full(self, base: Array, start: Array) -> Array:
        """The full parameters ``(p,)`` that have exactly these base parameters and lie closest to ``start (p,)``."""
        return start + np.linalg.lstsq(self.grouping, base - self.grouping @ start, rcond=None)[0]


def full_regressor(model: pin.Model, q: Array, qd: Array, qdd: Array, columns: Sequence[int] | None = None) -> Array:
    """Regressor ``(N, n, 12 n)`` of links, rotor inertias and offsets, in the order of ``BaseParameters``.

    Args:
        model: kinematics; its inertias do not matter.
        q, qd, qdd: joint positions, velocities and accelerations ``(N, n)`` [rad, rad/s, rad/s²].
        columns: those wanted of the ``12 n``, in their order; zeros for any beyond; all if None.

    Raises:
        InputError: the model branches, or a joint has more than one degree of freedom.
    """
    n = model.nv
    wanted = np.arange(12 * n) if columns is None else np.asarray(columns, dtype=int)
    result = regressor(model, q, qd, qdd, wanted.tolist())
    for place in np.flatnonzero((wanted >= 10 * n) & (wanted < 12 * n)):
        kind, joint = divmod(int(wanted[place]) - 10 * n, n)
        result[:, joint, place] = 1.0 if kind else qdd[:, joint]
    return result


def full_names(n: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names and units of the full parameters of an arm with ``n`` joints."""
    names = [f"{key}_{i + 1}" for i in range(n) for key in LINK_PARAMETERS]
    units = list(LINK_UNITS) * n
    names += [f"Ia_{i + 1}" for i in range(n)] + [f"offset_{i + 1}" for i in range(n)]
    units += ["kg m²"] * n + ["N m"] * n
    return tuple(names), tuple(units)


def base_parameters(model: pin.Model) -> BaseParameters:
    """The base parameters of any serial arm, by numerical QR; Pinocchio has merged the fixed joints."""
    n = model.nv
    # Random states at which the regressor is evaluated; the result does not depend on which.
    rng = np.random.default_rng(0)
    count = 40 * n
    q = rng.uniform(-np.pi, np.pi, (count, n))
    qd, qdd = rng.normal(size=(count, n)), rng.normal(size=(count, n))
    W = full_regressor(model, q, qd, qdd).reshape(count * n, 12 * n)
    names, units = full_names(n)
    units = (*units[: 10 * n], *joint_units("kg m²", model), *joint_units("N m", model))

    order = _order(n)
    size = np.linalg.norm(W, axis=0)
    visible = [i for i in order if size[i] > DEPENDENT * size.max()]
    independent = _independent(W[:, visible] / size[visible], visible)
    dependent = [i for i in visible if i not in independent]
    grouping = np.zeros((len(independent), 12 * n))
    grouping[np.arange(len(independent)), independent] = 1.0
    if dependent:
        beta = np.linalg.lstsq(W[:, independent], W[:, dependent], rcond=None)[0]
        beta[np.abs(beta) < 1e-7] = 0.0
        grouping[:, dependent] = beta

    by_name = np.argsort(independent, kind="stable")
    independent = [independent[i] for i in by_name]
    grouping = grouping[by_name]
    grouping.setflags(write=False)
    at_rest = full_regressor(model, q, np.zeros_like(q), np.zeros_like(q)).reshape(count * n, 12 * n)
    gravitational = np.linalg.norm(at_rest[:, independent], axis=0) > DEPENDENT * size.max()
    return BaseParameters(names, units, tuple(independent), grouping, tuple(bool(g) for g in gravitational))


def _independent(W: Array, columns: Sequence[int]) -> list[int]:
    """Those of ``columns``, the names of columns ``W (N, c)`` of length one, that span all, the preferred ones first.

    Of dependent ones the first, or the clearest where they hardly depend.
    """
    # W = Q R: a column whose diagonal element of R vanishes depends on the ones before it.
    R = linalg.qr(W, mode="economic")[1]
    clear = np.abs(np.diag(R)) > _CLEAR
    # What those leave of the others, the largest first.
    Q = linalg.qr(W[:, clear], mode="economic")[0]
    rest = W[:, ~clear] - Q @ (Q.T @ W[:, ~clear])
    added: list[int] = []
    if rest.shape[1]:
        R, order = linalg.qr(rest, mode="r", pivoting=True)
        own = np.abs(np.diag(R[: rest.shape[1]]))
        unclear = np.flatnonzero(~clear)
        added = [int(unclear[k]) for k, size in zip(order, own, strict=True) if size > DEPENDENT]
    return [columns[i] for i in sorted([*map(int, np.flatnonzero(clear)), *added])]


def _order(n: int) -> list[int]:
    """Column order for the QR: offsets and rotor inertias of their own joints last but offsets, links base to tip."""
    links = [10 * i + LINK_PARAMETERS.index(key) for key in _PREFERENCE for i in range(n)]
    return [*range(11 * n, 12 * n), *links, *range(10 * n, 11 * n)]


# Inertias that real bodies can have, closest to identified base parameters.
#
# A body's mass, first moments and inertia are possible exactly if its pseudo-inertia matrix ::
#
#     P = [ tr(I)/2 · 1 - I    m c ]
#         [ (m c)ᵀ             m   ]   with I about the link frame's origin
#
# is positive definite (Wensing, Kim and Slotine 2018). The nearest possible parameters are a semidefinite program; it
# is solved with Clarabel.



@dataclass(frozen=True)
class Consistency:
    """Physically possible full parameters and how they compare with the identified base parameters.

    Attributes:
        full: possible parameters ``(p,)``: links, rotor inertias, offsets.
        deviation: possible minus identified base parameters in their standard deviations ``(b,)``.
        smallest_eigenvalue: of each link's pseudo-inertia matrix before and after ``(n, 2)``; before belongs to the
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


def consistent_parameters(base: BaseParameters, values: Array, covariance: Array, nominal: Array) -> Consistency:
    """The physically possible full parameters closest to identified base parameters.

    Args:
        base: grouping of the parameters.
        values, covariance: identified base parameters ``(b,)``, and theirs ``(b, b)``; closeness is measured in it.
        nominal: full parameters ``(p,)``, physically possible, that what cannot be seen keeps near to.

    Raises:
        IdealRobotError: the solver finds no solution, or the covariance is none.
    """
    n = len(nominal) // 12
    scale = parameter_scales(nominal, n)
    # Whitened distance to the base parameters; a floor keeps parameters of tiny variance from spoiling the numbers.
    std = np.sqrt(np.diag(covariance))
    size = np.maximum(np.abs(values), 1e-3 * np.max(np.abs(values)))
    floor = np.where(std > 0, np.maximum(std, 1e-4 * size), 1e-2 * size)
    correlation = covariance / np.outer(np.maximum(std, 1e-100), np.maximum(std, 1e-100))
    correlation = 0.999 * np.where(np.outer(std > 0, std > 0), correlation, 0.0)
    np.fill_diagonal(correlation, 1.0)
    try:
        whiten = np.linalg.inv(np.linalg.cholesky(correlation + 1e-9 * np.eye(len(std)))) / floor
    except np.linalg.LinAlgError:
        raise IdealRobotError("the identified parameters have no usable standard deviations, so that no physically "
                              "possible inertias can be near them; check masses, lengths and inertias of the robot "
                              "description for numbers that cannot be") from None
    # Unknowns are the full parameters in units of their scales.
    A = np.vstack([whiten @ base.grouping * scale, np.sqrt(NOMINAL_WEIGHT) * np.eye(len(nominal))])
    b = np.concatenate([whiten @ values, np.sqrt(NOMINAL_WEIGHT) * nominal / scale])
    solved = _solve(A, b, scale, nominal, n)
    full = solved * scale
    exact = base.nearest_full(values, nominal)
    eigenvalues = np.array([[np.linalg.eigvalsh(pseudo_inertia(p[10 * i : 10 * i + 10]))[0] for p in (exact, full)]
                            for i in range(n)])
    possible = bool(np.all(eigenvalues[:, 0] > 0) and np.all(exact[10 * n : 11 * n] >= 0))
    return Consistency(full, (base.of(full) - values) / floor, eigenvalues, possible)


def _solve(A: Array, b: Array, scale: Array, nominal: Array, n: int) -> Array:
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
    for i in range(n):
        span = slice(10 * i, 10 * i + 10)
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
    rotor[np.arange(n), 10 * n + np.arange(n)] = -1.0
    rows.append(rotor)
    rhs.append(np.zeros(n))
    cones.append(clarabel.NonnegativeConeT(n))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    # What keeps the unseen parameters weighs little; its squares must still count.
    settings.tol_gap_abs = settings.tol_gap_rel = 1e-13
    G = np.vstack(rows)
    solver = clarabel.DefaultSolver(P, q, sparse.csc_matrix(G * size), np.concatenate(rhs) - G @ start, cones, settings)
    try:
        with kept_words():
            result = solver.solve()
    except BaseException as error:
        # Where eigenvalues of an iterate do not converge, Clarabel ends in a panic of Rust: no Exception, and of a
        # class that cannot be imported.
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


def parameter_scales(nominal: Array, n: int) -> Array:
    """Typical size of each full parameter, from the nominal arm."""
    scale = np.ones(len(nominal))
    mass = max(1e-3, float(np.mean(np.abs(nominal[: 10 * n : 10]))))
    for i in range(n):
        link = nominal[10 * i : 10 * i + 10]
        m = max(abs(link[0]), 0.02 * mass)
        length = max(0.05, float(np.sqrt(np.trace(pseudo_inertia(link)[:3, :3]) / m)))
        scale[10 * i] = m
        scale[10 * i + 1 : 10 * i + 4] = m * length
        scale[10 * i + 4 : 10 * i + 10] = m * length**2
        scale[10 * n + i] = m * length**2
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
