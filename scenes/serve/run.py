"""Serves a cell until it is told to stop, and says of each session what really happened."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

from scenes.report.page import write_json
from scenes.rsi.undisturbed import undisturbed
from scenes.scene import Scene
from scenes.serve.cell import Places, served_cell
from sim.devices.served_arm import Session
from sim.devices.unkind import Unkindness

_PRIORITY = 30
"""Below that of a follower on the same computer: the time the world takes must not be counted as the follower's."""


def serve_scene(scene: Scene, places: Places, unkind: Unkindness, sessions: int, json: Path | None,
                say: Callable[[str], None]) -> list[dict[str, Any]]:
    """Serves a scene's cell; Ctrl-C and SIGTERM end it. Returns what happened in each session.

    Args:
        scene: of kind ``line`` or ``force``.
        places: where the devices are.
        unkind: what clocks and network do.
        sessions: after how many it ends; 0 for no end.
        json: file for what happened in the last session; None for none.
        say: prints a line.
    """
    told: list[dict[str, Any]] = []
    with served_cell(scene, places, unkind) as (cell, arm):
        def done(session: Session) -> None:
            figures = {"session": len(told) + 1, **scene.played(), **cell.truth(session)}
            told.append(figures)
            if json is not None:
                write_json(json, figures)
            say(f"session {len(told)}: {session.answered} of {session.answered + session.late} cycles answered; "
                f"{session.ended}; "
                + "; ".join(f"{key} {value}" for key, value in figures.items() if key.endswith(("_mm", "_N"))))

        before = {number: signal.signal(number, lambda *_: arm.stop()) for number in (signal.SIGINT, signal.SIGTERM)}
        say("controller: {} {}:{}".format("listens on" if places.rtde else "sends to", *places.arm))
        if cell.camera is not None:
            say("camera: stream://{}:{}".format(*cell.camera))
        if cell.force is not None:
            say("force: netft://{}:{}?rate={:g}".format(*cell.force, scene.sensor.rate))  # type: ignore[attr-defined]
        try:
            with undisturbed(priority=_PRIORITY):
                arm.sessions(sessions, done)
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
    return told
