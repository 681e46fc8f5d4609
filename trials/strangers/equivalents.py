"""What counts as the right name of a cause: one table, fixed before any trial was played.

A name is here only where no recording of that kind could tell the two apart, or where they are one physical cause by
two names; never because a diagnosis was seen to confuse them.
"""

from __future__ import annotations

WHOLE_ARM = 0

EQUIVALENT: dict[str, tuple[tuple[str, str], ...]] = {
    "torque_filter": (
        ("dead_time", "below its corner a lag of first order is a delay; as one for all torques (joint 0) it is right"),
    ),
    "arm_delay": (
        ("arm:dead_time", "the library's name of a late arm encoder; each of those recorded is a place where it shows"),
    ),
    "transmission_error": (
        ("arm:transmission_error", "where it is seen, in the arm's angle"),
    ),
    "joint_elasticity": (
        ("arm:joint_elasticity", "the same gear where its angle is measured on the arm's side"),
    ),
    "backlash": (
        ("arm:backlash", "the same gear where its angle is measured on the arm's side"),
    ),
    "link_load": (
        ("payload", "a body on the last link but one, seen by the last joint alone, only by its inertia"),
    ),
}
"""Cause drawn → further names that are right, with the reason. The cause's own name is always right."""

LAST_BUT_ONE_ONLY = frozenset({("link_load", "payload")})
"""Pairs that hold only where the load sits on the last link but one."""

HEALTHY: dict[str, str] = {
    "presliding_hysteresis": "the plant's friction goes through standstill by bristles or Dahl's state in every joint",
    "arm:joint_elasticity": "all gears of the plant are elastic, which arm angles show",
    "joint_elasticity": "all gears of the plant are elastic, and say nothing but their stiffness",
    "torque_filter": "the logger averaged or filtered all torques; as one cause of the whole arm",
}
"""What a plant without any effect may truly have, and when; named where it is so it is neither asked for nor false."""


def right_names(cause: str, joint: int, n: int, qa: tuple[int, ...] = ()) -> frozenset[tuple[str, int]]:
    """Names with joints that are right for a cause.

    Args:
        cause: as drawn.
        joint: of it, from 1; 0 for the whole arm.
        n: joints of the arm.
        qa: joints, from 0, whose arm angle is recorded.
    """
    names = {cause, *(name for name, _ in EQUIVALENT.get(cause, ())
                      if (cause, name) not in LAST_BUT_ONE_ONLY or joint == n - 1)}
    if cause == "arm_delay":
        return frozenset((name, j) for name in names for j in (WHOLE_ARM, *(k + 1 for k in qa)))
    return frozenset((name, WHOLE_ARM if name == "payload" else joint) for name in names)
