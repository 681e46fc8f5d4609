"""The identified dynamic model of an arm: what precorrection inverts and what diagnosis subtracts."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.dynamics import (
    BaseParameters,
    base_parameters,
    link_parameters,
    torques,
    with_link_parameters,
)
from ideal_robot.effects import MOTOR_TORQUE, FittedEffect, Signals
from ideal_robot.errors import InputError
from ideal_robot.friction import PerJointFriction
from ideal_robot.model.controller_model import ControllerModel
from ideal_robot.model.parametrisation import Parameter, described, sensitivity
from ideal_robot.model.urdf_export import urdf_with_inertials
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.preprocess import preprocess
from ideal_robot.signals.recording import Recording

SCHEMA = 1
"""Version of the model file; readers accept any up to their own."""


@dataclass(frozen=True)
class Prediction:
    """Predicted and measured torque of a recording, both through the same decimation filter.

    Attributes:
        t: ``(M,)`` [s].
        tau: predicted motor torque ``(M, n)`` [N m].
        std: standard deviation of a measured value about it: parameters and noise together ``(M, n)`` [N m].
        measured: measured motor torque ``(M, n)`` [N m].
    """

    t: Array
    tau: Array
    std: Array
    measured: Array

    @property
    def relative_error_percent(self) -> Array:
        """``100 ‖y - ŷ‖ / ‖y‖`` per joint ``(n,)``; NaN for a joint without torque."""
        norm = np.linalg.norm(self.measured, axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(100.0 * np.linalg.norm(self.measured - self.tau, axis=0) / norm)

    @property
    def residual_std_percent(self) -> Array:
        """Standard deviation of the residual over that of the torque per joint ``(n,)`` [%]."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(100.0 * np.std(self.measured - self.tau, axis=0) / np.std(self.measured, axis=0))


@dataclass(frozen=True)
class Model:
    """Dynamic model of an arm with ``n`` joints, as written to a model file.

    Attributes:
        robot_name: name of the robot.
        urdf: text of the URDF it belongs to; kinematics and nominal inertias.
        urdf_hash: SHA-256 of that file, first 16 hex digits.
        base: the base parameters and their grouping.
        base_values: their values ``(b,)``.
        friction: friction law of each joint.
        covariance: of the parameter vector (``ideal_robot.model.parametrisation``) ``(P, P)``.
        consistent: physically possible full parameters ``(12 n,)``, closest to the base parameters: ten a link, rotor
            inertias, offsets.
        noise_std: standard deviation of the residual on the estimation data ``(n,)`` [N m].
        controller: the joint controllers, or None.
        stiffness, damping: of the joints ``(n,)`` [N m/rad, N m s/rad], or None.
        effects: what diagnosis added, with the evidence for each.
        provenance: recordings (source, hash), method, cut-offs, errors, warnings, version.
    """

    robot_name: str
    urdf: str = field(repr=False)
    urdf_hash: str
    base: BaseParameters = field(repr=False)
    base_values: Array
    friction: PerJointFriction
    covariance: Array = field(repr=False)
    consistent: Array = field(repr=False)
    noise_std: Array
    controller: ControllerModel | None = None
    stiffness: Array | None = None
    damping: Array | None = None
    effects: tuple[FittedEffect, ...] = ()
    provenance: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("base_values", "covariance", "consistent", "noise_std", "stiffness", "damping"):
            if getattr(self, name) is not None:
                array = np.array(getattr(self, name), dtype=float)
                array.setflags(write=False)
                object.__setattr__(self, name, array)

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.friction.n

    @property
    def rotor_inertia(self) -> Array:
        """Rotor inertias reflected to the joint side ``(n,)`` [kg m²].

        Where the arm's motion cannot tell one from a link inertia it is the physically consistent choice that counts.
        """
        return self.consistent[10 * self.n : 11 * self.n]

    @property
    def offset(self) -> Array:
        """Constant torque offsets ``(n,)`` [N m]."""
        return self._exact[11 * self.n :]

    @cached_property
    def kinematics(self) -> pin.Model:
        """Pinocchio model of the URDF with its nominal inertias."""
        return pin.buildModelFromXML(self.urdf)

    @cached_property
    def dynamics(self) -> pin.Model:
        """Pinocchio model with the physically consistent inertias and rotor inertias (``armature``), for simulation."""
        model = with_link_parameters(self.kinematics, self.consistent[: 10 * self.n])
        model.armature = np.array(self.rotor_inertia)
        return model

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Every parameter with name, joint, value, standard deviation and unit."""
        return described(self.base, self.base_values, self.friction, self.covariance, self.kinematics)

    @cached_property
    def _exact(self) -> Array:
        """Full parameters that have exactly the identified base parameters; they need not be possible as bodies."""
        return self.base.nearest_full(self.base_values, self.consistent)

    @cached_property
    def _exact_model(self) -> pin.Model:
        model = with_link_parameters(self.kinematics, self._exact[: 10 * self.n])
        model.armature = np.zeros(self.n)
        return model

    def rigid_body(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Torque ``(N, n)`` [N m] of the links alone: what the gears transmit. No rotors, friction, offsets."""
        return torques(self._exact_model, q, qd, qdd)

    def inverse_dynamics(self, q: Array, qd: Array, qdd: Array, *, t: Array | None = None,
                         temperature: Array | None = None, cutoff: float | None = None) -> Array:
        """Motor torque ``(N, n)`` [N m] for a motion, [G] (8), with the effects that act on the torque.

        Args:
            q, qd, qdd: ``(N, n)`` [rad, rad/s, rad/s²], consecutive in time: friction may have memory.
            t: times ``(N,)`` [s]; only effects with memory or warm-up look at them. One interpolation cycle apart if
                not given.
            temperature: gear temperatures ``(N, n)`` [°C], where known.
            cutoff: of the filter that measured positions went through [Hz]; None for exact ones.
        """
        q, qd, qdd = (np.atleast_2d(np.asarray(values, dtype=float)) for values in (q, qd, qdd))
        load = self.rigid_body(q, qd, qdd)
        friction = self.friction.torque(qd, load, q)
        tau = load + self._exact[10 * self.n : 11 * self.n] * qdd + self.offset + friction
        acting = [effect for effect in self.effects if effect.domain == MOTOR_TORQUE]
        if acting:
            cycle = self.controller.t_cycle if self.controller else 0.012
            times: Array = np.asarray(cycle * np.arange(len(q)) if t is None else t, dtype=float)
            signals = Signals(times, q, qd, qdd, load, tau, friction, temperature, rigid=self.rigid_body,
                              cutoff=cutoff, sliding=self.friction.sliding(q, qd))
            tau = tau + np.sum([effect.contribution(signals) for effect in acting], axis=0)
        return tau

    def torque_function(self) -> Callable[[Array, Array, Array], Array]:
        """A fast function of one sample ``q, qd, qdd (n,)`` to the motor torque ``(n,)`` [N m], for the control cycle.

        Without the effects, which may have memory; about 30 µs a call.
        """
        model, rotor, offset = self._exact_model, self._exact[10 * self.n : 11 * self.n], self.offset
        data, friction = model.createData(), self.friction

        def torque(q: Array, qd: Array, qdd: Array) -> Array:
            load = pin.rnea(model, data, q, qd, qdd)
            return np.asarray(load + rotor * qdd + offset + friction.torque(qd, load))

        return torque

    def predict(self, recording: Recording) -> Prediction:
        """Torque the model expects for a recording, with its uncertainty, beside what was measured.

        Raises:
            InputError: other joint count, missing columns, too short.
        """
        if recording.n != self.n:
            raise InputError(f"the recording has {recording.n} joints, the model of {self.robot_name} has {self.n}",
                             file=recording.source, field="q_i")
        used = self.provenance.get("filters", {})
        signals = preprocess(recording, cutoff=used.get("cutoff"), cutoff_decimation=used.get("cutoff_decimation"))
        temperature = (np.column_stack([signals.columns[f"temp_{i + 1}"] for i in range(self.n)])
                       if recording.has("temp") else None)
        tau = self.inverse_dynamics(signals.q, signals.qd, signals.qdd, t=signals.t - signals.t[0],
                                    temperature=temperature, cutoff=signals.cutoff)
        # The spread of the parameters needs no filtering: it is taken at the decimated instants.
        q, qd, qdd = (values[:: signals.factor][signals.keep] for values in (signals.q, signals.qd, signals.qdd))
        columns = sensitivity(self.kinematics, self.base, self.friction, q, qd, qdd, self.rigid_body(q, qd, qdd))
        of_parameters = np.einsum("knp,pr,knr->kn", columns, self.covariance, columns, optimize=True)
        std = np.sqrt(np.maximum(of_parameters, 0.0) + self.noise_std**2)
        return Prediction(signals.t_decimated, signals.decimate(tau), std, signals.decimate(signals.tau))

    @classmethod
    def nominal(cls, robot: Robot) -> Model:
        """The model a data sheet gives: the URDF's inertias, the data file's rotor inertias, no friction."""
        n = robot.n
        base = base_parameters(robot.pinocchio)
        full = np.concatenate([link_parameters(robot.pinocchio), robot.rotor_inertia, np.zeros(n)])
        friction = PerJointFriction.none(n)
        count = base.count + sum(len(law.coefficients) + len(law.shape) for law in friction.laws)
        return cls(robot.name, robot.urdf.read_text(encoding="utf-8"), robot.urdf_hash, base, base.of(full), friction,
                   np.zeros((count, count)), full, np.zeros(n), provenance={"method": "nominal"})

    def with_effects(self, effects: tuple[FittedEffect, ...]) -> Model:
        """A copy with these effects added to those it has."""
        return dataclasses.replace(self, effects=self.effects + tuple(effects))

    def save(self, path: str | Path) -> Path:
        """Writes the model as JSON; nothing is left half-written."""
        from ideal_robot.model.model_file import model_to_dict

        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(path.name + ".part")
        # One line per entry: still to be read by people, and the covariance does not fill thousands of lines.
        lines = [f"{json.dumps(key)}: {json.dumps(value, allow_nan=False)}"
                 for key, value in model_to_dict(self, SCHEMA).items()]
        partial.write_text("{" + ",\n ".join(lines) + "}\n", encoding="utf-8")
        partial.replace(path)
        return path

    @classmethod
    def load(cls, path: str | Path) -> Model:
        """Reads a model file of this or an earlier version.

        Raises:
            InputError: no such file, not a model file, or one of a later schema.
        """
        from ideal_robot.model.model_file import model_from_file

        return model_from_file(Path(path), SCHEMA)

    def export_urdf(self, path: str | Path) -> Path:
        """Writes the URDF with the physically consistent inertias; what is fixed to a link is merged into it."""
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        text = urdf_with_inertials(self.urdf, self.kinematics, self.consistent[: 10 * self.n])
        path.write_text(text, encoding="utf-8")
        return path
