"""The settings of the simulated world: every effect, its size and its switch.

Only the simulator reads it. The models never see it: they come from recordings.
"""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError, found_in
from ideal_robot.registry import imported
from ideal_robot.robots.robot import Robot
from ideal_robot.robots.size import of_its_size
from sim.arm.generic import STEP as STEP
from sim.arm.generic import generic_world

# What the settings of a world may be: types and ranges, key by key.

_POSITIVE = {"stiffness", "stribeck_velocity", "presliding", "degressive_velocity", "thermal_time_constant",
             "encoder_increments", "t_ipo", "t_position", "t_velocity", "log_cycle", "velocity_gain", "integral_time",
             "position_gain", "lubrication_time", "ripple_order", "transmission_order", "stiffness_scale",
             "column_stiffness", "column_frequency"}
_SIGNED = {"body", "start_temperature", "ambient_temperature", "reference_temperature", "payload_com",
           "friction_asymmetry"}
_CYCLES = {"t_ipo", "t_position", "t_velocity", "log_cycle", "command_late", "command_time"}
_LONGEST = 1.0
"""Longest cycle [s]."""
_COLDEST = -273.15
"""Absolute zero [°C]."""
_NAMES = {"controller": ("cascade", "impedance", "pid", "inverse_dynamics"),
          "command_smoothing": ("lag", "second_order", "moving_average")}
_FRACTION = {"inertia_tolerance": 0.9, "drive_gain_error": 0.9, "friction_asymmetry": 0.9,  # the largest value below 1
             "column_damping": 0.9, "gain_schedule": 1.0}


def _checked_value(name: str, kind: str, value: Any) -> Any:
    """The value of a key in the type of its field, ``kind``: ``bool``, ``int``, ``float`` or a tuple of ``float``."""
    if name in ("robot", "extra_torque"):
        return value
    field = f"world.{name}"
    if name in ("residual", "geometry"):
        return _rows(field, value, 0.0 if name == "residual" else -np.inf)
    if kind == "bool":
        if not isinstance(value, bool):
            raise InputError("expected true or false", field=field, value=value)
        return value
    if kind == "str":
        if value not in _NAMES[name]:
            raise InputError(f"expected one of {', '.join(_NAMES[name])}", field=field, value=value)
        return value
    if kind == "int":
        if isinstance(value, bool) or not isinstance(value, int) or value < 0:
            raise InputError("expected a whole number that is not negative", field=field, value=value)
        return value
    array = numbers(field, value)
    if name in ("stiffness", "column_stiffness"):
        array = np.where(array >= RIGID, np.inf, array)
    elif np.isinf(array).any():
        raise InputError("must be finite", field=field)
    if name in _POSITIVE and (array <= 0).any():
        raise InputError("must be positive", field=field, value=array.tolist())
    if name not in _SIGNED and (array < 0).any():
        raise InputError("must not be negative", field=field, value=array.tolist())
    if name in _FRACTION and (np.abs(array) > _FRACTION[name]).any():
        raise InputError(f"is a fraction, at most {_FRACTION[name]}", field=field, value=array.tolist())
    if name.endswith("_temperature") and (array < _COLDEST).any():
        raise InputError(f"expected degrees Celsius, {_COLDEST} or more", field=field, value=array.tolist())
    if name in _CYCLES and (array > _LONGEST).any():
        raise InputError(f"must be at most {_LONGEST:g} s", field=field, value=array.tolist())
    if array.ndim == 0 and name != "payload_com":
        return float(array)
    if array.ndim != 1 or kind == "float" or (name == "payload_com" and array.shape != (3,)):
        expected = {"float": "one number", "PerJoint": "one number or one per joint"}.get(kind, "three numbers")
        raise InputError(f"expected {expected}", field=field, value=array.tolist())
    return tuple(array.tolist())


def numbers(field: str, value: Any) -> Array:
    """A number or an array of numbers, unchanged; raises ``InputError`` with ``field`` for anything else."""
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError("expected a number or a list of numbers", field=field) from error
    if isinstance(value, (bool, str)) or np.isnan(array).any():
        raise InputError("expected a number or a list of numbers", field=field, value=value)
    return array


def _rows(field: str, value: Any, least: float) -> tuple[tuple[float, ...], ...]:
    """Rows of finite numbers from ``least`` up."""
    try:
        rows = tuple(tuple(float(number) for number in row) for row in value)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError("expected a list of lists of numbers", field=field) from error
    if not np.all([np.isfinite(row).all() and (np.array(row) >= least).all() for row in rows]):
        raise InputError(f"must be finite{' and not negative' if least == 0.0 else ''}", field=field)
    return rows


RIGID = 1.0e12
"""Stiffness from which on a gear is rigid [N m/rad]: files hold no infinite numbers."""

PerJoint = float | tuple[float, ...]
"""One number for all joints, or one per joint."""

ExtraTorque = Callable[[float, Array, Array, Array], Array]
"""``(t, q_m, qd_m, q_a) -> torque (n,)`` [N m] that is added on the motor side, for effects not named here."""


@dataclass(frozen=True)
class World:
    """Settings of the simulated arm's effects. Angles and torques are on the joint side.

    Attributes:
        robot: robot it belongs to.
        elasticity: gears are springs; off: the motors are rigidly the links.
        stiffness, damping: of each gear [N m/rad, N m s/rad]; an infinite stiffness, from 1e12 up, makes that one gear
            rigid.
        stiffness_scale: factor on the stiffness of each gear: a soft one has less than 1.
        backlash: backlash of each gear, from flank to flank [rad]; 0 is none.
        hysteresis: width of the loop that the twist of each gear describes over its torque [rad]; 0 is none.
        friction: dynamic gear friction; off: none at all.
        friction_scale: factor on the whole friction of each joint.
        coulomb, stribeck, stribeck_velocity, presliding: dry friction [N m], its surplus at standstill [N m], the
            velocity over which that decays [rad/s], the elastic displacement before sliding [rad].
        friction_asymmetry: relative difference of dry friction, larger for positive velocity.
        viscous, degressive, degressive_velocity: hydrodynamic friction [N m s/rad, N m, rad/s].
        load_friction: relative growth of dry friction when the gear carries the torque limit.
        thermal: gear temperatures move with the friction power; off: they stay at ``start_temperature``.
        start_temperature, ambient_temperature: [°C].
        thermal_resistance, thermal_time_constant: of each gear [K/W, s].
        viscosity_temperature, dry_temperature: relative fall of hydrodynamic and of dry friction per kelvin
            above ``reference_temperature``.
        reference_temperature: where friction has the size given [°C].
        lubrication: relative surplus of all friction after a long rest, before motion distributes the lubricant; 0 is
            none.
        lubrication_time: time constant with which motion distributes the lubricant and rest undoes it [s].
        time_compression: thermal and lubricant time runs this many times faster than the arm.
        quantisation: the encoder has increments.
        encoder_increments: per motor turn.
        current_noise: standard deviation of the *measured* current relative to its limit.
        torque_limits: the motors' torque is limited.
        torque_ripple: amplitude relative to the torque limit; ``ripple_order`` periods per motor turn.
        low_pass: time constant of each of the two stages of the command low-pass [s]; 0 is none.
        correction_delay: the standard path planner's delay of one interpolation cycle ([G] 5.2.1).
        t_ipo, t_position, t_velocity: cycle times [s].
        position_gain: of the position loop [1/s].
        velocity_feedforward: share of the commanded velocity added in the velocity loop.
        velocity_gain, integral_time: of the velocity PI loop [N m s/rad, s].
        velocity_filter: time constant of the low-pass differentiator [s].
        current_lag: time constant of the current loop [s]; 0 is none.
        individual: seed of the differences between this arm and its data sheet.
        inertia_tolerance: largest relative difference of the link masses; the extension of the masses differs by
            a third of it, rotor inertias too.
        drive_gain_error: largest relative difference of the true torque per ampere from the data sheet's.
        extra_rotor_inertia: of each drive beyond the data sheet's, on the joint side [kg m²].
        kinematic_error: largest difference of the joints' places from the URDF, in each direction [m].
        zero_error: largest difference of the joints' zero positions [rad].
        twist_error: largest turn of a joint's axes against the one before, about each of them; of the first, against
            the vertical [rad].
        transmission_error: amplitude by which a gear turns the arm unevenly [rad], ``transmission_order`` periods per
            joint turn.
        transmission_once, transmission_twice: the same once and twice per joint turn [rad]; the individual says where.
        link_bending: compliance of each joint's bearing and link across its axis over that of its gear about it; 0 is
            rigid.
        column_stiffness, column_frequency, column_damping: of the column or floor under the base, which tilts about the
            base's x and y axes [N m/rad, Hz, relative to critical]; a stiffness from 1e12 up is rigid.
        thermal_expansion: by how much links grow per kelvin of the gear before them above ``reference_temperature``
            [1/K]; 0 is none.
        hose, hose_friction: of a dress pack along the arm: spring about the home posture [N m/rad], and torque that
            turns round with the motion [N m].
        balancer: torque of a gas spring that supports joint 2, a quarter turn from where the arm stands upright [N m];
            0 is none.
        friction_compensation: share of the dry friction that the drive itself adds in the commanded direction.
        notch_frequency: of a notch filter in the velocity loop [Hz]; 0 is none.
        gain_schedule: share in which the velocity loop's gain follows the moment of inertia of the posture against that
            at home; 0 is a fixed gain, 1 a fixed bandwidth.
        controller: cascade (the industrial one), impedance (with the data sheet's rigid bodies, no integrator), pid (on
            the position, without a model of the arm) or inverse_dynamics (bodies 10 % too heavy); their gains follow
            from ``position_gain``, ``velocity_gain`` and ``integral_time``.
        command_late: additional delay of the commands [s].
        command_smoothing: what smooths them over ``command_time``: lag, second_order or moving_average.
        command_time: of the smoothing [s]; 0 is none.
        payload_mass, payload_com, payload_inertia: additional rigid load in the tool frame [kg, m, kg m² about its
            centre, the same about all axes].
        log_cycle: cycle of the recording [s].
        external_position_noise, external_rotation_noise: of the external measuring device [m, rad].
        body: identified bodies in the place of the data sheet's: of each link mass, first moments [kg m] and moments of
            inertia [kg m²] (``Ixx Ixy Iyy Ixz Iyz Izz``) about its joint's frame, then the rotor inertias, then
            constant torques [N m]; ``12 n`` numbers, none for the data sheet's.
        geometry: measured places of the joints against the URDF's, in their parents' frames: rows of three shifts [m]
            and three turns [rad], one row per joint; none for the URDF's.
        residual: random torque without a physical model, drawn anew for each run: rows of standard deviations [N m],
            one number per joint, for the octaves from 0.05 Hz up.
        extra_torque: see ``ExtraTorque``; None is none.
    """

    robot: str
    elasticity: bool = True
    stiffness: PerJoint = 1.0e5
    damping: PerJoint = 100.0
    stiffness_scale: PerJoint = 1.0
    backlash: PerJoint = 0.0
    hysteresis: PerJoint = 0.0
    friction: bool = True
    friction_scale: PerJoint = 1.0
    coulomb: PerJoint = 20.0
    stribeck: PerJoint = 5.0
    stribeck_velocity: PerJoint = 0.04
    presliding: PerJoint = 3.0e-4
    friction_asymmetry: PerJoint = 0.0
    viscous: PerJoint = 4.0
    degressive: PerJoint = 5.0
    degressive_velocity: PerJoint = 0.15
    load_friction: PerJoint = 0.25
    thermal: bool = True
    start_temperature: PerJoint = 35.0
    ambient_temperature: float = 22.0
    thermal_resistance: PerJoint = 0.3
    thermal_time_constant: PerJoint = 1200.0
    viscosity_temperature: float = 0.025
    dry_temperature: float = 0.006
    reference_temperature: float = 35.0
    lubrication: PerJoint = 0.0
    lubrication_time: float = 60.0
    time_compression: float = 1.0
    quantisation: bool = True
    encoder_increments: PerJoint = 16384.0
    current_noise: PerJoint = 0.005
    torque_limits: bool = True
    torque_ripple: PerJoint = 0.004
    ripple_order: PerJoint = 2.0
    low_pass: float = 0.0015
    correction_delay: bool = True
    t_ipo: float = 0.012
    t_position: float = 0.002
    t_velocity: float = 0.0005
    position_gain: PerJoint = 20.0
    velocity_feedforward: PerJoint = 0.93
    velocity_gain: PerJoint = 500.0
    integral_time: PerJoint = 0.05
    velocity_filter: float = 0.001
    current_lag: float = 0.0005
    individual: int = 1
    inertia_tolerance: float = 0.15
    drive_gain_error: float = 0.02
    extra_rotor_inertia: PerJoint = 0.0
    kinematic_error: float = 0.0
    zero_error: float = 0.0
    twist_error: float = 0.0
    transmission_error: PerJoint = 0.0
    transmission_order: PerJoint = 40.0
    transmission_once: PerJoint = 0.0
    transmission_twice: PerJoint = 0.0
    link_bending: PerJoint = 0.0
    column_stiffness: float = RIGID
    column_frequency: float = 20.0
    column_damping: float = 0.03
    thermal_expansion: float = 0.0
    hose: PerJoint = 0.0
    hose_friction: PerJoint = 0.0
    balancer: float = 0.0
    friction_compensation: PerJoint = 0.0
    notch_frequency: PerJoint = 0.0
    gain_schedule: float = 0.0
    controller: str = "cascade"
    command_late: float = 0.0
    command_smoothing: str = "lag"
    command_time: float = 0.0
    payload_mass: float = 0.0
    payload_com: tuple[float, float, float] = (0.0, 0.0, 0.0)
    payload_inertia: float = 0.0
    log_cycle: float = 0.002
    external_position_noise: float = 2.0e-5
    external_rotation_noise: float = 2.0e-5
    body: tuple[float, ...] = ()
    geometry: tuple[tuple[float, ...], ...] = ()
    residual: tuple[tuple[float, ...], ...] = ()
    extra_torque: ExtraTorque | None = None

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            object.__setattr__(self, field.name, _checked_value(field.name, str(field.type), getattr(self, field.name)))
        for name in ("t_ipo", "t_position", "t_velocity", "log_cycle"):
            ratio = getattr(self, name) / STEP
            if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-6:
                raise InputError(f"must be a multiple of {STEP} s", field=f"world.{name}", value=getattr(self, name))
        for long, short in (("t_ipo", "t_position"), ("t_position", "t_velocity")):
            ratio = getattr(self, long) / getattr(self, short)
            if abs(ratio - round(ratio)) > 1e-6:
                raise InputError(f"must be a multiple of {short} = {getattr(self, short)} s", field=f"world.{long}",
                                 value=getattr(self, long))

    @classmethod
    def default(cls, robot: str | Robot) -> World:
        """The default world of a robot: every effect of a real arm is on, at realistic size.

        Args:
            robot: a shipped robot, the path of a URDF, or a loaded robot; one without a world of its own gets one in
                proportion to its inertias and torque limits.

        Raises:
            InputError: there is no such robot.

        >>> World.default("kr6").replace(encoder_increments=4096).encoder_increments
        4096.0
        """
        return cls(robot=robot if isinstance(robot, str) else robot.name, **_table(robot))

    @classmethod
    def ideal(cls, robot_name: str) -> World:
        """The same arm with every effect off: rigid gears, and the data sheet is exact.

        Assumed rotors are kept where the data sheet has none: with the links alone many a loop is unstable.
        """
        return cls.default(robot_name).replace(
            elasticity=False, backlash=0.0, friction=False, thermal=False, quantisation=False, current_noise=0.0,
            torque_limits=False, torque_ripple=0.0, low_pass=0.0, correction_delay=False, current_lag=0.0,
            inertia_tolerance=0.0, drive_gain_error=0.0, payload_mass=0.0, external_position_noise=0.0,
            external_rotation_noise=0.0, **OF_A_CELL)

    @classmethod
    def cell(cls, robot_name: str) -> World:
        """The same arm in a production cell: the default world with all effects of ``sim.arm.cell``."""
        in_a_cell: Callable[..., dict[str, Any]] = imported("sim.arm.cell:in_a_cell")
        world, robot = cls.default(robot_name), Robot.load(robot_name)
        sizes = {name: world.per_joint(name, robot.n) for name in ("stiffness", "coulomb", "extra_rotor_inertia")}
        return world.replace(**in_a_cell(of_its_size(robot), sizes, world.t_velocity))

    def with_cycles(self, robot: Robot) -> Robot:
        """The robot with the cycle times of this world's controller, which stand in any manual."""
        return dataclasses.replace(robot, t_ipo=self.t_ipo, t_position=self.t_position, t_velocity=self.t_velocity)

    @classmethod
    def from_table(cls, robot_name: str, table: dict[str, Any], file: str | None = None) -> World:
        """The default world changed by a scene's ``[world]`` table.

        ``ideal = true`` starts from the ideal world, ``cell = true`` from that of a production cell. Keys in the table
        ``spread`` are random: it gives standard deviations of their logarithms (of ``velocity_feedforward`` itself),
        and ``individual`` is the seed. Raises ``InputError`` for an unknown key (named, with the allowed ones), a wrong
        type, a value out of range.

        Args:
            robot_name: of a shipped robot, or the path of a URDF.
            table: keys of the world with their values.
            file: the table was read from, for messages.
        """
        table = dict(table)
        ideal, cell, spread = table.pop("ideal", False), table.pop("cell", False), table.pop("spread", {})
        with found_in(file):
            for key, value in (("ideal", ideal), ("cell", cell)):
                if not isinstance(value, bool):
                    raise InputError("expected true or false", field=f"world.{key}", value=value)
            unknown = sorted(set(table) - set(TABLE_KEYS))
            if unknown:
                raise InputError(f"unknown key; allowed here are ideal, {', '.join(TABLE_KEYS)}",
                                 field=f"world.{unknown[0]}")
            begin = cls.ideal if ideal else cls.cell if cell else cls.default
            world = begin(robot_name).replace(**table)
            return world.drawn(spread) if spread else world

    def drawn(self, spread: dict[str, float]) -> World:
        """The world with its uncertain keys drawn for its individual; ``spread`` is described in ``from_table``.

        Raises ``InputError`` for a key that has no value per joint, or a spread that is negative or above 3.
        """
        rng, changed = np.random.default_rng([self.individual, 15485863]), {}
        sizes = {field.name for field in dataclasses.fields(self) if str(field.type) == "PerJoint"}
        if not isinstance(spread, dict):
            raise InputError("expected a table", field="world.spread", value=spread)
        for name in sorted(spread):
            width = spread[name]
            if name not in sizes or type(width) not in (int, float) or not 0.0 <= width <= 3.0:
                raise InputError("expected a standard deviation from 0 to 3" if name in sizes else
                                 f"not a key that can be random; such keys are {', '.join(sorted(sizes))}",
                                 field=f"world.spread.{name}", value=width)
            value = np.atleast_1d(getattr(self, name))
            off = width * rng.standard_normal(len(value))
            drawn = np.clip(value + off, 0.0, 1.0) if name == "velocity_feedforward" else value * np.exp(off)
            changed[name] = tuple(drawn.tolist()) if len(value) > 1 else float(drawn[0])
        return self.replace(**changed)

    def bodies(self, model: pin.Model) -> tuple[Array, Array, Array]:
        """Splits ``body`` into links ``(links, 10)``, rotor inertias and torque offsets ``(n,)`` each.

        Raises ``InputError`` for another number of values than an arm of this model has.
        """
        body, links, n = np.atleast_1d(self.body), model.njoints - 1, model.nv
        if len(body) != 10 * links + 2 * n:
            raise InputError(f"expected {10 * links + 2 * n} numbers for {links} links and {n} joints",
                             field="world.body", value=len(body))
        return body[: 10 * links].reshape(links, 10), body[10 * links : -n], body[-n:]

    def replace(self, **changes: Any) -> World:
        """A checked copy with some effects changed.

        Raises ``InputError`` where there is no such effect, for a wrong type and for a value out of range.
        """
        known = {field.name for field in dataclasses.fields(self)}
        for name in changes:
            if name not in known:
                raise InputError(f"no such effect; there are {', '.join(sorted(known))}", field=f"world.{name}")
        return dataclasses.replace(self, **changes)

    def per_joint(self, name: str, n: int) -> Array:
        """An effect's size as an array ``(n,)``; raises ``InputError`` where it is a list of another length."""
        value = np.asarray(getattr(self, name), dtype=float)
        if value.ndim == 1 and value.shape != (n,):
            raise InputError(f"expected one number or {n}, one per joint", field=f"world.{name}", value=value.tolist())
        return np.array(np.broadcast_to(value, (n,)), dtype=float)

    def table(self) -> dict[str, Any]:
        """All settings as a table, for reports and recordings; optional ones only where they are set."""
        values, unusual = {name: getattr(self, name) for name in TABLE_KEYS}, {**OF_A_CELL, **OF_A_CONTROLLER}
        return {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()
                if (name not in ("body", "geometry", "residual") or value)
                and not (name in unusual and value == unusual[name])}


TABLE_KEYS = tuple(field.name for field in dataclasses.fields(World) if field.name not in ("robot", "extra_torque"))
"""What a scene's ``[world]`` table may hold."""

OF_A_CELL: dict[str, Any] = {
    field.name: np.inf if field.name == "column_stiffness" else field.default for field in dataclasses.fields(World)
    if field.name in {"stiffness_scale", "hysteresis", "transmission_once", "transmission_twice", "link_bending",
                      "column_stiffness", "column_frequency", "column_damping", "thermal_expansion", "hose",
                      "hose_friction", "balancer", "friction_compensation", "notch_frequency", "gain_schedule"}}
"""Effects that arms have in cells and neither the default world nor the ideal one has: their values without."""

OF_A_CONTROLLER: dict[str, Any] = {
    field.name: field.default for field in dataclasses.fields(World)
    if field.name in {"controller", "command_late", "command_smoothing", "command_time"}}
"""What says that an arm has another controller than the industrial cascade: its values without."""


def _table(robot: str | Robot) -> dict[str, Any]:
    """Settings of a shipped world, or such in proportion for any other robot; a wrong name fails in ``Robot.load``."""
    name = robot if isinstance(robot, str) else robot.name
    path = Path(str(resources.files("sim"))) / "arm" / "worlds" / f"{name}.toml"
    # A user's arm may have a shipped robot's name and other joints.
    shipped = Path(str(resources.files("ideal_robot"))) / "robots" / name / f"{name}.urdf"
    own = isinstance(robot, Robot) and robot.urdf != shipped
    if path.is_file() and not own:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    return generic_world(of_its_size(Robot.load(robot) if isinstance(robot, str) else robot))
