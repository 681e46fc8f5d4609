"""Identification of measured arms: filters chosen from the data against fixed ones, on motion that was never fitted.

    python benchmarks/measured_arms.py DATA [--arms panda,ur5] [--cutoffs 4,6,8] [--markdown FILE]

DATA is the folder of the public recordings. Every model is judged alike, whatever filters it was made with: positions
below 8 Hz, measured and predicted torque below 4 Hz (EMPS: 100 and 50 Hz), std(residual) / std(torque) per joint.
"""

from __future__ import annotations

import argparse
import resource
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.identification.checks import checked
from ideal_robot.identification.idim import Identification, identify
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.preprocess import FilteredSignals, lowpass, preprocess
from ideal_robot.signals.recording import Recording

CUTOFFS = (4.0, 6.0, 8.0, 10.0, 15.0, 20.0, 30.0)


@dataclass(frozen=True)
class Arm:
    """One measured arm: what it is identified on, what it is judged on, and what its authors reached [%].

    Attributes:
        urdf, estimation, validation: files, from the folder of the data. A validation file that is the estimation file
            means its second half, and the first half is fitted.
        authors: std(residual)/std(torque) per joint, where published [%].
        live: joints whose torque channel is alive, from 1; all if empty.
        band: position and torque band of the judgement [Hz].
    """

    urdf: str
    estimation: str
    validation: str
    authors: tuple[float, ...] = ()
    live: tuple[int, ...] = ()
    band: tuple[float, float] = (8.0, 4.0)


ARMS = {
    "panda": Arm("panda/panda.urdf", "panda/panda_a.parquet", "panda/panda_b.parquet",
                 authors=(6.3, 2.5, 2.4, 5.1, 11.5, 7.4, 19.9)),
    "tiago": Arm("tiago/tiago.urdf", "tiago/tiago_a.parquet", "tiago/tiago_b.parquet", live=(1, 2, 3, 4, 5)),
    "ur5": Arm("ur5/ur5.urdf", "ur5/ur5_no9.parquet", "ur5/ur5_no6.parquet"),
    "ur10": Arm("ur10/ur10.urdf", "ur10/ur10.db3", "ur10/ur10.db3"),
    "ur10e": Arm("ur10e/ur10e.urdf", "ur10e/free_12harm_50s.parquet", "ur10e/free_8harm_20s.parquet"),
    "emps": Arm("emps/emps.urdf", "emps/emps_estimation.parquet", "emps/emps_validation.parquet", band=(100.0, 50.0)),
}


def recordings_of(arm: Arm, data: Path) -> tuple[Recording, Recording]:
    """What is fitted and what is judged."""
    estimation = Recording.read(data / arm.estimation)
    if arm.validation != arm.estimation:
        return estimation, Recording.read(data / arm.validation)
    middle = 0.5 * (estimation.t[0] + estimation.t[-1])
    return _part(estimation, estimation.t <= middle), _part(estimation, estimation.t > middle)


def _part(recording: Recording, rows: np.ndarray) -> Recording:
    return replace(recording, columns={name: np.ascontiguousarray(v[rows]) for name, v in recording.columns.items()})


def judged(model: Model, recording: Recording, band: tuple[float, float]) -> Array:
    """std(residual) / std(torque) per joint ``(n,)`` [%], positions and torques below the band's limits [Hz]."""
    s = preprocess(recording, cutoff=band[0])
    return share_left(s, model.inverse_dynamics(s.q, s.qd, s.qdd, t=s.t - s.t[0]), band[1])


def share_left(s: FilteredSignals, predicted: Array, cutoff: float, begin: int = 0) -> Array:
    """std(residual) / std(torque) per joint ``(n,)`` [%] below ``cutoff`` [Hz], from sample ``begin`` on.

    A period of the cut-off at either end does not count.
    """
    measured, predicted = (lowpass(values, s.dt, cutoff) for values in (s.tau, predicted))
    period = round(1.0 / (s.dt * cutoff))
    counts = slice(max(begin, period), -period)
    return np.asarray(100.0 * np.std((measured - predicted)[counts], axis=0) / np.std(measured[counts], axis=0))


def row(name: str, values: Array, arm: Arm) -> str:
    """One line of the table."""
    shown = [f"{v:.1f}" if not arm.live or j + 1 in arm.live else "—" for j, v in enumerate(values)]
    return f"| {name} | {', '.join(shown)} |"


def played(name: str, arm: Arm, data: Path, cutoffs: list[float]) -> list[str]:
    """The lines of one arm: its authors, without a switch, each fixed cut-off, and the ratio that counts."""
    robot = Robot.load(data / arm.urdf)
    estimation, validation = recordings_of(arm, data)
    (validation,), _ = checked([validation], robot)
    live = np.array(arm.live or range(1, robot.n + 1)) - 1
    lines = []
    if arm.authors:
        lines.append(row(f"{name}, its authors", np.array(arm.authors), arm))
    start = time.process_time()
    own = identify([estimation], robot)
    seconds = time.process_time() - start
    errors = judged(own.model, validation, arm.band)
    lines.append(row(f"{name}, no switch ({filters_of(own)}, {seconds:.0f} s)", errors, arm))
    fixed = []
    for cutoff in cutoffs:
        if cutoff >= 0.45 / float(np.median(np.diff(estimation.t))):
            continue
        model = identify([estimation], robot, cutoff=cutoff, cutoff_decimation=0.5 * cutoff).model
        fixed.append(judged(model, validation, arm.band))
        lines.append(row(f"{name}, {cutoff:g} Hz", fixed[-1], arm))
    if fixed:
        whole = np.mean(np.array(fixed)[:, live], axis=1)
        best = fixed[int(np.argmin(whole))]
        lines.append(row(f"{name}, no switch over the best of them", errors / best, arm).replace("| ", "| ", 1))
        lines.append(f"| {name}, mean over joints | {np.mean(errors[live]):.2f} against {whole.min():.2f}: "
                     f"{np.mean(errors[live]) / whole.min():.2f} |")
    return lines


def filters_of(result: Identification) -> str:
    """The filters that were used."""
    used = result.model.provenance["filters"]
    return f"{used['cutoff']:.3g} / {used['cutoff_decimation']:.3g} Hz"


def main() -> None:
    """Plays the arms and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--arms", default=",".join(ARMS))
    parser.add_argument("--cutoffs", default=",".join(f"{c:g}" for c in CUTOFFS))
    parser.add_argument("--markdown", type=Path)
    args = parser.parse_args()
    cutoffs = [float(c) for c in args.cutoffs.split(",") if c]
    lines = ["| | std(residual) / std(torque) per joint [%] |", "| --- | --- |"]
    print("\n".join(lines), flush=True)
    for name in args.arms.split(","):
        of_arm = played(name, ARMS[name], args.data, cutoffs)
        print("\n".join(of_arm), flush=True)
        lines += of_arm
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")
    if args.markdown:
        args.markdown.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
