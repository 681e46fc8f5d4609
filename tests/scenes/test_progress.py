"""The bar goes by measured shares of the time: they are declared, add up to the whole, and are what is told."""

from __future__ import annotations

import importlib
import pkgutil
from itertools import accumulate, pairwise

import numpy as np
import pytest

import ideal_robot
import scenes
from ideal_robot.identification import whole_model
from ideal_robot.progress import Steps
from ideal_robot.signals.recording import Recording
from scenes.commands import diagnose as diagnose_command
from scenes.commands import identify as identify_command
from scenes.path import close_loop, kind
from scenes.scene_file import load_scene
from tests.ideal_robot.test_door import ROBOT, frame

diagnosing = importlib.import_module("ideal_robot.diagnosis.diagnose")


class Heard:
    """A progress that remembers what it was told."""

    def __init__(self) -> None:
        self.told: list[tuple[float, str]] = []

    def __call__(self, fraction: float, text: str) -> None:
        self.told.append((fraction, text))

    def begins_as(self, shares: dict[str, float]) -> None:
        """Every step is told of where the shares before it end, and nothing goes back."""
        begun = dict(reversed([(text, fraction) for fraction, text in self.told]))
        for step, start in zip(shares, accumulate([0.0, *shares.values()]), strict=False):
            assert begun[step] == pytest.approx(start), step
        assert all(a <= b for (a, _), (b, _) in pairwise(self.told))


def declared() -> list[tuple[str, dict[str, float]]]:
    found = []
    for package in (ideal_robot, scenes):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            found += [(f"{module.name}.{name}", shares) for name, shares in
                      vars(importlib.import_module(module.name)).items()
                      if name.startswith("SHARES") and isinstance(shares, dict)]
    return found


@pytest.mark.parametrize(("where", "shares"), declared())
def test_shares_add_up_to_the_whole(where: str, shares: dict[str, float]) -> None:
    assert sum(shares.values()) == pytest.approx(1.0), where
    assert min(shares.values()) > 0.0


def test_steps_begin_where_those_before_end_and_never_go_back() -> None:
    heard = Heard()
    steps = Steps(heard, {"first": 0.2, "second": 0.5, "third": 0.3})
    steps.begin("first")(0.5, "half")
    part = steps.begin("second", "in other words")
    part(0.8, "far")
    part(0.1, "again from the beginning")
    steps.begin("third")(1.0, "")
    assert [text for _, text in heard.told] == ["first", "half", "in other words", "far", "again from the beginning",
                                                "third", ""]
    assert [fraction for fraction, _ in heard.told] == pytest.approx([0.0, 0.1, 0.2, 0.6, 0.6, 0.7, 1.0])


def test_diagnosis_goes_by_its_shares(monkeypatch: pytest.MonkeyPatch) -> None:
    assert list(diagnosing.SHARES)[1:] == list(diagnosing.STAGES)

    def stage(case, found):  # type: ignore[no-untyped-def]
        case.progress(1.0, "done")
        return found

    monkeypatch.setattr(diagnosing, "STAGES", dict.fromkeys(diagnosing.STAGES, stage))
    monkeypatch.setattr(diagnosing, "diagnosis_of", lambda case, found: None)
    recording = Recording.from_arrays(0.01 * np.arange(3000.0), q=np.column_stack(
        [0.8 * np.sin((0.7 + 0.2 * j) * 0.01 * np.arange(3000.0)) for j in range(6)]), tau=np.random.default_rng(
            0).normal(size=(3000, 6)))
    heard = Heard()
    diagnosing.diagnose(recording, ROBOT, progress=heard)
    heard.begins_as(diagnosing.SHARES)
    assert heard.told[-1] == (pytest.approx(1.0), "done")


def test_identification_and_a_played_path_go_by_their_shares() -> None:
    heard = Heard()
    whole_model.identify_model(Recording.from_frame(frame()), ROBOT, friction="viscous_coulomb", cascade=False,
                               progress=heard)
    heard.begins_as(whole_model.SHARES)
    played = Heard()
    kind.run(load_scene("iso9283_1"), progress=played)
    begun = {text: fraction for fraction, text in played.told}
    assert begun["report"] == pytest.approx(1.0 - kind.SHARES["report"])
    assert all(a <= b for (a, _), (b, _) in pairwise(played.told))


def test_drawing_the_page_is_no_last_moment() -> None:
    """It takes a third of the time or more, so that the bar has room left for it."""
    for shares in (diagnose_command.SHARES, identify_command.SHARES, identify_command.SHARES_WITH_CASCADE):
        assert list(shares)[-1] == "drawing"
        assert shares["drawing"] > 0.25
    assert close_loop.SHARES["rounds"] > 0.5

