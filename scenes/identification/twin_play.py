"""A twin runs the recorded motion: its torques beside the measured ones, and the identification residuals of both."""

from __future__ import annotations

import os
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import welch

from ideal_robot.arrays import Array, interpolated
from ideal_robot.identification.whole_model import IdentificationResult, identify_model
from ideal_robot.model.parametrisation import joined
from ideal_robot.results import Summarised, listed, one_unit, plain
from ideal_robot.robots import SHIPPED
from ideal_robot.robots.size import FEWEST
from ideal_robot.signals.recording import Recording
from scenes.arms import arm_of
from scenes.identification.twin import Twin, behind_gears, played_again, twin_of
from scenes.placing import place_line, scene_text
from scenes.result import Progress, silent
from scenes.scene_file import library, load_scene
from scenes.scene_files.line_scene import LineScene

_START = 1.0
"""Left out at the start: a recording may begin in motion, the twin begins at rest [s]."""
_SEGMENT = 5.0
"""Length of the pieces that spectra are averaged over [s]."""


@dataclass(frozen=True, repr=False)
class TwinResult(Summarised):
    """A twin, and its comparison with the recording.

    Attributes:
        twin: its world.
        analysis: the model identified from the recordings.
        rms: of the torque, measured and the twin's ``(2, n)`` [N m].
        spectrum: difference of the amplitudes in octaves, weighted by the measured ones' power, over them ``(n,)``.
        left: std(residual) / std(torque) of identification, on the measured and on the twin's recording ``(2, n)`` [%].
    """

    twin: Twin
    analysis: IdentificationResult
    rms: Array
    spectrum: Array
    left: Array

    def summary(self) -> list[tuple[str, str]]:
        """How well the twin agrees with the recording, as rows of label and value."""
        return [("torque, twin over measured", listed(self.rms[1] / self.rms[0])),
                ("spectrum off by", listed(100.0 * self.spectrum, "%")),
                ("seen", "; ".join(self.twin.seen)), ("assumed", "; ".join(self.twin.assumed) or "nothing")]

    @property
    def columns(self) -> list[str]:
        """Titles of ``rows``."""
        return [title.replace("N m", one_unit(self.analysis.model.units("N m"))) for title in COLUMNS]

    def rows(self) -> list[list[Any]]:
        """One row per joint: torques, their ratio, spectrum, and the identification residuals of both."""
        return [[j + 1, self.rms[0, j], self.rms[1, j], 100.0 * (self.rms[1, j] / self.rms[0, j] - 1.0),
                 100.0 * self.spectrum[j], self.left[0, j], self.left[1, j]] for j in range(self.rms.shape[1])]

    def to_dict(self) -> dict[str, Any]:
        """The figures as plain values."""
        return plain({
            "world": self.twin.table, "seen": self.twin.seen, "assumed": self.twin.assumed,
            "torque_rms_N_m": {"measured": self.rms[0], "twin": self.rms[1]},
            "spectrum_off_percent": 100.0 * self.spectrum,
            "residual_std_percent": {"measured": self.left[0], "twin": self.left[1]}})


COLUMNS = ["joint", "torque measured [N m]", "twin's [N m]", "off by [%]", "spectrum off by [%]",
           "identify leaves of the measured [%]", "of the twin's [%]"]


def make_twin(recordings: list[Recording], robot_name: str, *, analysis: IdentificationResult | None = None,
              seed: int = 1, progress: Progress = silent) -> TwinResult:
    """Makes a twin from recordings and runs it along the first of them.

    Args:
        recordings, robot_name: of free motion, as for ``identify_model``, of a shipped robot or URDF.
        analysis: of the same recordings, where it was made already.
        seed: of the twin's noise and residual.
        progress: called with the fraction done.
    """
    robot = arm_of(robot_name)
    progress(0.0, "identifying")
    analysis = identify_model(recordings, robot) if analysis is None else analysis
    progress(0.5, "making the world")
    twin = twin_of(analysis, robot, robot_name)
    progress(0.6, "playing the recorded motion")
    first = analysis.estimation[0]
    own = played_again(twin.world(robot_name), robot, first, seed)
    progress(0.8, "identifying the twin")
    again = identify_model(own, robot, cascade=False)
    rms, spectrum = _compared(first, behind_gears(own, twin, analysis.model.provenance["filters"]))
    return TwinResult(twin, analysis, rms, spectrum,
                      np.array([joined(some).residual_std_percent
                                for some in (analysis.result.estimation[:1], again.result.estimation)]))


def _compared(measured: Recording, own: Recording) -> tuple[Array, Array]:
    """Torques of two recordings of one motion: root mean squares ``(2, n)`` [N m], difference of spectra ``(n,)``."""
    both = [(r.t[r.t > r.t[0] + _START], r.joints("tau", r.t > r.t[0] + _START)) for r in (measured, own)]
    rms = np.array([np.sqrt(np.mean(tau**2, axis=0)) for _, tau in both])
    top = 0.4 / max(float(np.median(np.diff(t))) for t, _ in both)
    edges = np.array([0.0, *(top / 2.0 ** np.arange(8)[::-1])])
    amplitudes = []
    for t, tau in both:
        step = float(np.median(np.diff(t)))
        even = np.arange(t[0], t[-1], step)
        values = interpolated(even, t, tau)
        f, density = welch(values, 1.0 / step, nperseg=min(len(even), round(_SEGMENT / step)), axis=0, detrend=False)
        amplitudes.append(np.sqrt([np.sum(density[(f >= low) & (f < high)], axis=0) * (f[1] - f[0])
                                   for low, high in pairwise(edges)]))
    first, second = amplitudes
    return rms, np.sum(np.abs(second - first) * first, axis=0) / np.sum(first**2, axis=0)


def twin_text(twin: Twin, robot_name: str, file: Path) -> str:
    """The scene file of a twin, in which its arm follows a line; for fewer than six joints its world alone.

    Args:
        twin, robot_name: its world, and shipped robot or URDF.
        file: of the scene, from whose folder the URDF is seen.
    """
    robot = arm_of(robot_name)
    named = robot_name if robot_name in SHIPPED or os.path.isabs(robot_name) else \
        os.path.relpath(robot_name, file.parent)
    head = [f"# A twin of {robot.name}, made of recordings. Told by them:", *(f"#   {text}" for text in twin.seen),
            "# Not known, and taken instead:", *(f"#   {text}" for text in twin.assumed or ("nothing",))]
    table = {key: value for key, value in twin.table.items() if key != "spread"}
    world = ["[world]", *(f"{key} = {_toml(value)}" for key, value in table.items()), "", "[world.spread]",
             *(f"{key} = {_toml(value)}" for key, value in twin.table["spread"].items())]
    if robot.n < FEWEST:
        return "\n".join([*head, f"robot = {_toml(named)}", "", *world]) + "\n"
    example = (library() / "line.toml").read_text(encoding="utf-8")
    example = example[example.index("kind ="):]
    if Path(robot_name).suffix == ".urdf":
        scene = load_scene("line").changed(robot=robot_name, model="own")
        assert isinstance(scene, LineScene)
        example = scene_text(example, named, place_line(scene))
    else:
        example = example.replace('robot = "kr6"', f'robot = {_toml(named)}\nmodel = "own"')
    return "\n".join([*head, f'name = "{file.stem}"', example, *world]) + "\n"


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    return f'"{value}"' if isinstance(value, str) else repr(float(value))
