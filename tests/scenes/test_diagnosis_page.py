"""The page of a diagnosis: the effect drawn through its residual, the ladder, words that claim no more than shown."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from ideal_robot.diagnosis.validation.result import ChannelResult, Diagnosis, FoundEffect, Traces
from ideal_robot.effects.base import EffectParameter
from ideal_robot.effects.fitted import FittedEffect
from scenes.diagnosis.figures import contributions, effect_figure, in_order, ladder_figure
from scenes.diagnosis.page import _amount, diagnosis_page, summary


def found(before: float, after: float, transfers: bool | None = None, name: str = "asymmetric_friction") -> FoundEffect:
    fitted = FittedEffect(name, 1, "tau_1", (2.0,), parameters=(EffectParameter("half difference", 2.0, 0.1, "N m"),))
    return FoundEffect(fitted, before, after, 1e-9, transfers=transfers)


def diagnosis(*effects: FoundEffect) -> Diagnosis:
    rng = np.random.default_rng(1)
    n = 4000
    t = 0.01 * np.arange(n)
    qd = np.sin(1.7 * t) + 0.3 * np.sin(0.31 * t)
    added = 2.0 * np.abs(np.sign(qd))[:, None] * (qd > 0)[:, None]
    left = 0.2 * rng.standard_normal((n, 1))
    traces = Traces(t, added + left, added + left, left, np.ones((n, 1), bool), t > 20, np.cumsum(qd)[:, None] * 0.01,
                    qd[:, None], tuple(added for _ in effects))
    return Diagnosis("effects", (ChannelResult("tau_1", "N m", 2.0, 2.0, 0.2, 0.19, 3.0),), effects, (), "blocks", 20.0,
                     traces=((("tau_1",), traces),))


def test_the_effect_is_drawn_over_the_signal_it_depends_on() -> None:
    one = found(2.0, 0.2)
    whole = diagnosis(one)
    traces = whole.traces[0][1]
    figure, said = effect_figure(one, "tau_1", "N m", traces, 0, traces.added[0][:, 0])
    (axes,) = figure.axes
    assert axes.get_xlabel() == "velocity of joint 1 [rad/s]"
    assert axes.get_ylabel() == "tau_1 [N m]"
    curve = next(line for line in axes.lines if line.get_label() == "asymmetric friction")
    x, y = curve.get_data()
    np.testing.assert_allclose(y[x > 0.1], 2.0, atol=1e-9)
    np.testing.assert_allclose(y[x < -0.1], 0.0, atol=1e-9)
    assert "asymmetric friction" in said


def test_the_ladder_has_a_step_an_effect_and_the_noise() -> None:
    figure = ladder_figure(diagnosis(found(2.0, 0.9), found(0.9, 0.2)))
    (axes,) = figure.axes
    assert [round(bar.get_width(), 3) for bar in axes.patches] == [2.0, 0.9, 0.2]
    assert any(np.allclose(line.get_xdata(), 0.19) for line in axes.lines)


def test_an_effect_reported_under_another_name_is_drawn_where_it_acts() -> None:
    one = found(2.0, 0.2)
    late = dataclasses.replace(one, fitted=dataclasses.replace(one.fitted, name="dead_time", channel="q_1"))
    (shown,) = contributions(diagnosis(late))
    assert shown[0] is late
    assert shown[1][2] == 0


def test_effects_stand_in_the_order_in_which_they_were_taken() -> None:
    first, second, third = found(2.0, 0.9), found(0.9, 0.5), found(0.5, 0.2)
    assert in_order([first, third, second]) == [first, second, third]


@pytest.mark.parametrize("worse", [found(0.5, 0.6), found(0.5, 0.4, transfers=False)])
def test_an_effect_whose_error_rose_is_not_called_missing(worse: FoundEffect) -> None:
    text = summary(diagnosis(worse))
    assert "The model misses no effect" in text
    assert "not claimed" in text


def test_a_number_without_uncertainty_does_not_pretend_to_one() -> None:
    assert "±" not in _amount(EffectParameter("gain", 0.0, 0.0, "N m"))
    assert "nan" not in _amount(EffectParameter("gain", 0.0, float("nan"), "N m"))
    assert _amount(EffectParameter("gain", 1.23456, 0.0456, "N m")) == "gain 1.23 ± 0.046 N m"


def test_pictures_of_effects_come_before_the_rest() -> None:
    blocks = diagnosis_page(diagnosis(found(2.0, 0.2)), "d")._blocks
    headings = [block["text"] for block in blocks if block["kind"] == "heading"]
    assert headings.index("The effects that were found") == 1
