"""An arm behind joint controllers of many kinds: what the command's law leaves of a path, with and without torques."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array, held
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.feedforward.command_inverse import CommandInverse
from ideal_robot.identification.angles_alone import identify_from_commands
from ideal_robot.identification.command import identify_command
from ideal_robot.identification.idim import identify
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.filters import lowpass
from ideal_robot.signals.recording import Recording
from studies.controlled_arms import KINDS, USUAL, Plant, drawn, motion
from studies.report import head, row

REST = 1.0
"""Rest before a path [s]."""
HALF, OF_PLAIN, AS_EXPECTED = 0.5, 0.03, (0.7, 1.4)
"""What is asked for: with torques, of the regression's error or of the plain path's; measured over expected."""


def controllers(robot: str = "kr6", seed: int = 1, cycle: float = 0.004, kind: str = "", engine: str = "plain",
                draws: int = 0, elastic: bool = False) -> None:
    """Errors of a path behind each kind of controller: plain, corrected with and without torques, and as expected.

    Each arm plays one motion of 20 s, from which the law is identified, then another path of 8 s, plainly and
    corrected. Behind each measured error stands measured over expected. The last column is a regression of
    ``q_c - q`` on velocity, acceleration, jerk and direction. Of drawn arms a last line counts how many are left with
    what was asked for, and in how many rows the errors are as expected.

    Args:
        robot: shipped arm or URDF.
        seed: of motions and noise.
        cycle: from command to command, and of the log [s].
        kind: of these alone, with commas between; all if empty.
        engine: plain or mujoco.
        draws: arms with gains, lateness, friction, bodies and encoder drawn at random; 0 for the usual one.
        elastic: gears as springs; MuJoCo's alone.
    """
    names = kind.split(",") if kind else list(KINDS)
    for name in names:
        if name not in KINDS:
            raise InputError(f"there is none; expected {', '.join(KINDS)}", field="kind", value=name)
    arm = dataclasses.replace(Robot.load(robot), t_ipo=cycle)
    head("controller", "plain path [mrad]", "over expected", "with torques", "over expected", "angles alone",
         "over expected", "regression")
    errors: list[_Errors] = []
    for name in names:
        for draw in range(max(draws, 1)):
            rng = np.random.default_rng(seed + 1000 * draw)
            plant = Plant(arm, name, USUAL[name], engine=engine, elastic=elastic) if not draws else Plant(
                arm, name, drawn(name, rng), float(rng.uniform(0.03, 0.2)), float(rng.uniform(0.9, 1.1)),
                float(10.0 ** rng.uniform(-6.0, -4.3)), engine=engine, elastic=elastic)
            errors.append(_one(name, plant, arm, rng))
    if draws:
        _counted(errors)


@dataclass(frozen=True)
class _Errors:
    """Errors of one arm's path [mrad], NaN where the program refused; measured over expected behind them.

    Attributes:
        plain, torques, alone, regression: as it is, corrected with torques and without, and by the regression.
        over: measured over expected, with torques and without ``(2,)``.
    """

    plain: float
    torques: float
    alone: float
    regression: float
    over: tuple[float, float]


def _counted(errors: Sequence[_Errors]) -> None:
    """Prints how many arms are left with what was asked for."""
    halved = sum(e.torques <= max(HALF * e.regression, OF_PLAIN * e.plain) for e in errors)
    beaten = [e.alone / e.regression for e in errors]
    over = np.array([e.over for e in errors])
    low, high = AS_EXPECTED
    within = np.mean((over > low) & (over < high), axis=0)
    print(f"\n{halved} of {len(errors)} with torques leave at most {HALF:g} times what the regression leaves, or "
          f"{100 * OF_PLAIN:g} % of the plain path; {sum(x <= 1.0 for x in beaten)} from angles alone no more than the "
          f"regression, at most {np.nanmax(beaten):.2f} times as much.")
    for words, ratios, share in zip(("with torques", "from angles alone"), over.T, within, strict=True):
        print(f"Measured over expected {words}: {np.nanmedian(ratios):.2f} in the median, {100 * share:.0f} % between "
              f"{low} and {high}.")


def _one(name: str, plant: Plant, arm: Robot, rng: np.random.Generator) -> _Errors:
    cycle = arm.t_ipo
    shown = plant.run(motion(arm, rng, 20.0, cycle), cycle, cycle, rng)
    path = held(motion(arm, rng, 8.0, cycle), before=round(REST / cycle))
    plain, foretold, corrected = _missed(plant, path, path, cycle, rng), np.nan, []
    for model in (_with_torques(shown, arm), _alone(shown, arm)):
        if model is None:
            corrected.append((np.nan, np.nan))
            continue
        inverse = CommandInverse(model, arm)
        # Of the two the one from angles alone, which every arm has.
        foretold = _rms(inverse.uncorrected(path)[round(REST / cycle):])
        left = _missed(plant, inverse.along(path), path, cycle, rng)
        corrected.append((left, left / _rms(inverse.expected(path)[round(REST / cycle):])))
    (torques, over), (alone, over_alone) = corrected
    regression = _missed(plant, _regression(shown, path, cycle), path, cycle, rng)
    cells = [cell for left, share in corrected
             for cell in (("refused", "") if np.isnan(left) else (f"{left:.3g}", f"{share:.2f}"))]
    row(name, f"{plain:.3g}", f"{plain / foretold:.2f}", *cells, f"{regression:.3g}")
    return _Errors(plain, torques, alone, regression, (over, over_alone))


def _with_torques(shown: Recording, arm: Robot) -> Model | None:
    return _tried(lambda: (known := identify([shown], arm).model) and dataclasses.replace(
        known, command=identify_command([shown], known, torque=True)))


def _alone(shown: Recording, arm: Robot) -> Model | None:
    columns = {name: values for name, values in shown.columns.items() if not name.startswith("tau")}
    return _tried(lambda: identify_from_commands(Recording(columns), arm).model)


def _tried(make: Callable[[], Model]) -> Model | None:
    """The model, or None where the program refuses."""
    try:
        return make()
    except IdealRobotError:
        return None


def _regression(shown: Recording, path: Array, cycle: float) -> Array:
    """Commands by a regression without shapes, terms of the body or a choice: what a user writes in an hour."""
    def columns(q: Array) -> Array:
        rates = [q]
        for _ in range(3):
            rates.append(np.gradient(rates[-1], cycle, axis=0))
        return np.stack([*rates[1:], np.tanh(rates[1] / still), np.ones_like(q)], axis=2)

    q_c, q = shown.joints("q_c"), lowpass(shown.joints("q"), cycle, 10.0)
    still = 0.05 * np.std(np.gradient(q, cycle, axis=0), axis=0)
    X, y, ahead = columns(q), lowpass(q_c, cycle, 10.0) - q, columns(path)
    commands = path.copy()
    for j in range(path.shape[1]):
        size = np.linalg.norm(X[:, j], axis=0)
        commands[:, j] += ahead[:, j] @ (np.linalg.lstsq(X[:, j] / size, y[:, j], rcond=1e-9)[0] / size)
    return commands


def _missed(plant: Plant, commands: Array, path: Array, cycle: float, rng: np.random.Generator) -> float:
    """Root mean square of path minus angle over all joints, after the rest [mrad]."""
    return _rms((path - plant.run(commands, cycle, cycle, rng).joints("q"))[round(REST / cycle):])


def _rms(errors: Array) -> float:
    return 1e3 * float(np.sqrt(np.mean(errors**2)))
