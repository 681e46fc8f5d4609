"""What the data did not show, once a model was identified from them. Warnings have a name, as in ``checks``."""

from __future__ import annotations

from ideal_robot.friction import Asymmetric
from ideal_robot.identification.weighted_least_squares import Solution
from ideal_robot.model.model import Model


def excitation_warnings(model: Model, solution: Solution) -> list[str]:
    """What the data do not show, from the solution's statistics."""
    warnings = []
    parameters = model.parameters
    asymmetric = {f"offset_{j + 1}" for j, law in enumerate(model.friction.laws) if isinstance(law, Asymmetric)}
    silent = [p.name for p, dark in zip(parameters, solution.unexcited, strict=False)
              if dark and p.name not in asymmetric]
    if silent:
        warnings.append(f"not-excited: the motion says nothing about {', '.join(silent)}; nominal values are kept")
    vague = [p.name for p, dark in zip(parameters, solution.unexcited, strict=False)
             if not dark and p.std > 0.3 * abs(p.value)]
    if vague:
        warnings.append(f"poorly-excited: standard deviation above 30 % of the value for {', '.join(vague)}")
    if solution.condition_number_scaled > 200.0:
        warnings.append(f"ill-conditioned: condition number {solution.condition_number_scaled:.3g} with scaled "
                        "columns; a motion from plan-identification excites better")
    for parameter in parameters:
        if parameter.name.startswith(("Fv", "Fc")) and parameter.value < -3.0 * parameter.std:
            warnings.append(f"negative-friction: {parameter.name} = {parameter.value:.3g} {parameter.unit}; the torque "
                            f"of joint {parameter.joint} may have the wrong sign")
    return warnings
