"""The regression of the tip's place while it touches a surface.

The tip stands on the surface, so what its place along the normal does in proportion to the force is compliance.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import ndimage

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.frames import frames_along
from ideal_robot.diagnosis.channels.noise import noise_in_band
from ideal_robot.diagnosis.channels.regression import Regression
from ideal_robot.diagnosis.channels.wrench import FEWEST, Wrench, rows_of, sensor_regression
from ideal_robot.effects.force import ASSUMED_GIVE, CONTACT_FORCE
from ideal_robot.effects.learned import spline_basis
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.preprocess import lowpass, resampled
from ideal_robot.signals.recording import Recording

LEAST_FORCE = 3.0
"""Contact force that counts as contact [N]."""
_CONTACT_BAND = 8.0
"""Band in which a contact is looked at [Hz]."""
_SLOW = 0.01
"""Speed below which the direction of sliding says little [m/s]."""
_FEATURE = 0.04
"""Shortest undulation of an unknown surface that is followed [m]."""


def contact_regression(recording: Recording, robot: Robot, wrench: Wrench, torque: Regression,
                       stiffness: Array | None) -> Regression | None:
    """Place of the tip along the surface's normal in contact, plus the give that is assumed (``contact_stiffness``).

    The surface is fitted as a smooth curve along the path.

    Args:
        recording: as for ``force_regressions``.
        robot: the arm.
        wrench: of the recording.
        torque: the regression of its torques, for signals and filters.
        stiffness: of the gears as far as the model knows ``(n,)`` [N m/rad], or None.
    """
    contact = wrench.values[:, :3] - wrench.load[:3] - wrench.load[3] * wrench.pull
    force = np.einsum("kij,kj->ki", wrench.rotation, contact)
    strong = ~wrench.free & (np.linalg.norm(force, axis=1) > LEAST_FORCE)
    filtered = rows_of(torque, strong)
    if int(filtered.keep.sum()) < FEWEST:
        return None
    place = _arm_side(recording, robot, torque, force, stiffness)
    normal = _normal(force, place, strong, torque.filtered.dt)
    pressed = force @ normal
    if float(np.mean(pressed[strong] > LEAST_FORCE)) < 0.9 or float(np.ptp(pressed[strong])) < LEAST_FORCE:
        return None
    assumed = recording.meta.get("contact_stiffness")
    y = place @ normal + (pressed / float(assumed) if assumed else 0.0)
    y = y - y[strong].mean()
    # Damping of the tip, and a force that is a little late against the position, follow the force's rate.
    rate = np.gradient(pressed, torque.filtered.dt)
    W = np.concatenate([_surface(place, normal, strong), rate[:, None, None]], axis=2)
    # The filter looks to both sides: out of contact stands what was last or next in contact, for which the law holds.
    touching = _nearest(strong)
    # Noise of the force is in the column as well and would make it look too small: less of it in a narrow band.
    dt = torque.filtered.dt
    band = min(_CONTACT_BAND, 0.2 / dt)
    wide = noise_in_band(filtered.decimate(y[touching])[:, None], torque)
    y, W, pressed = (lowpass(values[touching], dt, band) for values in (y, W, pressed))
    small = filtered.decimate(y)
    extra = {CONTACT_FORCE: pressed, ASSUMED_GIVE: np.full(len(pressed), 1.0 / float(assumed) if assumed else 0.0)}
    made = sensor_regression(torque, filtered, ("contact",), ("m",), small[:, None], filtered.decimate(W), extra,
                 (small - small.mean())[:, None])
    return dataclasses.replace(made, noise_floor=wide * np.sqrt(2.0 * band * dt * filtered.factor))


def _normal(force: Array, place: Array, strong: np.ndarray, dt: float) -> Array:
    """Normal of the surface ``(3,)``: mean direction of the contact force without what turns with the sliding."""
    width = max(1, round(0.05 / dt))
    velocity = np.gradient(ndimage.uniform_filter1d(place, width, axis=0), dt, axis=0)[strong]
    direction = force[strong] / np.linalg.norm(force[strong], axis=1, keepdims=True)
    normal = direction.mean(axis=0)
    for _ in range(3):
        normal = normal / np.linalg.norm(normal)
        sliding = velocity - np.outer(velocity @ normal, normal)
        sliding = sliding / np.sqrt((sliding**2).sum(axis=1, keepdims=True) + _SLOW**2)
        # direction = normal - mu sliding, mu from the scatter of both about their means.
        middle, spread = sliding.mean(axis=0), sliding - sliding.mean(axis=0)
        mu = -float(np.sum(spread * direction)) / max(float(np.sum(spread**2)), 1e-9)
        normal = direction.mean(axis=0) + float(np.clip(mu, 0.0, 1.0)) * middle
    return np.asarray(normal / np.linalg.norm(normal))


def _nearest(mask: np.ndarray) -> np.ndarray:
    """Index of the nearest sample inside a mask, for each sample ``(N,)``."""
    inside, every = np.flatnonzero(mask), np.arange(len(mask))
    right = np.clip(np.searchsorted(inside, every), 0, len(inside) - 1)
    left = np.maximum(right - 1, 0)
    closer = np.abs(inside[left] - every) < np.abs(inside[right] - every)
    return np.asarray(np.where(closer, inside[left], inside[right]))


def _arm_side(recording: Recording, robot: Robot, torque: Regression, force: Array, stiffness: Array | None) -> Array:
    """Tip ``(N, 3)`` where it is measured, else by kinematics, minus what the gears are known to give way."""
    if all(axis in recording.columns for axis in "xyz"):
        measured = np.column_stack([recording.columns[axis] for axis in "xyz"])
        if np.all(np.isfinite(measured)):
            return resampled(recording.t, measured, torque.filtered.t)
    q = torque.signals.q
    frames = frames_along(robot, q)
    if stiffness is None:
        return frames.tool
    bend = -(torque.signals.load - np.einsum("kij,ki->kj", frames.jacobian, force)) / stiffness
    return np.asarray(frames.tool + np.einsum("kij,kj->ki", frames.jacobian, bend))


def _surface(place: Array, normal: Array, strong: np.ndarray) -> Array:
    """Columns ``(N, 1, p)`` of an unknown smooth surface along the path that was driven in contact."""
    middle = place[strong].mean(axis=0)
    flat = (place - middle) - np.outer((place - middle) @ normal, normal)
    _, _, axes = np.linalg.svd(flat[strong][:: max(1, int(strong.sum()) // 2000)], full_matrices=False)
    along, across = flat @ axes[0], flat @ axes[1]
    # A path on one line leaves nothing across but what tilts the normal; it must not stand for the force.
    columns = [across] if float(np.std(across[strong])) > 0.1 * _FEATURE else []
    low, high = float(along[strong].min()), float(along[strong].max())
    intervals = int(min((high - low) / _FEATURE, 40))
    if intervals >= 2:
        knots = tuple(float(v) for v in np.linspace(low, high, intervals + 1))
        columns += list(spline_basis(along, knots, 0.1).T)
    else:
        columns += [np.ones(len(along)), along]
    return np.column_stack(columns)[:, None, :]
