"""The arm behind its gears, once the forces that bent them are known."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ideal_robot.elasticity.observer import ArmObserver
from ideal_robot.model.model import Model
from planning.force.felt_arm import FeltArm
from planning.force.tare import Tare
from scenes.models import shipped_model
from tests.planning.cell import T, kr6


def test_late_forces_give_what_an_observer_gives_that_knew_them_at_once() -> None:
    robot = kr6()
    model = Model.load(shipped_model("kr6"))
    rng = np.random.default_rng(2)
    force = np.array([0.0, 0.0, 1.0]) * (20.0 + 10.0 * rng.standard_normal((30, 1)))

    def torque(q: np.ndarray, f: np.ndarray) -> np.ndarray:
        data = robot.pinocchio.createData()
        jacobian = pin.computeFrameJacobian(robot.pinocchio, data, q, robot.tool_id, pin.LOCAL_WORLD_ALIGNED)
        return np.asarray(jacobian[:3].T @ f)

    felt, knew = FeltArm(ArmObserver(model, T), robot.home, torque), ArmObserver(model, T)
    state = knew.init(robot.home)
    revised: dict[int, np.ndarray] = {}
    truth: dict[int, np.ndarray] = {}
    for k in range(30):
        q = robot.home + 0.01 * np.sin(0.3 * k)
        felt.step(k * T, q, torque(robot.home, np.array([0.0, 0.0, 20.0])))
        state = knew.step(state, q, torque(state.q_a, force[k]))
        truth[k] = state.q_a
        if k >= 2:
            changed = felt.feel(np.array([(k - 2) * T - 0.004]), force[k - 2][None])
            revised.update((round(t / T), q_a) for t, q_a in changed)
    for k in range(5, 28):
        np.testing.assert_allclose(revised[k], truth[k], atol=5e-6)


def test_drift_of_the_bias_shows_in_the_air_and_a_touch_does_not() -> None:
    tare, t = Tare(), np.arange(0.0, 0.3, 0.004)
    drift = np.array([0.1, -0.1, 0.3])
    touching = np.where(t > 0.26, 50.0 * (t - 0.26), 0.0)[:, None] * np.array([0.0, 0.0, 1.0])
    for at, one in zip(t, drift + touching, strict=True):
        tare.add(np.array([at]), one[None])
    np.testing.assert_allclose(tare.force, drift, atol=1e-12)
