"""Direct sensor feedback, the baseline: it works at low gain, and latency makes it swing ([L] 4.4)."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.errors import InputError
from planning.line.direct_feedback import DirectFeedback
from planning.line.line_follower import LineFollower
from tests.planning.cell import Camera, Seen, T, displaced, distance, joint_path, kr6, profile, reference, sine_points

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


def test_the_command_follows_the_law() -> None:
    """[L] (1): the correction grows by K_p Δs in every cycle, and by K_d times what Δs has changed by."""
    signals = np.array([0.0, 0.004, 0.004, 0.007, -0.002, -0.002])

    def corrections(k_p: float, k_d: float) -> np.ndarray:
        follower = LineFollower(kr6(), reference(), profile(), joint_path=joint_path())
        feedback, pose, found = DirectFeedback(follower, k_p, k_d), kr6().fk()(follower.q_start), []
        frames = follower.reference.frames(follower.reference.project(pose.translation[None], 0.0)[0])
        for signal in signals:
            points = pose.actInv((frames.position + signal * frames.normal)[0])[None].repeat(3, axis=0)
            feedback.update(Seen(0.0, points, np.full(3, 3e-5), np.ones(3, dtype=bool), True), pose)
            feedback.command(0.0)
            found.append(feedback.correction)
        return np.array(found)

    for k_p, k_d in ((0.1, 0.0), (0.0, 0.5), (0.2, 0.7)):
        expected = np.cumsum(k_p * signals + k_d * np.diff(signals, prepend=0.0))
        np.testing.assert_allclose(corrections(k_p, k_d), expected, atol=1e-8)


def test_negative_gain_is_refused() -> None:
    with pytest.raises(InputError):
        ride(-0.1)
