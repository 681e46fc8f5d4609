"""A run played in the browser: slider, speed, the trace coloured by its error, the camera's picture, the error."""

from __future__ import annotations

import io
import time
from typing import Any

import numpy as np
from PIL import Image

from ideal_robot.arrays import Array
from scenes.report.replay import Replay
from scenes.view.viewer import GHOST, Viewer

PERIOD = 0.04
"""Time between two pictures [s]."""
SPEEDS = ("0.1 ×", "0.25 ×", "0.5 ×", "1 ×", "2 ×", "5 ×")
_ARROW = 0.4
"""Length of a large force's arrow [m]."""
_ABOVE = 0.012
"""How far above where it was the tool's path is drawn [m]."""
_MARGIN, _WIDTH, _CONTROLS = 15, 320, 255
"""On a wide page: plot and picture are so far from the right edge, so wide, and below the controls [px]."""
_PLOTTED = 600
"""Most points of the error's plot."""
_COLOURS = ((40, 40, 40), (10, 110, 189), (120, 80, 160), (43, 138, 62))
_NAMES = ("black", "blue", "violet", "green")


class Player:
    """Controls for a replay beside the scene; ``show(k)`` shows one sample, ``play()`` all of them again and again.

    Args:
        viewer: where it is shown.
        replay: what is shown.
    """

    def __init__(self, viewer: Viewer, replay: Replay) -> None:
        self.viewer, self.replay = viewer, replay
        self._t = replay.t - replay.t[0]
        self._pictures = [(t - replay.t[0], np.array(Image.open(io.BytesIO(png)).convert("RGB")))
                          for t, png in replay.pictures]
        self._set_up_scene()
        gui = viewer.server.gui
        self.slider = gui.add_slider("time [s]", min=0.0, max=float(self._t[-1]), step=0.002, initial_value=0.0)
        self.running = gui.add_checkbox("play", initial_value=True)
        self.speed = gui.add_dropdown("speed", SPEEDS, initial_value="0.5 ×")
        self.said = gui.add_markdown("")
        shown = [f"{name} {colour}" for name, colour in zip(replay.curves, _NAMES, strict=False)]
        gui.add_markdown(", ".join([*shown, "tool green to red by its error"])
                         + (", force on the tool a blue arrow" if replay.force is not None else ""))
        # The plot takes no gaps: only where the error counts.
        counts = np.flatnonzero(np.isfinite(replay.error))
        self._rows = counts[np.unique(np.linspace(0, len(counts) - 1, _PLOTTED).astype(int))] if len(counts) else counts
        self.plot: Any = None
        self.picture: Any = None
        if len(counts) > 1 or self._pictures:
            self._add_pictures(len(counts) > 1)
        self.slider.on_update(lambda event: self.show(self._at(float(self.slider.value))))
        self.show(0)

    def _add_pictures(self, plotted: bool) -> None:
        """The error's plot and the camera's picture, in a panel of their own: a phone's page begins with it closed."""
        gui, replay = self.viewer.server.gui, self.replay
        panel = gui.add_panel()
        panel.float(x=-_MARGIN, y=_CONTROLS, width=_WIDTH)
        with panel.add_tab("error and camera" if plotted and self._pictures else "error" if plotted else "camera"):
            if plotted:
                self.plot = gui.add_uplot(self._plotted(0), (
                    {"label": "t [s]"},
                    {"label": f"{replay.error_name} [{replay.unit}]", "stroke": "#e06a00", "width": 1.5},
                    {"label": "until now", "stroke": "#1c2430", "width": 1, "fill": "rgba(28, 36, 48, 0.25)"}),
                    scales={"x": {"time": False}}, axes=({"label": "t [s]"}, {"label": replay.unit}), aspect=1.8)
            if self._pictures:
                self.picture = gui.add_image(self._pictures[0][1], label="camera")

    def _set_up_scene(self) -> None:
        viewer, replay = self.viewer, self.replay
        middle = 0.5 * (replay.tool.mean(axis=0) + np.array([0.0, 0.0, 0.6]))
        viewer.look_at(middle, 1.7 + float(np.ptp(replay.tool, axis=0).max()))
        if replay.surface is not None:
            viewer.surface(replay.surface)
        for i, ((name, points), colour) in enumerate(zip(replay.curves.items(), _COLOURS, strict=False)):
            # The tool's path lies on the line it follows: that is drawn wider, and the path a little above it.
            viewer.draw(name.replace(" ", "_"), points, colour, thickness=9.0 if i == 0 else 2.5)
        step = max(1, len(self._t) // 1500)
        above = replay.tool[::step] + np.array([0.0, 0.0, _ABOVE])
        viewer.draw("tool", above, error_colours(replay.error[::step])[1:], thickness=4.0)
        # The 99th percentile, so that a shock does not make all else invisible.
        self._per_newton = 0.0 if replay.force is None else _ARROW / max(
            float(np.nanquantile(np.linalg.norm(replay.force, axis=1), 0.99)), 1e-9)
        self.tool = viewer.server.scene.add_icosphere("/tool", radius=0.008, color=(224, 106, 0))

    def show(self, k: int) -> None:
        """Shows sample ``k``: arm, tool, picture and what the error is."""
        replay = self.replay
        self.viewer.show(replay.q[k])
        if replay.ghost is not None:
            self.viewer.show(replay.ghost[k], GHOST)
        self.tool.position = tuple(float(v) for v in replay.tool[k])
        if replay.force is not None and np.isfinite(replay.force[k]).all():
            # It ends at the tool: on the other side it would be hidden in the wrist.
            push = self._per_newton * replay.force[k]
            self.viewer.arrow("force", replay.tool[k] - push, push, (0, 110, 190))
        error = replay.error[k]
        self.said.content = f"**{self._t[k]:.2f} s**" + (
            f", {replay.error_name} {abs(error):.3g} {replay.unit}" if np.isfinite(error) else "") + (
            f", force {np.linalg.norm(replay.force[k]):.3g} N" if replay.force is not None else "")
        if self.plot is not None:
            self.plot.data = self._plotted(k)
        if self.picture is not None:
            shown = min(self._pictures, key=lambda one: abs(one[0] - self._t[k]))[1]
            if shown is not self._shown_picture:
                self.picture.image = self._shown_picture = shown

    _shown_picture: Any = None

    def play(self) -> None:
        """Plays again and again at the speed chosen; ends with the keyboard interrupt."""
        while True:
            begun = time.perf_counter()
            if self.running.value:
                factor = float(self.speed.value.split()[0])
                # Setting the slider shows the sample as moving it by hand does.
                self.slider.value = float((self.slider.value + PERIOD * factor) % self._t[-1])
            time.sleep(max(0.0, PERIOD - (time.perf_counter() - begun)))

    def _at(self, t: float) -> int:
        return min(int(np.searchsorted(self._t, t)), len(self._t) - 1)

    def _plotted(self, k: int) -> tuple[Array, Array, Array]:
        """Times, errors, and the errors until sample ``k``, zero after it."""
        error = self.replay.error[self._rows]
        return self._t[self._rows], error, np.where(self._rows <= k, error, 0.0)


def error_colours(error: Array) -> Array:
    """Green for none to red for the largest error, gray where it does not count ``(N, 3)``, 0 to 255.

    Args:
        error: ``(N,)``; NaN where it does not count.
    """
    counts = np.isfinite(error)
    size = np.abs(np.nan_to_num(error)) / max(float(np.max(np.abs(error[counts]), initial=0.0)), 1e-12)
    colours = np.column_stack([40 + 190 * size, 150 - 110 * size, np.full(len(error), 50.0)])
    colours[~counts] = (136, 147, 161)
    return np.asarray(colours.round().astype(np.uint8))
