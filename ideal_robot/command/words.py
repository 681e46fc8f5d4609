"""Describes a law in words: the kind of controller, its gains, and its delay."""

from __future__ import annotations

from ideal_robot.command.law import CommandLaw, JointLaw

_SHOWN_LATE = 5e-4
"""Lateness that is worth a word [s]: recordings are stamped to about that."""
_SHARE = 0.1
"""Share of fed-forward velocity, or of compensated gravity, that is worth a word."""


def described(law: JointLaw, unit: str = "N m/rad") -> str:
    """The controller of one joint, e.g. "P/PI cascade, 20 1/s, reset time 50 ms, commands 4 ms late".

    Args:
        law: of the joint.
        unit: of a stiffness.
    """
    parts = [*_controller(law, unit), *_commands(law)]
    followed = sorted({column.posture for column in law.columns if column.posture})
    if followed:
        parts.append(f"gains follow the posture of joint {', '.join(map(str, followed))}")
    return ", ".join(parts)


def beyond_cascade(law: CommandLaw) -> tuple[tuple[int, str], ...]:
    """Functions of each joint's controller beyond a P/PI cascade: joint, from 1, and the function in words.

    A loop of [G]'s cascade lacks these functions, while the command law has them.
    """
    found = []
    for j, own in enumerate(law.joints, start=1):
        behind = own.coefficient("velocity") + own.shape.a_1
        share = own.shape.a_1 / behind if behind > 0.0 else 0.0
        if share > _SHARE:
            found.append((j, f"{100 * min(share, 1.0):.0f} % of the velocity is fed forward"))
        torque = own.coefficient("torque")
        compensated = -own.coefficient("gravity") / torque if torque > 0.0 else 0.0
        if own.shape.reset is None and torque > 0.0:
            found.append((j, "no integrator"))
        if compensated > _SHARE:
            found.append((j, f"{100 * compensated:.0f} % of gravity is compensated"))
        found += [(j, words) for words in _commands(own)]
        found += [(j, f"gains follow the posture of joint {i}")
                  for i in sorted({column.posture for column in own.columns if column.posture})]
    return tuple(found)


def _controller(law: JointLaw, unit: str) -> list[str]:
    shape, torque, speed = law.shape, law.coefficient("torque"), law.coefficient("velocity")
    behind = speed + shape.a_1
    if torque > 0.0 and shape.reset is not None:
        # Velocity that is not fed forward gives the lag (1 - k_ff)/k_v; the rest is the command's pole.
        parts = ["P/PI cascade", *([f"{1.0 / behind:.3g} 1/s"] if behind > 0.0 else []),
                 f"reset time {_ms(shape.reset)}"]
        share = shape.a_1 / behind if behind > 0.0 else 0.0
        return [*parts, f"{100 * min(share, 1.0):.0f} % of the velocity fed forward"] if share > _SHARE else parts
    if torque > 0.0:
        parts = ["PD control", f"stiffness {1.0 / torque:.3g} {unit}"]
        share = -law.coefficient("gravity") / torque
        return [*parts, f"{100 * share:.0f} % of gravity compensated"] if share > _SHARE else parts
    if law.coefficient("free_acceleration") > 0.0:
        return ["inverse dynamics"]
    if law.coefficient("bodies") > 0.0 and shape.reset is not None:
        # Without torques the share that is fed forward and the gain are not determined separately.
        fed = shape.a_1 > _SHARE * behind
        gain = ["velocity fed forward"] if fed else [f"{1.0 / behind:.3g} 1/s"] if behind > 0.0 else []
        return ["cascade or PID control", *gain, f"reset time {_ms(shape.reset)}"]
    lag = speed + shape.late + shape.filter.delay * shape.time
    return [f"lags by {_ms(lag)}"] if lag > _SHOWN_LATE else ["follows at once"]


def _commands(law: JointLaw) -> list[str]:
    shape, parts = law.shape, []
    if shape.time > _SHOWN_LATE:
        parts.append(f"{shape.filter.words} {_ms(shape.time)}")
    if shape.late > _SHOWN_LATE:
        parts.append(f"commands {_ms(shape.late)} late")
    return parts


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.2g} ms" if seconds < 0.0995 else f"{1e3 * seconds:.3g} ms"
