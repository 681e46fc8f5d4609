"""Found effects in the identified loop: each says where it acts and by how much (``Effect.loop_change``)."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects import FittedEffect, Signals
from ideal_robot.loop.loop_model import LoopModel
from ideal_robot.model.arm_with_effects import chain_with, changes_of, stiffness_with


def with_effects(loop: LoopModel, effects: tuple[FittedEffect, ...]) -> LoopModel:
    """The loop with the effects added that act in it."""
    torque, load, bend = loop.friction_torque.copy(), loop.friction_load.copy(), loop.friction_bend.copy()
    driven = loop.friction_driven.copy()
    offset, rotor, gain = loop.offset.copy(), loop.rotor_inertia.copy(), loop.gain.copy()
    half_gap, gap_load = loop.half_gap.copy(), loop.gap_load.copy()
    ripples, uneven = [loop.ripple], [loop.uneven]
    changes = changes_of(effects)
    for effect, change in changes:
        j = effect.joint - 1
        if change.friction_curve:
            for side, sense in enumerate((1.0, -1.0)):
                torque[side] += sense * _curve(effect, sense * loop.friction_velocity)
        load[j] += change.friction_per_load
        driven[j] += change.friction_per_driven_load
        bend[j] = max(bend[j], change.presliding)
        offset[j] += change.offset
        gain[j] *= 1.0 + change.gain
        if change.rotor_inertia:
            rotor[j] = max(rotor[j] + change.rotor_inertia, 0.0)
        if change.half_gap:
            half_gap[j], gap_load[j] = max(half_gap[j] + change.half_gap, 0.0), change.gap_load
        for wave, rows in ((change.ripple, ripples), (change.uneven, uneven)):
            if wave is not None:
                rows.append(_wave(wave, j, loop.n))
    stiffness = stiffness_with(loop.stiffness, changes)
    return loop.replace(
        chain=chain_with(loop.chain, changes), friction_torque=np.maximum(torque, 0.0),
        friction_load=np.maximum(load, 0.0), friction_driven=np.maximum(driven, 0.0), friction_bend=bend,
        offset=offset, rotor_inertia=rotor, gain=gain, stiffness=stiffness, half_gap=half_gap, gap_load=gap_load,
        ripple=_joined(ripples, loop.n), uneven=_joined(uneven, loop.n),
        # Where there was no dry friction, what is found is all of it.
        friction_dry=np.where(loop.friction_torque[:, 0].mean(axis=0) > 0.0, loop.friction_dry,
                              np.where(torque[:, 0].mean(axis=0) > 0.0, torque[:, 0].mean(axis=0), 1.0)),
        terms=(*loop.terms, *(effect for effect, change in changes if change.torque)))


def _wave(wave: tuple[float, float, float], j: int, n: int) -> Array:
    row = np.zeros((1, 3, n))
    row[0, :, j] = wave
    return row


def _joined(rows: list[Array], n: int) -> Array:
    kept = [row for row in rows if len(row)]
    return np.concatenate(kept) if kept else np.zeros((0, 3, n))


def _curve(effect: FittedEffect, speeds: Array) -> Array:
    """The effect's torque at constant speeds ``(m, n)``; at speed zero the limit from the side that was asked for."""
    sense = 1.0 if float(speeds.sum()) >= 0.0 else -1.0
    qd = np.where(speeds == 0.0, sense * 1e-9, speeds)
    still = np.zeros_like(qd)
    return effect.contribution(Signals(np.arange(float(len(qd))), still, qd, still, still, still, still))
