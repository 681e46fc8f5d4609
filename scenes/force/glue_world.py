"""The drawn line of a ``glue`` scene as the world has it: what the camera sees, and how far the tip is from it."""

from __future__ import annotations

from types import TracebackType
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.file_array import let_go, new_array
from scenes.camera_table import believed_camera, true_camera
from scenes.camera_world import camera_settings
from scenes.force.cell import Cell
from scenes.force.line_camera import GlueCamera
from scenes.thinned import step
from sim.camera.bullet_camera import BulletCamera
from sim.camera.surface import AT_A_TIME, DrawnLine


class GlueWorld:
    """Renders the line on the curved surface, and measures against it.

    Args:
        cell: the scene set up.
    """

    def __init__(self, cell: Cell) -> None:
        scene = cell.scene
        noise, calibration = cell.camera_streams
        true = true_camera(believed_camera(scene.camera), scene.calibration, calibration)
        where = cell.geometry
        self.line = DrawnLine(where.drawn, where.plane, width=1e-3 * scene.line.width_mm, gray=scene.line.gray,
                              background=scene.line.background, edge=1e-3 * scene.line.edge_mm)
        self._surface = cell.surface
        self.rendered = BulletCamera(true, self.line, camera_settings(scene.camera), noise, relief=cell.surface)

    def close(self) -> None:
        """Frees the renderer."""
        self.rendered.close()

    def __enter__(self) -> GlueWorld:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self.close()

    def control_error(self, seen: GlueCamera, t: Array, tip: Array) -> tuple[dict[str, Any], tuple[Array, Array]]:
        """Distance of the true tip from the drawn line, seen along the plane's normal, while it is followed.

        Args:
            seen: what the camera saw.
            t: instants during the travel ``(N,)`` [s].
            tip: true positions of the tip at them, in the surface's coordinates ``(N, 3)`` [m].

        Returns:
            the figures for ``--json`` and the series (instants, signed distances [m]), of a long run thinned.
        """
        surface, positions = self._surface.plane, new_array(len(tip), 3)
        for first in range(0, len(tip), AT_A_TIME):
            part = slice(first, first + AT_A_TIME)
            positions[part] = tip[part] @ surface.rotation.T + surface.translation
            let_go(tip, positions)
        s, beside = self.line.beside(positions)
        inside = (s > 1e-6) & (s < self.line.polyline.s[-1] - 1e-6)
        inside &= t >= seen.first_used + 0.3 if np.isfinite(seen.first_used) else False
        lateral = beside[inside]
        size, every = 1e3 * np.abs(lateral), step(len(lateral))
        nothing = {"mean": float("nan"), "p95": float("nan"), "max": float("nan")}
        figures = nothing if not len(size) else {"mean": float(size.mean()), "p95": float(np.quantile(size, 0.95)),
                                                 "max": float(size.max())}
        used = sum(1 for one in seen.fields if one[1] > 0)
        refused = sum(1 for one in seen.fields if one[1] == 0)
        return ({"control_error_mm": figures, "fields": {"seen": len(seen.fields), "used": used, "left_out": refused}},
                (t[np.flatnonzero(inside)[::every]], lateral[::every].copy()))
