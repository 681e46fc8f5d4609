"""Plays a scene of kind ``force``: the tip presses on an unknown surface and moves along it ([L] section 4)."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.elasticity.observer import ArmObserver
from ideal_robot.errors import InputError, LimitError
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.feedforward.ideal import IdealRobot
from ideal_robot.feedforward.passthrough import PassThrough
from planning.force.contact import Phase
from planning.force.direct_force import DirectForceFeedback
from planning.force.stop_conditions import StopConditions
from planning.path.stopping import stopping_rows
from planning.planning_error import PlanningError
from scenes.force.cell import N_D, Cell, calibrations, scene_curves, set_up
from scenes.force.compare import ForceComparison, compare_forces
from scenes.force.line_camera import GlueCamera, glue_fusion
from scenes.force.result import ForceLog, ForceResult, force_result
from scenes.force.scene import Assumed, CameraTrouble, Emergency, ForceScene
from scenes.result import Progress, silent
from sensing.force.force_calibration import ContactElasticity, ToolLoad
from sensing.force.force_deviation import WrenchFilter
from sensing.force.wrench import WrenchSample
from sim.arm.arm import SimulatedArm
from sim.contact.contact import TipContact

SceneModel = ForceScene
METHODS = ("direct_feedback", "sensor_path", "ideal")
WINDOW = 0.0
"""Length of the moving average over wrenches [s]; the map averages better, and without delay."""
BRAKING = 2.0
"""Deceleration of a stop on the path [m/s²]."""
REST = 12
"""Cycles for which the recording goes on after a stop."""
LONGEST = 60.0
"""A run that has not ended by then is stuck [s]."""


def curves(scene: ForceScene) -> dict[str, Array]:
    """Reference path and the true surface along it ``(N, 3)`` [m], for the viewer."""
    return scene_curves(scene)


def run(scene: ForceScene, *, method: str | None = None, out: Path | None = None, progress: Progress = silent,
        gains: tuple[float, float] | None = None) -> ForceResult:
    """Presses and moves once.

    Args:
        scene: what to play.
        method: one of ``METHODS``; the scene's own if None.
        out: folder for recording and report; nothing is written without.
        progress: told how far it is.
        gains: K_p, K_d of direct feedback; the scene's, or found by search, if None.

    Raises:
        InputError: the scene cannot be played.
    """
    method = method or scene.method
    allowed = METHODS if scene.task == "surface" else METHODS[1:]
    if method not in allowed:
        raise InputError(f"expected one of {', '.join(allowed)}", field="method", value=method)
    if method == "direct_feedback" and gains is None:
        from scenes.force.compare import best_gains

        gains = scene.gains or best_gains(scene, progress=lambda part, text: progress(0.8 * part, text))[0]
    result = play(scene, method, gains, progress)
    if out is None:
        return result
    from scenes.force.page import write_run

    return write_run(result, out)


def compare(scene: ForceScene, *, out: Path | None = None, progress: Progress = silent) -> ForceComparison:
    """Plays the scene with every method and with direct feedback at its best gains."""
    return compare_forces(scene, out=out, progress=progress)


def play(scene: ForceScene, method: str, gains: tuple[float, float] | None = None,
         progress: Progress = silent) -> ForceResult:
    """One run without files."""
    # What calibration does not see must not make it run again.
    alike = scene.model_copy(update={"method": "ideal", "gains": None, "assumed": Assumed(), "emergency": Emergency(),
                                     "trouble": CameraTrouble(),
                                     "sensor": scene.sensor.model_copy(update={"drift": ()})})
    tool, elasticity = calibrations(alike.model_dump_json())
    loop = ForceLoop(set_up(scene), method, gains, tool, elasticity)
    with SimulatedArm(loop.cell.robot, loop.cell.world, loop.cell.noise, loop.follower.q_start) as arm:
        contact = TipContact(arm, loop.cell.surface, scene.tip.truth())
        started = time.perf_counter()
        loop.play(arm, contact, progress)
        wall = time.perf_counter() - started
        result = force_result(scene, method, loop, arm, contact, wall)
    if loop.vision is not None:
        loop.vision.close()
    return result


class ForceLoop:
    """The two loops of [L] Fig. 1 with a force sensor."""

    def __init__(self, cell: Cell, method: str, gains: tuple[float, float] | None, tool: ToolLoad,
                 elasticity: ContactElasticity) -> None:
        self.cell, self.method, self.tool, self.elasticity = cell, method, tool, elasticity
        assumed = cell.scene.assumed.elasticity_ratio * elasticity.stiffness
        self.assumed_stiffness = assumed
        self.follower: Any
        if cell.scene.task == "contour":
            self.follower = cell.contour_follower(assumed)
        else:
            self.follower = cell.follower(assumed, glue_fusion(cell) if cell.scene.task == "glue" else None)
        self.vision = GlueCamera(cell, self.follower) if cell.scene.task == "glue" else None
        self.watch = StopConditions(cell.robot, cell.scene.emergency.limits())
        self.filter = WrenchFilter(WINDOW)
        self.direct = DirectForceFeedback(self.follower, *gains) if method == "direct_feedback" and gains else None
        T = cell.world.t_ipo
        self.feedforward: Feedforward = PassThrough(T)
        if method == "ideal":
            self.feedforward = IdealRobot.of(cell.model, cell.robot, N_D, delay=int(cell.world.correction_delay))
        # Where the gears are not known, commands and motor angles share the same error: q_a ≈ q.
        self.observer = ArmObserver(cell.model, T) if method == "ideal" else None
        self.arm = self.observer.init(self.follower.q_start) if self.observer is not None else None
        self.state = self.feedforward.init(self.follower.q_start)
        self.log = ForceLog()
        self.under_way: list[WrenchSample] = []
        self._torque = np.zeros((N_D, cell.robot.n))

    def play(self, arm: SimulatedArm, contact: TipContact, progress: Progress) -> None:
        """Cycle by cycle until the tip is lifted again, or the arm has stopped."""
        follower, T = self.follower, arm.t_ipo
        q, last = follower.q_start, np.tile(follower.q_start, (N_D, 1))
        stopping: Iterator[Array] | None = None
        resting = 0
        for k in range(int(LONGEST / T)):
            t = k * T
            begin = time.perf_counter()
            follower.observe(t, self._arm_angles(q))
            if stopping is None:
                try:
                    self._sense(t)
                    if self.vision is not None:
                        self.vision.sense(t)
                    self._check(t)
                    # Direct feedback goes its own way between touch-down and lift: no need to plan.
                    last = self._desired(t, last)
                except (PlanningError, LimitError) as error:
                    self.log.failure = str(error)
                    stopping = stopping_rows(last[1:], T, max(follower.speed_at(t), 0.1), BRAKING)
            if stopping is not None:
                last = _padded(next(stopping))
            self._torque = follower.contact_torque(last)
            try:
                q_c = self._command(t, last)
                self.log.add(t, last[0], q_c, follower, time.perf_counter() - begin)
                wanted = self.vision.windows(t, t + T) if self.vision is not None else []
                q = arm.cycle(q_c).q
                if self.vision is not None:
                    self.vision.expose(wanted, arm)
            except (PlanningError, LimitError) as error:
                # A gain of direct feedback that drives the arm out of its limits: the controller refuses.
                self.log.failure = self.log.failure or str(error)
                break
            measured = self.cell.sensor.due(t, t + T, arm.tcp_at, contact.force_at)
            self.log.wrenches += measured
            self.under_way += measured
            resting = resting + 1 if stopping is not None and np.allclose(last, last[0], atol=1e-9) else 0
            if self._done() or resting > REST:
                break
            if k % 16 == 0:
                progress(min(1.0, t / (self.cell.profile.duration + 2.0)), self.method)
        else:
            self.log.failure = f"not done after {LONGEST:.0f} s, phase {follower.phase.value}"

    def _arm_angles(self, q: Array) -> Array:
        """q_a from the motor angles, the contact torque included."""
        if self.observer is None or self.arm is None:
            return q
        self.arm = self.observer.step(self.arm, q, self._torque[0])
        return self.arm.q_a

    def _sense(self, t: float) -> None:
        arrived = sorted((s for s in self.under_way if s.t_arrival <= t), key=lambda s: s.t_arrival)
        self.under_way = [s for s in self.under_way if s.t_arrival > t]
        if not arrived:
            return
        samples = [self.filter.add(sample) for sample in arrived]
        history = self.follower.history
        contact = np.array([self.tool.contact(s.wrench, history.pose(max(s.t, history.first)).rotation)[:3]
                            for s in samples])
        fused = self.follower.update_force(np.array([s.t for s in samples]), contact)
        nis = float("nan") if fused is None or not fused.dof else fused.nis / fused.dof
        self.log.samples.append((samples[-1].t, self.follower.force, nis))
        if self.direct is not None:
            self.direct.update(self.follower.force)
        self.watch.force(t, float(np.median(np.linalg.norm(contact, axis=1))))

    def _check(self, t: float) -> None:
        follower = self.follower
        if follower.phase is Phase.TRAVEL:
            # Samples are late: contact is judged at the time of the newest one.
            newest = self.log.samples[-1][0] if self.log.samples else t
            self.watch.contact(newest, follower.last_touch)
            if self.vision is not None:
                self.vision.sight.check(t)
        elif follower.phase is Phase.APPROACH:
            self.watch.approach(t, follower.descended, follower.settings.reach)

    def _desired(self, t: float, last: Array) -> Array:
        if self.direct is not None and self.follower.phase is not Phase.APPROACH:
            self.follower.advance(t)
            return last
        q_d = self.follower.horizon(t)
        self.watch.command(t, q_d)
        return q_d

    def _done(self) -> bool:
        lifted = self.direct is not None and self.direct.lifted >= self.follower.settings.clearance
        return self.follower.phase is Phase.DONE or lifted

    def _command(self, t: float, q_d: Array) -> Array:
        if self.direct is not None:
            return self.direct.command(t, q_d)
        q_c, self.state = self.feedforward.step(self.state, q_d, self._torque)
        return q_c


def _padded(rows: Array) -> Array:
    """A horizon that is one row short, its last row held."""
    return np.concatenate([rows, rows[-1:]])
