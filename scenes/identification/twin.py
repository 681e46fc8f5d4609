"""A simulated world from an identified model: what recordings determine, and typical values for the rest.

Only the simulated arm gets it. The model under test is identified from that arm's own recordings, as from a real one's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.optimize import nnls
from scipy.signal import welch

from ideal_robot.arrays import Array, interpolated
from ideal_robot.dynamics import link_parameters
from ideal_robot.dynamics.consistent_inertias import consistent_parameters
from ideal_robot.effects import FittedEffect
from ideal_robot.errors import IdealRobotError
from ideal_robot.identification.friction_runs import fit_ripple
from ideal_robot.identification.geometry import has_geometry, measured_geometry
from ideal_robot.identification.whole_model import IdentificationResult, identify_model
from ideal_robot.model.arm_with_effects import changes_of
from ideal_robot.model.cascade import SPREAD, Cascade
from ideal_robot.model.model import Model
from ideal_robot.results import listed, one_unit
from ideal_robot.robots.joints import mass_matrix
from ideal_robot.robots.robot import Robot, spread_postures
from ideal_robot.signals.preprocess import preprocess
from ideal_robot.signals.recording import Recording
from scenes.scene_files.scene import ARM
from sim.arm.arm import SimulatedArm
from sim.arm.drive import motor_torque_limit
from sim.arm.generic import generic_world, growth, too_fast
from sim.arm.specimen import LOWEST, octave_edges
from sim.arm.world import RIGID, World

DRAWS = 10
"""Individuals of a twin that are looked at."""
_LEAST_ROTOR = 0.02
"""Rotor inertia over what the links hold against the joint, below which the torques were measured behind the gears."""
_GEARS = 0.4
"""Spread of the gears' stiffness and damping that nobody measured, of the logarithm: a factor of 1.5."""
_SEGMENT = 20.0
"""Length of the pieces that a spectrum is averaged over [s]: one oscillation of the slowest octave."""
_EDGE = 0.5
"""Left out at either end, where filters swing [s]."""


@dataclass(frozen=True)
class Twin:
    """A simulated world that resembles a recorded arm.

    Attributes:
        table: of the scene's ``[world]``, its ``spread`` included.
        seen: quantities from the recordings, and how they were used.
        assumed: quantities that they do not determine, and the values used instead.
    """

    table: dict[str, Any]
    seen: tuple[str, ...]
    assumed: tuple[str, ...]

    def world(self, robot: str) -> World:
        """The world of the twin's first individual; its robot is named as in the scene."""
        return World.from_table(robot, {**self.table, "individual": 1})


def twin_of(analysis: IdentificationResult, robot: Robot, name: str) -> Twin:
    """Makes the world of a recorded arm.

    Args:
        analysis: the model identified from its recordings.
        robot, name: the arm as its data sheet has it, and as scenes name it.
    """
    model, recordings = analysis.model, analysis.estimation
    seen = ["friction: the identified law, as presliding and viscous friction"]
    assumed: list[str] = []
    body = _body(model, robot)
    links, rotor = _link_moments(robot, body), body[model.base.layout.rotors]
    hidden = _hidden_rotors(robot, rotor, links.min(axis=0))
    rotor = rotor + hidden
    seen.insert(0, "masses and offsets: identified" if np.any(hidden) else "masses, rotors and offsets: identified")
    if np.any(hidden):
        assumed.append("rotors: those of a class; the torques were measured behind the gears and do not show them")
    table: dict[str, Any] = {
        "body": body, "extra_rotor_inertia": hidden, "thermal": False, "lubrication": 0.0,
        "correction_delay": bool(recordings[0].meta.get("correction_delay", False)),
        "inertia_tolerance": float(min(0.15, 0.01 * np.median([v.uncertain_percent for v in analysis.verdicts]))),
        **_friction(model, recordings, robot)}
    spread: dict[str, float] = {}
    ripples = fit_ripple(recordings, model, robot)
    bands, noise = _residual_octaves(model.with_effects(ripples), recordings)
    table["current_noise"] = noise / motor_torque_limit(robot)
    unit = one_unit(robot.units("N m"))
    seen.append(f"noise of the torque: {listed(noise, unit)}")
    table |= _encoder(model, robot, seen)
    table |= _ripple(ripples, robot)
    table |= _geometry(recordings, robot, (seen, assumed))
    loads = links.mean(axis=0) + rotor, links.min(axis=0)
    _controller(model, robot, loads, (table, spread), (seen, assumed))
    _gears(model, robot, (body, rotor, *loads), (table, spread), (seen, assumed))
    if table["elasticity"]:
        _stabilised(table, spread, (rotor, *loads), name)
    table["spread"] = spread
    without = Twin({key: _plain(value) for key, value in table.items()}, (), ())
    own = _left_of(without, robot, name, recordings[0], len(bands))
    table["residual"] = np.sqrt(np.maximum(bands**2 - own**2, 0.0))
    seen.append("residual: "
                f"{listed(np.sqrt(np.sum(np.square(bands), axis=0)), unit)} with its spectrum, of which "
                f"{listed(np.sqrt(np.sum(np.square(table['residual']), axis=0)), unit)} are not what the identified "
                "law leaves of the twin's own friction")
    return Twin({key: _plain(value) for key, value in table.items()}, tuple(seen), tuple(assumed))


def _left_of(twin: Twin, robot: Robot, name: str, recording: Recording, octaves: int) -> Array:
    """What identification leaves of the twin without a residual, by octaves ``(octaves, n)`` [N m].

    Its friction is of another form than any law, as that of real gears: a part of the residual is there already.
    """
    own = played_again(twin.world(name), robot, recording, seed=1)
    again = identify_model(own, robot, cascade=False)
    ripples = fit_ripple(again.estimation, again.model, robot)
    bands, _ = _residual_octaves(again.model.with_effects(ripples), again.estimation)
    return np.concatenate([bands, np.zeros((octaves, robot.n))])[:octaves]


def played_again(world: World, robot: Robot, recording: Recording, seed: int) -> Recording:
    """The twin's recording of a recorded motion: of its commands, else of its positions.

    Args:
        world, robot: the twin's, and the arm as its data sheet has it.
        recording: of the motion.
        seed: of noise and residual.
    """
    name = next(prefix for prefix in ("q_c", "q_d", "q") if recording.has(prefix))
    q = recording.joints(name)
    cycles = np.arange(recording.t[0], recording.t[-1], world.t_ipo)
    commands = np.clip(interpolated(cycles, recording.t, q), robot.q_min, robot.q_max)
    with SimulatedArm(robot, world, np.random.default_rng(seed), commands[0]) as arm:
        for q_c in commands:
            arm.cycle(q_c)
        return arm.recording()


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return [[float(f"{v:.6g}") for v in row] if value.ndim == 2 else float(f"{row:.6g}") for row in value]
    return value


def _body(model: Model, robot: Robot) -> Array:
    """Possible bodies ``(p,)`` with the identified base parameters, near those of the data sheet or of the class."""
    near = np.concatenate([link_parameters(robot.pinocchio), _usual_rotors(robot), np.zeros(robot.n)])
    b = model.base.count
    try:
        full = consistent_parameters(model.base, model.base_values, model.covariance[:b, :b], near).full
    except IdealRobotError:
        full = model.consistent
    return np.asarray(np.concatenate([full[: model.base.layout.offsets.start], model.offset]))


def _hidden_rotors(robot: Robot, rotor: Array, least: Array) -> Array:
    """Rotors ``(n,)`` [kg m²] that torques measured behind the gears do not show: those of the class; else none.

    No drive is without. Behind links that are slim where two axes fall together, one would not be stable. ``least``
    are the moments of inertia that the links hold against each joint at least ``(n,)`` [kg m²].
    """
    if robot.n == 1 or np.all(rotor >= _LEAST_ROTOR * least):
        return np.zeros(robot.n)
    return np.maximum(_usual_rotors(robot) - rotor, 0.0)


def _usual_rotors(robot: Robot) -> Array:
    return np.where(robot.rotor_inertia > 0.0, robot.rotor_inertia, generic_world(robot)["extra_rotor_inertia"])


def behind_gears(own: Recording, twin: Twin, filters: dict[str, Any]) -> Recording:
    """A twin's recording without the torques of its added rotors, which recordings do not determine.

    Args:
        own, twin: the recording, and the twin that made it.
        filters: of the identification.
    """
    hidden = np.asarray(twin.table["extra_rotor_inertia"])
    if not np.any(hidden):
        return own
    s = preprocess(own, cutoff=filters["cutoff"], cutoff_decimation=filters["cutoff_decimation"])
    tau = own.joints("tau") - hidden * interpolated(own.t, s.t, s.qdd)
    columns = {**own.columns, **{f"tau_{j + 1}": tau[:, j] for j in range(own.n)}}
    return Recording(columns, dict(own.meta), own.source)


def _friction(model: Model, recordings: Sequence[Recording], robot: Robot) -> dict[str, Array]:
    """Coulomb, Stribeck, viscous and degressive friction nearest to the identified law over the recorded speeds."""
    n = model.n
    top = np.max([np.quantile(np.abs(np.gradient(r.joints("q"), r.t, axis=0)), 0.99, axis=0) for r in recordings],
                 axis=0)
    v = np.linspace(0.01, 1.0, 80)[:, None] * np.maximum(top, 1e-6)
    forward, backward = model.friction.torque(v), -model.friction.torque(-v)
    table = {key: np.zeros(n) for key in ("coulomb", "stribeck", "stribeck_velocity", "viscous", "degressive",
                                          "degressive_velocity", "friction_asymmetry", "presliding", "load_friction")}
    limit = motor_torque_limit(robot)
    for j, law in enumerate(model.friction.laws):
        best = np.inf
        for slow, degressive in product((0.01, 0.03, 0.1), (0.03, 0.1, 0.3)):
            v_s, v_e = slow * top[j], degressive * top[j]
            basis = np.column_stack([np.ones(len(v)), np.exp(-((v[:, j] / v_s) ** 2)), v[:, j],
                                     np.arcsinh(v[:, j] / v_e)])
            parts, residual = nnls(basis, np.maximum(0.5 * (forward[:, j] + backward[:, j]), 0.0))
            if residual < best:
                best = residual
                table["coulomb"][j], table["stribeck"][j], table["viscous"][j], table["degressive"][j] = parts
                table["stribeck_velocity"][j], table["degressive_velocity"][j] = v_s, v_e
        dry = max(table["coulomb"][j] + table["stribeck"][j], 1e-9)
        half = 0.5 * float(np.mean(forward[:, j] - backward[:, j]))
        table["friction_asymmetry"][j] = np.clip(half / dry, -0.9, 0.9)
        bend = law.shape[-1, 0] if law.presliding else 3.0e-4
        table["presliding"][j] = np.clip(bend, 2.0e-5, 5.0e-3)
        if law.loaded:
            table["load_friction"][j] = law.coefficients[-1, 0] * limit[j] / dry
    return table


def _residual_octaves(model: Model, recordings: Sequence[Recording]) -> tuple[Array, Array]:
    """Standard deviation of the unexplained torque by octaves ``(B, n)``, and of white noise in 2 ms samples ``(n,)``.

    The recordings are checked ones, with torques in N m.
    """
    filters = model.provenance["filters"]
    power, noise = [], []
    for recording in recordings:
        s = preprocess(recording, cutoff=filters["cutoff"], cutoff_decimation=filters["cutoff_decimation"])
        residual = s.tau - model.inverse_dynamics(s.q, s.qd, s.qdd, t=s.t - s.t[0])
        residual = residual[round(_EDGE / s.dt) : -round(_EDGE / s.dt)]
        f, density = welch(residual, 1.0 / s.dt, nperseg=min(len(residual), round(_SEGMENT / s.dt)), axis=0)
        white = np.median(density[(f > 0.25 / s.dt) & (f < 0.45 / s.dt)], axis=0)
        edges = octave_edges(max(1, round(np.log2(s.cutoff / LOWEST))))
        inside = [np.where((f >= low) & (f < high)) for low, high in pairwise(edges)]
        power.append(np.array([np.maximum(np.sum(density[rows] - white, axis=0) * (f[1] - f[0]), 0.0)
                               for rows in inside]))
        noise.append(white * 250.0)
    rows = min(len(bands) for bands in power)
    return np.sqrt(np.mean([bands[:rows] for bands in power], axis=0)), np.sqrt(np.mean(noise, axis=0))


def _encoder(model: Model, robot: Robot, seen: list[str]) -> dict[str, Any]:
    step = np.array(model.provenance.get("position_error", {}).get("step", np.zeros(robot.n)))
    if not np.all(step > 0.0):
        return {}
    seen.append("encoder steps: from the positions")
    return {"encoder_increments": 2.0 * np.pi / (step * robot.gear_ratio)}


def _ripple(ripples: tuple[FittedEffect, ...], robot: Robot) -> dict[str, Array]:
    """The strongest ripple of each joint; where the gear ratio is not known it stays in the residual."""
    size, order = np.zeros(robot.n), np.full(robot.n, 2.0)
    for effect, change in changes_of(ripples):
        wave, j = change.ripple, effect.joint - 1
        if wave is not None and size[j] == 0.0:
            size[j], order[j] = float(np.hypot(wave[1], wave[2])), wave[0] / robot.gear_ratio[j]
    return {"torque_ripple": size / motor_torque_limit(robot), "ripple_order": np.maximum(order, 1e-3)}


Tables = tuple[dict[str, Any], dict[str, float]]
Words = tuple[list[str], list[str]]


def _geometry(recordings: Sequence[Recording], robot: Robot, words: Words) -> dict[str, Any]:
    """Places of the joints from measured poses; else scenes draw them as an uncalibrated arm's."""
    measured = [recording for recording in recordings if has_geometry(recording)]
    if not measured:
        words[1].append("geometry: off as an uncalibrated arm's, no poses beside arm angles in the recordings")
        return {}
    usual = ARM["kinematic_error"] / np.sqrt(3.0), np.hypot(ARM["zero_error"], ARM["twist_error"]) / np.sqrt(3.0)
    words[0].append("geometry: from the poses")
    return {**dict.fromkeys(ARM, 0.0), "geometry": measured_geometry(measured, robot, usual)}


def _controller(model: Model, robot: Robot, loads: tuple[Array, Array], tables: Tables, words: Words) -> None:
    """The cascade: identified, else a given one or that of the class, with its spread."""
    table, spread = tables
    controller = model.controller
    if controller is None:
        cascade = Cascade.of_class(loads[0], robot.t_position)
        spread |= {key: SPREAD[key] for key in ("position_gain", "velocity_gain", "integral_time",
                                                 "velocity_feedforward")}
        words[1].append("controllers: those of a class, no commands in the recordings")
    else:
        cascade = Cascade.of(controller)
        spread |= {key: float(np.max(width)) for key, width in controller.spread.items()
                   if key not in ("velocity_filter", "command_filter")}
        words[1 if controller.spread else 0].append(f"controllers: {'given' if controller.spread else 'identified'}")
    table |= {"position_gain": cascade.position_gain,
              "velocity_feedforward": np.clip(cascade.velocity_feedforward, 0.0, 2.0),
              "velocity_gain": cascade.velocity_gain, "integral_time": np.minimum(cascade.integral_time, 1e3),
              "velocity_filter": float(np.clip(np.median(cascade.velocity_filter) - 0.0005, 0.0, 0.01)),
              "low_pass": float(np.median(cascade.command_filter))}


def _gears(model: Model, robot: Robot, loads: tuple[Array, Array, Array, Array], tables: Tables, words: Words) -> None:
    """Stiffness of the gears: identified, else of the class; of one axis rigid."""
    table, spread = tables
    body, rotor, mean, _ = loads
    table["elasticity"] = robot.n > 1
    if not table["elasticity"]:
        words[1].append("gear: rigid")
        return
    usual = generic_world(robot)
    table["stiffness"], table["damping"] = np.array(usual["stiffness"]), np.array(usual["damping"])
    if model.gears is not None:
        table["stiffness"] = np.array(model.gears.stiffness)
        table["damping"] = 0.14 * np.sqrt(table["stiffness"] * np.maximum(mean - rotor, 0.2 * rotor))
        words[0].append("gears: stiffness identified")
    else:
        spread |= {"stiffness": _GEARS, "damping": _GEARS}
        words[1].append("gears: stiffness and damping of a class")
    rigid = too_fast(replace(robot, pinocchio=_with_body(robot, body)), table["stiffness"], table["damping"], rotor)
    table["stiffness"] = np.where(rigid, RIGID, np.minimum(table["stiffness"], RIGID))


def _link_moments(robot: Robot, body: Array) -> Array:
    """What the links hold against each joint in postures spread over the range ``(m, n)`` [kg m²]."""
    model = _with_body(robot, body)
    data = model.createData()
    return np.array([mass_matrix(model, data, q).diagonal() for q in spread_postures(robot.q_min, robot.q_max)])


def _with_body(robot: Robot, body: Array) -> pin.Model:
    """Pinocchio model with these links."""
    model = robot.pinocchio.copy()
    for j in range(1, model.njoints):
        model.inertias[j] = pin.Inertia.FromDynamicParameters(body[10 * j - 10 : 10 * j])
    return model


def _stabilised(table: dict[str, Any], spread: dict[str, float], loads: tuple[Array, Array, Array], name: str) -> None:
    """Changes what was assumed until all individuals are stable: the arm that was recorded is.

    Gains of a class are lowered; behind identified ones the gears that nobody measured are stiffer.
    """
    rotor, mean, least = loads
    n = len(rotor)
    for _ in range(40):
        worst = np.full(n, -np.inf)
        for individual in range(DRAWS + 1):
            plain = {key: _plain(value) for key, value in table.items()}
            world = World.from_table(name, {**plain, "individual": individual, "spread": spread})
            values = [world.per_joint(key, n) for key in ("velocity_gain", "stiffness", "damping", "position_gain",
                                                          "integral_time")]
            for j in np.flatnonzero(np.isfinite(values[1])):
                gain, stiffness, damping, k_v, time = (float(value[j]) for value in values)
                worst[j] = max(worst[j], *(growth(gain, float(rotor[j]), link, stiffness, damping, k_v, time)
                                           for link in (float(least[j]), float(mean[j] - rotor[j]))))
        if np.all(worst < 0.0):
            return
        key, factor = ("velocity_gain", 0.9) if "velocity_gain" in spread else ("stiffness", 1.25)
        table[key] = np.where(worst < 0.0, table[key], factor * table[key])
