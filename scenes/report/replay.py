"""A replay inside a page: the arm moves, the error is drawn enlarged, all in one self-contained piece of HTML.

No library is loaded and nothing is fetched: the arm's primitive shapes become polygons that a short script draws on a
canvas, so that the page also plays on a phone and without a network.
"""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass, field
from importlib import resources
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from scenes.report.arm_shapes import link_poses, polygons, rounded

FRAMES = 400
"""A replay has no more frames than that; longer runs are thinned out."""


def rises(t: Array) -> bool:
    """Whether times ``(N,)`` can be played: finite, sorted, and not all the same."""
    return bool(np.isfinite(t).all() and np.all(np.diff(t) >= 0.0) and t[0] < t[-1])


@dataclass(frozen=True)
class Replay:
    """What a replay shows; everything over one time axis of ``N`` samples.

    Attributes:
        robot: the arm, drawn from its URDF's primitive shapes.
        t: times ``(N,)`` [s].
        q: arm angles ``(N, n)`` [rad].
        tool: where the TCP truly was ``(N, 3)`` [m].
        wanted: the point it should have been at, or the nearest one of the line ``(N, 3)`` [m].
        error: what is plotted below and colours the trace ``(N,)``, in ``unit``; NaN where it does not count.
        error_name, unit: what that is.
        curves: further curves by name ``(K, 3)`` [m], e.g. the drawn line.
        surface: corners of the surface ``(4, 3)`` [m], or None.
        pictures: camera pictures, time [s] and PNG.
        ghost: arm angles of another method at the same times ``(N, n)`` [rad], drawn pale, or None.
        enlarged: how many times the error is enlarged in the view from above.
        force: of the environment on the tool ``(N, 3)`` [N] in the base frame, drawn as an arrow, or None.
    """

    robot: Robot
    t: Array
    q: Array
    tool: Array
    wanted: Array
    error: Array
    error_name: str = "distance from the path"
    unit: str = "mm"
    curves: dict[str, Array] = field(default_factory=dict)
    surface: Array | None = None
    pictures: tuple[tuple[float, bytes], ...] = ()
    ghost: Array | None = None
    enlarged: float = 50.0
    force: Array | None = None

    def __post_init__(self) -> None:
        n = len(self.t)
        shapes = {"q": (n, self.robot.n), "tool": (n, 3), "wanted": (n, 3), "error": (n,)}
        optional = {"force": (n, 3), "ghost": (n, self.robot.n), "surface": (4, 3)}
        shapes |= {name: shape for name, shape in optional.items() if getattr(self, name) is not None}
        for name, shape in shapes.items():
            if np.shape(getattr(self, name)) != shape:
                raise InputError(f"expected the shape {shape}", field=name, value=np.shape(getattr(self, name)))
        for name in ("q", "ghost"):
            if getattr(self, name) is not None and not np.isfinite(getattr(self, name)).all():
                raise InputError("expected finite angles", field=name)
        if n < 2:
            raise InputError("a replay needs two samples at least", field="t", value=n)
        if not rises(self.t):
            raise InputError("the times of a replay must rise", field="t")
        for name, curve in self.curves.items():
            if np.ndim(curve) != 2 or np.shape(curve)[1] != 3 or len(curve) < 2:
                raise InputError("expected two points (K, 3) at least", field=name, value=np.shape(curve))

    def html(self) -> str:
        """The replay as a piece of HTML for a page."""
        script = resources.files("scenes").joinpath("templates/replay.js").read_text(encoding="utf-8")
        # "</" inside a script would end it.
        data = json.dumps(self._data(), allow_nan=False, separators=(",", ":")).replace("</", "<\\/")
        return f'<div class="replay"></div>\n<script>\n(function () {{\nconst DATA = {data};\n{script}}})();\n</script>'

    def _data(self) -> dict[str, Any]:
        step = max(1, -(-len(self.t) // FRAMES))
        rows = slice(None, None, step)
        shapes, links = polygons(self.robot)
        counts = np.isfinite(self.error)
        # Where the error does not count, there is nothing to enlarge.
        wanted = np.where(counts[:, None], self.wanted, self.tool)
        error = [None if not np.isfinite(value) else round(float(value), 4) for value in self.error[rows]]
        return {
            "t": rounded(self.t[rows] - self.t[0], 3),
            "links": rounded(link_poses(self.robot, self.q[rows], links), 4),
            "ghost": None if self.ghost is None else rounded(link_poses(self.robot, self.ghost[rows], links), 4),
            "shapes": shapes,
            "tool": rounded(self.tool[rows], 5), "wanted": rounded(wanted[rows], 5),
            "error": error, "errorName": self.error_name, "unit": self.unit,
            "curves": {name: rounded(curve[:: max(1, len(curve) // 300)], 4) for name, curve in self.curves.items()},
            "surface": None if self.surface is None else rounded(self.surface, 4),
            "pictures": [[round(float(t - self.t[0]), 3), "data:image/png;base64,"
                          + base64.b64encode(png).decode("ascii")] for t, png in self.pictures],
            "enlarged": self.enlarged,
            "force": None if self.force is None else rounded(np.nan_to_num(self.force[rows]), 2),
        }
