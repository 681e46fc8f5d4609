"""What processes of this computer take: memory and processor time, as the system tells; NaN where it does not."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path


def peak_memory(pid: int) -> float:
    """Largest resident memory of a process [MB] since it began, or since ``give_back``; what it shares counts whole."""
    return _field(Path(f"/proc/{pid}/status"), "VmHWM")


def memory_together(pids: Sequence[int]) -> float:
    """Memory of processes now [MB]; what they share, libraries above all, counts once."""
    own, shared = 0.0, 0.0
    for pid in pids:
        file = Path(f"/proc/{pid}/smaps_rollup")
        own += _field(file, "Private_Clean") + _field(file, "Private_Dirty")
        shared = max(shared, _field(file, "Shared_Clean") + _field(file, "Shared_Dirty"))
    return own + shared


def processor_seconds(pid: int) -> float:
    """Processor time that all threads of a process have taken [s]."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError):
        return float("nan")


def _field(file: Path, name: str) -> float:
    try:
        line = next(line for line in file.read_text(encoding="ascii").splitlines() if line.startswith(f"{name}:"))
        return int(line.split()[1]) * 1024 / 1e6
    except (OSError, ValueError, StopIteration):
        return float("nan")
