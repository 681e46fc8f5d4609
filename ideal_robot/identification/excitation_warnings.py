"""What the data did not show, once a model was identified from them. Warnings have a name, as in ``checks``."""

from __future__ import annotations

from collections.abc import Sequence

from ideal_robot.identification.weighted_least_squares import Solution
from ideal_robot.model.model import Model


def excitation_warnings(model: Model, solution: Solution, wrong_sign: Sequence[int] = ()) -> list[str]:
    """What the data do not show, from the solution's statistics.

    Args:
        model: what was identified.
        solution: and how well.
        wrong_sign: joints, counted from 0, that behave as if their torque had the wrong sign.
    """
    warnings = []
    parameters = model.parameters
    within_friction = {f"offset_{j + 1}" for j, law in enumerate(model.friction.laws) if law.holds_offset}
    silent = [p.name for p, dark in zip(parameters, solution.unexcited, strict=False)
              if dark and p.name not in within_friction]
    if silent:
        warnings.append(f"not-excited: the motion says nothing about {', '.join(silent)}; nominal values are kept")
    vague = [p.name for p, dark in zip(parameters, solution.unexcited, strict=False)
             if not dark and p.std > 0.3 * abs(p.value)]
    if vague:
        warnings.append(f"poorly-excited: standard deviation above 30 % of the value for {', '.join(vague)}")
    if solution.condition_number_scaled > 200.0:
        warnings.append(f"ill-conditioned: condition number {solution.condition_number_scaled:.3g} with scaled "
                        "columns; a motion from plan-identification excites better")
    bounds = [p.name for p, held in zip(parameters, solution.at_bound, strict=False) if held]
    if bounds:
        warnings.append(f"friction-at-bound: {', '.join(bounds)} would be negative and is held at zero; the motion has "
                        "too few speeds to tell friction apart, or something that is not friction acts like it")
    warnings += [f"wrong-sign: the torque of joint {j + 1} has the wrong sign: friction would drive the joint and its "
                 f"inertia be negative; multiply tau_{j + 1} by -1" for j in wrong_sign]
    return warnings
