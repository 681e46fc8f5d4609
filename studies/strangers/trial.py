"""A trial: arm, plant, motion, logger and effect drawn from one seed, played in one engine; its right answers."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.signals.recording import Recording
from studies.strangers.arm import Motion, draw_arm, draw_motion
from studies.strangers.effects import ARM, INSIDE, Draw, Drawn, Setup, Values
from studies.strangers.engines import ENGINES, NOT_IN, TURNS, dart
from studies.strangers.logger import Logger, Reading, draw_logger, read, record, sizes, twist_sizes
from studies.strangers.other_effects import AGAINST_MODEL, NEW, OUTSIDE
from studies.strangers.plant import BRISTLE, DAHL, MAXWELL, REGULARISATIONS, Plant, Run, draw_plant, with_observer

WHOLE_ARM = 0

EQUIVALENT: dict[str, tuple[tuple[str, str], ...]] = {
    "torque_filter": (
        ("common_delay", "below its corner a lag of first order is a delay"),
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
    "hose_pull": (
        ("cable_spring", "a hose is a cable; the library has one with slack"),
    ),
    "link_load": (
        ("payload", "a body on the last link but one, seen by the last joint alone, only by its inertia"),
    ),
}
"""Cause drawn → further names that are right, with the reason. The cause's own name is always right."""

LATE = ("common_delay", "torque_filter")
"""Names of what makes all torques late."""

LAST_BUT_ONE_ONLY = frozenset({("link_load", "payload")})
"""Pairs that hold only where the load sits on the last link but one."""

HEALTHY: dict[str, str] = {
    "presliding_hysteresis": "the plant's friction goes through standstill by bristles, Dahl's state or Maxwell's",
    "arm:joint_elasticity": "all gears of the plant are elastic, which arm angles show",
    "joint_elasticity": "all gears of the plant are elastic, and say nothing but their stiffness",
    "common_delay": "the logger averaged or filtered all torques; as one cause of the whole arm",
    "torque_filter": "the same",
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


KINDS = ("none", "inside", "new", "outside", "two", "model", "arm", "known")
"""``model``: an effect against a model of the healthy arm; ``known``: nothing against such a model."""
SHARES = (0.38, 0.20, 0.09, 0.09, 0.09, 0.10, 0.05, 0.0)
POOLS: dict[str, dict[str, Draw]] = {
    "inside": INSIDE, "new": NEW, "outside": OUTSIDE, "two": INSIDE, "model": AGAINST_MODEL, "arm": ARM}
_CLOSE = 1.7
"""By what the size that came out may differ from the one drawn."""


@dataclass(frozen=True)
class Cause:
    """What was put into a recording.

    Attributes:
        name, joint: as drawn; joint from 1, 0 for the whole arm.
        size: as it came out, in multiples of visible.
        right: names with joints that are right for it.
        outside: whether the library has no name for it.
    """

    name: str
    joint: int
    size: float
    right: frozenset[tuple[str, int]]
    outside: bool


@dataclass(frozen=True)
class Trial:
    """One trial.

    Attributes:
        seed, kind, engine: what it was drawn from.
        recording, urdf: for the diagnosis.
        reference: a healthy recording of the same arm, where a model is to be known before; else None.
        causes: what is in the recording; empty for none.
        healthy: names with joints that are true of the plant without any cause.
        values: true numbers of parameters by effect, joint, parameter.
        arm, motion, logger, controller, friction, gears: what was drawn, in a word each.
        late: by how much the logger makes all torques late [s].
    """

    seed: int
    kind: str
    engine: str
    recording: Recording
    urdf: str
    reference: Recording | None
    causes: tuple[Cause, ...]
    healthy: frozenset[tuple[str, int]]
    values: Values
    arm: str
    motion: str
    logger: str
    controller: str
    friction: str
    gears: str
    late: float = 0.0


def draw_trial(seed: int, kind: str | None = None, engine: str | None = None, size: tuple[float, float] = (0.5, 10.0),
               seconds: tuple[float, float] = (20.0, 45.0), cause: str | None = None) -> Trial:
    """Draws a trial.

    Args:
        seed: everything follows from it.
        kind: one of ``KINDS``; drawn if None, more than a third of them ``none``.
        engine: one of ``ENGINES``; of ``TURNS`` by turns with the seed if None.
        size: range of the effect's size in multiples of visible, drawn evenly in its logarithm.
        seconds: range of the recording's length [s].
        cause: the effect, of those of a kind with one; drawn if None.

    Raises:
        InputError: there is no such engine, or its library is not installed.
        RuntimeError: nothing can be drawn from the seed.
    """
    rng = np.random.default_rng([seed, 40013])
    drawn_kind = str(rng.choice(KINDS, p=SHARES))
    kind = drawn_kind if kind is None else kind
    engine = TURNS[seed % len(TURNS)] if engine is None else _playable(engine)
    for _ in range(25):
        try:
            trial = _attempt(rng, seed, kind, engine, size, seconds, cause)
        except (RuntimeError, IdealRobotError):
            # A plant that its controller cannot hold, or that an engine's step is too long for, is no trial.
            continue
        if trial is not None:
            return trial
    raise RuntimeError(f"no trial of kind {kind} in {engine} from seed {seed}")


def _playable(engine: str) -> str:
    if engine not in ENGINES:
        raise InputError(f"the engines are {', '.join(ENGINES)}", field="--engine", value=engine)
    if engine == "dart":
        dart()
    return engine


def _attempt(rng: np.random.Generator, seed: int, kind: str, engine: str, size: tuple[float, float],
             seconds: tuple[float, float], cause: str | None) -> Trial | None:
    arm = draw_arm(rng)
    plant = draw_plant(rng, arm)
    if engine == "pybullet":
        plant = dataclasses.replace(_with_cascade(rng, plant), regularisation=np.full(arm.n, BRISTLE))
    elif engine == "dart":
        plant = with_observer(rng, plant)
    duration = float(rng.uniform(*seconds))
    motion = draw_motion(rng, arm, duration)
    qa = tuple(range(int(rng.integers(min(2, arm.n), arm.n + 1)))) if kind == "arm" else None
    healthy = Twin(Setup(plant, draw_logger(rng, arm.n, qa)), engine, motion)
    drawn = _effects(rng, kind, engine, healthy.setup, cause)
    if drawn is None:
        return None
    setup, causes, values = healthy.setup, [], {}
    for effect in drawn:
        target = float(np.exp(rng.uniform(*np.log(size))))
        scaled = healthy.scaled(effect, target, kind)
        if scaled is None:
            return None
        amount, reached, run = scaled
        setup = effect.apply(setup, amount)
        values.update(effect.values(amount))
        outside = kind == "outside" and effect.name not in EQUIVALENT
        right = frozenset({("unknown", effect.joint)}) if outside else right_names(
            effect.name, effect.joint, arm.n, setup.logger.qa)
        causes.append(Cause(effect.name, effect.joint, reached, right, outside))
    if len(drawn) != 1:
        run = ENGINES[engine](setup.plant, motion) if drawn else healthy.run
    reference = None
    if kind in ("model", "known"):
        again = draw_motion(rng, arm, duration, motion.kind)
        other = dataclasses.replace(healthy.setup.logger, seed=int(rng.integers(2**31)))
        reference = record(other, plant, ENGINES[engine](plant, again))
    if kind == "outside" and not any(cause.outside for cause in causes):
        # It was outside when the seeds were drawn first; the library has a name for it since.
        kind = "new"
    logger = setup.logger
    # Two lags in a row are one.
    values = {key: value + (logger.late if key[0] in LATE else 0.0) for key, value in values.items()}
    return Trial(
        seed, kind, engine, record(logger, setup.plant, run), arm.urdf, reference, tuple(causes),
        _truly_there(setup), values, f"{arm.name}/{arm.n}", motion.kind, logger.torque, plant.controller,
        REGULARISATIONS[int(plant.regularisation[0])], "elastic" if plant.elastic.any() else "rigid", logger.late)


def _with_cascade(rng: np.random.Generator, plant: Plant) -> Plant:
    """The same plant under the cascade that our arm always has."""
    if plant.controller == "cascade":
        return plant
    while True:
        other = draw_plant(rng, plant.arm)
        if other.controller == "cascade":
            return other


def _effects(rng: np.random.Generator, kind: str, engine: str, setup: Setup,
             cause: str | None) -> list[Drawn] | None:
    """Effects of a trial, no two of them at one joint; None where the plant cannot have the one drawn."""
    if kind in ("none", "known"):
        return []
    result: list[Drawn] = []
    pool = {name: draw for name, draw in POOLS[kind].items() if name not in NOT_IN.get(engine, frozenset())}
    if cause not in (None, *pool):
        return None
    joints = rng.permutation(setup.plant.n)
    for j in joints[: 2 if kind == "two" else 1]:
        effect = pool[str(rng.choice(sorted(pool))) if cause is None else cause](rng, setup, int(j))
        if effect is None:
            return None
        result.append(effect)
    return result


def _truly_there(setup: Setup) -> frozenset[tuple[str, int]]:
    """What is true of the plant and its logger beside the causes, see ``equivalents.HEALTHY``."""
    plant, names = setup.plant, set()
    for j in range(plant.n):
        if plant.regularisation[j] in (BRISTLE, DAHL, MAXWELL):
            names.add(("presliding_hysteresis", j + 1))
        if np.isfinite(plant.stiffness[j]) and np.isfinite(plant.stiffness).all():
            names |= {("joint_elasticity", j + 1), ("arm:joint_elasticity", j + 1)}
    if setup.logger.late > 2e-4:
        names |= {("common_delay", 0), ("torque_filter", 0), ("dead_time", 0)}
    return frozenset(names)


class Twin:
    """The healthy twin, played once, against which effects are sized.

    Args:
        setup: plant and logger; the logger's noise relative to the torques.
        engine: one of ``ENGINES``.
        motion: that is played.
    """

    def __init__(self, setup: Setup, engine: str, motion: Motion) -> None:
        self.engine, self.motion = engine, motion
        self.run = ENGINES[engine](setup.plant, motion)
        noise: Array = setup.logger.noise * np.std(self.run.tau, axis=0)
        self.setup = Setup(setup.plant, dataclasses.replace(setup.logger, noise=noise))
        self._reading: Reading | None = None

    def scaled(self, effect: Drawn, target: float, kind: str) -> tuple[float, float, Run] | None:
        """Amount of an effect that makes it about as large as wanted, how large it became, and what happened then.

        None where it cannot become so large.

        Args:
            effect: drawn.
            target: its size in multiples of visible.
            kind: of the trial, see ``KINDS``.
        """
        if self._reading is None:
            self._reading = self._read(self.setup, self.run)
        amount = min(1.0, effect.largest)
        for _ in range(3):
            changed = effect.apply(self.setup, amount)
            run = self.run if changed.plant is self.setup.plant else ENGINES[self.engine](changed.plant, self.motion)
            reading = self._read(changed, run)
            if kind == "arm":
                every = twist_sizes(self._reading, reading)
            else:
                every = sizes(self._reading, reading, absorbed=kind != "model")
            reached = float(np.max(every) if effect.joint == 0 else every[effect.joint - 1])
            if target / _CLOSE <= reached <= target * _CLOSE:
                return amount, reached, run
            if reached < 1e-6 or amount * target / reached > effect.largest:
                return None
            amount *= target / reached
        return None

    def _read(self, setup: Setup, run: Run) -> Reading:
        plain: Logger = dataclasses.replace(setup.logger, spikes=0.0, temp=(), xy=False)
        return read(record(plain, setup.plant, run), setup.plant.arm.model)
