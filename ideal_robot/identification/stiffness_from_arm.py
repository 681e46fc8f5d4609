"""Joint stiffness and damping from motor and arm angles, where an external device measured the arm ([J] (1))."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.model.model import Model
from ideal_robot.signals.preprocess import lowpass, preprocess, resampled
from ideal_robot.signals.recording import Recording

_PASSED = 20.0
"""Twists are compared with loads up to this frequency at least [Hz]: gears of arms resonate at 10 to 20 Hz."""


def stiffness_from_arm(recordings: Sequence[Recording], model: Model) -> tuple[Array, Array]:
    """Stiffness and damping of each joint, ``k (q_m - q) + d (q̇_m - q̇) = load``, by least squares.

    The load is the torque of the links; the rotor's share never passes the gear. An offset between the two angles is
    estimated along with each recording.

    Args:
        recordings: with ``q_i`` and ``qa_i``.
        model: identified rigid body.

    Returns:
        ``k (n,)`` [N m/rad] and ``d (n,)`` [N m s/rad], both at least zero.

    Raises:
        InputError: no arm angles in a recording.
    """
    # Accelerations of a coarse encoder need the filter that the identification chose: noise in the load would make
    # gears look stiff. Damping shows near the gears' resonance, which must pass.
    cutoff = max(_PASSED, model.provenance.get("filters", {}).get("cutoff", 0.0))
    twists, rates, loads = [], [], []
    for recording in recordings:
        if not recording.has("qa"):
            raise InputError("arm angles qa_1 to qa_n are needed for stiffness", file=recording.source, field="qa_1")
        s = preprocess(recording, cutoff=cutoff)
        arm = resampled(recording.t, recording.joints("qa"), s.t, smooth=True)
        raw = resampled(recording.t, recording.joints("q"), s.t, smooth=True) - arm
        twist = lowpass(raw, s.dt, s.cutoff)
        load = model.rigid_body(lowpass(arm, s.dt, s.cutoff), s.qd, s.qdd)
        twists.append(s.decimate(twist))
        rates.append(s.decimate(np.gradient(twist, s.dt, axis=0)))
        loads.append(s.decimate(load))
    k, d = np.empty(model.n), np.empty(model.n)
    for j in range(model.n):
        x = np.concatenate([v[:, j] - v[:, j].mean() for v in twists])
        v = np.concatenate([v[:, j] - v[:, j].mean() for v in rates])
        y = np.concatenate([v[:, j] - v[:, j].mean() for v in loads])
        # The noise is in the angles, not in the load: regress the twist on the load, and invert.
        compliance = float(y @ x / (y @ y))
        k[j] = 1.0 / max(compliance, 1e-12)
        d[j] = max(0.0, float((y - k[j] * x) @ v / (v @ v)))
    return k, d
