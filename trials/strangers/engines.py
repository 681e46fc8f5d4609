"""The seam of the engines: a plant and a motion in, what happened out."""

from __future__ import annotations

from collections.abc import Callable

from trials.strangers import bullet_engine, integrator, mujoco_engine
from trials.strangers.motion import Motion
from trials.strangers.plant import Plant, Run

Engine = Callable[[Plant, Motion], Run]

ENGINES: dict[str, Engine] = {
    "mujoco": mujoco_engine.simulate, "pybullet": bullet_engine.simulate, "integrator": integrator.simulate,
}
NOT_IN = {"pybullet": frozenset({"axis_coupling", "drive_gain"})}
"""Effects that an engine has no means for."""
