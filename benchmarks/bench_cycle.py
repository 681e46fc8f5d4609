"""What one control cycle of the ideal robot costs: six joints, n_d = 30.

    python benchmarks/bench_cycle.py [--cycles 20000]

The horizon is new in every cycle, as with a sensor that bends the path; nothing can be reused from the cycle before.
"""

from __future__ import annotations

import argparse
import gc
import os
import time

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import numpy as np  # noqa: E402

from ideal_robot.arrays import Array  # noqa: E402
from ideal_robot.feedforward.base import Feedforward  # noqa: E402
from ideal_robot.feedforward.friction_adaptation import AdaptedIdeal, FrictionAdaptation  # noqa: E402
from ideal_robot.feedforward.friction_curve import FrictionCurve  # noqa: E402
from ideal_robot.feedforward.ideal import IdealRobot  # noqa: E402
from ideal_robot.feedforward.precorrection import Precorrection  # noqa: E402
from ideal_robot.feedforward.training import LinearInverse  # noqa: E402
from ideal_robot.loop.from_model import loop_model  # noqa: E402
from ideal_robot.loop.impulse_response import LinearLoop  # noqa: E402
from ideal_robot.model.model import Model  # noqa: E402
from ideal_robot.robots.interface import RobotState  # noqa: E402
from ideal_robot.robots.robot import Robot  # noqa: E402
from scenes.models import shipped_model  # noqa: E402

N_D = 30


def timed(feedforward: Feedforward, q_d: Array, cycles: int, *, observe: bool = False) -> tuple[Array, Array]:
    """Elapsed and processor seconds of each cycle ``(cycles,)``, after a warm-up that compiles."""
    state = feedforward.init(q_d[0])
    times, busy = np.empty(cycles), np.empty(cycles)
    rng = np.random.default_rng(0)
    bends = rng.normal(scale=1e-5, size=(64, 1, q_d.shape[1]))
    for k in range(-50, cycles):
        start = k % (len(q_d) - N_D)
        # A new path every cycle: the planned one plus what a sensor just found.
        horizon = q_d[start : start + N_D] + bends[k % 64]
        measured = RobotState(0.012 * k, q_d[start], np.zeros(q_d.shape[1]))
        working, begun = time.thread_time(), time.perf_counter()
        _, state = feedforward.step(state, horizon)
        if observe and isinstance(feedforward, AdaptedIdeal):
            state = feedforward.observe(state, measured)
        if k >= 0:
            times[k], busy[k] = time.perf_counter() - begun, time.thread_time() - working
    return times, busy


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--cycles", type=int, default=20000)
    cycles = parser.parse_args().cycles
    robot = Robot.load("kr15")
    model = Model.load(shipped_model("kr15"))
    loop = loop_model(model, robot, delay=1)
    t = 0.012 * np.arange(2000)
    q_d = robot.home + 0.2 * np.sin(np.outer(t, 2 * np.pi * np.array([0.3, 0.4, 0.5, 0.6, 0.7, 0.8])))
    tool = robot.tool_place
    laws: dict[str, tuple[Feedforward, bool]] = {
        "linear": (LinearInverse(LinearLoop.of(loop, robot.home), N_D), False),
        "precorrected": (Precorrection.complete(model, robot, delay=1), False),
        "ideal": (IdealRobot(loop, N_D), False),
        "adapted, a line": (AdaptedIdeal(IdealRobot(loop, N_D), FrictionAdaptation(loop, tool=tool, curve=True)), True),
        "adapted, known path": (AdaptedIdeal(IdealRobot(loop, N_D), FrictionAdaptation(loop, tool=tool),
                                              curve=FrictionCurve(loop)), True),
    }
    print(f"{cycles} cycles, six joints, n_d = {N_D}, a new horizon in every cycle; milliseconds.")
    print("Elapsed time includes what else runs on the machine, processor time does not.\n")
    print(f"{'method':20s} {'median':>8s} {'p99':>8s} {'p99.9':>8s}   processor: {'median':>8s} {'p99.9':>8s}")
    gc.disable()
    for name, (feedforward, observe) in laws.items():
        elapsed, busy = (1e3 * seconds for seconds in timed(feedforward, q_d, cycles, observe=observe))
        gc.collect()
        print(f"{name:20s} {np.median(elapsed):8.3f} {np.quantile(elapsed, 0.99):8.3f} "
              f"{np.quantile(elapsed, 0.999):8.3f}              {np.median(busy):8.3f} {np.quantile(busy, 0.999):8.3f}")


if __name__ == "__main__":
    main()
