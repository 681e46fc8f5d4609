"""One individual of a robot type: how it differs from its data sheet, drawn from a seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots.joints import own_joints
from ideal_robot.robots.robot import Robot
from sim.arm.world import ExtraTorque, World


@dataclass(frozen=True)
class Specimen:
    """The true arm: one individual of its type, with its deviations from the data sheet.

    Attributes:
        model: Pinocchio model with the true kinematics and inertias, the payload included, rotors not.
        rotor_inertia: on the joint side ``(n,)`` [kg m²].
        drive_gain: true torque per ampere relative to the data sheet's ``(n,)``.
        phase: of torque ripple and transmission error ``(n,)`` [rad].
        turn_phase: of the transmission errors once and twice per turn ``(2, n)`` [rad].
    """

    model: pin.Model
    rotor_inertia: Array
    drive_gain: Array
    phase: Array
    turn_phase: Array


def draw_specimen(robot: Robot, world: World) -> Specimen:
    """Draws the individual arm of the seed ``world.individual``.

    Raises ``InputError`` for elastic gears without rotor inertia, which no equation of motion exists for.
    """
    rng = np.random.default_rng([world.individual, 7919])
    n = robot.n
    tolerance = world.inertia_tolerance
    model = robot.pinocchio.copy()
    sheet = robot.rotor_inertia
    if world.body:
        links, sheet, _ = world.bodies(model)
        for joint, link in enumerate(links, start=1):
            model.inertias[joint] = pin.Inertia.FromDynamicParameters(link)
    for joint in range(1, model.njoints):
        mass_factor = 1.0 + tolerance * rng.uniform(-1.0, 1.0)
        extension = 1.0 + tolerance / 3.0 * rng.uniform(-1.0, 1.0, 3)
        model.inertias[joint] = _scaled(model.inertias[joint], mass_factor, extension)
    rotor = sheet * (1.0 + tolerance / 3.0 * rng.uniform(-1.0, 1.0, n))
    rotor = rotor + world.per_joint("extra_rotor_inertia", n)
    gain = 1.0 + world.drive_gain_error * rng.uniform(-1.0, 1.0, n)
    phase = rng.uniform(0.0, 2.0 * np.pi, n)
    offsets, turns = rng.uniform(-1.0, 1.0, (n, 3)), rng.uniform(-1.0, 1.0, n)
    twists = rng.uniform(-1.0, 1.0, (n, 3))
    turn_phase = rng.uniform(0.0, 2.0 * np.pi, (2, n))
    measured = np.array(world.geometry) if world.geometry else np.zeros((n, 6))
    if measured.shape != (n, 6):
        raise InputError(f"expected {n} rows of six numbers, a row per joint", field="world.geometry")
    if world.geometry or world.kinematic_error > 0.0 or world.zero_error > 0.0 or world.twist_error > 0.0:
        _displace(model, measured[:, :3] + world.kinematic_error * offsets, world.zero_error * turns,
                  measured[:, 3:] + world.twist_error * twists)
    if world.payload_mass > 0.0:
        frame = model.frames[robot.tool_id]
        load = pin.Inertia(world.payload_mass, np.array(world.payload_com), np.eye(3) * world.payload_inertia)
        model.inertias[frame.parentJoint] = model.inertias[frame.parentJoint] + frame.placement.act(load)
    elastic = world.elasticity & np.isfinite(world.per_joint("stiffness", n))
    if np.any(elastic & (rotor <= 0.0)):
        raise InputError("elastic gears need a rotor inertia in the robot data; give it, or set "
                         "world.elasticity = false",
                         field="joints.rotor_inertia", value=robot.rotor_inertia.tolist())
    return Specimen(model, rotor, gain, phase, turn_phase)


def _displace(model: pin.Model, offsets: Array, turns: Array, twists: Array) -> None:
    """Moves joints, zeros and axes of ``model``.

    ``offsets (n, 3)`` [m] and rotation vectors ``twists (n, 3)`` [rad] are in the parents' frames, ``turns (n,)`` [rad]
    about the joints.
    """
    data = model.createData()
    for j, joint in enumerate(own_joints(model)):
        q = np.zeros(model.nq)
        q[j] = turns[j]
        pin.forwardKinematics(model, data, q)
        turned = data.liMi[joint]
        model.jointPlacements[joint] = pin.SE3(pin.exp3(twists[j]) @ turned.rotation, turned.translation + offsets[j])


def _scaled(inertia: pin.Inertia, mass_factor: float, extension: Array) -> pin.Inertia:
    """The inertia of the same body made of more mass and stretched along its axes; stays physical.

    The second moments Σ = ∫ x xᵀ dm become f S Σ S, the first moments f S ∫ x dm, S = diag(extension).
    """
    if inertia.mass <= 0.0:
        return inertia
    mass, lever = inertia.mass, np.array(inertia.lever)
    about_centre = np.array(inertia.inertia)
    second = 0.5 * np.trace(about_centre) * np.eye(3) - about_centre
    stretch = np.diag(extension)
    second = mass_factor * stretch @ second @ stretch
    stretched = np.trace(second) * np.eye(3) - second
    if np.linalg.eigvalsh(stretched)[0] < -1e-12 * np.trace(second):
        # Impossible moments of inertia cannot be stretched, so only the mass is drawn.
        return pin.Inertia.FromDynamicParameters(mass_factor * inertia.toDynamicParameters())
    return pin.Inertia(mass_factor * mass, stretch @ lever, stretched)


# Random torque without a physical model, drawn anew for every run: as strong in each octave as it was measured.

LOWEST = 0.05
"""Where the first octave begins [Hz]: slower torques are those of postures."""
WAVES = 6
"""Sinusoids in an octave: with their random phases the sum is as good as normally distributed."""


def octave_edges(count: int) -> Array:
    """Frequencies between octaves ``(count + 1,)`` [Hz]."""
    return LOWEST * 2.0 ** np.arange(count + 1.0)


def residual_torque(world: World, model: pin.Model, rng: np.random.Generator) -> ExtraTorque | None:
    """The world's ``extra_torque`` with its random residual and its body's offsets; None where it has none of them.

    Args:
        world: the true world.
        model: Pinocchio model of the arm.
        rng: draws frequencies and phases; is not touched where the world has no residual.

    Raises:
        InputError: a row of the residual for another number of joints.
    """
    n = model.nv
    offset = world.bodies(model)[2] if world.body else np.zeros(n)
    extra = world.extra_torque
    if not world.residual:
        if not offset.any():
            return extra
        return lambda t, q, qd, q_a: -offset + (0.0 if extra is None else extra(t, q, qd, q_a))
    for row in world.residual:
        if len(row) not in (1, n):
            raise InputError(f"expected rows of one number or {n}, one per joint", field="world.residual", value=row)
    bands = np.array([np.broadcast_to(row, n) for row in world.residual])
    edges = octave_edges(len(bands))
    share = rng.uniform(size=(len(bands), WAVES, 1))
    frequency = 2.0 * np.pi * edges[:-1, None, None] * 2.0**share
    phase = rng.uniform(0.0, 2.0 * np.pi, (len(bands), WAVES, n))
    size = np.sqrt(2.0 / WAVES) * bands[:, None, :] * np.ones((1, WAVES, 1))
    rate, phase, size = (np.ascontiguousarray(waves.reshape(-1, waves.shape[-1])) for waves in (frequency, phase, size))

    def torque(t: float, q: Array, qd: Array, q_a: Array) -> Array:
        drawn = np.einsum("wn,wn->n", size, np.sin(rate * t + phase)) - offset
        return np.asarray(drawn if extra is None else drawn + extra(t, q, qd, q_a))

    return torque
