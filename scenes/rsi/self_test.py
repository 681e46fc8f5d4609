"""Finds the interpolation cycles that this computer keeps up with: a packet's whole way with the real feedforward."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.rsi import RsiRobot
from ideal_robot.rsi.link import received, stamp_arrivals
from scenes.result import Progress, silent
from scenes.rsi.server import RsiServer, prepared

CYCLES_MS = (12, 8, 4, 2, 1)
"""Cycles that are tried [ms]."""
_ALLOWED = 1e-3
"""Share of late answers with which a cycle counts as held."""


@dataclass(frozen=True)
class CycleTest:
    """The test of one cycle time.

    Attributes:
        cycle_ms: cycle [ms].
        delays_ms: from each packet to its answer as the other process saw it [ms]; inf for none.
        computing_ms: from reading each packet to its answer as the server saw it [ms].
        failure: why the server gave up, or None.
    """

    cycle_ms: int
    delays_ms: Array
    computing_ms: Array
    failure: str | None

    @property
    def late(self) -> float:
        """Share of answers that came later than the cycle, or not at all."""
        return float(np.mean(self.delays_ms >= self.cycle_ms))

    @property
    def held(self) -> bool:
        """Whether this computer keeps up with the cycle."""
        return self.failure is None and self.late <= _ALLOWED


@dataclass(frozen=True)
class HeldCycles:
    """The results of the test whether this computer keeps up, for all cycle times.

    Attributes:
        tests: one a cycle.
        granted: privileges for even timing that the system granted.
        load: load average of the last minute, per core.
        cores: processor cores this process may use.
    """

    tests: tuple[CycleTest, ...]
    granted: list[str]
    load: float
    cores: int

    def shortest(self) -> int | None:
        """Shortest cycle [ms] that this computer keeps up with, together with all longer ones."""
        held = [test.cycle_ms for test in takewhile(lambda test: test.held, self.tests)]
        return held[-1] if held else None

    def json(self) -> dict[str, Any]:
        """The content of ``--json``: delays and losses of each cycle time."""
        return {"shortest_cycle_ms": self.shortest(), "granted": self.granted, "load_per_core": self.load,
                "cores": self.cores, "cycles": [
                    {"cycle_ms": t.cycle_ms, "held": t.held, "share_late": t.late, "packets": len(t.delays_ms),
                     "answer_ms": _spread(t.delays_ms), "computing_ms": _spread(t.computing_ms),
                     "failure": t.failure} for t in self.tests]}

    def table(self) -> tuple[list[str], list[list[Any]]]:
        """Column titles, and one row per cycle time."""
        rows = [[t.cycle_ms, "yes" if t.held else "no", f"{1e2 * t.late:.2f}", *_spread(t.delays_ms).values()]
                for t in self.tests]
        return ["cycle ms", "held", "late %", "answer after, median ms", "99 %", "worst"], rows

    def reasons(self) -> list[str]:
        """The reasons for the result on this computer, as sentences."""
        lines = [f"granted: {', '.join(self.granted)}; {self.cores} cores, load {self.load:.1f} per core"]
        failed = next((t for t in self.tests if not t.held), None)
        if failed is None:
            return [*lines, "every cycle tried is held"]
        own, whole = _spread(failed.computing_ms), _spread(failed.delays_ms)
        lines.append(f"{failed.cycle_ms} ms are not held: {1e2 * failed.late:.2f} % of the answers late"
                     + (f"; {failed.failure}" if failed.failure else ""))
        if own["p99"] > 0.5 * failed.cycle_ms:
            lines.append(f"the answer itself takes up to {own['p99']:.1f} ms (99 %): a faster processor, or --method "
                         "none")
        elif whole["max"] > failed.cycle_ms:
            lines.append("the program was not let run in time: stop other programs, keep to a core of its own (--core),"
                         " permit real-time priority (rtprio in limits.conf), or take a real-time kernel")
        return lines


def held_cycles(*, robot: str | None = None, model: Path | None = None, method: str = "ideal",
                core: int | None = None, seconds: float = 4.0, cycles_ms: tuple[int, ...] = CYCLES_MS,
                progress: Progress = silent) -> HeldCycles:
    """Tests for each cycle time whether this computer answers a simulated controller in time.

    The controller is a separate process that sends packets in real time; the answers command an arm at rest.

    Args:
        robot: shipped robot or URDF; the one the model names if None, the kr6 where no model is given either.
        model: file of an identified model; None for the shipped one of the robot.
        method: one of ``scenes.rsi.server.methods()``.
        core: processor core to keep to; None for any.
        seconds: how long each cycle is tried [s].
        cycles_ms: cycles that are tried, longest first [ms].
        progress: called with the share that is done.
    """
    tests, granted = [], []
    for i, cycle_ms in enumerate(cycles_ms):
        progress(i / len(cycles_ms), f"{cycle_ms} ms")
        name = robot if robot is not None or model is not None else "kr6"
        arm, law, _, _ = prepared(robot=name, model=model, method=method, cycle=1e-3 * cycle_ms)
        packets = round(1e3 * seconds / cycle_ms)
        with RsiRobot(arm, port=0) as link:
            server = RsiServer(link, law, np.tile(arm.home, (packets + 2, 1)), 0)
            words = [sys.executable, "-m", "scenes.rsi.self_test", str(link.address[1]), str(cycle_ms), str(packets),
                     *(f"{angle:.6f}" for angle in link.axes.angles(arm.home))]
            with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as pacer:
                run = server.play(patience=30.0, core=core)
                output = pacer.communicate(timeout=30.0 + 2 * seconds)[0]
        delays = np.array([np.inf if delay is None else delay for delay in json.loads(output)])
        # A silence after the pacer's last packet is the end of the test, not a failure.
        failure = run.failure if len(run.recording.t) < 0.9 * packets else None
        tests.append(CycleTest(cycle_ms, delays, 1e3 * np.array(link.answer_times), failure))
        granted = run.precautions
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    load = os.getloadavg()[0] / (os.cpu_count() or 1) if hasattr(os, "getloadavg") else float("nan")
    return HeldCycles(tuple(tests), granted, load, cores)


def _spread(times: Array) -> dict[str, float]:
    """Median, 99th percentile and maximum, NaN where there are none; an answer that never came is later than any."""
    return {name: float(np.percentile(times, share, method="lower")) if len(times) else float("nan")
            for name, share in (("median", 50), ("p99", 99), ("max", 100))}


# A controller's clock in a process of its own: sends a packet every cycle and notes when its answer is there.
#
#     python -m scenes.rsi.self_test PORT CYCLE_MS PACKETS A1 … An
#
# prints the delays in ms as a JSON list, null for no answer.

_PATIENCE = 20.0
"""How long the first answer is waited for [s]."""
_AFTER = 4
"""Packets behind the last that counts."""


def _delays(port: int, cycle: float, packets: int, axes: list[float]) -> list[float | None]:
    """Time from each packet to its answer [ms], from the first answered one on; None where there was none.

    ``cycle`` [s]; ``axes``: the axis angles that every packet tells [deg].
    """
    angles = " ".join(f'A{i + 1}="{angle:.6f}"' for i, angle in enumerate(axes))
    step = round(1e3 * cycle)
    most = packets + round(_PATIENCE / cycle)
    sent, first = [0.0] * most, most
    delays: list[float | None] = [None] * most
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        stamp_arrivals(link)
        due = time.perf_counter() + cycle
        for k in range(most):
            if k >= first + packets + _AFTER:
                break
            while (remaining := due - time.perf_counter()) > 0:
                link.settimeout(remaining)
                try:
                    answer, _, arrived = received(link)
                except (TimeoutError, ConnectionError):
                    continue
                packet = (int(answer.split(b"<IPOC>")[1].split(b"<")[0]) - 1000) // step
                if delays[packet] is None:
                    delays[packet], first = 1e3 * (arrived - sent[packet]), min(first, packet)
            now = time.perf_counter()
            # If it is late itself, it continues from now: two packets at once would not be a fault of the server.
            due = max(due, now - 0.1 * cycle) + cycle
            sent[k] = now
            link.sendto(f'<Rob Type="KUKA"><AIPos {angles}/><IPOC>{1000 + k * step}</IPOC></Rob>'.encode(),
                        ("127.0.0.1", port))
    return delays[first : first + packets]


if __name__ == "__main__":
    # A controller is punctual; where priority is not permitted, some of this process's delay is attributed to the
    # server.
    if hasattr(os, "sched_setscheduler"):
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(60))
    print(json.dumps(_delays(int(sys.argv[1]), 1e-3 * int(sys.argv[2]), int(sys.argv[3]),
                             [float(angle) for angle in sys.argv[4:]])))
