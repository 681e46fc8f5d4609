"""What scenes of kind ``close_clamped`` offer: all of a path scene, and the way from the clamp to the path."""

from __future__ import annotations

from scenes.close_clamped.close_loop import close_loop
from scenes.close_clamped.scene import CloseClampedScene
from scenes.kind import SceneKind
from scenes.path.kind import PATH

CLOSE_CLAMPED = SceneKind(CloseClampedScene, PATH.methods, PATH.run, PATH.compare, None, close_loop, PATH.replay)
