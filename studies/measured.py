"""Measured arms, from the folder of the public recordings: identification, and what adaptation is worth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.dynamics.newton_euler import inverse_dynamics, point_mass
from ideal_robot.feedforward.command_inverse import CommandInverse
from ideal_robot.feedforward.friction_adaptation import FrictionAdaptation
from ideal_robot.friction.table import friction_sizes
from ideal_robot.identification.angles_alone import identify_arm
from ideal_robot.identification.checks import checked
from ideal_robot.identification.idim import identify
from ideal_robot.identification.whole_model import identify_model
from ideal_robot.loop.from_model import loop_model
from ideal_robot.loop.loop import Loop
from ideal_robot.model.model import Model
from ideal_robot.model.parametrisation import ControllerModel
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.filters import lowpass
from ideal_robot.signals.preprocess import FilteredSignals, preprocess
from ideal_robot.signals.recording import Recording
from scenes.arms import arm_of
from scenes.commands.common import numbers, whole_numbers
from scenes.identification.own_model import identified_model
from scenes.identification.twin import DRAWS, twin_of
from scenes.identification.twin_play import COLUMNS, make_twin
from scenes.line.play import play
from scenes.scene_file import load_scene
from scenes.scene_files.line_scene import LineScene
from sim.arm.world import World
from studies.report import head, row


@dataclass(frozen=True)
class Arm:
    """One measured arm: what it is identified on, what it is judged on, and what its authors reached [%].

    Attributes:
        files: URDF, estimation, validation, from the folder of the data. A validation file that is the estimation file
            means its second half, and the first half is fitted.
        authors: std(residual)/std(torque) per joint, where published [%].
        live: how many joints, the first ones, have a torque channel that is alive; all if None.
        band: position and torque band of the judgement [Hz].
    """

    files: tuple[str, str, str]
    authors: tuple[float, ...] = ()
    live: int | None = None
    band: tuple[float, float] = (8.0, 4.0)


ARMS = {
    "panda": Arm(("panda/panda.urdf", "panda/panda_a.parquet", "panda/panda_b.parquet"),
                 authors=(6.3, 2.5, 2.4, 5.1, 11.5, 7.4, 19.9)),
    "tiago": Arm(("tiago/tiago.urdf", "tiago/tiago_a.parquet", "tiago/tiago_b.parquet"), live=5),
    "ur5": Arm(("ur5/ur5.urdf", "ur5/ur5_no9.parquet", "ur5/ur5_no6.parquet")),
    "ur10": Arm(("ur10/ur10.urdf", "ur10/ur10.db3", "ur10/ur10.db3")),
    "ur10e": Arm(("ur10e/ur10e.urdf", "ur10e/free_12harm_50s.parquet", "ur10e/free_8harm_20s.parquet")),
    "emps": Arm(("emps/emps.urdf", "emps/emps_estimation.parquet", "emps/emps_validation.parquet"), band=(100.0, 50.0)),
}


def measured(data: Path, arms: str = ",".join(ARMS), cutoffs: str = "4,6,8,10,15,20,30") -> None:
    """Identification of measured arms: filters chosen from the data against fixed ones, on motion that was not fitted.

    Every model is judged alike, whatever filters it was made with: positions below 8 Hz, measured and predicted torque
    below 4 Hz (EMPS: 100 and 50 Hz), std(residual) / std(torque) per joint. DATA is the folder of the recordings.
    """
    head("", "std(residual) / std(torque) per joint [%]")
    for name in arms.split(","):
        arm = ARMS[name]
        robot, estimation, validation = _loaded(arm, data)
        if arm.authors:
            _row(f"{name}, its authors", arm.authors, arm)
        own = identify([estimation], robot).model
        errors, fixed, filters = _judged(own, validation, arm), [], own.provenance["filters"]
        _row(f"{name}, no switch ({filters['cutoff']:.3g} / {filters['cutoff_decimation']:.3g} Hz)", errors, arm)
        for cutoff in numbers(cutoffs, "--cutoffs"):
            if cutoff < 0.45 / float(np.median(np.diff(estimation.t))):
                model = identify([estimation], robot, cutoff=cutoff, cutoff_decimation=0.5 * cutoff).model
                fixed.append(_judged(model, validation, arm))
                _row(f"{name}, {cutoff:g} Hz", fixed[-1], arm)
        if fixed:
            whole = np.mean(np.array(fixed)[:, : arm.live], axis=1)
            _row(f"{name}, no switch over the best of them", errors / fixed[int(np.argmin(whole))], arm)
            mean = np.mean(errors[: arm.live])
            row(f"{name}, mean over joints", f"{mean:.2f} against {whole.min():.2f}: {mean / whole.min():.2f}")


def measured_adapted(data: Path, arms: str = "ur10e,emps,panda,ur5") -> None:
    """What adaptation is worth on measured arms: torques predicted before they are seen.

    Along the motion that was left for judging, adaptation is told positions and torques once an interpolation cycle,
    and what it knew before a cycle predicts that cycle's torque. On the second half of the motion counts
    std(residual) / std(torque): by the model alone, and adapted.
    These recordings hold no commands, so no controller is known; adaptation needs one for the unit of apparent
    inertias alone, and is given a usual one.
    """
    head("arm", "residual over torque, per joint [%]")
    for name in arms.split(","):
        arm = ARMS[name]
        robot, estimation, validation = _loaded(arm, data)
        model = identify([estimation], robot).model
        loop = loop_model(replace(model, controller=_usual_controller(robot, validation.joints("q")[0])), robot)
        s = preprocess(validation, cutoff=arm.band[0])
        alone = model.inverse_dynamics(s.q, s.qd, s.qdd, t=s.t - s.t[0])
        adaptation = FrictionAdaptation(loop, tool=robot.tool_place, noise_std=model.noise_std)
        adapted = alone + _learned_on_the_way(model, loop, adaptation, validation, s)
        for title, torque in (("model alone", alone), ("adapted", adapted)):
            _row(f"{name}, {title}", _share_left(s, torque, arm.band[1], len(s.t) // 2), arm)


def measured_commands(data: Path) -> None:
    """Errors of the paths that a measured machine (EMPS) followed: measured, and expected from either of its files.

    The command's law is identified from one file, with its torque and from commands and angles alone; the error of the
    path as it was commanded is root mean square.

    Args:
        data: folder of the recordings.
    """
    machine, *files = ARMS["emps"].files
    robot, recordings = Robot.load(data / machine), [Recording.read(data / file) for file in files]
    head("identified from", "by", "path", "measured [mm]", "expected", "expected over measured")
    for file, recording in zip(files, recordings, strict=True):
        for by in ("torque", "angles alone"):
            columns = {name: values for name, values in recording.columns.items()
                       if by == "torque" or not name.startswith("tau")}
            model = identify_arm(Recording(columns), robot).model
            assert model.command is not None
            inverse = CommandInverse(model, replace(robot, t_ipo=model.command.t_cycle))
            for other, path in zip(files, recordings, strict=True):
                desired = path.joints("q_d")
                error, expected = (1e3 * float(np.sqrt(np.mean(x**2))) for x in (
                    desired - path.joints("q"), inverse.uncorrected(desired)))
                row(Path(file).stem, by, Path(other).stem, f"{error:.3f}", f"{expected:.3f}", f"{expected / error:.3f}")


def _loaded(arm: Arm, data: Path) -> tuple[Robot, Recording, Recording]:
    """The arm, what is fitted, and what is judged."""
    urdf, first, second = (data / file for file in arm.files)
    robot, estimation = Robot.load(urdf), Recording.read(first)
    if first == second:
        middle = 0.5 * (estimation.t[0] + estimation.t[-1])
        estimation, validation = (_part(estimation, estimation.t <= middle), _part(estimation, estimation.t > middle))
    else:
        validation = Recording.read(second)
    return robot, estimation, checked([validation], robot)[0][0]


def _part(recording: Recording, rows: np.ndarray) -> Recording:
    return replace(recording, columns={name: np.ascontiguousarray(v[rows]) for name, v in recording.columns.items()})


def _judged(model: Model, recording: Recording, arm: Arm) -> Array:
    """std(residual) / std(torque) per joint ``(n,)`` [%] in the arm's band."""
    s = preprocess(recording, cutoff=arm.band[0])
    return _share_left(s, model.inverse_dynamics(s.q, s.qd, s.qdd, t=s.t - s.t[0]), arm.band[1])


def _share_left(s: FilteredSignals, predicted: Array, cutoff: float, begin: int = 0) -> Array:
    """The same below ``cutoff`` [Hz] from sample ``begin`` on; a period of it at either end does not count."""
    tau, predicted = (lowpass(values, s.dt, cutoff) for values in (s.tau, predicted))
    period = round(1.0 / (s.dt * cutoff))
    counts = slice(max(begin, period), -period)
    return np.asarray(100.0 * np.std((tau - predicted)[counts], axis=0) / np.std(tau[counts], axis=0))


def _row(name: str, values: Sequence[float] | Array, arm: Arm) -> None:
    row(name, ", ".join(f"{v:.1f}" if arm.live is None or j < arm.live else "—" for j, v in enumerate(values)))


def _usual_controller(robot: Robot, q: Array) -> ControllerModel:
    """A cascade whose velocity loop takes away 0.3 of an error in a cycle, at a posture ``(n,)``."""
    inertia = np.diag(pin.crba(robot.pinocchio, robot.pinocchio.createData(), q))
    gain, zero = 0.3 * inertia / robot.t_ipo, np.zeros(robot.n)
    return ControllerModel(robot.t_ipo, 15.0 * gain, gain, zero, zero, np.full(robot.n, 0.2), zero)


def _learned_on_the_way(model: Model, loop: Loop, adaptation: FrictionAdaptation, recording: Recording,
                        s: FilteredSignals) -> Array:
    """Torque beyond the model's that was known before each cycle, between cycles by straight lines ``(N, n)`` [N m]."""
    times = np.arange(recording.t[0], recording.t[-1], loop.t_ipo)
    q, tau = (np.array([np.interp(times, recording.t, column) for column in recording.joints(name).T]).T
              for name in ("q", "tau"))
    moved = [np.array([np.interp(times, s.t, column) for column in values.T]).T
             for values in (s.q, s.qd, s.qdd, model.friction.direction(s.q, s.qd))]
    more, state = np.zeros_like(q), adaptation.init()
    for k, (angles, v, a, direction) in enumerate(zip(*moved, strict=True)):
        now, before = ([friction_sizes(friction, i, speed, 0.0) for i, speed in enumerate(v)]
                       for friction in (state.friction, loop.friction))
        dry, fluid = (np.array(now) - np.array(before)).T
        more[k] = direction * dry + np.sign(v) * fluid
        carried = adaptation.carried(state)
        if carried is not None:
            kilogram = point_mass(loop.chain, carried.place)
            more[k] += carried.mass * inverse_dynamics(kilogram, angles[None], v[None], a[None])[0]
        state = adaptation.update(state, RobotState(float(times[k]), q[k], tau[k]))
    return np.array([np.interp(s.t, times, column) for column in more.T]).T


# Twins of recorded arms: how near they play what was recorded, and what line error they predict.

def twins(data: Path, arms: str = "ur10e,panda,emps") -> None:
    """Twins of measured arms play the recorded motion: torques beside the measured ones, spectrum, identification.

    DATA is the folder of the recordings. The spectrum's difference is that of the amplitudes in octaves, weighted by
    the measured power. None of these recordings has commands: the controllers are those of a class.
    """
    head("arm", *COLUMNS)
    for name in arms.split(","):
        urdf, first, _ = (data / file for file in ARMS[name].files)
        result = make_twin([Recording.read(first)], str(urdf))
        for values in result.rows():
            row(name, str(values[0]), *(f"{value:.3g}" for value in values[1:]))


def twin_arms(arms: str = "1-3", draws: int = DRAWS) -> None:
    """The line error that a twin predicts for a simulated KR 6, and that arm's own, over several arms of the type.

    The twin is made of the recordings of the arm's two identification motions. It is drawn anew as often as DRAWS says,
    each time with another seed, and each time follows with the model identified from its own recordings, as the arm
    does, with the same seeds. Of the arm the mean over seeds counts.
    """
    head("arm", "mean [mm]", "predicted", "off by [%]", "95 % [mm]", "predicted from", "to", "inside")
    for number in whole_numbers(arms, "--arms"):
        scene = load_scene("line").changed(model="own", world={"individual": number})
        assert isinstance(scene, LineScene)
        seeds = range(1, draws + 1)
        mean, worst = np.mean([_line_error(scene.changed(seed=seed)) for seed in seeds], axis=0)
        world = World.from_table(scene.robot, scene.arm_world)
        _, recordings = identified_model(scene.robot, world=world)
        robot = arm_of(scene.robot)
        twin = twin_of(identify_model(recordings, robot), robot, scene.robot)
        errors = np.array([_line_error(scene.changed(seed=seed, world={**twin.table, "individual": seed}))
                           for seed in seeds])
        predicted, low, high = float(np.mean(errors[:, 0])), float(errors[:, 1].min()), float(errors[:, 1].max())
        row(str(number), f"{mean:.3f}", f"{predicted:.3f}", f"{100.0 * (predicted / mean - 1.0):+.0f}", f"{worst:.3f}",
            f"{low:.3f}", f"{high:.3f}", "yes" if low <= worst <= high else "no")


def _line_error(scene: LineScene) -> Array:
    """Mean and 95 % of the distance from the line ``(2,)`` [mm]."""
    error = play(scene, "adapted").control_error
    return 1e3 * np.array([error.mean, error.p95])
