"""Assumed joint controllers where no recording shows them: of a data sheet, or typical ones with their spread.

The cascade is ``u = k_v (r - q) + k_ff ṙ - q̇``, ``τ = k_p (u + ∫u / T_i)`` behind the low-pass of commands r.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.bounded_values import read_toml
from ideal_robot.errors import InputError
from ideal_robot.model.parametrisation import ControllerModel
from ideal_robot.robots.joints import mass_matrix
from ideal_robot.robots.robot import Robot, spread_postures

CLASS = "class"
"""Asks for the values of a class instead of a file's."""

POSITION_GAIN = 20.0
"""Of the position loop [1/s]: position controllers of machines have 1 to 2 (m/min)/mm, which is 17 to 33 1/s."""
VELOCITY_OVER_POSITION = 4.0
"""Bandwidth of the velocity loop over the position gain: the poles of s²/ω + s + k_v just do not oscillate."""
SYMMETRIC = 4.0
"""Integral time times that bandwidth: the symmetrical optimum with a = 2."""
FEEDFORWARD = 0.9
"""Share of the commanded velocity that is fed forward: most, not all, for all of it overshoots."""
SPREAD = {"position_gain": 0.4, "velocity_feedforward": 0.1, "velocity_gain": 0.4, "integral_time": 0.4,
          "velocity_filter": 0.4, "command_filter": 0.4}
"""Standard deviations of a class: of logarithms, the feedforward's of itself. 0.4 is a factor of 1.5, what lies between
the middle and the ends of 17 to 33 1/s."""


@dataclass(frozen=True)
class Cascade:
    """Gains of ``n`` joints, each ``(n,)``, named as in data sheets.

    Attributes:
        position_gain: [1/s].
        velocity_feedforward: share of the commanded velocity, 0 to 1.
        velocity_gain: [N m s/rad, N s/m where a joint slides].
        integral_time: of the velocity loop [s]; inf where it has no integrator.
        velocity_filter: lag of the measured velocity [s].
        command_filter: time constant of each of the two stages of the commands' low-pass [s].
    """

    position_gain: Array
    velocity_feedforward: Array
    velocity_gain: Array
    integral_time: Array
    velocity_filter: Array
    command_filter: Array

    @classmethod
    def of_class(cls, inertia: Array, t_position: float) -> Cascade:
        """Typical gains of arm controllers.

        ``inertia (n,)`` [kg m², or kg] is that of each joint with its rotor; velocity is measured and commands are
        smoothed over ``t_position`` [s], the position loop's cycle.
        """
        ones = np.ones_like(inertia)
        bandwidth = VELOCITY_OVER_POSITION * POSITION_GAIN
        return cls(POSITION_GAIN * ones, FEEDFORWARD * ones, bandwidth * inertia, SYMMETRIC / bandwidth * ones,
                   0.5 * t_position * ones, 0.5 * t_position * ones)

    @classmethod
    def of(cls, controller: ControllerModel) -> Cascade:
        """The cascade of a controller in the form of [G] (16), (17)."""
        k_p = controller.k_d - controller.k_1
        with np.errstate(divide="ignore"):
            return cls(controller.k_p / k_p, controller.k_d / k_p, k_p, controller.t_cycle / controller.k_i,
                       controller.k_2 / k_p, np.array(controller.filter_time))

    def controller(self, t_position: float, spread: dict[str, list[float]]) -> ControllerModel:
        """The controller in the form of [G] (16), (17), at the position loop's cycle [s], with a spread."""
        k_p, k_ff = self.velocity_gain, self.velocity_feedforward
        return ControllerModel(t_position, k_p * self.position_gain, k_p * k_ff, k_p * (k_ff - 1.0),
                               k_p * self.velocity_filter, t_position / self.integral_time, self.command_filter,
                               filter_order=2, spread=spread)

    def drawn(self, spread: dict[str, list[float]], rng: np.random.Generator) -> Cascade:
        """A random cascade within the spread."""
        changed = {}
        for name in spread:
            value, off = getattr(self, name), np.asarray(spread[name]) * rng.standard_normal(len(self.position_gain))
            changed[name] = np.clip(value + off, 0.0, 1.0) if name == "velocity_feedforward" else value * np.exp(off)
        return dataclasses.replace(self, **changed)


def given_controller(wanted: str | Path, dynamics: pin.Model, robot: Robot) -> ControllerModel:
    """The controller of a file or of the typical class; raises InputError for no such file or wrong entries.

    Args:
        wanted: ``class``, or the path of a TOML with the keys of ``Cascade``, one number or one per joint each, and in
            ``[spread]`` their standard deviations; keys that it leaves out are the class's, with its spread.
        dynamics: dynamics of the arm with its rotors, for each joint's inertia.
        robot: cycle, and postures.
    """
    table = {} if str(wanted) == CLASS else read_toml(Path(wanted), "a file of controller gains")
    spread = table.pop("spread", {})
    known = [field.name for field in dataclasses.fields(Cascade)]
    if not isinstance(spread, dict):
        raise InputError("expected a table of standard deviations", file=wanted, field="spread")
    for place, names in (("", table), ("spread.", spread)):
        for name in names:
            if name not in known:
                raise InputError(f"unknown key; allowed here are {', '.join(known)} and the table spread", file=wanted,
                                 field=f"{place}{name}")
    usual = Cascade.of_class(moved_inertia(dynamics, robot), robot.t_position)
    values = {name: per_joint(table[name], robot.n, wanted, name) for name in table}
    if "integral_time" in values:
        values["integral_time"] = np.where(values["integral_time"] > 0.0, values["integral_time"], np.inf)
    for name in ("position_gain", "velocity_gain"):
        if np.any(values.get(name, np.ones(1)) <= 0.0):
            raise InputError("must be positive", file=wanted, field=name, value=table[name])
    widths = {name: np.full(robot.n, 0.0 if name in table else SPREAD[name]) for name in known}
    widths |= {name: per_joint(value, robot.n, wanted, f"spread.{name}") for name, value in spread.items()}
    return dataclasses.replace(usual, **values).controller(
        robot.t_position, {name: width.tolist() for name, width in widths.items() if width.any()})


def moved_inertia(dynamics: pin.Model, robot: Robot) -> Array:
    """Mean inertia of each joint over its postures, its rotor included ``(n,)`` [kg m², or kg]."""
    data = dynamics.createData()
    return np.asarray(np.mean([mass_matrix(dynamics, data, q).diagonal()
                               for q in spread_postures(robot.q_min, robot.q_max)], axis=0))


def per_joint(value: object, n: int, file: str | Path | None, field: str) -> Array:
    """One number, or one per joint, as ``(n,)``; raises InputError for no such numbers, or one below 0.

    Args:
        value, n: as it was read, and the number of joints.
        file, field: source of the value, for the message.
    """
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError("expected a number or a list of numbers", file=file, field=field) from error
    if isinstance(value, (bool, str)) or array.shape not in ((), (n,)) or not np.all(array >= 0.0):
        raise InputError(f"expected one number or {n}, none below 0", file=file, field=field, value=value)
    return np.array(np.broadcast_to(array, (n,)), dtype=float)


def beside_cascade(controller: ControllerModel) -> str:
    """Functions of the drives besides a P/PI cascade, in words; empty where there are none."""
    parts = [] if controller.integrated else ["PID control of the position"]
    if controller.bodies is not None:
        shares = ", ".join(f"{100.0 * share:.0f}" for share in controller.bodies)
        parts.append(f"gravity and Coriolis torques of the data sheet are added by {shares} %")
    if controller.compensation is not None:
        sizes = ", ".join(f"{size:.3g}" for size in controller.compensation)
        parts.append(f"drives compensate friction by {sizes} N m")
    if controller.coupled:
        parts.append("joints are decoupled by the data sheet's mass matrix (inverse dynamics)")
    if controller.acceleration is not None:
        parts.append("the command's acceleration is fed forward")
    if controller.rate_filter:
        parts.append(f"rates of the command lag by {1e3 * controller.rate_filter:.2g} ms")
    if controller.schedule:
        parts.append(f"gains follow the inertia in a share of {controller.schedule:.2g}")
    return " and ".join(parts)
