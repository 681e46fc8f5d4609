"""Regressions of a force sensor: of its wrench without contact, of the tip's place in contact."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from ideal_robot.arrays import GRAVITY, Array, G, interpolated
from ideal_robot.diagnosis.channels.arm import frames_along, measured_axes, tool_motion
from ideal_robot.diagnosis.channels.regression import (
    BAND,
    CUTOFF,
    FEWEST,
    KNOTS,
    MEMORY,
    OWN,
    RESTING,
    WRENCH,
    Regression,
    noise_floor,
)
from ideal_robot.effects import SENSOR
from ideal_robot.effects.fitted import spline_basis
from ideal_robot.effects.force import ASSUMED_GIVE, CONTACT_FORCE, MOMENTS
from ideal_robot.estimate.score import CLEAR
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.filters import lowpass
from ideal_robot.signals.preprocess import FilteredSignals
from ideal_robot.signals.recording import Recording
from ideal_robot.signals.sampling import resampled


def force_regressions(recording: Recording, validate: Recording | None, robot: Robot, torque: Regression,
                      validation: Regression | None,
                      stiffness: Array | None) -> Iterator[tuple[Regression, Regression | None]]:
    """The regressions that a recording's wrench allows, each with that of the validation recording if it has one.

    Args:
        recording, validate: with ``fx fy fz`` and at best ``mx my mz``, else there are none; the other one, or None.
        robot: the arm.
        torque, validation: the regressions of their torques, for signals and filters.
        stiffness: of the gears as far as the model knows ``(n,)`` [N m/rad], or None.
    """
    wrench = _wrench_of(recording, robot, torque)
    if wrench is None:
        return
    other = None if validate is None or validation is None else _wrench_of(validate, robot, validation)
    free = wrench.without_contact(wrench.turns)
    if free is not None:
        yield free, None if other is None else other.without_contact(wrench.turns)
    contact = wrench.in_contact(recording, robot, stiffness)
    # Another recording has another surface, so its curve does not apply.
    if contact is not None:
        yield contact, None


@dataclass(frozen=True)
class _Wrench:
    """A sensor's wrench on the grid of the torques' regression, and what the motion says about it.

    Attributes:
        torque: that regression.
        values: measured minus what calibration says ``(N, 3 or 6)``.
        rotation: of the sensor in the base frame ``(N, 3, 3)``.
        pull: gravity in the sensor frame ``(N, 3)`` [m/s²].
        push: minus the sensor's acceleration in its own frame ``(N, 3)`` [m/s²].
        there: samples at which it is measured ``(N,)``, away from gaps.
        free: samples without contact ``(N,)``.
        load: bias and mass ``(3 + 1,)`` as they follow from the free samples.
        limit: what force a sample without contact has beside them at most [N].
    """

    torque: Regression
    values: Array
    rotation: Array
    pull: Array
    push: Array
    there: np.ndarray
    free: np.ndarray
    load: Array
    limit: float

    @property
    def turns(self) -> bool:
        """Whether weight cannot do nearly all that a bias does, as is asked of any effect."""
        pull = self.pull[self.free] / G
        return bool(np.sum(np.var(pull, axis=0)) > OWN) if len(pull) else False

    def without_contact(self, turns: bool) -> Regression | None:
        """The wrench while nothing touches the tool: bias, the tool's weight in the changing orientation, and inertia.

        Mass and first moments of the tool are taken for granted, inertia on its own: a sensor that leaves it out, or
        takes it away, then does not look biased. In one orientation, where nothing ``turns``, weight is a constant like
        the bias; what is found then is their sum.
        """
        count, filtered = self.values.shape[1], self._rows(self.free)
        if filtered is None:
            return None
        W = np.zeros((len(self.values), count, 8 if count == 6 else 2))
        for i, field in enumerate((self.pull, self.push)):
            W[:, :3, i] = field
            for axis, unit in enumerate(np.eye(3) if count == 6 else ()):
                W[:, 3:, 2 + 3 * i + axis] = np.cross(unit, field)
        if not turns:
            W = W[:, :, [1, 5, 6, 7] if count == 6 else [1]]
        extra = {MOMENTS: np.full(len(self.values), float(count == 6)),
                 **{f"gravity_{axis}": self.pull[:, i] for i, axis in enumerate("xyz")}}
        return self._regression(filtered, WRENCH[:count], ("N", "N", "N", "N m", "N m", "N m")[:count],
                                filtered.decimate(self.values), filtered.decimate(W), extra)

    def in_contact(self, recording: Recording, robot: Robot, stiffness: Array | None) -> Regression | None:
        """See ``force_regressions``. The tip's place along a surface's normal, plus the give that is assumed.

        The tip stands on the surface, so what its place along the normal does in proportion to the force is compliance,
        of which ``contact_stiffness`` says what is assumed. The surface is fitted as a smooth curve along the path.
        """
        contact = self.values[:, :3] - self.load[:3] - self.load[3] * self.pull
        force = np.einsum("kij,kj->ki", self.rotation, contact)
        least, dt = CLEAR * self.limit, self.torque.filtered.dt
        strong = self.there & ~self.free & (np.linalg.norm(force, axis=1) > least)
        filtered = self._rows(strong)
        if filtered is None:
            return None
        place = _arm_side(recording, robot, self.torque, force, stiffness)
        normal = _normal(force, place, strong, dt)
        pressed = force @ normal
        if float(np.mean(pressed[strong] > least)) < 0.9 or float(np.ptp(pressed[strong])) < least:
            return None
        assumed = recording.meta.get("contact_stiffness")
        y = place @ normal + (pressed / float(assumed) if assumed else 0.0)
        y = y - y[strong].mean()
        # Damping of the tip, and a small delay of the force against the position, are proportional to the force's rate.
        rate = np.gradient(pressed, dt)
        W = np.concatenate([_surface(place, normal, strong), rate[:, None, None]], axis=2)
        # The filter has a two-sided window: without contact it uses the last or next contact values, for which the law
        # holds.
        touching, = ndimage.distance_transform_edt(~strong, return_distances=False, return_indices=True)
        # Noise of the force in the column would bias its coefficient low; a narrow band has less noise.
        band = min(BAND, 0.2 / dt)
        noise = noise_floor(filtered.decimate(y[touching])[:, None], 2.0 * band * dt * filtered.factor)
        y, W, pressed = (lowpass(values[touching], dt, band) for values in (y, W, pressed))
        small = filtered.decimate(y)
        extra = {CONTACT_FORCE: pressed, ASSUMED_GIVE: np.full(len(pressed), 1.0 / float(assumed) if assumed else 0.0)}
        regression = self._regression(filtered, ("contact",), ("m",), small[:, None], filtered.decimate(W), extra)
        return replace(regression, measured=(small - small.mean())[:, None], noise_floor=noise)

    def _rows(self, mask: np.ndarray) -> FilteredSignals | None:
        """The filter with rows of some samples only, None for too few; ends, where no derivatives are, count too."""
        filtered, rows = self.torque.filtered, np.flatnonzero(self.torque.filtered.keep)
        keep = filtered.keep.copy()
        keep[: rows[0]], keep[rows[-1] :] = True, True
        keep &= mask[:: filtered.factor]
        return replace(filtered, keep=keep) if keep.sum() >= FEWEST else None

    def _regression(self, filtered: FilteredSignals, channels: tuple[str, ...], units: tuple[str, ...], y: Array,
                    W: Array, extra: dict[str, Array]) -> Regression:
        """A regression of the sensor, with its filter's rows and undecimated signals for its effects."""
        signals = replace(self.torque.signals, extra=extra, frames=None)
        return replace(self.torque, t=filtered.t_decimated - filtered.t[0], channels=channels, units=units, y=y,
                       measured=y, W=W, use=np.ones(y.shape, dtype=bool), signals=signals, filtered=filtered,
                       noise_floor=noise_floor(y), domain=SENSOR)


def _wrench_of(recording: Recording, robot: Robot, torque: Regression) -> _Wrench | None:
    """The recorded wrench, minus bias and weight in the recording's ``tool`` metadata; None without ``fx fy fz``."""
    names = tuple(name for name in WRENCH if name in recording.columns)
    if names not in (WRENCH[:3], WRENCH):
        return None
    measured = np.column_stack([recording.columns[name] for name in names])
    filtered, usable = torque.filtered, np.all(np.isfinite(measured), axis=1)
    if not usable.any():
        return None
    # Values are constant within gaps, near which no samples are used.
    values = resampled(recording.t, interpolated(recording.t, recording.t[usable], measured[usable]), filtered.t)
    usable = interpolated(filtered.t, recording.t, usable[:, None])[:, 0] == 1.0
    usable = ndimage.binary_erosion(usable, iterations=_memory(filtered.dt), border_value=1)
    if not usable.any():
        return None
    rotation, place, _ = tool_motion(robot, filtered.q, filtered.qd)
    pull = np.einsum("kij,i->kj", rotation, GRAVITY)
    acceleration = np.gradient(np.gradient(place, filtered.dt, axis=0), filtered.dt, axis=0)
    push = -np.einsum("kij,ki->kj", rotation, acceleration)
    known = recording.meta.get("tool")
    if known:
        mass, com = float(known["mass"]), np.asarray(known["com"], dtype=float)
        weight = np.column_stack([mass * pull, np.cross(mass * com, pull)])
        values = values - (np.asarray(known["bias"], dtype=float) + weight)[:, : len(names)]
    free = np.zeros(len(values), dtype=bool)
    free[usable], load, limit = _untouched(values[usable, :3], pull[usable], push[usable], filtered.dt, bool(known))
    return _Wrench(torque, values, rotation, pull, push, usable, free, load, limit)


def _memory(dt: float) -> int:
    """Samples that the filters remember at a step of ``dt`` [s]."""
    return max(5, round(MEMORY / CUTOFF / dt))


def _untouched(force: Array, pull: Array, push: Array, dt: float, calibrated: bool) -> tuple[np.ndarray, Array, float]:
    """Samples without contact ``(N,)``, bias and mass from them ``(4,)``, and what they leave at most [N].

    All samples if bias and weight explain them all; else those that agree with the beginning, where nothing touches.
    """
    width = max(1, round(0.02 / dt))
    smooth = ndimage.uniform_filter1d(force, width, axis=0)
    noise = np.linalg.norm(np.median(np.abs(force - smooth), axis=0)) / 0.67
    limit = 1.0 + 3.0 * noise / np.sqrt(width)
    rows = np.zeros((len(force), 3, 5))
    rows[:, :, :3], rows[:, :, 3], rows[:, :, 4] = np.eye(3), pull, push
    # Prior: a bias of ten newtons, a tool of three kilograms (or as calibrated), for what the orientations do not
    # determine.
    ridge = np.diag((max(noise, 1e-3) / np.array([10.0, 10.0, 10.0, 0.02 if calibrated else 3.0, 3.0])) ** 2)

    def fitted(gram: Array, right: Array) -> Array:
        return np.asarray(np.linalg.solve(gram + ridge, right))

    def sums(where: slice | np.ndarray) -> tuple[Array, Array]:
        flat = rows[where].reshape(-1, 5)
        return flat.T @ flat, flat.T @ smooth[where].reshape(-1)

    everything = fitted(*sums(slice(None)))
    if np.percentile(np.linalg.norm(smooth - rows @ everything, axis=1), 99.0) < limit:
        return np.ones(len(force), dtype=bool), everything[:4], limit
    # An interval as long as the filters' memory is without contact as a whole, or not.
    chunk = _memory(dt)
    free = np.zeros(len(force), dtype=bool)
    free[: 2 * chunk] = True
    gram, right = sums(slice(0, 2 * chunk))
    for start in range(2 * chunk, len(force), chunk):
        part = slice(start, start + chunk)
        misfit = np.linalg.norm(smooth[part] - rows[part] @ fitted(gram, right), axis=1)
        if np.all(misfit < limit):
            free[part] = True
            more = sums(part)
            gram, right = gram + more[0], right + more[1]
    # A contact begins before the force shows it, so the ends are removed.
    return ndimage.binary_erosion(free, iterations=chunk // 2, border_value=1), fitted(gram, right)[:4], limit


def _normal(force: Array, place: Array, strong: np.ndarray, dt: float) -> Array:
    """Normal of the surface ``(3,)``: mean direction of the contact force without what turns with the sliding."""
    width = max(1, round(0.05 / dt))
    velocity = np.gradient(ndimage.uniform_filter1d(place, width, axis=0), dt, axis=0)[strong]
    direction = force[strong] / np.linalg.norm(force[strong], axis=1, keepdims=True)
    normal = direction.mean(axis=0)
    for _ in range(3):
        normal = normal / np.linalg.norm(normal)
        sliding = velocity - np.outer(velocity @ normal, normal)
        speed = np.linalg.norm(sliding, axis=1, keepdims=True)
        sliding = sliding / np.maximum(speed, RESTING * speed.max() + 1e-300)
        # direction = normal - mu sliding, mu from the scatter of both about their means.
        middle, spread = sliding.mean(axis=0), sliding - sliding.mean(axis=0)
        mu = -float(np.sum(spread * direction)) / max(float(np.sum(spread**2)), 1e-9)
        normal = direction.mean(axis=0) + float(np.clip(mu, 0.0, 1.0)) * middle
    return np.asarray(normal / np.linalg.norm(normal))


def _arm_side(recording: Recording, robot: Robot, torque: Regression, force: Array, stiffness: Array | None) -> Array:
    """Tip ``(N, 3)`` where it is measured, else by kinematics, minus what the gears are known to give way."""
    if measured_axes(recording).all():
        return resampled(recording.t, np.column_stack([recording.columns[axis] for axis in "xyz"]), torque.filtered.t)
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
    # On a path along one line the lateral position only shows a tilt of the normal; it must not replace the force.
    columns = [across] if float(np.std(across[strong])) > 0.1 * KNOTS else []
    low, high = float(along[strong].min()), float(along[strong].max())
    intervals = int(min((high - low) / KNOTS, 40))
    if intervals >= 2:
        knots = tuple(float(v) for v in np.linspace(low, high, intervals + 1))
        columns += list(spline_basis(along, knots, 0.1).T)
    else:
        columns += [np.ones(len(along)), along]
    return np.column_stack(columns)[:, None, :]
