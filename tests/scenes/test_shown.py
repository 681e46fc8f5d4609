"""Every public result says at the prompt in three lines what it is, however much it holds."""

from __future__ import annotations

import importlib
import pkgutil
import re
from types import SimpleNamespace
from typing import Any

import pytest

import ideal_robot
import scenes
from ideal_robot.summary import Summarised
from scenes.line.fastest import Fastest
from scenes.shown import ShownRun, ShownTable

for package in (ideal_robot, scenes):
    for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        importlib.import_module(module.name)

RESULT = re.compile(r"(Result|Comparison|Identification|Analysis|Plan|Diagnosis|Prediction)$")
"""How classes are called that public functions return."""
OTHERS = {"ideal_robot.diagnosis.validation.result:ChannelResult", "ideal_robot.diagnosis.asking.comparison:Comparison",
          "ideal_robot.diagnosis.validation.domain_diagnosis:DomainResult",
          "ideal_robot.diagnosis.validation.domain_diagnosis:DomainDiagnosis"}
"""A line of numbers, and parts of a diagnosis that nobody is handed."""


def results(base: type) -> list[type]:
    found = [sub for one in base.__subclasses__() for sub in (one, *results(one))]
    return sorted({one for one in found if one not in (ShownRun, ShownTable)
                   and one.__module__.startswith(("ideal_robot.", "scenes."))}, key=lambda one: one.__qualname__)


def said_by(result: type, **told: Any) -> Any:
    """A result without its content: what it says of itself is given."""
    said = type(result.__name__, (result,), {"__init__": lambda self: None, **told})
    return said()


LONG = "a reason in many words\nwith a second line " * 40
MANY = [("first", LONG), *((f"figure {i}", f"{i} N m\nand more") for i in range(60))]


@pytest.mark.parametrize("result", [*results(Summarised), *results(ShownTable)], ids=lambda one: one.__name__)
def test_a_result_is_three_lines(result: type) -> None:
    scene = SimpleNamespace(name="line")
    shown = said_by(result, scene=scene, failure=LONG, summary=lambda self: MANY,
                 rows=lambda self: (("method", "mean mm"), [[f"method_{i}", value] for i in range(40)
                                                            for value in (0.12345678, None, "-")]))
    for one in (shown, [shown]):
        text = repr(one)
        assert len(text.splitlines()) <= 3
        assert max(map(len, text.splitlines())) < 300
    assert repr(shown).startswith(f"{result.__name__}(")
    assert "<table" in shown._repr_html_()


def test_no_result_is_shown_otherwise() -> None:
    for package in (ideal_robot, scenes):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            for name, one in vars(importlib.import_module(module.name)).items():
                if isinstance(one, type) and one.__module__ == module.name and RESULT.search(name) \
                        and not getattr(one, "_is_protocol", False) and f"{module.name}:{name}" not in OTHERS:
                    assert issubclass(one, Summarised | ShownTable), f"{module.name}.{name}"


def test_what_a_result_says_is_of_its_content() -> None:
    found = Fastest(0.71, 2e-4, 1.9e-4, ((0.5, 1e-4), (0.8, 2.5e-4)))
    assert repr(found) == "Fastest(0.71 m/s within 0.2 mm)\n  95 % predicted 0.19 mm; trials 2"
