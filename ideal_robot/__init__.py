"""Makes a position-controlled arm ideal: models, feedforward, identification and diagnosis in one namespace.

    import ideal_robot as ir

    robot = ir.Robot.load("kr15")
    recording = ir.Recording.from_frame(frame)
    model = ir.identify(recording, robot).model
    corrected = ir.precorrect(t, q_d, model, robot)

Names are imported when they are used for the first time, so that ``import ideal_robot`` is cheap.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ideal_robot.diagnosis.diagnose import diagnose
    from ideal_robot.diagnosis.validation.result import Diagnosis
    from ideal_robot.effects.base import Effect
    from ideal_robot.effects.registry import register as register_effect
    from ideal_robot.elasticity.stiffness_analysis import analyse_stiffness
    from ideal_robot.errors import IdealRobotError, InputError, LimitError
    from ideal_robot.execution.play import PlayResult, play
    from ideal_robot.execution.precorrect import PrecorrectedPath, precorrect
    from ideal_robot.feedforward.base import Feedforward
    from ideal_robot.feedforward.method import Method, Needs, Practice, Setting
    from ideal_robot.feedforward.registry import feedforward, methods
    from ideal_robot.feedforward.registry import register as register_feedforward
    from ideal_robot.identification.angles_alone import identify_arm as identify
    from ideal_robot.identification.inspection import Inspection, inspect
    from ideal_robot.identification.whole_model import IdentificationResult
    from ideal_robot.model.model import Model
    from ideal_robot.robots.interface import RobotInterface, RobotState
    from ideal_robot.robots.robot import Robot
    from ideal_robot.signals.recording import Recording

    __version__: str

_PLACES = {
    "Diagnosis": "diagnosis.validation.result:Diagnosis",
    "Effect": "effects.base:Effect",
    "Feedforward": "feedforward.base:Feedforward",
    "IdealRobotError": "errors:IdealRobotError",
    "IdentificationResult": "identification.whole_model:IdentificationResult",
    "InputError": "errors:InputError",
    "LimitError": "errors:LimitError",
    "Inspection": "identification.inspection:Inspection",
    "Method": "feedforward.method:Method",
    "Model": "model.model:Model",
    "Needs": "feedforward.method:Needs",
    "PlayResult": "execution.play:PlayResult",
    "Practice": "feedforward.method:Practice",
    "PrecorrectedPath": "execution.precorrect:PrecorrectedPath",
    "Recording": "signals.recording:Recording",
    "Robot": "robots.robot:Robot",
    "RobotInterface": "robots.interface:RobotInterface",
    "RobotState": "robots.interface:RobotState",
    "Setting": "feedforward.method:Setting",
    "analyse_stiffness": "elasticity.stiffness_analysis:analyse_stiffness",
    "diagnose": "diagnosis.diagnose:diagnose",
    "feedforward": "feedforward",
    "identify": "identification.angles_alone:identify_arm",
    "inspect": "identification.inspection:inspect",
    "methods": "feedforward.registry:methods",
    "play": "execution.play:play",
    "precorrect": "execution.precorrect:precorrect",
    "register_effect": "effects.registry:register",
    "register_feedforward": "feedforward.registry:register",
}
"""Name at the door → module and name behind it."""

_OF_SCENES = ("DeviationSensor", "Reading", "close_scene", "compare_scene", "load_scene", "run_scene", "shipped_model",
              "sweep_scene")
"""Names of the package beside this one, which this one does not know."""

__all__ = [
    "Diagnosis", "Effect", "Feedforward", "IdealRobotError", "IdentificationResult", "InputError", "Inspection",
    "LimitError", "Method", "Model", "Needs", "PlayResult", "Practice", "PrecorrectedPath", "Recording", "Robot",
    "RobotInterface", "RobotState", "Setting", "__version__", "analyse_stiffness", "diagnose", "feedforward",
    "identify", "inspect", "methods", "play", "precorrect", "register_effect", "register_feedforward",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("ideal-robot")
    if name in _OF_SCENES:
        raise AttributeError(f"module 'ideal_robot' has no attribute {name!r}: it is for scene files, "
                             f"in the package scenes (from scenes import {name})")
    if name not in _PLACES:
        from ideal_robot.errors import did_you_mean

        raise AttributeError(f"module 'ideal_robot' has no attribute {name!r}; {did_you_mean(name, _PLACES)}it offers "
                             f"{', '.join(__all__)}")
    module, _, attribute = _PLACES[name].partition(":")
    value: Any = import_module(f"ideal_robot.{module}")
    if attribute:
        value = getattr(value, attribute)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
