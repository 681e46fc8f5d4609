"""Every result says in three lines what it is, goes into JSON, and shows itself in a notebook without scripts.

What is written is read again the same: recordings, models, scenes.
"""

from __future__ import annotations

import dataclasses
import importlib
import json
import pkgutil
import re
import tempfile
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import ideal_robot
import ideal_robot as ir
import scenes
from ideal_robot.diagnosis.validation.result import ChannelResult, Diagnosis, Traces
from ideal_robot.model.described_arm import Gears
from ideal_robot.model.model import Model
from ideal_robot.results import Summarised
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes import compare_scene, load_scene, run_scene, shipped_model
from scenes.line.compare import Fastest
from scenes.regression.comparison import SUITE, compared
from scenes.regression.formats import sentence
from scenes.regression.paired import BETTER, NOT_COMPARABLE, SAME, WORSE
from scenes.regression.results import Results
from scenes.result import ShownRun, ShownTable
from scenes.scene_file import library
from scenes.scene_file import load_scene as load_scene_round_trips
from tests.arms import ROBOT, T, motion
from tests.scenes.regression.test_check import run_of, runs
from tests.sources import ROOT

TABLE = ir.Robot.load(ROOT / "examples" / "own_robot.urdf")


class Echo:
    """An arm that is at once where it shall be."""

    t, t_ipo = 0.0, ROBOT.t_ipo

    def cycle(self, q_c: np.ndarray) -> ir.RobotState:
        self.t += self.t_ipo
        return ir.RobotState(self.t, q_c, np.full(6, np.nan))


def recording() -> ir.Recording:
    t = np.arange(0.0, 10.0, 0.004)
    q = np.sin(np.outer(t, [1.1, 2.3, 4.7])) @ [0.6, 0.3, 0.1]
    qd = np.gradient(q, t)
    tau = 2.0 * np.gradient(qd, t) + 3.0 * qd + np.random.default_rng(1).normal(0.0, 0.1, len(t))
    return ir.Recording.from_arrays(t, q=q, tau=tau, meta={"when": Path("a"), "gain": np.float64(np.nan)})


def diagnosis() -> Diagnosis:
    t, ones = np.arange(50.0), np.ones((50, 1))
    traces = Traces(t, ones, ones, 0.5 * ones, ones > 0, ones > 0, ones, ones)
    channel = ChannelResult("tau_1", "N m", 1.0, 1.0, 0.5, 0.1, 0.0)
    return Diagnosis("none", (channel,), (), (), "every fourth block", 3.0, traces=((("tau_1",), traces),))


def clamped() -> Any:
    return run_scene(load_scene("clamped_kr500_1"))


def short_path() -> Any:
    return load_scene("iso9283_1").changed(path={"shape": "edge", "size_mm": 100.0}, speed=0.3)


MADE = {
    "Recording": recording,
    "Robot": lambda: ROBOT,
    "Model": lambda: ir.Model.load(shipped_model("kr15")),
    "IdentificationResult": lambda: ir.identify(recording(), TABLE, friction="viscous_coulomb"),
    "Diagnosis": diagnosis,
    "PrecorrectedPath": lambda: ir.precorrect(T * np.arange(len(motion(lead=2))), motion(lead=2),
                                              ir.Model.load(shipped_model("kr15")), ROBOT),
    "PlayResult": lambda: ir.play(Echo(), ir.feedforward("none", None, ROBOT), motion(lead=2)),
    "ClampedResult": clamped,
    "StiffnessAnalysis": lambda: made("ClampedResult").analysis,
    "PathResult": lambda: run_scene(short_path(), method="none"),
    "PathComparison": lambda: compare_scene(short_path(), methods=["none"]),
}
DRAWN = ("Recording", "IdentificationResult", "Diagnosis", "PrecorrectedPath", "PlayResult", "StiffnessAnalysis")


@cache
def made(name: str) -> Any:
    return MADE[name]()


@pytest.mark.parametrize("name", MADE)
def test_results_show_themselves(name: str) -> None:
    result = made(name)
    assert type(result).__name__ == name
    assert 1 <= len(repr(result).splitlines()) <= 3
    assert len(repr(result)) < 600
    json.dumps(result.to_dict(), allow_nan=False)
    html = result._repr_html_()
    assert html.startswith("<table>")
    assert "<script" not in html


@pytest.mark.parametrize("name", DRAWN)
def test_results_are_drawn(name: str, tmp_path: Path) -> None:
    made(name).plot().savefig(tmp_path / "picture.png")
    assert (tmp_path / "picture.png").stat().st_size > 5000


def test_names_from_files_are_escaped() -> None:
    hostile = ir.Recording({"t": np.arange(3.0), "<script>alert(1)</script>": np.zeros(3)})
    assert "<script" not in hostile._repr_html_()


def test_several_recordings_for_validation_are_refused_in_words() -> None:
    with pytest.raises(ir.InputError, match="give one recording") as caught:
        ir.diagnose(recording(), TABLE, validate=[recording()])  # type: ignore[arg-type]
    assert caught.value.field == "validate"


# Every public result says at the prompt in three lines what it is, however much it holds.

MODULES = [importlib.import_module(module.name) for package in (ideal_robot, scenes)
           for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")]
RESULT = re.compile(r"(Result|Comparison|Identification|Analysis|Plan|Diagnosis|Prediction)$")
"""How classes are called that public functions return."""
OTHERS = {"scenes.closing.loop:Comparison", "ideal_robot.diagnosis.validation.result:ChannelResult",
          "ideal_robot.diagnosis.report:DomainResult", "ideal_robot.diagnosis.report:DomainDiagnosis"}
"""A line of numbers, and parts of a diagnosis that nobody is handed."""


def results(base: type) -> list[type]:
    classes = [sub for subclass in base.__subclasses__() for sub in (subclass, *results(subclass))]
    return sorted({cls for cls in classes if cls not in (ShownRun, ShownTable)
                   and cls.__module__.startswith(("ideal_robot.", "scenes."))}, key=lambda cls: cls.__qualname__)


def said_by(result: type, **told: Any) -> Any:
    """A result without its content: what it says of itself is given."""
    return type(result.__name__, (result,), {"__init__": lambda self: None, **told})()


LONG = "a reason in many words\nwith a second line " * 40
MANY = [("first", LONG), *((f"figure {i}", f"{i} N m\nand more") for i in range(60))]


@pytest.mark.parametrize("result", [*results(Summarised), *results(ShownTable)], ids=lambda kind: kind.__name__)
def test_a_result_is_three_lines(result: type) -> None:
    scene = SimpleNamespace(name="line")
    shown = said_by(result, scene=scene, failure=LONG, summary=lambda self: MANY,
                 rows=lambda self: (("method", "mean mm"), [[f"method_{i}", value] for i in range(40)
                                                            for value in (0.12345678, None, "-")]))
    for view in (shown, [shown]):
        text = repr(view)
        assert len(text.splitlines()) <= 3
        assert max(map(len, text.splitlines())) < 300
    assert repr(shown).startswith(f"{result.__name__}(")
    assert "<table" in shown._repr_html_()


def test_no_result_is_shown_otherwise() -> None:
    for module in MODULES:
        for name, member in vars(module).items():
            if isinstance(member, type) and member.__module__ == module.__name__ and RESULT.search(name) \
                    and not getattr(member, "_is_protocol", False) and f"{module.__name__}:{name}" not in OTHERS:
                assert issubclass(member, Summarised | ShownTable), f"{module.__name__}.{name}"


def test_what_a_result_says_is_of_its_content() -> None:
    fastest = Fastest(0.71, 2e-4, 1.9e-4, ((0.5, 1e-4), (0.8, 2.5e-4)))
    assert repr(fastest) == "Fastest(0.71 m/s within 0.2 mm)\n  95 % predicted 0.19 mm; trials 2"


NAMES = st.text("abcdefgh_123 é[]", min_size=1, max_size=8).filter(lambda name: name.strip() == name and name != "t")


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    """Any columns of any finite or missing values, and metadata."""
    count = draw(st.integers(2, 20))
    values = arrays(np.float64, count, elements=st.floats(allow_infinity=False))
    columns = draw(st.dictionaries(NAMES, values, max_size=5))
    whole = st.integers(-10**15, 10**15)
    meta = draw(st.dictionaries(st.text(max_size=5), st.none() | st.booleans() | whole | st.text(max_size=5)))
    return Recording({"t": np.arange(float(count)), **columns}, meta)


@pytest.mark.parametrize("ending", ["parquet", "csv"])
@settings(max_examples=25)
@given(recording=recordings())
def test_a_recording_comes_back_to_the_last_bit(ending: str, recording: Recording) -> None:
    with tempfile.TemporaryDirectory() as folder:
        again = Recording.read(recording.write(Path(folder) / f"r.{ending}"))
    assert set(again.columns) == set(recording.columns)
    for name, values in recording.columns.items():
        assert np.array_equal(again.columns[name], values, equal_nan=True)
    if ending == "parquet":
        assert again.meta == recording.meta


@cache
def nominal_model() -> Model:
    return Model.nominal(Robot.load("kr6"))


@settings(max_examples=5)
@given(seed=st.integers(0, 1000))
def test_a_model_comes_back_with_its_twelve_digits(seed: int) -> None:
    rng, nominal = np.random.default_rng(seed), nominal_model()
    model = dataclasses.replace(nominal, base_values=nominal.base_values * rng.normal(size=nominal.base_values.shape),
                                gears=Gears(rng.uniform(1e4, 1e6, nominal.n)))
    with tempfile.TemporaryDirectory() as folder:
        again = Model.load(model.save(Path(folder) / "m.json"))
    for name in ("base_values", "consistent", "covariance", "noise_std", "known_stiffness"):
        assert np.allclose(getattr(again, name), getattr(model, name), rtol=1e-11, atol=0.0), name
    assert np.allclose(again.base.grouping, model.base.grouping, rtol=1e-11, atol=0.0)
    assert again.arm == model.arm
    assert again.friction.to_dict() == model.friction.to_dict()
    assert again.base.names == model.base.names


@pytest.mark.parametrize("path", sorted(library().glob("*.toml")), ids=lambda path: path.stem)
def test_a_scene_comes_back_from_its_values(path: Path) -> None:
    scene = load_scene_round_trips(path)
    assert type(scene)(**json.loads(scene.model_dump_json())) == scene.beside(None)
    assert scene.changed(seed=scene.seed) == scene


# Results beside earlier ones.


def test_a_ratio_has_no_unit() -> None:
    rows = {row.case: sentence(row) for row in compared(runs(0), runs(1), figures=["control_error_mm.mean"]).rows}
    assert " mm, difference" in rows.pop("corner, 0.4 m/s, ideal, bench")
    assert "1 → " in rows[SUITE]
    assert "mm" not in rows[SUITE]


def test_seeds_that_do_not_enter_are_one_run_without_a_chance() -> None:
    def of(factor: float, seeds: int = 4) -> Results:
        return Results.of([run_of(seed=seed, fields={"used": 7}, control_error_mm={"mean": 0.1 * factor})
                           for seed in range(seeds)])

    for factor, verdict in ((1.0, SAME), (1.005, SAME), (1.5, WORSE), (0.5, BETTER)):
        comparison = compared(of(1.0), of(factor))
        (row,) = comparison.rows
        assert (comparison.verdict, row.verdict, row.pairs) == (verdict, verdict, 1)
        assert np.isnan(row.p)
        assert np.isnan(row.corrected)
        assert "the seed does not enter" in row.why
        assert row.why in sentence(row)
        assert any(row.why in str(cell) for line in comparison.table()[1] for cell in line)
    # One figure alone, such as a count, may be the same by chance; and a single seed tells nothing.
    counts = compared(runs(0, fields={"used": 7}), runs(1, fields={"used": 8}), figures=["fields.used"])
    assert not any("does not enter" in row.why for row in counts.rows)
    assert compared(of(1.0, 1), of(1.5, 1)).verdict == NOT_COMPARABLE
