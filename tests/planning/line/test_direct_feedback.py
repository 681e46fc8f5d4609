"""Direct sensor feedback, the baseline: it works at low gain, and latency makes it swing ([L] 4.4)."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.errors import InputError
from planning.line.direct_feedback import DirectFeedback
from planning.line.line_follower import LineFollower
from tests.planning.cell import Camera, T, displaced, distance, joint_path, kr6, profile, reference, sine_points

DISPLACED = displaced(sine_points(), turn=0.0, along=0.0)


def ride(k_p: float, k_d: float = 0.0, latency: float = 0.04) -> tuple[np.ndarray, np.ndarray]:
    """TCP distances from the line [m] and lateral corrections [m] of an arm that follows its commands exactly."""
    follower = LineFollower(kr6(), reference(), profile(), joint_path=joint_path())
    feedback = DirectFeedback(follower, k_p, k_d)
    camera, fk = Camera(DISPLACED, np.random.default_rng(1)), kr6().fk()
    under_way, tcp, corrections = [], [], []
    exposure = 3 * T
    for k in range(int(follower.duration / T)):
        t = k * T
        while under_way and under_way[0].t + latency <= t:
            feedback.update(under_way.pop(0))
        q = feedback.command(t)
        follower.observe(t, q)
        tcp.append(fk(q).translation)
        corrections.append(feedback.correction)
        while exposure <= t - 2 * T:
            under_way.append(camera.look(follower, exposure, follower.history.pose(exposure)))
            exposure += 0.02
    inside = slice(int(0.6 / T), int(1.2 / T))
    return distance(np.array(tcp)[inside], DISPLACED), np.array(corrections)


def test_without_gain_the_reference_is_driven() -> None:
    error, corrections = ride(0.0)
    assert not corrections.any()
    assert error.mean() > 5e-3


def test_moderate_gain_brings_the_arm_towards_the_line() -> None:
    error, _ = ride(0.08)
    assert error.mean() < 0.3 * ride(0.0)[0].mean()


def test_latency_limits_the_gain() -> None:
    # A gain that a prompt sensor takes swings with a late one.
    prompt, late = ride(0.3, latency=0.0)[1], ride(0.3, latency=0.12)[1]
    turns = [np.sum(np.diff(np.sign(np.diff(c[20:]))) != 0) for c in (prompt, late)]
    assert np.ptp(late[40:]) > 3 * np.ptp(prompt[40:])
    assert turns[1] > 2


def test_negative_gain_is_refused() -> None:
    with pytest.raises(InputError):
        ride(-0.1)
