"""The drawn line of a ``glue`` scene as the world has it: what the camera sees, and how far the tip is from it."""

from __future__ import annotations

from types import TracebackType
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from scenes.camera_table import believed_camera, true_camera
from scenes.camera_world import camera_settings
from scenes.force.cell import Cell
from scenes.force.line_camera import GlueCamera
from sim.camera.bullet_camera import BulletCamera
from sim.camera.surface import DrawnLine


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
        self.rendered = BulletCamera(true, self.line, camera_settings(scene.camera), noise, relief=cell.surface)

    def close(self) -> None:
        """Frees the renderer."""
        self.rendered.close()

    def __enter__(self) -> GlueWorld:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self.close()

    def control_error(self, seen: GlueCamera, t: Array, tcp: Array) -> tuple[dict[str, Any], tuple[Array, Array]]:
        """Distance of the true tip from the drawn line, seen along the plane's normal, while it is followed.

        Args:
            seen: what the camera saw.
            t: instants during the travel ``(N,)`` [s].
            tcp: true positions of the tip at them ``(N, 3)`` [m].

        Returns:
            the figures for ``--json`` and the series (instants, signed distances [m]).
        """
        plane = self.line.plane
        up = plane.rotation[:, 2]
        nearest = self.line.nearest(tcp - np.outer((tcp - plane.translation) @ up, up))
        inside = (nearest.s > 1e-6) & (nearest.s < self.line.polyline.s[-1] - 1e-6)
        inside &= t >= seen.first_used + 0.3 if np.isfinite(seen.first_used) else False
        lateral = nearest.lateral[inside]
        size = 1e3 * np.abs(lateral)
        nothing = {"mean": float("nan"), "p95": float("nan"), "max": float("nan")}
        figures = nothing if not len(size) else {"mean": float(size.mean()), "p95": float(np.quantile(size, 0.95)),
                                                 "max": float(size.max())}
        used = sum(1 for one in seen.fields if one[1] > 0)
        refused = sum(1 for one in seen.fields if one[1] == 0)
        return ({"control_error_mm": figures, "fields": {"seen": len(seen.fields), "used": used, "left_out": refused}},
                (t[inside], lateral))
