"""Pages: contents, folded tables, digits, units of the world's settings."""

from __future__ import annotations

import dataclasses
import inspect
import json
import re
import shlex
from pathlib import Path

import cv2
import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image
from typer.main import get_command

from ideal_robot.diagnosis.validation.result import ChannelResult, Diagnosis, FoundEffect, Traces
from ideal_robot.effects.base import EffectParameter
from ideal_robot.effects.fitted import FittedEffect
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.cli import app
from scenes.closing.result import Closing
from scenes.commands.common import reading_options
from scenes.diagnosis.figures import contributions, effect_figure, without_each_figure
from scenes.diagnosis.page import diagnosis_page, summary
from scenes.path.page import path_replay, run_page
from scenes.play import run_scene
from scenes.report.call import Call
from scenes.report.page import UNITS, Report, world_rows
from scenes.report.replay import (
    FRAMES,
    Replay,
    enlarged_alike,
    link_poses,
    polygons,
    sensed_force,
    sensed_line,
    shown_motion,
)
from scenes.report.video import frames, write_video
from scenes.result import MOST, extremes, step
from scenes.scene_file import load_scene
from sim.arm.world import TABLE_KEYS, World
from tests.browser import chromium, needs_chromium

WITHOUT_UNIT = {"stiffness_scale", "link_bending", "column_damping", "friction_compensation", "gain_schedule",
                "elasticity", "friction", "friction_scale", "friction_asymmetry", "load_friction", "thermal",
                "lubrication", "time_compression", "quantisation", "torque_limits", "correction_delay",
                "velocity_feedforward", "individual", "inertia_tolerance", "drive_gain_error", "body", "controller",
                "command_smoothing"}


def test_every_heading_is_in_the_contents_and_leads_to_its_section(tmp_path: Path) -> None:
    page = Report("t")
    for word in ("one", "two", "three", "four"):
        page.heading(word)
    html = page.write(tmp_path / "p.html").read_text(encoding="utf-8")
    links = dict(re.findall(r'<a href="#([\w-]+)">(\w+)</a>', html))
    assert list(links.values()) == ["one", "two", "three", "four"]
    assert all(f'<h2 id="{anchor}">{word}</h2>' in html for anchor, word in links.items())


def test_long_tables_fold_and_numbers_are_short(tmp_path: Path) -> None:
    page = Report("t")
    page.table(["a"], [[1.23456], [float("nan")], [12345.6], [1.2345e7]], folded="All of it")
    html = page.write(tmp_path / "p.html").read_text(encoding="utf-8")
    assert "<details><summary>All of it</summary>" in html
    assert re.findall(r'<td class="number">(.*?)</td>', html) == ["1.23", "–", "12346", "1.23e+07"]


def test_every_setting_of_the_world_says_its_unit_or_has_none() -> None:
    assert set(UNITS) | WITHOUT_UNIT == set(TABLE_KEYS)
    rows = {row[0]: row[1:] for row in world_rows(World.default("kr6").table())}
    assert rows["stiffness"][1] == "N m/rad"
    assert len(rows["stiffness"][0].split(", ")) == 6


def test_drawings_are_vectors_pictures_and_clouds_of_points_are_pixels(tmp_path: Path) -> None:
    page = Report("t")
    drawing, picture, cloud = (Figure() for _ in range(3))
    drawing.add_subplot().plot([0, 1], [0, 1])
    picture.add_subplot().imshow(np.eye(3))
    cloud.add_subplot().plot(*np.random.default_rng(0).normal(size=(2, 20_000)), ".")
    for figure in (drawing, picture, cloud):
        page.figure(figure)
    html = page.write(tmp_path / "p.html").read_text(encoding="utf-8")
    assert re.findall(r"data:image/([\w+]+);", html) == ["svg+xml", "png", "png"]


def test_the_same_figure_makes_the_same_page(tmp_path: Path) -> None:
    pages = []
    for name in ("a.html", "b.html"):
        figure = Figure(figsize=(4.0, 2.0))
        axes = figure.add_subplot()
        axes.fill_between([0.0, 1.0, 2.0], [0.0, 1.0, 0.0], alpha=0.5)
        axes.plot([0.0, 2.0], [0.0, 1.0], "o")
        report = Report("page", "of a figure")
        report.figure(figure, "what to see")
        report.write(tmp_path / name)
        pages.append((tmp_path / name).read_bytes())
    assert pages[0] == pages[1]


def test_the_page_of_a_closed_loop_begins_with_before_and_after() -> None:
    """One page for all kinds of scenes."""
    headings = re.findall(r'page\.heading\("(.*?)"', inspect.getsource(Closing.page))
    assert headings[0] == "Before and after"


@needs_chromium
def test_a_page_is_no_wider_than_a_phone_and_what_is_wide_moves_sideways(tmp_path: Path) -> None:
    page = Report("A_title_of_one_word_that_is_longer_than_a_phone_is_wide", "said in words " * 20)
    for name in ("one", "two", "three", "four"):
        page.heading(name)
    page.figures([("a label", "0.123 mm")] * 5)
    page.warning("a warning of many words " * 10)
    page.table([f"column {i}" for i in range(14)],
               [["a long text of more than forty letters, which folds", *range(13)]])
    figure = Figure(figsize=(11.0, 3.0))
    figure.add_subplot().plot([0, 1], [0, 1])
    page.figure(figure, "a wide figure")
    page.write(tmp_path / "page.html")
    with chromium(tmp_path) as browser:
        browser.open((tmp_path / "page.html").as_uri(), 400, 800)
        assert browser.value("document.documentElement.scrollWidth") == 400
        assert browser.value("document.querySelector('figure img').getBoundingClientRect().width") == 720
        assert browser.value("document.querySelector('td.long').getBoundingClientRect().width") > 150
        # On a wide page the figure is as wide as the text.
        browser.open((tmp_path / "page.html").as_uri(), 1200, 800)
        assert browser.value("document.documentElement.scrollWidth") == 1200
        assert browser.value("document.querySelector('figure img').getBoundingClientRect().width") > 760


# The page of a diagnosis: the effect drawn through its residual, the ladder, words that claim no more than shown.

def found(before: float, after: float, transfers: bool | None = None, name: str = "asymmetric_friction") -> FoundEffect:
    fitted = FittedEffect(name, 1, "tau_1", (2.0,), parameters=(EffectParameter("half difference", 2.0, 0.1, "N m"),))
    return FoundEffect(fitted, before, after, 1e-9, transfers=transfers)


def diagnosis(*effects: FoundEffect) -> Diagnosis:
    rng = np.random.default_rng(1)
    n = 4000
    t = 0.01 * np.arange(n)
    qd = np.sin(1.7 * t) + 0.3 * np.sin(0.31 * t)
    added = 2.0 * np.abs(np.sign(qd))[:, None] * (qd > 0)[:, None]
    rest = 0.2 * rng.standard_normal((n, 1))
    traces = Traces(t, added + rest, added + rest, rest, np.ones((n, 1), bool), t > 20, np.cumsum(qd)[:, None] * 0.01,
                    qd[:, None], tuple(added for _ in effects))
    return Diagnosis("effects", (ChannelResult("tau_1", "N m", 2.0, 2.0, 0.2, 0.19, 3.0),), effects, (), "blocks", 20.0,
                     traces=((("tau_1",), traces),))


def test_the_effect_is_drawn_over_the_signal_it_depends_on() -> None:
    effect = found(2.0, 0.2)
    whole = diagnosis(effect)
    traces = whole.traces[0][1]
    figure, caption = effect_figure(effect, (("tau_1",), traces, 0, traces.added[0][:, 0]), "N m")
    (axes,) = figure.axes
    assert axes.get_xlabel() == "velocity of joint 1 [rad/s]"
    assert axes.get_ylabel() == "tau_1 [N m]"
    x, y = next(line for line in axes.lines if line.get_label() == "asymmetric friction").get_data()
    np.testing.assert_allclose(y[x > 0.1], 2.0, atol=1e-9)
    np.testing.assert_allclose(y[x < -0.1], 0.0, atol=1e-9)
    assert "asymmetric friction" in caption


def test_what_each_cause_is_worth_stands_between_before_and_after() -> None:
    figure = without_each_figure(diagnosis(found(2.0, 0.2), dataclasses.replace(found(0.9, 0.2), taken=1)))
    (axes,) = figure.axes
    assert [round(bar.get_width(), 3) for bar in axes.patches] == [2.0, 2.0, 0.9, 0.2]
    assert any(np.allclose(line.get_xdata(), 0.19) for line in axes.lines)


def test_an_effect_reported_under_another_name_is_drawn_where_it_acts() -> None:
    effect = found(2.0, 0.2)
    late = dataclasses.replace(effect, fitted=dataclasses.replace(effect.fitted, name="dead_time", channel="q_1"))
    (shown,) = contributions(diagnosis(late))
    assert shown[0] is late
    assert shown[1][2] == 0


def test_effects_stand_in_the_order_in_which_they_were_taken() -> None:
    first, second = (dataclasses.replace(found(2.0, 0.2), taken=k) for k in range(2))
    # A learned term that was taken first: each with what it adds, and not with what another one does.
    whole = dataclasses.replace(diagnosis(second, first), effects=(second,), unknown=(first,))
    assert [effect for effect, _ in contributions(whole)] == [first, second]


def test_an_effect_that_two_channels_show_is_missing_once() -> None:
    effect = found(2.0, 0.9)
    assert summary(diagnosis(effect, found(0.9, 0.2))).count(f" {effect.fitted.joint}") == 1


def test_the_error_that_is_told_is_that_of_the_channel_with_the_effect() -> None:
    whole = diagnosis(found(2.0, 0.2))
    channels = dataclasses.replace(whole.channels[0], channel="tau_2", rms_after=0.01), *whole.channels
    assert "error of tau_1 goes from 2 to 0.2 N m." in summary(dataclasses.replace(whole, channels=channels))


@pytest.mark.parametrize("worse", [found(0.5, 0.6), found(0.5, 0.4, transfers=False)])
def test_an_effect_whose_error_rose_is_not_called_missing(worse: FoundEffect) -> None:
    text = summary(diagnosis(worse))
    assert "The model misses no effect" in text
    assert "not claimed" in text


def test_what_is_left_above_the_noise_is_told_where_no_cause_is_found() -> None:
    def none(left: float) -> Diagnosis:
        channels = (ChannelResult("tau_1", "N m", left, left, left, 0.5, 3.0),
                    ChannelResult("x", "m", 1e-4, 1e-4, 1e-4, 1e-4, 1.0))
        return Diagnosis("none", channels, (), (), "blocks", 20.0)

    assert "Nothing is missing" in summary(none(0.6))
    text = summary(none(1.3))
    assert "Nothing is missing" not in text
    assert text.endswith("Left above the noise of the measurement: tau_1 (1.3 N m, 2.6 times).")
    assert none(1.3).to_dict()["above_noise"] == ["tau_1"]
    assert none(0.6).to_dict()["above_noise"] == []


def test_a_number_without_uncertainty_does_not_pretend_to_one() -> None:
    assert "±" not in EffectParameter("gain", 0.0, 0.0, "N m").text
    assert "nan" not in EffectParameter("gain", 0.0, float("nan"), "N m").text
    assert EffectParameter("gain", 1.23456, 0.0456, "N m").text == "gain 1.23 ± 0.046 N m"


def test_a_diagnosis_answers_shows_and_says_what_to_do_before_its_reasons() -> None:
    blocks = diagnosis_page(diagnosis(found(2.0, 0.2)), "d", Call("rec.parquet", "kr6", "m.json"))._blocks
    kinds = [block["kind"] for block in blocks]
    folded = next(i for i, block in enumerate(blocks) if block["kind"] == "heading" and block["folded"])
    assert kinds.index("image") < kinds.index("next") < folded
    assert "ideal-robot precorrect PATH.csv --robot kr6 --model better.json" in " ".join(
        step["command"] for step in blocks[kinds.index("next")]["steps"])
    headings = [block["text"] for block in blocks if block["kind"] == "heading"]
    assert headings.index("The effects that were found") == 1


def test_a_command_that_a_page_proposes_can_be_typed() -> None:
    call = Call("my cell/rec.parquet", "my arm.urdf", "it's.json")
    assert shlex.split(str(call)) == ["my cell/rec.parquet", "--robot", "my arm.urdf", "--model", "it's.json"]
    assert str(Call("rec.parquet", "kr6")) == "rec.parquet --robot kr6"


@pytest.mark.parametrize("verb", ["identify", "diagnose", "plan-diagnosis", "inspect", "validate", "twin", "stiffness"])
def test_every_verb_that_reads_a_recording_is_told_how_it_is_read(verb: str) -> None:
    call = Call("r.csv", "kr6", None, reading_options(Path("map.toml"), "left", "a, b"))
    assert shlex.split(str(call))[3:] == ["--columns", "map.toml", "--topic", "left", "--joints", "a, b"]
    takes = {word for p in get_command(app).get_command(None, verb).params for word in p.opts}
    assert takes >= {word for word in shlex.split(str(call)) if word in ("--columns", "--topic", "--joints")}
    # What inspect lacks, a model, is not proposed to it.
    assert Call("r.csv", "kr6", "m.json").recorded == "r.csv --robot kr6"


# Long series are thinned, short ones are not, and no peak is lost from a drawing.

def test_a_normal_series_is_whole() -> None:
    assert step(MOST) == step(0) == 1
    np.testing.assert_array_equal(extremes(np.zeros(MOST)), np.arange(MOST))


def test_the_extremes_of_a_long_series_are_drawn() -> None:
    values = np.random.default_rng(0).standard_normal(7 * MOST + 13)
    values[[123_457, 400_001]] = 50.0, -50.0
    rows = extremes(values)
    assert len(rows) <= MOST
    assert np.all(np.diff(rows) > 0)
    assert {123_457, 400_001} <= set(rows)
    assert len(values[:: step(len(values))]) <= MOST


# The replay in a page: what it holds, and that it moves in a browser.

ROBOT = Robot.load("kr6")


def _replay(n: int = 1000, script: str = "") -> Replay:
    t = np.linspace(0.0, 4.0, n)
    q = ROBOT.home + 0.2 * np.sin(t)[:, None]
    tool = ROBOT.tool_places(q)
    error = np.where(t > 1.0, 0.1 + 0.05 * np.sin(9.0 * t), np.nan)
    return Replay(ROBOT, t, q, tool, tool + np.array([0.0, 1e-4, 0.0]), error, error_name=f"distance{script}",
                  curves={"line": tool})


def test_a_long_run_is_thinned_out_and_stays_small() -> None:
    html = _replay(20000).html()
    match = re.search(r"const DATA = (.*);\n", html)
    assert match is not None
    assert len(json.loads(match[1].replace("<\\/", "</"))["t"]) <= FRAMES
    assert len(html) < 2_000_000


def test_links_stand_where_pinocchio_has_them() -> None:
    shapes, links = polygons(ROBOT)
    poses = link_poses(ROBOT, ROBOT.home[None, :], links)
    tool = ROBOT.fk()(ROBOT.home).translation
    last = max(shape["link"] for shape in shapes)
    corners = np.array([corner for shape in shapes if shape["link"] == last for face in shape["faces"]
                        for corner in face])
    placed = corners @ poses[0, last, :9].reshape(3, 3).T + poses[0, last, 9:]
    assert np.min(np.linalg.norm(placed - tool, axis=1)) < 0.15


def test_an_arm_without_shapes_is_drawn_as_rods(tmp_path: Path) -> None:
    text = re.sub(r"<visual>.*?</visual>", "", ROBOT.urdf.read_text(encoding="utf-8"), flags=re.S)
    (tmp_path / "bare.urdf").write_text(text, encoding="utf-8")
    shapes, _ = polygons(Robot.load(tmp_path / "bare.urdf"))
    assert len(shapes) >= 4


def test_names_cannot_end_the_script() -> None:
    assert _replay(50, "</script><script>alert(1)</script>").html().count("</script>") == 1


def test_arrays_of_other_lengths_are_refused() -> None:
    good = _replay(50)
    with pytest.raises(InputError, match="error"):
        Replay(ROBOT, good.t, good.q, good.tool, good.wanted, good.error[:-1])


@needs_chromium
def test_it_moves_in_a_browser(tmp_path: Path) -> None:
    """The slider moves the arm: the canvas changes, and the frame shown follows."""
    page, canvas = tmp_path / "page.html", 'document.querySelector("canvas").toDataURL()'
    page.write_text(f'<!DOCTYPE html><meta charset="utf-8">{_replay(100).html()}', encoding="utf-8")
    with chromium(tmp_path) as browser:
        browser.open(page.as_uri(), 1000, 800)
        before = browser.value(canvas)
        assert len(before) > 5000, "blank"
        browser.value('slider = document.querySelector("input[type=range]"); slider.value = 10; '
                      'slider.dispatchEvent(new Event("input"))')
        assert browser.value('document.querySelector(".replay").dataset.frame') == "10"
        assert browser.value(canvas) != before


# Replays of paths and of methods side by side, and the film of ``run --video``.

def test_a_paths_replay_shows_the_errors_of_its_table() -> None:
    scene = load_scene("iso9283_1")
    ideal, none = (run_scene(scene, method=method) for method in ("ideal", "none"))
    replay, other = path_replay(ideal), path_replay(none)
    assert replay is not None
    assert other is not None
    assert np.sqrt(np.nanmean(replay.error**2)) == pytest.approx(1e3 * ideal.errors.time_matched.E_car, rel=0.02)
    # Beside each other both are enlarged alike, and the larger error stays readable beside the path.
    shown, beside = enlarged_alike([replay, other])
    assert shown.enlarged == beside.enlarged < replay.enlarged
    extent = np.ptp(other.wanted, axis=0).max()
    assert beside.enlarged * 1e-3 * np.nanmax(other.error) < 0.2 * extent
    kinds = [block["kind"] for block in run_page(ideal, replay)._blocks]
    assert kinds.index("replay") < kinds.index("table")


def test_a_film_of_another_format_is_refused_before_the_run(program, tmp_path: Path) -> None:
    done = program("run", "line", "--out", "o", "--video", "x.avi")
    assert done.code == 2
    assert ".mp4 or .gif or .webp" in done.err
    assert not (tmp_path / "o").exists()


# What the sensors felt, in the base frame: the weight of the tool and the sensor's bias are not the environment's.

def test_the_force_of_the_environment_comes_back() -> None:
    q = _replay(50).q
    true = np.tile([3.0, -4.0, 12.0], (50, 1))
    bias, mass = np.array([1.0, 2.0, -3.0, 0.0, 0.0, 0.0]), 0.8
    pose = ROBOT.fk()
    weight = np.array([0.0, 0.0, -9.81 * mass])
    felt = np.array([pose(row).rotation.T @ (force + weight) for row, force in zip(q, true, strict=True)])
    columns = {name: felt[:, i] + bias[i] for i, name in enumerate(("fx", "fy", "fz"))}
    plain = Recording.from_arrays(np.arange(50) * 0.01, meta={"tool": {"bias": bias.tolist(), "mass": mass}}, q=q)
    recording = Recording({**plain.columns, **columns}, plain.meta, "test")
    np.testing.assert_allclose(sensed_force(ROBOT, recording), true, atol=1e-9)
    some = sensed_force(ROBOT, recording, np.array([3, 7]))
    assert some is not None
    assert some.shape == (2, 3)


def test_recordings_without_sensors_have_neither() -> None:
    plain = Recording.from_arrays(np.arange(50) * 0.01, meta={}, q=_replay(50).q)
    assert sensed_force(ROBOT, plain) is None
    assert len(sensed_line(ROBOT, plain)) == 0


def test_without_a_tracker_the_motors_angles_are_shown() -> None:
    q = _replay(50).q
    motors = Recording.from_arrays(np.arange(50) * 0.01, meta={}, q=q)
    np.testing.assert_array_equal(shown_motion(ROBOT, motors)[2], q)
    both = Recording.from_arrays(np.arange(50) * 0.01, meta={}, q=q, qa=q + 1e-3)
    np.testing.assert_array_equal(shown_motion(ROBOT, both)[2], q + 1e-3)


# Films of a run.

def test_the_arm_moves_and_the_trace_grows() -> None:
    shown = list(frames(_replay(200), 1.0))
    assert len(shown) == 4
    assert all(frame.shape == shown[0].shape for frame in shown)
    assert np.abs(shown[0][:400, :500].astype(int) - shown[2][:400, :500]).mean() > 1.0


@pytest.mark.parametrize("ending", [".gif", ".webp", ".mp4"])
def test_a_film_can_be_played(ending: str, tmp_path: Path) -> None:
    short = dataclasses.replace(_replay(60), t=np.linspace(0.0, 0.5, 60))
    path = write_video(short, tmp_path / f"run{ending}", rate=10.0, slow=1.0)
    if ending != ".mp4":
        with Image.open(path) as film:
            assert film.n_frames == 5
    else:
        film = cv2.VideoCapture(str(path))
        assert int(film.get(cv2.CAP_PROP_FRAME_COUNT)) == 5
        film.release()
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


def test_another_ending_is_refused_before_anything_is_drawn(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"\.mp4 or \.gif or \.webp"):
        write_video(_replay(50), tmp_path / "run.avi")
