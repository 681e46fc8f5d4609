"""What every feedforward has to obey, whatever it does."""

from __future__ import annotations

import copy
import dataclasses
import importlib
from collections.abc import Iterator
from importlib import metadata

import numpy as np
import pytest

from ideal_robot.arrays import eased
from ideal_robot.errors import InputError
from ideal_robot.feedforward.base import CommandLimits, Feedforward, PassThrough
from ideal_robot.feedforward.friction_adaptation import AdaptedIdeal
from ideal_robot.feedforward.inverse import AHEAD, PRINTED, Inverse, Options
from ideal_robot.feedforward.learning import Playback
from ideal_robot.feedforward.linear_inverse import LinearInverse
from ideal_robot.feedforward.method import Needs, Practice, Rehearsed, Setting
from ideal_robot.feedforward.registry import (
    _REGISTRY,
    feedforward,
    method,
    methods,
    register,
    require,
    settings,
    unregister,
)
from ideal_robot.feedforward.training import train
from ideal_robot.loop.from_model import loop_model
from ideal_robot.loop.impulse_response import LinearLoop
from ideal_robot.loop.simulation import simulate
from ideal_robot.model.described_arm import Gears
from ideal_robot.model.model import Model
from ideal_robot.model.parametrisation import ControllerModel
from ideal_robot.registry import Registry
from ideal_robot.robots.robot import Robot
from tests.arms import ROBOT, T, commands, motion, plant
from tests.sources import MODELS

LIMITS = CommandLimits.of(ROBOT)


def nominal_model() -> Model:
    """The data sheet's model with the plant's controller and gears."""
    loop = plant()
    own = loop.cascade
    controller = ControllerModel(
        t_cycle=0.002, k_p=own.k_p * own.k_v, k_d=own.k_p * own.k_ff, k_1=own.k_p * (own.k_ff - 1),
        k_2=own.k_p * own.t_filter, k_i=own.k_i / own.k_p * 0.002, filter_time=np.full(6, 1.5e-3), filter_order=2)
    return dataclasses.replace(Model.nominal(ROBOT), controller=controller,
                               gears=Gears(loop.drives.stiffness, loop.drives.damping))


def trained():
    q_d = motion()
    return train([(q_d, q_d + 1e-3 * np.sin(np.arange(len(q_d)))[:, None])], T, chain=plant().chain, limits=LIMITS)


MAKERS = {
    "none": lambda: PassThrough(T),
    "linear": lambda: LinearInverse(LinearLoop.of(plant(), ROBOT.home), limits=LIMITS),
    "trained": trained,
    "precorrected-printed": lambda: Inverse.of(nominal_model(), ROBOT, None, options=PRINTED),
    "precorrected": lambda: Inverse.of(nominal_model(), ROBOT, None, delay=1, options=AHEAD),
    "learned": lambda: Playback(motion(), T),
    "ideal": lambda: Inverse(plant()),
    "ideal_rigid": lambda: Inverse(plant(), options=Options(elastic=False)),
    "adapted": lambda: AdaptedIdeal(Inverse(plant())),
}
RIGID = ("none", "linear", "trained", "precorrected-printed", "learned", "ideal_rigid")
"""Those that do not compensate the gears' deflection, so that at rest nothing may be left of the correction."""


@pytest.fixture(scope="module", params=MAKERS)
def named(request):
    return request.param, MAKERS[request.param]()


def test_shape_and_finiteness(named):
    q_d = motion()
    q_c = commands(named[1], q_d)
    assert q_c.shape == q_d.shape
    assert np.isfinite(q_c).all()


def test_a_step_changes_neither_state_nor_input_and_repeats_bit_for_bit(named):
    feedforward = named[1]
    q_d = motion()
    state = feedforward.init(q_d[0])
    for k in range(50, 55):
        horizon = q_d[k : k + 30].copy()
        before = copy.deepcopy(state)
        first, _ = feedforward.step(state, horizon)
        second, following = feedforward.step(before, horizon)
        np.testing.assert_array_equal(first, second)
        np.testing.assert_array_equal(horizon, q_d[k : k + 30])
        state = following


def test_at_rest_the_command_comes_to_rest(named):
    q_c = commands(named[1], np.tile(ROBOT.home, (260, 1)))
    assert np.max(np.abs(np.diff(q_c[-30:], axis=0))) < 1e-5


def test_the_correction_vanishes_at_rest_so_that_static_accuracy_is_untouched(named):
    key, feedforward = named
    if key not in RIGID:
        pytest.skip("compensates the gears' deflection at rest on purpose")
    if key == "trained":
        pytest.skip("has the deflection under gravity in its third sum on purpose")
    q_c = commands(feedforward, np.concatenate([motion(), np.tile(ROBOT.home, (150, 1))]))
    # After the motion u_d of [G] (18) fades with the integrator's time constant of 50 ms.
    assert np.max(np.abs(q_c[-1] - ROBOT.home)) < 1e-6


def test_commands_stay_within_the_limits(named):
    key, feedforward = named
    if key in ("none", "learned"):
        pytest.skip("plays what it is given")
    far = np.where(np.arange(ROBOT.n) % 2 == 0, ROBOT.q_max, ROBOT.q_min)
    q_c = commands(feedforward, ROBOT.home + np.linspace(0, 1, 80)[:, None] * (far - ROBOT.home))
    assert np.all(q_c <= ROBOT.q_max + 1e-12)
    assert np.all(q_c >= ROBOT.q_min - 1e-12)


def test_a_longer_horizon_than_needed_changes_nothing(named):
    feedforward = named[1]
    q_d = motion()
    np.testing.assert_allclose(commands(feedforward, q_d, 45), commands(feedforward, q_d, max(30, feedforward.n_d)),
                               atol=1e-12)


def test_a_horizon_of_one_is_borne(named):
    q_c = commands(named[1], motion(), 1)
    assert np.isfinite(q_c).all()
    # Without a horizon no law can be good; it must not be wild either: 0.1 rad is what the arm moves in four cycles.
    assert np.max(np.abs(q_c - motion())) < 0.1


# Methods by their key: laws over all of them, and one that a user adds.

KR6 = Robot.load("kr6")
MODEL = Model.load(MODELS / "kr6.json")


def path() -> np.ndarray:
    """Half a second of rest, a smooth move of all joints, rest again."""
    return KR6.home + 0.1 * eased(np.clip(np.linspace(-0.5, 1.5, 120), 0.0, 1.0)[:, None])


def practice() -> Practice:
    """An arm to play on: the identified loop itself, with gears a little softer."""
    loop = loop_model(MODEL, KR6, delay=0)
    arm = loop.changed(stiffness=0.9 * loop.drives.stiffness)

    def play(law: Feedforward, q_d: np.ndarray) -> Rehearsed:
        return Rehearsed(law.init(q_d[0]), lambda: np.asarray(q_d - simulate(arm, law.along(q_d)).q_a[:-1]))

    return Practice(play, KR6)


@pytest.mark.parametrize("key", [key for key in methods() if method(key).needs <= Needs.PATH])
def test_every_method_is_made_by_its_key_and_holds_an_arm_at_rest(key: str) -> None:
    law = feedforward(key, MODEL, KR6, q_d=path())
    state = law.init(KR6.home)
    for _ in range(20):
        q_c, state = law.step(state, np.tile(KR6.home, (law.n_d, 1)))
    assert np.max(np.abs(q_c - KR6.home)) < 0.01
    assert method(key).description


def test_a_method_that_learns_on_the_arm_shares_its_plays() -> None:
    place = practice()
    laws = [feedforward(key, MODEL, KR6, q_d=path(), practice=place) for key in ("learned-1", "learned")]
    q_d = path()
    off = [np.sqrt(np.mean(place.play(law, q_d).errors() ** 2)) for law in laws]
    plain = np.sqrt(np.mean(place.play(PassThrough(KR6.t_ipo), q_d).errors() ** 2))
    assert off[1] <= off[0] < 0.3 * plain


@pytest.mark.parametrize(("key", "field"), [("ideal", "model"), ("linear", "q_d"), ("trained", "practice"),
                                            ("unknown", "method")])
def test_what_is_missing_is_named(key: str, field: str) -> None:
    arguments = {"model": None if field == "model" else MODEL, "q_d": None if field == "q_d" else path()}
    with pytest.raises(InputError) as caught:
        feedforward(key, arguments["model"], KR6, q_d=arguments["q_d"])
    assert caught.value.field == field


class HalfAhead(PassThrough):
    """Commands the middle of the next cycle."""

    n_d = 2

    def __init__(self, setting: Setting) -> None:
        super().__init__(setting.robot.t_ipo)

    def step(self, state: None, q_d: np.ndarray, tau_ext_d: np.ndarray | None = None) -> tuple[np.ndarray, None]:
        return 0.5 * (q_d[0] + q_d[-1]), None


@pytest.fixture
def own() -> Iterator[str]:
    register("half_ahead", HalfAhead, needs=Needs.NOTHING)
    yield "half_ahead"
    unregister("half_ahead")


def test_an_own_method_stands_beside_the_built_in_ones(own: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert methods()[-1] == own
    assert own in methods(Needs.NOTHING)
    assert "ideal" not in methods(Needs.NOTHING)
    assert method(own).description == "Commands the middle of the next cycle."
    q_d = path()
    np.testing.assert_allclose(feedforward(own, None, KR6).along(q_d)[:-1], 0.5 * (q_d[:-1] + q_d[1:]))
    with pytest.raises(InputError, match="another name"):
        register(own, PassThrough)
    with pytest.raises(InputError, match="lower case"):
        register("My Method", HalfAhead)
    for key in ("half-ahead", "Half", "2nd", "half_delay", "learned_1"):
        with pytest.raises(InputError, match="no key of an earlier version"):
            register(key, HalfAhead)
        point = metadata.EntryPoint(key, "house:Method", "seam")
        monkeypatch.setattr(metadata, "entry_points", lambda point=point, **_: [point])
        with pytest.raises(InputError, match=f"earlier version; rename the entry point.*{key} = house:Method"):
            Registry("method", "seam", {}, _REGISTRY._wanted, _REGISTRY._fits).names()


@pytest.mark.parametrize(("before", "today"), [
    ("precorrected_1", "precorrected-printed"), ("linear_1", "linear-printed"), ("trained_1", "trained-printed"),
    ("model_learned", "learned-model"), ("learned_2", "learned-2"), ("learned_4", "learned"),
    ("ideal_delay", "ideal-delay"), ("precorrected_1_delay", "precorrected-printed-delay")])
def test_a_key_of_an_earlier_version_names_the_setting_of_today(before: str, today: str) -> None:
    with pytest.raises(InputError, match=f"write {today} "):
        require(before, (*methods(), *settings()))
    with pytest.raises(InputError, match=f"write {today} "):
        method(before)
    assert today.removesuffix("-delay") in (*methods(), *settings())


@pytest.mark.parametrize("key", settings())
def test_a_setting_is_described_and_says_what_it_needs(key: str) -> None:
    base = key.partition("-")[0]
    assert method(key).description != method(base).description
    assert (method(key).needs <= Needs.PATH) == (key in settings(Needs.PATH))


@pytest.mark.parametrize("key", ["ideal-printed", "learned-4", "precorrected-", "nothing-printed"])
def test_a_setting_that_is_none_is_refused_with_those_there_are(key: str) -> None:
    with pytest.raises(InputError, match=r"expected one of|no such setting"):
        method(key)


def test_linear_as_printed_knows_the_arm_from_sinusoids_alone() -> None:
    """[G] (7), (12): an arm that is a linear filter is inverted without a model; the motion keeps the arm's limits."""
    place, q_d = practice(), path()
    g = np.array([0.0, 0.3, 0.4, 0.2, 0.1])

    def play(law: Feedforward, wanted: np.ndarray) -> Rehearsed:
        q_c = law.along(wanted)
        answer = q_c[:1] + np.array([np.convolve(g, column)[: len(q_c)] for column in (q_c - q_c[0]).T]).T
        return Rehearsed(law.init(wanted[0]), lambda: np.asarray(wanted - answer))

    linear = Practice(play, KR6)
    motion = linear.sinusoids(q_d)
    assert np.all(motion > KR6.q_min)
    assert np.all(motion < KR6.q_max)
    assert np.all(np.abs(np.diff(motion, axis=0)) < 0.5 * KR6.v_max * KR6.t_ipo)
    np.testing.assert_allclose(motion[0], np.median(q_d, axis=0), atol=1e-9)
    law = feedforward("linear-printed", None, KR6, n_d=30, q_d=q_d, practice=linear)
    before, after = (np.abs(play(candidate, q_d).errors()).max() for candidate in (PassThrough(KR6.t_ipo), law))
    # The inverse of paths of 3 Hz, of responses that sinusoids told.
    assert after < 0.15 * before
    assert feedforward("linear-printed", MODEL, KR6, q_d=q_d, practice=place).n_d == 30


def test_training_as_printed_weighs_no_torques() -> None:
    """[G] (13) has positions and signs; ``trained`` adds the rigid body, and is better where links couple."""
    place, q_d = practice(), path()
    printed, more = (feedforward(key, MODEL, KR6, q_d=q_d, practice=place) for key in ("trained-printed", "trained"))
    assert len(printed.w) == 0  # type: ignore[attr-defined]
    assert len(more.w) > 0  # type: ignore[attr-defined]
    off = [np.sqrt(np.mean(place.play(law, q_d).errors() ** 2)) for law in (PassThrough(KR6.t_ipo), printed, more)]
    assert off[2] < off[1] < off[0]


@pytest.mark.parametrize(("q_d", "learns"), [(path(), True), (None, False)])
def test_frictions_shape_is_learned_where_the_path_is_known_beforehand(q_d: np.ndarray | None, learns: bool) -> None:
    """On paths planned anew the following error is not friction's alone."""
    law = feedforward("adapted", MODEL, KR6, q_d=q_d)
    assert isinstance(law, AdaptedIdeal)
    assert (law.curve is not None) == learns


def test_the_package_is_called_as_the_function_of_its_name() -> None:
    package = importlib.import_module("ideal_robot.feedforward")
    law = package("none", Model.nominal(ROBOT), ROBOT)
    q_c, _ = law.step(law.init(ROBOT.home), np.tile(ROBOT.home, (3, 1)))
    np.testing.assert_array_equal(q_c, ROBOT.home)
