"""A path played on the simulated arm in lockstep, as ``play`` does behind a maker's interface: no wires, no clocks."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.robots.interface import LinkedRobot, RobotState
from ideal_robot.signals.recording import Recording
from scenes.metrics import path_errors
from scenes.path.cell import PathCell, set_up
from scenes.played_path import PlaySettings, planned_path
from scenes.scene_files.path_scene import PathScene
from sim.arm.arm import SimulatedArm


class Bench(LinkedRobot):
    """The simulated arm as an arm behind a link; each command is in force at once."""

    def __init__(self, arm: SimulatedArm, within: float) -> None:
        super().__init__(arm.robot, 0.1, within)
        self.arm = arm

    def connect(self, patience: float = 60.0) -> RobotState:
        """See ``LinkedRobot.connect``."""
        held = self.arm.truth.q_m.copy()
        self._at_rest(held, held)
        self._command = held
        return RobotState(self.arm.t, held, np.zeros(self.robot.n))

    def _handed_over(self, q_c: Array) -> None:
        self._command = q_c

    def _received(self) -> RobotState:
        state = self.arm.cycle(self._command)
        self.arrived = self.arm.t
        return RobotState(state.t, self._looked_at(state.q), state.tau)

    def close(self) -> None:
        """See ``LinkedRobot.close``."""


def played(scene: PathScene, folder: Path) -> SimpleNamespace:
    """Plays a scene's path with the shipped model of its arm.

    Returns ``failure`` (None for the whole path), time-matched error of the true tool ``E_car`` [m] while the path is
    under way, and the ``run``.
    """
    cell: PathCell = set_up(scene, delay=False)
    n = cell.robot.n
    file = folder / "path.parquet"
    columns = {"t": cell.path.t, **{f"q_d_{i + 1}": cell.path.q_d[:, i].copy() for i in range(n)}}
    Recording(columns, {"robot": scene.robot, "cycle_time": cell.robot.t_ipo}).write(file)
    planned = planned_path(file, PlaySettings("rsi://127.0.0.1", robot=scene.robot, method=scene.method,
                                              cycle=cell.robot.t_ipo))
    rng = np.random.default_rng([scene.seed, 0, 1])
    with SimulatedArm(cell.robot, cell.world, rng, planned.desired[0]) as arm:
        assert planned.within is not None
        link = Bench(arm, planned.within)
        run = planned.player(link).play(patience=1.0)
        t, tcp = arm.history()["t"], arm.tcp_path()[1]
    rec = run.recording
    rows = slice(run.begun, run.begun + len(cell.path.t))
    under_way = np.flatnonzero(cell.path.counts[: len(rec.t[rows])]) + run.begun
    if run.failure is not None or not len(under_way):
        return SimpleNamespace(failure=run.failure, E_car=float("nan"), run=run)
    errors = path_errors(rec.t[under_way], cell.path.x_d[cell.path.counts], t, tcp)
    return SimpleNamespace(failure=None, E_car=errors.time_matched.E_car, run=run)
