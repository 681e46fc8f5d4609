"""Pages: contents, folded tables, digits, units of the world's settings."""

from __future__ import annotations

import importlib
import inspect
import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from scenes.report.page import Report
from scenes.report.world_table import UNITS, world_rows
from sim.arm.world import TABLE_KEYS, World
from tests.browser import chromium, needs_chromium

WITHOUT_UNIT = {"elasticity", "friction", "friction_scale", "friction_asymmetry", "load_friction", "thermal",
                "lubrication", "time_compression", "quantisation", "torque_limits", "correction_delay",
                "velocity_feedforward", "individual", "inertia_tolerance", "drive_gain_error"}


def test_every_heading_is_in_the_contents_and_leads_to_its_section(tmp_path: Path) -> None:
    page = Report("t")
    for word in ("one", "two", "three", "four"):
        page.heading(word)
    html = page.write(tmp_path / "p.html").read_text(encoding="utf-8")
    links = dict(re.findall(r'<a href="#([\w-]+)">(\w+)</a>', html))
    assert list(links.values()) == ["one", "two", "three", "four"]
    assert all(f'<h2 id="{anchor}">{word}</h2>' in html for anchor, word in links.items())


def test_long_tables_fold_and_numbers_have_three_digits(tmp_path: Path) -> None:
    page = Report("t")
    page.table(["a"], [[1.23456], [float("nan")], [12345.6]], folded="All of it")
    html = page.write(tmp_path / "p.html").read_text(encoding="utf-8")
    assert "<details><summary>All of it</summary>" in html
    assert re.findall(r'<td class="number">(.*?)</td>', html) == ["1.23", "–", "1.23e+04"]


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


@pytest.mark.parametrize("kind", ["line", "force", "path", "clamped"])
def test_the_page_of_a_closed_loop_begins_with_before_and_after(kind: str) -> None:
    room = "scenes.close_clamped.page" if kind == "clamped" else f"scenes.{kind}.close_loop_page"
    source = inspect.getsource(importlib.import_module(room))
    headings = re.findall(r'page\.heading\("(.*?)"', source)
    assert headings[0].endswith("before and after")


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
