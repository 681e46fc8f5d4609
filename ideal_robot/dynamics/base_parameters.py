"""Base parameters: the smallest set of linear combinations that joint torques determine ([G] 3.1.2).

Found numerically from the QR decomposition of the regressor at random states, for any serial arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy import linalg

from ideal_robot.arrays import Array
from ideal_robot.dynamics.regressor import LINK_PARAMETERS, LINK_UNITS, regressor
from ideal_robot.robots.joints import joint_motions, own_joints
from ideal_robot.robots.robot import joint_units
from ideal_robot.tolerances import DEPENDENT

_PREFERENCE = ("Ixy", "Ixz", "Iyz", "Izz", "Ixx", "Iyy", "mx", "my", "mz", "m")
"""Which of several dependent link parameters stays in the base: what is usually named in print comes first."""

FOLLOWING = "bcdefghijklmnopqrstuvwxyz"
"""What links that follow a joint are told apart by."""
_CLEAR = 0.01
"""Share of a column, apart from those before it, from which on the preference decides. A column of which only a
thousandth is its own would be in the base for what another one shows plainly: no motion tells it in its numbers."""


class FullLayout(NamedTuple):
    """Positions of an arm's full parameters: ten per link, then the rotor inertias and offsets of its ``n`` joints.

    Attributes:
        bodies: number of links; n where no joint follows another one.
        own: link that each joint moves itself, from 0 ``(n,)``.
    """

    bodies: int
    own: tuple[int, ...]

    @classmethod
    def of(cls, model: pin.Model) -> FullLayout:
        """The layout of a Pinocchio model's arm."""
        return cls(model.njoints - 1, tuple(j - 1 for j in own_joints(model)))

    @property
    def size(self) -> int:
        """Number of full parameters: 12 n where no joint follows another one."""
        return 10 * self.bodies + 2 * len(self.own)

    @property
    def links(self) -> slice:
        """Slice of all links' parameters."""
        return slice(0, 10 * self.bodies)

    @property
    def rotors(self) -> slice:
        """Slice of the rotor inertias."""
        return slice(10 * self.bodies, 10 * self.bodies + len(self.own))

    @property
    def offsets(self) -> slice:
        """Slice of the torque offsets."""
        return slice(10 * self.bodies + len(self.own), self.size)

    def link(self, i: int) -> slice:
        """Slice of a link's ten parameters, counted from 0 along the chain."""
        return slice(10 * i, 10 * i + 10)

    def carried_by(self, joint: int) -> slice:
        """Slice of the ten parameters of the link that a joint, counted from 1, moves; 0 is the last one."""
        return self.link(self.own[joint - 1] if joint > 0 else self.bodies - 1)


@dataclass(frozen=True)
class BaseParameters:
    """Which parameters are in the base and how the others are grouped into them.

    Full parameters are, in this order: ten a link (``m_1 … Izz_n``), the rotor inertias reflected to the joint side
    ``Ia_1 … Ia_n`` and the constant torque offsets ``offset_1 … offset_n``; ``p = 12 n`` in all. Links that are coupled
    to joint 2 have the names ``m_2b``, ``m_2c`` and so on, ten parameters each.

    Attributes:
        full_names: names of the full parameters.
        full_units: their units.
        independent: indices of the ``b`` columns that stay, in base order.
        grouping: matrix ``(b, p)`` from full to base parameters.
        gravitational: mask ``(b,)``: those that occur in g(q) are p_g, the others p_m ([G] (6)).
        layout: positions of the full parameters.
    """

    full_names: tuple[str, ...]
    full_units: tuple[str, ...]
    independent: tuple[int, ...]
    grouping: Array
    gravitational: tuple[bool, ...]
    layout: FullLayout

    @property
    def count(self) -> int:
        """Number of base parameters."""
        return len(self.independent)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the base parameters: each is that of the parameter into which others are grouped."""
        return tuple(self.full_names[i] for i in self.independent)

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the base parameters."""
        return tuple(self.full_units[i] for i in self.independent)

    @property
    def joints(self) -> tuple[int, ...]:
        """Joint, counted from 1, that each base parameter is named after."""
        return tuple(int(name.rsplit("_", 1)[1].rstrip(FOLLOWING)) for name in self.names)

    def words(self) -> tuple[str, ...]:
        """Each base parameter as a sum of full ones, e.g. ``Izz_1 + Ia_1 + Iyy_2 + 0.09·m_2``."""
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
    """Regressor ``(N, n, p)`` of links, rotor inertias and offsets, in the order of ``BaseParameters``.

    Args:
        model: kinematics; its inertias do not matter.
        q, qd, qdd: joint positions, velocities and accelerations ``(N, n)`` [rad, rad/s, rad/s²].
        columns: indices of the wanted columns, in their order; zeros for any beyond ``p``; all if None.

    Raises:
        InputError: the model branches, or a joint has more than one degree of freedom.
    """
    n, layout = model.nv, FullLayout.of(model)
    wanted = np.arange(layout.size) if columns is None else np.asarray(columns, dtype=int)
    result = regressor(model, q, qd, qdd, wanted.tolist())
    for place in np.flatnonzero((wanted >= layout.rotors.start) & (wanted < layout.size)):
        kind, joint = divmod(int(wanted[place]) - layout.rotors.start, n)
        result[:, joint, place] = 1.0 if kind else qdd[:, joint]
    return result


def link_labels(model: pin.Model) -> tuple[str, ...]:
    """Labels of the links by the joints that move them: "2", and "2b", "2c" for links coupled to joint 2."""
    labels, followers = [], [0] * model.nv
    motions = joint_motions(model)
    for joint, own in zip(motions.coordinate, motions.own, strict=True):
        followers[joint] += not own
        labels.append(f"{joint + 1}" if own else f"{joint + 1}{FOLLOWING[followers[joint] - 1]}")
    return tuple(labels)


def full_names(model: pin.Model) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names and units of the full parameters of an arm."""
    labels, n = link_labels(model), model.nv
    names = [f"{key}_{label}" for label in labels for key in LINK_PARAMETERS]
    names += [f"Ia_{i + 1}" for i in range(n)] + [f"offset_{i + 1}" for i in range(n)]
    return tuple(names), (*LINK_UNITS * len(labels), *joint_units("kg m²", model), *joint_units("N m", model))


def base_parameters(model: pin.Model) -> BaseParameters:
    """The base parameters of any serial arm, by numerical QR; Pinocchio has merged the fixed joints."""
    n = model.nv
    # Random states at which the regressor is evaluated; the result does not depend on which.
    rng = np.random.default_rng(0)
    count = 40 * n
    q = rng.uniform(-np.pi, np.pi, (count, n))
    qd, qdd = rng.normal(size=(count, n)), rng.normal(size=(count, n))
    layout = FullLayout.of(model)
    W = full_regressor(model, q, qd, qdd).reshape(count * n, layout.size)
    names, units = full_names(model)

    order = _order(layout)
    size = np.linalg.norm(W, axis=0)
    visible = [i for i in order if size[i] > DEPENDENT * size.max()]
    independent = _independent(W[:, visible] / size[visible], visible)
    dependent = [i for i in visible if i not in independent]
    grouping = np.zeros((len(independent), layout.size))
    grouping[np.arange(len(independent)), independent] = 1.0
    if dependent:
        beta = np.linalg.lstsq(W[:, independent], W[:, dependent], rcond=None)[0]
        beta[np.abs(beta) < 1e-7] = 0.0
        grouping[:, dependent] = beta

    by_name = np.argsort(independent, kind="stable")
    independent = [independent[i] for i in by_name]
    grouping = grouping[by_name]
    grouping.setflags(write=False)
    at_rest = full_regressor(model, q, np.zeros_like(q), np.zeros_like(q)).reshape(count * n, layout.size)
    gravitational = np.linalg.norm(at_rest[:, independent], axis=0) > DEPENDENT * size.max()
    return BaseParameters(names, units, tuple(independent), grouping, tuple(bool(g) for g in gravitational),
                          layout)


def _independent(W: Array, columns: Sequence[int]) -> list[int]:
    """Those of ``columns``, the names of columns ``W (N, c)`` of length one, that span all, the preferred ones first.

    Of dependent ones the first, or the clearest where they hardly depend.
    """
    # W = Q R: a column whose diagonal element of R vanishes depends on the ones before it.
    R = linalg.qr(W, mode="economic")[1]
    clear = np.abs(np.diag(R)) > _CLEAR
    # Part of the other columns that is independent of those, the largest first.
    Q = linalg.qr(W[:, clear], mode="economic")[0]
    rest = W[:, ~clear] - Q @ (Q.T @ W[:, ~clear])
    added: list[int] = []
    if rest.shape[1]:
        R, order = linalg.qr(rest, mode="r", pivoting=True)
        own = np.abs(np.diag(R[: rest.shape[1]]))
        unclear = np.flatnonzero(~clear)
        added = [int(unclear[k]) for k, size in zip(order, own, strict=True) if size > DEPENDENT]
    return [columns[i] for i in sorted([*map(int, np.flatnonzero(clear)), *added])]


def _order(layout: FullLayout) -> list[int]:
    """Column order for the QR: offsets and rotor inertias of their own joints last but offsets, links base to tip."""
    links = [10 * i + LINK_PARAMETERS.index(key) for key in _PREFERENCE for i in range(layout.bodies)]
    every = range(layout.size)
    return [*every[layout.offsets], *links, *every[layout.rotors]]
