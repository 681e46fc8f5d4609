"""A self-contained HTML page made of sections, and the same content as JSON."""

from __future__ import annotations

import base64
import io
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import jinja2
import numpy as np

from ideal_robot.registry import in_words
from ideal_robot.results import plain
from ideal_robot.whole_file import write_text
from scenes.outputs import whole_folder
from scenes.report.replay import KeptReplay, Replay, replay_beside, write_replay
from scenes.verdict import Verdict

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from sensing.camera.hand_eye import HandEye

_PHONE, _SCROLLED = 5.0, 720
"""Figures wider than that [inch] are scrolled on a phone instead of made smaller, and then so wide at most [px]."""
_SVG_MAX = 600_000
"""Drawings of more bytes than that (clouds of points) are embedded as pixels."""
_CORRECTIONS = {"roll": ("°", 57.2958), "pitch": ("°", 57.2958), "yaw": ("°", 57.2958), "height": ("mm", 1e3),
                "lateral": ("mm", 1e3), "forward": ("mm", 1e3), "focal": ("%", 100.0), "principal_u": ("px", 1.0),
                "principal_v": ("px", 1.0), "k1": ("1", 1.0), "surface_rise": ("mm", 1e3), "surface_bend": ("1/m", 1.0)}
"""Unit that a correction of a camera is shown in, and its factor."""


@dataclass
class Report:
    """Collects headings, sentences, key figures, tables and pictures in reading order, then writes one HTML file.

    Args:
        title: the page's title.
        summary: one or two sentences that say the result; shown under the title.
    """

    title: str
    summary: str = ""
    _blocks: list[dict[str, Any]] = field(default_factory=list)

    def heading(self, text: str, *, folded: bool = False) -> None:
        """Starts a section; the page's table of contents has them all.

        Args:
            text: its title.
            folded: whether the section is folded under its title.
        """
        number = sum(block["kind"] == "heading" for block in self._blocks) + 1
        open_before = next((block["folded"] for block in reversed(self._blocks) if block["kind"] == "heading"), False)
        self._blocks.append({"kind": "heading", "text": text, "anchor": f"section-{number}", "folded": folded,
                             "ends": open_before})

    def text(self, text: str) -> None:
        """Adds a paragraph of plain text."""
        self._blocks.append({"kind": "text", "text": text})

    def warning(self, text: str) -> None:
        """Adds a highlighted paragraph."""
        # A code of the documentation, a file or a channel keeps its case.
        begins = text.partition(" ")[0].rstrip(":,").isalpha()
        self._blocks.append({"kind": "warning", "text": f"{text[:1].upper()}{text[1:]}" if begins else text})

    def figures(self, items: list[tuple[str, str]]) -> None:
        """Adds key figures as tiles: ``[(label, value with unit), …]``."""
        self._blocks.append({"kind": "figures", "cells": items})

    def table(self, columns: Sequence[str], rows: list[list[Any]], caption: str = "", folded: str = "") -> None:
        """Adds a table; numbers are shown with three significant digits and aligned right.

        Args:
            columns: titles, with units.
            rows: cells.
            caption: explanation of the columns.
            folded: title under which a long table is folded; empty: it is shown.
        """
        cells = [[{"text": _shown(cell), "number": isinstance(cell, (int, float, np.number)),
                   "verdict": cell.kind if isinstance(cell, Verdict) else ""} for cell in row] for row in rows]
        self._blocks.append({"kind": "table", "columns": columns, "rows": cells, "caption": caption,
                             "raw": rows, "folded": folded})

    def figure(self, figure: Figure, caption: str = "", folded: str = "") -> None:
        """Adds a matplotlib figure with its caption: as SVG, as PNG where it contains pictures.

        Args:
            figure: to embed.
            caption: the sentence.
            folded: title under which it is folded; empty: it is shown.
        """
        from matplotlib import rc_context, rcParams

        wide = min(_SCROLLED, round(96.0 * figure.get_figwidth())) if figure.get_figwidth() > _PHONE else 0
        # The figure is laid out and measured here, as saving would otherwise draw it a second time.
        if (layout := figure.get_layout_engine()) is not None:
            layout.execute(figure)
        figure.set_layout_engine(None)
        size = figure.get_tightbbox().padded(rcParams["savefig.pad_inches"])
        if not any(axes.images for axes in figure.axes):
            svg = io.BytesIO()
            # With a fixed salt the identifiers in the SVG, and so the page, are the same each time.
            with rc_context({"svg.hashsalt": "ideal-robot"}):
                figure.savefig(svg, format="svg", bbox_inches=size, metadata={"Date": None})
            if len(svg.getvalue()) <= _SVG_MAX:
                self._embed(svg.getvalue(), "svg+xml", caption, wide, folded)
                return
        png = io.BytesIO()
        # With more compression pictures would be smaller by a tenth and take three times as long.
        figure.savefig(png, format="png", dpi=130, bbox_inches=size, pil_kwargs={"compress_level": 3})
        self._embed(png.getvalue(), "png", caption, wide, folded)

    def image(self, png: bytes, caption: str = "") -> None:
        """Adds a PNG image with its caption."""
        self._embed(png, "png", caption)

    def _embed(self, data: bytes, kind: str, caption: str, wide: int = 0, folded: str = "") -> None:
        self._blocks.append({"kind": "image", "data": base64.b64encode(data).decode("ascii"), "type": kind,
                             "caption": caption, "wide": wide, "folded": folded})

    def replay(self, replay: Replay, caption: str = "") -> None:
        """Adds an animated replay with its caption."""
        self.replays([("", replay)], caption)

    def replays(self, replays: Sequence[tuple[str, Replay | KeptReplay]], caption: str = "") -> None:
        """Adds replays beside each other, each under its title, with a common caption."""
        self._blocks.append({"kind": "replay", "caption": caption,
                             "replays": [{"title": title, "html": replay.html()} for title, replay in replays]})

    def next(self, *steps: tuple[str, str]) -> None:
        """Adds the next steps, each a sentence and its command line (empty where there is none)."""
        self._blocks.append({"kind": "next", "steps": [{"text": text, "command": command} for text, command in steps]})

    def calibration(self, camera: HandEye) -> None:
        """Adds the camera calibration that was done before the run."""
        self.text(
            "Before the run the camera was calibrated by moving it over a segment of the line ([L] 4.4): seen from "
            f"all poses, its points lay {1e3 * camera.residual_before:.2f} mm (RMS) from one common curve with the "
            f"camera as mounted by hand, and {1e3 * camera.residual_after:.3f} mm with the camera as calibrated. Where "
            f"the middle of its view lies across the travel is known to ± {1e3 * camera.across():.3f} mm.")
        self.table(["correction found", "value", "± σ", "unit"],
                   [[in_words(name), camera.parameters[name] * scale, camera.sigma[name] * scale, unit]
                    for name, (unit, scale) in _CORRECTIONS.items() if name in camera.parameters])

    def write(self, path: str | Path) -> Path:
        """Writes the page to ``path`` (parents are made) and returns it."""
        template = resources.files("scenes").joinpath("templates/report.html").read_text(encoding="utf-8")
        environment = jinja2.Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
        return write_text(path, environment.from_string(template).render(title=self.title, summary=self.summary,
                                                                         blocks=self._blocks))


def write_json(path: str | Path, content: dict[str, Any]) -> Path:
    """Writes ``content`` as strict JSON (NumPy values converted, NaN and infinities as null) and returns the path."""
    return write_text(path, json.dumps(plain(content), indent=2, allow_nan=False) + "\n")


R = TypeVar("R", bound=Any)


def write_run_files(result: R, page: Callable[[R, Replay | None], Report], out: Path, replay: Replay | None) -> R:
    """Writes recording, page and figures of a run into ``out``; returns the result with their paths.

    Args:
        result: a frozen run result with ``recording``, ``recording_path``, ``report`` and ``json()``.
        page: makes the page of it, with the replay.
        out: folder.
        replay: written beside the recording, for the viewer.
    """
    report = page(result, replay)
    result = replace(result, recording_path=out / "recording.parquet", report=out / "report.html")
    with whole_folder(out) as new:
        result.recording.write(new / "recording.parquet")
        if replay is not None:
            write_replay(replay, replay_beside(new / "recording.parquet"), result.recording)
        report.write(new / "report.html")
        write_json(new / "report.json", result.json())
    return result


def write_comparison_files(comparison: R, page: Callable[[R], Report], out: Path) -> R:
    """Writes each run's recording, the common page and the figures into a folder; returns the result with paths.

    Args:
        comparison: the comparison; it has ``runs`` by method, ``recording_path`` of each, ``report`` and ``json``.
        page: makes the page of it.
        out: folder of the files.
    """
    runs = {method: replace(run, recording_path=out / f"{method}.parquet") for method, run in comparison.runs.items()}
    comparison = replace(comparison, runs=runs, report=out / "report.html")
    with whole_folder(out) as new:
        for method, run in runs.items():
            run.recording.write(new / f"{method}.parquet")
        page(comparison).write(new / "report.html")
        write_json(new / "report.json", comparison.json())
    return comparison


def _shown(cell: Any) -> str:
    if isinstance(cell, (bool, np.bool_)):
        return "yes" if cell else "no"
    if isinstance(cell, (float, np.floating)):
        # A torque of 1800 N m is read more easily than one of 1.8e+03.
        value = float(cell)
        return "–" if not math.isfinite(value) else f"{value:.0f}" if 1e3 <= abs(value) < 1e6 else f"{value:.3g}"
    return "–" if cell is None else str(cell)


UNITS = {
    "transmission_once": "rad", "transmission_twice": "rad", "hysteresis": "rad",
    "column_stiffness": "N m/rad", "column_frequency": "Hz", "thermal_expansion": "1/K", "hose": "N m/rad",
    "hose_friction": "N m", "balancer": "N m", "notch_frequency": "Hz",
    "stiffness": "N m/rad", "damping": "N m s/rad", "backlash": "rad", "coulomb": "N m", "stribeck": "N m",
    "stribeck_velocity": "rad/s", "presliding": "rad", "viscous": "N m s/rad", "degressive": "N m",
    "degressive_velocity": "rad/s", "start_temperature": "°C", "ambient_temperature": "°C",
    "thermal_resistance": "K/W", "thermal_time_constant": "s", "viscosity_temperature": "1/K",
    "dry_temperature": "1/K", "reference_temperature": "°C", "lubrication_time": "s",
    "encoder_increments": "per motor turn", "current_noise": "of the limit", "torque_ripple": "of the limit",
    "ripple_order": "per motor turn", "low_pass": "s", "t_ipo": "s", "t_position": "s", "t_velocity": "s",
    "position_gain": "1/s", "velocity_gain": "N m s/rad", "integral_time": "s", "velocity_filter": "s",
    "current_lag": "s", "extra_rotor_inertia": "kg m²", "kinematic_error": "m", "zero_error": "rad",
    "twist_error": "rad",
    "transmission_error": "rad", "transmission_order": "per joint turn", "payload_mass": "kg", "payload_com": "m",
    "payload_inertia": "kg m²", "log_cycle": "s", "external_position_noise": "m", "external_rotation_noise": "rad",
    "geometry": "m, rad", "residual": "N m", "command_late": "s", "command_time": "s",
}
"""Units of the settings that have one; the others are switches, shares and seeds."""
COLUMNS = ["setting", "value, per joint where there are several", "unit"]


def world_rows(world: Mapping[str, Any]) -> list[list[Any]]:
    """Rows of setting, value and unit, from ``World.table()``."""
    return [[in_words(name), _short(value), UNITS.get(name, "")] for name, value in world.items()]


def _short(value: Any) -> Any:
    if isinstance(value, (list, tuple)):
        if value and isinstance(value[0], (list, tuple)):
            return "; ".join(map(_short, value))
        return ", ".join(f"{entry:.3g}" if isinstance(entry, (int, float)) else str(entry) for entry in value)
    return value
