"""MuJoCo as the plant: its bodies, constraints, tendons and integrator; effects by its own means wherever it has them.

Dry friction is its ``frictionloss``, whose level changes with what the drive says and whose softness, some mrad/s of
creep, is the engine's own default; smooth friction is its implicit joint damping. Elastic gears are a second joint in
series with a spring, play is a limit of that joint, cables and balance springs are tendons, a shaft that turns two
joints is a tendon with inertia and friction, a tilted base is tilted gravity.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.jit import jit
from trials.strangers.arm import joint_axes, sliding
from trials.strangers.drive import (
    ACTING,
    BELIEVED,
    CABLE,
    CABLE_REST,
    FLUID,
    LEVEL,
    RESULTS,
    STATES,
    drive_step,
)
from trials.strangers.motion import STEP, Motion
from trials.strangers.plant import BRISTLE, CONSTRAINT, DAHL, TANH, Plant, Run


def mjcf(plant: Plant) -> str:
    """The plant in MuJoCo's format; joints ``m1 …`` are the motors, ``s1 …`` the twist of gears that are not rigid."""
    model, elastic = plant.model, plant.elastic
    axes, slides = joint_axes(model), sliding(model)
    k_gear, d_gear = plant.springs()
    gravity = " ".join(f"{g:.12g}" for g in model.gravity.linear)
    parts = [f'<mujoco><compiler angle="radian" autolimits="false" boundmass="1e-9" boundinertia="1e-12"/>'
             f'<option timestep="{STEP}" integrator="implicitfast" gravity="{gravity}" iterations="50" '
             f'tolerance="1e-10"><flag contact="disable"/></option><worldbody>']
    closing: list[str] = []
    for j in range(plant.n):
        placement, body = model.jointPlacements[j + 1], model.inertias[j + 1]
        axis = axes[j, :3] if slides[j] else axes[j, 3:]
        kind = f'type="{"slide" if slides[j] else "hinge"}" axis="{_text(axis)}"'
        across, balancers = _across(axis), [s for s in plant.balancers if s.joint == j]
        parts += [f'<site name="frame{j + 1}" pos="{_text(placement.act(s.reach * across))}"/>' for s in balancers]
        turn = pin.Quaternion(placement.rotation)
        parts.append(f'<body pos="{_text(placement.translation)}" quat="{_text([turn.w, turn.x, turn.y, turn.z])}">'
                     f'<joint name="m{j + 1}" {kind} armature="{plant.rotor[j]:.12g}" frictionloss="1e-9"/>')
        closing.append("</body>")
        if elastic[j]:
            play = plant.gap[j] > 0.0
            # A limit's stiffness and damping are given per inertia: those of a stop as stiff as the gear.
            stop = (f'limited="true" range="{-0.5 * plant.gap[j]:.12g} {0.5 * plant.gap[j]:.12g}" solreflimit="'
                    f'{-k_gear[j] / plant.arm.mass[j]:.12g} {-d_gear[j] / plant.arm.mass[j]:.12g}" '
                    f'solimplimit="0.99 0.99 0.001"' if play else
                    f'stiffness="{k_gear[j]:.12g}" damping="{d_gear[j]:.12g}"')
            parts.append('<inertial pos="0 0 0" mass="1e-9" diaginertia="1e-12 1e-12 1e-12"/>'
                         f'<body><joint name="s{j + 1}" {kind} {stop}/>')
            closing[-1] += "</body>"
        i = body.inertia
        parts.append(f'<inertial pos="{_text(body.lever)}" mass="{body.mass:.12g}" fullinertia="'
                     f'{_text([i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]])}"/>')
        for s in balancers:
            back = pin.exp3(-s.angle * axis) @ across
            parts.append(f'<site name="link{j + 1}" pos="{_text(s.lever * back)}"/>')
    return "".join([*parts, *reversed(closing), "</worldbody>", _tendons(plant), "</mujoco>"])


def _tendons(plant: Plant) -> str:
    parts = []
    for j in np.flatnonzero(plant.block[CABLE]):
        k, rest = plant.block[[CABLE, CABLE_REST], j]
        parts.append(f'<fixed stiffness="{k:.12g}" springlength="{rest:.12g}">'
                     f'<joint joint="m{j + 1}" coef="1"/></fixed>')
    for c in plant.couplings:
        parts.append(f'<fixed armature="{c.inertia:.12g}" damping="{c.viscous:.12g}" frictionloss="{c.dry:.12g}">'
                     f'<joint joint="m{c.joint + 1}" coef="1"/><joint joint="m{c.partner + 1}" coef="{c.sense:g}"/>'
                     "</fixed>")
    for s in plant.balancers:
        parts.append(f'<spatial stiffness="{s.stiffness:.12g}" springlength="{s.rest:.12g}">'
                     f'<site site="frame{s.joint + 1}"/><site site="link{s.joint + 1}"/></spatial>')
    return f"<tendon>{''.join(parts)}</tendon>" if parts else ""


def _text(values: Array | list[float]) -> str:
    return " ".join(f"{float(v):.12g}" for v in values)


def _across(axis: Array) -> Array:
    """A direction across an axis."""
    other = np.eye(3)[int(np.argmin(np.abs(axis)))]
    across = other - axis * (axis @ other)
    return np.asarray(across / np.linalg.norm(across))


@jit()
def _friction_of(kinds: Array, v: Array, out: Array, v_smooth: Array, presliding: Array, bristle_damping: Array,
                 z: Array, loss: Array, damping: Array, torque: Array, friction: Array) -> None:
    """What MuJoCo gets as friction for the next step: its constraint, its damping, or the torque of bristles."""
    for j in range(v.shape[0]):
        level = out[LEVEL, j]
        loss[j], damping[j], torque[j] = 1e-9, out[FLUID, j], out[ACTING, j]
        friction[j] = out[FLUID, j] * v[j]
        if kinds[j] == CONSTRAINT:
            loss[j] = level
        elif kinds[j] == TANH:
            # tanh as a secant damping, which the integrator takes implicitly.
            ratio = abs(v[j]) / v_smooth[j]
            damping[j] += level / v_smooth[j] * (math.tanh(ratio) / ratio if ratio > 1e-6 else 1.0)
            friction[j] += level * math.tanh(v[j] / v_smooth[j])
        else:
            towards = 1.0 if v[j] > 0.0 else -1.0
            before = z[j]
            z[j] = towards + (before - towards) * math.exp(-abs(v[j]) * STEP / presliding[j])
            dry = level * z[j]
            if kinds[j] == BRISTLE:
                dry += bristle_damping[j] * (z[j] - before) / STEP * presliding[j]
            torque[j] -= dry
            friction[j] += dry


def simulate(plant: Plant, motion: Motion) -> Run:
    """Plays a motion on a plant.

    Args:
        plant: the arm.
        motion: desired motion, every ``STEP``.
    """
    n, N = plant.n, len(motion.t)
    model = mujoco.MjModel.from_xml_string(mjcf(plant))
    data = mujoco.MjData(model)
    address = np.array([model.joint(f"m{j + 1}").dofadr[0] for j in range(n)])
    elastic = np.flatnonzero(plant.elastic)
    twist = np.array([model.joint(f"s{j + 1}").dofadr[0] for j in elastic], dtype=int)
    k_gear, _ = plant.springs()
    forward = plant.forward(motion)
    block = plant.block.copy()
    block[CABLE] = 0.0
    holding = plant.holding(motion.q[0])
    data.qpos[address] = motion.q[0]
    bent = holding / k_gear + np.sign(holding) * 0.5 * plant.gap
    data.qpos[twist] = -bent[elastic]
    x, out = np.zeros((STATES, n)), np.zeros((RESULTS, n))
    z, loss, damping, torque, friction = (np.zeros(n) for _ in range(5))
    kinds = plant.regularisation.astype(np.int64)
    dahl_like = (kinds == BRISTLE) | (kinds == DAHL)
    # Bristles are lightly damped against the rotor.
    stiff = plant.block[0] / plant.presliding
    bristle_damping = np.where(dahl_like, 0.6 * np.sqrt(stiff * plant.rotor), 0.0)
    load, before = holding.copy(), np.zeros(n)
    log_q, log_qa, log_tau = np.zeros((N, n)), np.zeros((N, n)), np.zeros((N, n))
    qpos, qvel = data.qpos, data.qvel
    hard = kinds == CONSTRAINT
    for k in range(N):
        q, v = qpos[address], qvel[address]
        drive_step(k, plant.cycle, block, x, q, v, load, motion.q[k], motion.qd[k], forward[k], out)
        log_q[k], log_qa[k], log_tau[k] = q, q, out[BELIEVED]
        if len(twist):
            log_qa[k, elastic] += qpos[twist]
        _friction_of(kinds, v, out, plant.v_smooth, plant.presliding, bristle_damping, z, loss, damping, torque,
                     friction)
        model.dof_frictionloss[address] = loss
        model.dof_damping[address] = damping
        data.qfrc_applied[address] = torque
        mujoco.mj_step(model, data)
        now = qvel[address]
        dry = np.where(hard, -data.qfrc_constraint[address], 0.0)
        load = out[ACTING] - friction - dry - plant.rotor * (now - before) / STEP
        before = now
    if not np.isfinite(log_q).all() or np.abs(log_q - motion.q).max() > 2.0:
        raise RuntimeError("the plant left its path")
    return Run(motion.t, motion.q, log_q, log_qa, log_tau)
