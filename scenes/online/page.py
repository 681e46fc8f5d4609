"""Writes the HTML page of a run on devices."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ideal_robot.registry import in_words
from ideal_robot.results import flat
from scenes.online.result import FollowResult
from scenes.report.page import Report, write_run_files
from scenes.report.replay import Replay
from scenes.verdict import BAD, GOOD, Verdict

_TILE = 20
"""Letters that a tile has room for; what is longer stands in a table."""


def write_run(result: FollowResult, out: Path) -> FollowResult:
    """Writes recording, page and figures of a run into a folder; returns the result with their paths."""
    return write_run_files(replace(result, recording_path=out / "recording.parquet"), _page, out, None)


def _page(result: FollowResult, _: Replay | None) -> Report:
    page = Report(result.scene.title, result.answer())
    if result.failure is not None:
        page.warning(result.failure)
    if count := result.devices.get("arm", {}).get("cycles_not_recorded", 0):
        page.warning(f"The disk did not take {count} cycles: they are missing in the recording.")
    if result.left_behind is not None:
        page.warning(f"A run before this one was killed; what it did until then is in {result.left_behind}.")
    # Statistics of processes and clocks are shown with the devices and the timing.
    said = [(label, value) for label, value in result.summary()
            if not label.startswith(("clock of", "both together")) and not label.endswith("process")]
    page.figures([("verdict", Verdict("ended early", BAD) if result.failure else Verdict("whole path", GOOD)),
                  *(pair for pair in said if len(pair[1]) <= _TILE)])
    page.next(*result.next_steps())
    page.figure(_motion(result), "Top: how far beside the reference path the tool was planned to be. Middle: commanded "
                "joint speeds. Bottom: desired position of the arm minus motor angle, which is all that a controller "
                "tells: the gears' deflection is in it.")
    if sentences := [[label, value] for label, value in said if len(value) > _TILE]:
        page.table(["checked", "result"], sentences)
    page.heading("Scene", folded=True)
    page.text(result.scene.description)
    page.heading("Devices", folded=True)
    for name, device in result.devices.items():
        page.table(["figure", name], _told(device))
    page.heading("Timing", folded=True)
    page.table(["figure", "value"], _told(result.timing))
    return page


def _motion(result: FollowResult) -> Figure:
    figure = Figure(figsize=(8.0, 6.0), layout="constrained")
    top, middle, bottom = figure.subplots(3, 1)
    if len(result.planned):
        top.plot(result.planned[:, 0], 1e3 * result.planned[:, 1], color="#2f6690")
    top.set(ylabel="deviation [mm]", xlabel="time of the run [s]")
    recording = result.recording
    t, q_c = recording.t, recording.joints("q_c")
    if len(t) > 2:
        speeds, off = np.gradient(q_c, t, axis=0), 1e3 * (recording.joints("q_d") - recording.joints("q"))
        for j in range(q_c.shape[1]):
            middle.plot(t, speeds[:, j], lw=0.8, label=f"joint {j + 1}")
            bottom.plot(t, off[:, j], lw=0.8)
        # The legend stands above the picture, where it covers no curve.
        middle.legend(ncols=6, fontsize=9, frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    middle.set_ylabel("speed [rad/s]")
    bottom.set(ylabel="off [mrad]", xlabel="controller's time [s]")
    return figure


def _told(values: dict[str, Any]) -> list[list[Any]]:
    return [[in_words(name.replace(".", " ")), ", ".join(map(str, value)) if isinstance(value, list) else value]
            for name, value in flat(values).items()]
