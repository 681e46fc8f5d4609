"""Laws of every deviation model, and what the path's own map promises."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.line.deviation_model import ConstantDeviation, DeviationModel, PathDeviation, SlowlyVaryingDeviation
from tests.planning.cell import reference

MODELS: dict[str, Callable[[], DeviationModel]] = {
    "constant": lambda: ConstantDeviation(0.01),
    "constant in two directions": lambda: ConstantDeviation(0.01, 2),
    "slowly varying": lambda: SlowlyVaryingDeviation(0.01, 1, 0.005),
    "path": lambda: PathDeviation(reference()),
    "path in two directions": lambda: PathDeviation(reference(), directions=2),
}


@pytest.fixture(params=MODELS)
def model(request: pytest.FixtureRequest) -> DeviationModel:
    return MODELS[request.param]()


def test_prior_is_a_covariance_around_no_deviation(model: DeviationModel) -> None:
    x, P = model.prior()
    assert x.shape == (model.size,)
    assert not x.any()
    np.testing.assert_allclose(P, P.T)
    assert np.linalg.eigvalsh(P).min() > -1e-12
    x[0] = 1.0
    assert model.prior()[0][0] == 0.0


def test_basis_is_smooth_along_the_path(model: DeviationModel) -> None:
    s = np.linspace(0.0, 0.3, 3001)
    H = model.basis(s)
    assert H.shape == (3001, model.directions, model.size)
    slope = np.diff(H, axis=0) / 1e-4
    assert np.max(np.abs(np.diff(slope, axis=0))) < 0.5


@pytest.mark.parametrize("name", ["constant in two directions", "path in two directions"])
def test_directions_do_not_share_their_shape_states(name: str) -> None:
    model = MODELS[name]()
    H = model.basis(np.array([0.1]))[0]
    own = 1 if model.size == 2 else (model.size - 6) // 2
    shape = H[:, -2 * own :]
    assert not shape[0, own:].any()
    assert not shape[1, :own].any()


def test_drift_grows_with_time_and_only_where_there_is_one(model: DeviationModel) -> None:
    Q = model.drift(0.3)
    assert bool(Q.any()) == model.drifts
    np.testing.assert_allclose(model.drift(0.6), 2.0 * Q)


def test_travel_keeps_what_is_ahead(model: DeviationModel) -> None:
    rng = np.random.default_rng(1)
    x, P = model.prior()
    x = rng.normal(size=model.size) * np.sqrt(np.diag(P))
    s = np.linspace(0.35, 0.55, 12)
    while (step := model.travel(0.3)) is not None:
        x = step[0] @ x
    before = model.basis(s) @ x
    while (step := model.travel(0.36)) is not None:
        F, Q = step
        assert np.linalg.eigvalsh(Q).min() >= 0.0
        x = F @ x
    np.testing.assert_allclose(model.basis(s) @ x, before, atol=1e-12)


def test_path_prior_stays_the_same_while_the_window_moves() -> None:
    model = PathDeviation(reference())
    _, P = model.prior()
    moved = P
    for s in np.arange(0.0, 0.8, 0.02):
        while (step := model.travel(s)) is not None:
            F, Q = step
            moved = F @ moved @ F.T + Q
    np.testing.assert_allclose(moved, P, atol=2e-3 * P.max())


@settings(max_examples=30, deadline=None)
@given(st.floats(-0.02, 0.02), st.floats(-0.02, 0.02), st.floats(-0.02, 0.02))
def test_rigid_part_is_the_deviation_of_a_moved_path_to_first_order(x: float, y: float, turn: float) -> None:
    path = reference()
    model = PathDeviation(path)
    frame = path.frames(0.0)
    s = np.linspace(0.1, 0.35, 6)
    centre = path.position(np.linspace(0.0, path.length, 50)).mean(axis=0)
    lever = path.position(s) - centre
    move = x * frame.tangent + y * frame.normal + turn * np.cross(frame.up, lever)
    state = np.zeros(model.size)
    state[:3] = x, y, turn
    np.testing.assert_allclose(model.basis(s)[:, 0] @ state, np.sum(move * path.normal(s), axis=1), atol=1e-9)
