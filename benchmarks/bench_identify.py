"""Time, memory and error of the identification: 60 s at 500 Hz, six joints; beside FIGAROH where that is installed.

FIGAROH is no dependency. To compare, install it apart and say where:

    python3.11 -m venv figaroh-env && figaroh-env/bin/pip install figaroh
    FIGAROH_PYTHON=figaroh-env/bin/python python benchmarks/bench_identify.py

Both get the same recording of the simulated KR 15 in its default world and the same filtered signals: FIGAROH its
regressor (links, viscous and dry friction, rotor inertias, offsets), its QR decomposition to base parameters with least
squares, and scipy's decimation as in its own pipeline. Errors are on the same second recording that neither has seen.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from ideal_robot.signals.recording import Recording

FIGAROH = r'''
import sys, time, warnings
warnings.filterwarnings("ignore")
import numpy as np
from scipy import signal
started = time.perf_counter()
import pinocchio as pin
from figaroh.tools.regressor import RegressorBuilder, RegressorConfig
from figaroh.tools.qrdecomposition import QRDecomposer
imported, cpu = time.perf_counter(), time.process_time()
folder, urdf, factor = sys.argv[1], sys.argv[2], int(sys.argv[3])

class Robot:
    model = pin.buildModelFromUrdf(urdf)
    data = model.createData()

n = Robot.model.nv
settings = {"act_idxv": list(range(n)), "has_coupled_wrist": False, "act_Jid": list(range(1, n + 1))}
builder = RegressorBuilder(Robot, RegressorConfig(has_friction=True, has_actuator_inertia=True, has_joint_offset=True))

def prepared(name):
    d = np.load(f"{folder}/{name}.npz")
    W = builder.build_basic_regressor(d["q"], d["qd"], d["qdd"], settings)
    N = len(d["q"])
    # Rows are joint after joint, as FIGAROH stacks them.
    parts, y = [], []
    for j in range(n):
        parts.append(signal.decimate(W[j * N:(j + 1) * N], factor, axis=0, zero_phase=True)[5:-5])
        y.append(signal.decimate(d["tau"][:, j], factor, zero_phase=True)[5:-5])
    return np.concatenate(parts), np.concatenate(y)

W, tau = prepared("estimation")
seen = np.flatnonzero(np.linalg.norm(W, axis=0) > 1e-3)
names = [f"p{i}" for i in seen]
decomposer = QRDecomposer()
base_indices, _ = decomposer._identify_base_parameters(W[:, seen], names)
phi = np.linalg.lstsq(W[:, seen][:, list(base_indices)], tau, rcond=None)[0]
done = time.perf_counter()
used = time.process_time() - cpu
V, y = prepared("validation")
e = (y - V[:, seen][:, list(base_indices)] @ phi).reshape(n, -1)
error = 100 * np.linalg.norm(e, axis=1) / np.linalg.norm(y.reshape(n, -1), axis=1)
import resource
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(f"{done - imported:6.2f} s ({used:.2f} s CPU), peak {peak:.0f} MB, {len(base_indices)} parameters, "
      f"error {np.round(error, 1)} %")
'''


def recording(seed: int, seconds: float) -> Recording:
    """A recording of the simulated KR 15 moving along an optimised Fourier series."""
    from ideal_robot.identification.excitation import design_excitation
    from ideal_robot.robots.robot import Robot
    from scenes.identification.plan import fourier_commands
    from sim.arm.arm import SimulatedArm
    from sim.arm.world import World

    robot = Robot.load("kr15")
    motion = design_excitation(robot, np.random.default_rng(seed), period=seconds - 10.0)
    commands = fourier_commands(robot, motion, robot.home, robot.t_ipo)[: round(seconds / robot.t_ipo)]
    with SimulatedArm(robot, World.default("kr15"), np.random.default_rng(seed), robot.home) as arm:
        for q_c in commands:
            arm.cycle(q_c)
        return arm.recording()


def ours(folder: Path) -> None:
    """Runs in its own process, so that the peak memory is that of the identification."""
    from ideal_robot.identification.idim import identify, relative_error
    from ideal_robot.robots.robot import Robot

    robot = Robot.load("kr15")
    estimation, validation = (Recording.read(folder / f"{name}.parquet") for name in ("estimation", "validation"))
    identify([estimation], robot, friction="viscous_coulomb")  # the first call loads compiled code
    for friction in ("viscous_coulomb", "auto"):
        start, cpu = time.perf_counter(), time.process_time()
        result = identify([estimation], robot, friction=friction)
        took, used = time.perf_counter() - start, time.process_time() - cpu
        error = relative_error([result.model.predict(validation)])
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(f"ours, {friction:16s} {took:6.2f} s ({used:.2f} s CPU), peak {peak:.0f} MB, "
              f"{len(result.model.parameters)} parameters with σ, error {np.round(error, 1)} %", flush=True)


def main() -> None:
    """Makes the recordings, then times both."""
    if len(sys.argv) > 1:
        ours(Path(sys.argv[1]))
        return
    from ideal_robot.robots.robot import Robot
    from ideal_robot.signals.preprocess import preprocess

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        estimation, validation = recording(1, 60.0), recording(2, 30.0)
        print(f"KR 15, default world: {estimation.t[-1]:.0f} s at 500 Hz, {len(estimation.t)} samples")
        signals = preprocess(estimation)
        for role, r in (("estimation", estimation), ("validation", validation)):
            r.write(folder / f"{role}.parquet")
            s = preprocess(r, cutoff=signals.cutoff)
            np.savez(folder / f"{role}.npz", q=s.q, qd=s.qd, qdd=s.qdd, tau=s.tau)
        subprocess.run([sys.executable, __file__, str(folder)], check=True)
        python = os.environ.get("FIGAROH_PYTHON")
        if python is None:
            print("FIGAROH: not compared (set FIGAROH_PYTHON, see above)")
            return
        (folder / "figaroh_run.py").write_text(FIGAROH)
        answer = subprocess.run([python, str(folder / "figaroh_run.py"), str(folder), str(Robot.load("kr15").urdf),
                                 str(signals.factor)], capture_output=True, text=True, check=False)
        print("FIGAROH:", answer.stdout.strip() or answer.stderr.strip()[-800:])


if __name__ == "__main__":
    main()
