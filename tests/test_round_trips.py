"""What is written is read again the same: recordings, models, scenes."""

from __future__ import annotations

import dataclasses
import json
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.scene_file import library, load_scene

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
                                stiffness=rng.uniform(1e4, 1e6, nominal.n))
    with tempfile.TemporaryDirectory() as folder:
        again = Model.load(model.save(Path(folder) / "m.json"))
    for name in ("base_values", "consistent", "covariance", "noise_std", "stiffness"):
        assert np.allclose(getattr(again, name), getattr(model, name), rtol=1e-11, atol=0.0), name
    assert np.allclose(again.base.grouping, model.base.grouping, rtol=1e-11, atol=0.0)
    assert (again.urdf, again.urdf_hash, again.robot_name) == (model.urdf, model.urdf_hash, model.robot_name)
    assert again.friction.to_dict() == model.friction.to_dict()
    assert again.base.names == model.base.names


@pytest.mark.parametrize("path", sorted(library().glob("*.toml")), ids=lambda path: path.stem)
def test_a_scene_comes_back_from_its_values(path: Path) -> None:
    scene = load_scene(path)
    assert type(scene)(**json.loads(scene.model_dump_json())) == scene.beside(None)
    assert scene.changed(seed=scene.seed) == scene
