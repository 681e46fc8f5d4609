"""The identified dynamic model of an arm, which precorrection inverts and diagnosis subtracts."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.command.law import CommandLaw
from ideal_robot.dynamics import BaseParameters, base_parameters, link_parameters, with_link_parameters
from ideal_robot.dynamics.base_parameters import FullLayout, full_regressor
from ideal_robot.dynamics.newton_euler import Chain, chain_of, gravity_across, inverse_dynamics
from ideal_robot.dynamics.regressor import regressor
from ideal_robot.effects import MOTOR_TORQUE, FittedEffect, Signals
from ideal_robot.effects.signals import constant_of_weight
from ideal_robot.errors import InputError
from ideal_robot.friction import PerJointFriction
from ideal_robot.model.described_arm import DescribedArm, Gears
from ideal_robot.model.model_file import SCHEMA, read_values, require_consistent, urdf_with_inertials, write_values
from ideal_robot.model.parametrisation import ControllerModel, Parameter, Prediction, described, friction_sensitivity
from ideal_robot.results import Summarised, plain
from ideal_robot.robots.robot import Robot, joint_units, unit_in_amperes
from ideal_robot.signals.preprocess import FilteredSignals, evenly_sampled
from ideal_robot.signals.recording import Recording
from ideal_robot.whole_file import write_text


@dataclass(frozen=True, repr=False)
class Model(Summarised):
    """Dynamic model of an arm with ``n`` joints, as written to a model file.

    Attributes:
        arm: name of the arm that it belongs to.
        base: the base parameters and their grouping.
        base_values: their values ``(b,)``.
        friction: friction law of each joint.
        covariance: of the parameter vector (``ideal_robot.model.parametrisation``) ``(P, P)``.
        consistent: physically possible full parameters ``(p,)``, closest to the base parameters: ten a link, rotor
            inertias, offsets.
        noise_std: standard deviation of the residual on the estimation data ``(n,)`` [N m].
        controller: the joint controllers, or None.
        gears: their stiffness and damping, or None.
        effects: effects that diagnosis added, with the evidence for each.
        command: which command makes the arm move so, behind whatever controller; or None.
        provenance: recordings (source, hash), method, cut-offs, errors, warnings, version.
    """

    arm: DescribedArm
    base: BaseParameters = field(repr=False)
    base_values: Array
    friction: PerJointFriction
    covariance: Array = field(repr=False)
    consistent: Array = field(repr=False)
    noise_std: Array
    controller: ControllerModel | None = None
    gears: Gears | None = None
    effects: tuple[FittedEffect, ...] = ()
    command: CommandLaw | None = None
    provenance: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("base_values", "covariance", "consistent", "noise_std"):
            array = np.array(getattr(self, name), dtype=float)
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def summary(self) -> list[tuple[str, str]]:
        """Main properties and added effects as rows of label and value."""
        known = [name for name, part in (("controller", self.controller), ("stiffness", self.gears))
                 if part is not None]
        effects = ", ".join(f"{effect.name} of joint {effect.joint}" for effect in self.effects[:6])
        rows = [("model", f"{self.arm.name!r}: {self.n} joints, {len(self.base_values)} base parameters, "
                          f"{' and '.join(known) or 'neither controller nor stiffness'} known"),
                ("friction", ", ".join(law.label for law in self.friction.laws))]
        return [*rows, ("effects", effects + (", …" if len(self.effects) > 6 else ""))] if effects else rows

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.friction.n

    def units(self, unit: str) -> tuple[str, ...]:
        """A unit for each joint, e.g. "N m": unchanged for revolute joints, "N" for prismatic ones ``(n,)``."""
        amperes = self.provenance.get("amperes", ())
        return tuple(unit_in_amperes(own) if j + 1 in amperes else own
                     for j, own in enumerate(joint_units(unit, self.kinematics)))

    @property
    def rotor_inertia(self) -> Array:
        """Rotor inertias reflected to the joint side ``(n,)`` [kg m²].

        Where the motion cannot separate one from a link inertia it is the physically consistent choice.
        """
        return self.consistent[self.base.layout.rotors]

    @property
    def by_law(self) -> bool:
        """Whether the command's law is used, as it predicts commands better than [G]'s loop."""
        return self.command is not None and (self.command.leads or self.controller is None)

    @property
    def known_stiffness(self) -> Array | None:
        """Stiffness of the gears, rigid where it is unknown ``(n,)`` [N m/rad], or None without gears."""
        return None if self.gears is None else self.gears.rigid_if_unknown

    @property
    def known_compliance(self) -> Array | None:
        """Compliance of the gears, zero where it is unknown ``(n,)`` [rad/(N m)], or None without gears."""
        return None if self.gears is None else self.gears.compliance

    @property
    def offset(self) -> Array:
        """Constant torque offsets ``(n,)`` [N m]."""
        return self._exact[self.base.layout.offsets]

    @property
    def kinematics(self) -> pin.Model:
        """Pinocchio model of the URDF with its nominal inertias."""
        return self.arm.kinematics

    @cached_property
    def dynamics(self) -> pin.Model:
        """Pinocchio model with the physically consistent inertias and rotor inertias (``armature``), for simulation."""
        model = with_link_parameters(self.kinematics, self.consistent[self.base.layout.links])
        model.armature = np.array(self.rotor_inertia)
        return model

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Every parameter with name, joint, value, standard deviation and unit."""
        amperes = self.provenance.get("amperes", ())
        found = described(self.base, self.base_values, self.friction, self.covariance, self.kinematics)
        return tuple(dataclasses.replace(own, unit=unit_in_amperes(own.unit)) if own.joint in amperes else own
                     for own in found)

    @cached_property
    def _exact(self) -> Array:
        """Full parameters that have exactly the identified base parameters; they need not be possible as bodies."""
        return self.base.nearest_full(self.base_values, self.consistent)

    @cached_property
    def _exact_model(self) -> pin.Model:
        model = with_link_parameters(self.kinematics, self._exact[self.base.layout.links])
        model.armature = np.zeros(self.n)
        return model

    @cached_property
    def _exact_chain(self) -> Chain:
        return chain_of(self._exact_model)

    def rigid_body(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Torque ``(N, n)`` [N m] of the links alone, which the gears transmit; without rotors, friction, offsets.

        Args:
            q, qd, qdd: joint positions, velocities and accelerations ``(N, n)`` [rad, rad/s, rad/s²].
        """
        return inverse_dynamics(self._exact_chain, *(np.ascontiguousarray(values, dtype=float)
                                                     for values in (q, qd, qdd)))

    def inverse_dynamics(self, q: Array, qd: Array, qdd: Array, *, t: Array | None = None,
                         temperature: Array | None = None, cutoff: float | None = None,
                         direction: Array | None = None) -> Array:
        """Motor torque ``(N, n)`` [N m] for a motion, [G] (8), with the effects that act on the torque.

        Args:
            q, qd, qdd: positions, velocities and accelerations ``(N, n)`` [rad, rad/s, rad/s²], consecutive in time:
                friction may have memory.
            t: times ``(N,)`` [s]; only effects with memory or warm-up use them. One interpolation cycle apart if not
                given.
            temperature: gear temperatures ``(N, n)`` [°C], where known.
            cutoff: of the filter that measured positions went through [Hz]; None for exact ones.
            direction: of sliding ``(N, n)``, -1 to 1, of who has followed the joints for longer than these positions.
        """
        q, qd, qdd = (np.atleast_2d(np.asarray(values, dtype=float)) for values in (q, qd, qdd))
        load = self.rigid_body(q, qd, qdd)
        friction = self.friction.torque(qd, load, q if direction is None else None, direction)
        tau = load + self._own_torque(qdd) + friction
        acting = [effect for effect in self.effects if effect.domain == MOTOR_TORQUE]
        if acting:
            cycle = self.controller.t_cycle if self.controller else 0.012
            times: Array = np.asarray(cycle * np.arange(len(q)) if t is None else t, dtype=float)
            # The regressor of the last link is expensive, so it is computed only for a payload.
            body = self._body_on(0, q, qd, qdd) if any(effect.joint == 0 for effect in acting) else None
            still = np.zeros_like(q)
            signals = Signals(times, q, qd, qdd, load, tau, friction, temperature, rigid=self.rigid_body,
                              constant=constant_of_weight(self.offset, self.rigid_body(q, still, still)),
                              cutoff=cutoff, payload=body, dry=self.friction.dry, compliance=self.known_compliance,
                              sliding=self.friction.sliding(q, qd) if direction is None else direction,
                              bodies=lambda link: self._body_on(link, q, qd, qdd),
                              gravity_across=lambda at: gravity_across(self._exact_chain, at))
            tau = tau + np.sum([effect.contribution(signals) for effect in acting], axis=0)
        return tau

    def _own_torque(self, qdd: Array) -> Array:
        """What rotors and offsets ask of the motors ``(N, n)`` [N m]."""
        return self._exact[self.base.layout.rotors] * qdd + self.offset

    def _decimated_torque(self, s: FilteredSignals) -> Array:
        """``inverse_dynamics`` of filtered signals, decimated ``(M, n)`` [N m]."""
        if any(law.loaded for law in self.friction.laws) or any(e.domain == MOTOR_TORQUE for e in self.effects):
            return s.decimate(self.inverse_dynamics(s.q, s.qd, s.qdd, t=s.t - s.t[0], temperature=s.temperature,
                                                    cutoff=s.cutoff))
        # Friction needs all samples; the bodies' torque is as smooth as the motion.
        smooth = s.decimate_motion(lambda rows: self.rigid_body(s.q[rows], s.qd[rows], s.qdd[rows])
                                   + self._own_torque(s.qdd[rows]))
        return smooth + s.decimate(self.friction.torque(s.qd, None, s.q))

    def _body_on(self, link: int, q: Array, qd: Array, qdd: Array) -> Array:
        """Regressor ``(N, n, 10)`` of a body rigidly on the link of a joint (from 1), or on the last one (0)."""
        return regressor(self.kinematics, q, qd, qdd)[:, :, self.base.layout.carried_by(link)]

    def predict(self, recording: Recording) -> Prediction:
        """Predicted torque of a recording with its uncertainty, beside the measured one.

        Raises InputError for another joint count, missing columns, a recording that is too short.
        """
        if recording.n != self.n:
            raise InputError(f"the recording has {recording.n} joints, the model of {self.arm.name} has {self.n}",
                             file=recording.source, field="q_i")
        used = self.provenance.get("filters", {})
        even = evenly_sampled(recording, columns=bool(self.effects))
        signals = even.filtered(used.get("cutoff"), used.get("cutoff_decimation"))
        # The parameters' spread needs no filtering: it is computed at the decimated instants.
        q, qd, qdd = (values[:: signals.factor][signals.keep] for values in (signals.q, signals.qd, signals.qdd))
        columns = self.sensitivity(q, qd, qdd)
        of_parameters = np.einsum("knp,pr,knr->kn", columns, self.covariance, columns, optimize=True)
        std = np.sqrt(np.maximum(of_parameters, 0.0) + self.noise_std**2)
        return Prediction(signals.t_decimated, self._decimated_torque(signals), std, signals.decimate(signals.tau))

    def sensitivity(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Derivative of the torque with respect to the parameter vector, ``(N, n, P)``; effects are left out.

        In the linear parameters this is the regressor. The load, if a friction law uses it, is not differentiated.

        Args:
            q, qd, qdd: positions, velocities and accelerations ``(N, n)`` [rad, rad/s, rad/s²], consecutive in time.
        """
        bodies = full_regressor(self.kinematics, q, qd, qdd, self.base.independent)
        return np.concatenate([bodies, friction_sensitivity(self.friction, q, qd, self.rigid_body(q, qd, qdd))], axis=2)

    @classmethod
    def nominal(cls, robot: Robot) -> Model:
        """The model of a data sheet: the URDF's inertias, the data file's rotor inertias, no friction."""
        n = robot.n
        base = base_parameters(robot.pinocchio)
        full = np.concatenate([link_parameters(robot.pinocchio), robot.rotor_inertia, np.zeros(n)])
        friction = PerJointFriction.none(n)
        count = base.count + sum(len(law.coefficients) + len(law.shape) for law in friction.laws)
        return cls(DescribedArm.of(robot), base, base.of(full), friction,
                   np.zeros((count, count)), full, np.zeros(n), provenance={"method": "nominal"})

    def with_effects(self, effects: tuple[FittedEffect, ...]) -> Model:
        """A copy with these effects added to those it has."""
        return dataclasses.replace(self, effects=self.effects + tuple(effects))

    def require_torques(self) -> None:
        """Raises InputError where parameters are in amperes, as no drive gain was known."""
        if amperes := self.provenance.get("amperes"):
            raise InputError("the parameters of joint" + "s" * (len(amperes) > 1) + f" {', '.join(map(str, amperes))} "
                             "are in amperes; give drive gains (torque_constant in the robot's TOML) and identify "
                             "again", field="model", value=self.arm.name)

    def require_arm(self, robot: Robot, *, file: Path | str | None = None) -> None:
        """Raises InputError for a robot of another arm: other joints, or joints at other places."""
        if difference := self.arm.difference(robot):
            raise InputError(f"{difference}; give the model that was identified for this arm", file=file, field="model",
                             value=self.arm.name)

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as in the model file; non-finite numbers become None, an infinite stiffness ``"inf"``."""
        return plain({
            "schema": SCHEMA,
            "robot": self.arm.to_dict(),
            "parameters": [parameter.to_dict() for parameter in self.parameters],
            "base": {
                "full_names": self.base.full_names, "full_units": self.base.full_units,
                "independent": self.base.independent, "gravitational": self.base.gravitational,
                "grouping": self.base.grouping, "values": self.base_values,
            },
            "friction": self.friction.to_dict(),
            "covariance": self.covariance,
            "consistent": self.consistent,
            "noise_std": self.noise_std,
            "controller": None if self.controller is None else self.controller.to_dict(),
            **({"stiffness": None, "damping": None} if self.gears is None else self.gears.to_dict()),
            "effects": [effect.to_dict() for effect in self.effects],
            "command": None if self.command is None else self.command.to_dict(),
            "provenance": self.provenance,
        }, digits=12)

    @classmethod
    def from_dict(cls, values: dict[str, Any], *, file: Path | str | None = None) -> Model:
        """Makes a model from the values of ``to_dict``; raises InputError, with ``file``, if values are missing."""
        try:
            base = values["base"]
            arm = DescribedArm(values["robot"]["name"], values["robot"]["urdf"], values["robot"]["urdf_hash"])
            model = cls(
                arm=arm,
                base=BaseParameters(tuple(base["full_names"]), tuple(base["full_units"]), tuple(base["independent"]),
                                    np.array(base["grouping"], dtype=float), tuple(base["gravitational"]),
                                    FullLayout.of(arm.kinematics)),
                base_values=np.array(base["values"], dtype=float),
                friction=PerJointFriction.from_dict(values["friction"]),
                covariance=np.array(values["covariance"], dtype=float),
                consistent=np.array(values["consistent"], dtype=float),
                noise_std=np.array(values["noise_std"], dtype=float),
                controller=ControllerModel.from_dict(values["controller"]) if values.get("controller") else None,
                gears=Gears.from_dict(values),
                effects=tuple(FittedEffect.from_dict(entry) for entry in values.get("effects", [])),
                command=CommandLaw.from_dict(values["command"]) if values.get("command") else None,
                provenance=dict(values.get("provenance", {})),
            )
        except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError) as error:
            raise InputError(f"not a complete model file ({type(error).__name__}: {error})", file=file) from error
        require_consistent(model, file)
        return model

    def save(self, path: str | Path) -> Path:
        """Writes the model as JSON, whole or not at all."""
        return write_values(Path(path), self.to_dict())

    @classmethod
    def load(cls, path: str | Path) -> Model:
        """Reads a model file of this or an earlier version; raises InputError for anything else."""
        return cls.from_dict(read_values(Path(path)), file=path)

    def export_urdf(self, path: str | Path) -> Path:
        """Writes the URDF with the physically consistent inertias; links fixed to another are merged into it."""
        self.require_torques()
        links = self.consistent[self.base.layout.links]
        return write_text(path, urdf_with_inertials(self.arm.urdf, self.kinematics, links))
