"""Examples in the help: each verb has one, and it runs as printed in an empty folder, after those it names."""

from __future__ import annotations

import inspect
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import typer
from PIL import Image, ImageDraw

from scenes.cli import THEMES, VERBS, function_of
from tests.conftest import Ended
from tests.sources import ROOT

QUICK = {"list", "new", "fetch", "detect"}
"""Verbs whose example takes a second and needs no other."""
ADDITION = {"view": ["--once"]}
"""What keeps an example from waiting for the user."""


class Example(NamedTuple):
    """The first example of a verb.

    Attributes:
        after: verb whose example has to run before; empty for none.
        commands: to be typed one after the other.
        beside: the last command runs in another terminal, beside the others.
    """

    after: str
    commands: tuple[tuple[str, ...], ...]
    beside: bool


def example(verb: str) -> Example:
    paragraphs = re.split(r"\n\n", inspect.getdoc(function_of(verb)) or "")
    text = next(" ".join(one.split()) for one in paragraphs if one.startswith("Example"))
    head = re.match(r"Example(?:, after that of `([\w-]+)`|, with [\w ]+)?:", text)
    assert head is not None, text
    commands = re.findall(r"`(ideal-robot .*?)`", text)
    return Example(head[1] or "", tuple(tuple(shlex.split(one)[1:]) for one in commands), "another terminal" in text)


def chain(verb: str) -> list[str]:
    """A verb behind those whose examples come before it."""
    before = example(verb).after
    return [*(chain(before) if before else []), verb]


ENDS = sorted(set(VERBS) - QUICK - {example(verb).after for verb in VERBS} - {"simulate"})
"""Verbs after which no other one comes; the example of ``simulate`` is that of ``follow``."""


def test_six_verbs_come_first() -> None:
    assert len(next(iter(THEMES.values()))) == 6
    assert len(VERBS) == sum(map(len, THEMES.values()))


@pytest.mark.parametrize("verb", VERBS)
def test_the_first_example_of_a_verb_has_its_options(verb: str) -> None:
    found = example(verb)
    assert verb in [words[0] for words in found.commands]
    for name, *words in found.commands:
        assert {word for word in words if word.startswith("-")} <= options_of(name)
    assert chain(verb)[-1] == verb
    assert found.beside == (verb in ("follow", "simulate"))


@pytest.mark.parametrize("verb", sorted(QUICK))
def test_a_quick_example_runs_as_printed(verb: str, program: Callable[..., Ended], tmp_path: Path) -> None:
    if verb == "detect":
        picture = Image.new("L", (640, 480), 200)
        ImageDraw.Draw(picture).line([(0, 200), (640, 260)], fill=40, width=9)
        noise = np.random.default_rng(1).normal(0.0, 8.0, (480, 640))
        (tmp_path / "pictures").mkdir()
        Image.fromarray(np.clip(picture + noise, 0, 255).astype(np.uint8)).save(tmp_path / "pictures" / "line.png")
    for words in example(verb).commands:
        done = program(*words)
        assert done.code == 0, done.err


@pytest.mark.slow
@pytest.mark.parametrize("verb", [pytest.param(one, marks=pytest.mark.real_time if example(one).beside else ())
                                  for one in ENDS])
def test_an_example_runs_as_printed(verb: str, tmp_path: Path) -> None:
    shutil.copytree(ROOT / "examples", tmp_path / "examples")  # A baseline is written beside its suite.
    told = {**os.environ, "PYTHONPATH": str(ROOT), "IDEAL_ROBOT_CACHE": str(tmp_path / "cache")}

    def begun(words: tuple[str, ...]) -> subprocess.Popen[str]:
        return subprocess.Popen([sys.executable, "-m", "scenes.cli", *words, *ADDITION.get(words[0], [])],
                                cwd=tmp_path, env=told, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)

    for one in chain(verb):
        found = example(one)
        aside = [begun(words) for words in found.commands[:-1]] if found.beside else []
        for words in found.commands[-1:] if found.beside else found.commands:
            process = begun(words)
            said, _ = process.communicate(timeout=1800)
            assert process.returncode == 0, f"{' '.join(words)}\n{said[-3000:]}"
        for process in aside:
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=60)
            assert process.returncode == 0


# How-to pages: a question and one screen each, with commands that run as printed.

INDEX = ROOT / "docs" / "howto" / "index.md"
PAGES = sorted(page for page in INDEX.parent.glob("*.md") if page != INDEX)
BLOCK = re.compile(r"```(sh|python)\n(.*?)```", re.DOTALL)


def options_of(verb: str) -> set[str]:
    """All options of a verb, as its own parser has them."""
    app = typer.Typer()
    app.command()(function_of(verb))
    return {option for one in typer.main.get_command(app).params for option in (*one.opts, *one.secondary_opts)}


def test_the_questions_are_a_click_from_the_index() -> None:
    linked = re.findall(r"^- \[(.*?)\]\((\w+\.md)\)$", INDEX.read_text(encoding="utf-8"), flags=re.MULTILINE)
    titles = {page.name: page.read_text(encoding="utf-8").splitlines()[0] for page in PAGES}
    assert {name: f"# {title}" for title, name in linked} == titles
    assert len(titles) >= 20
    assert all("?" in title for title in titles.values())


def test_the_doors_of_the_front_page_open_the_parts_of_the_index() -> None:
    doors = re.findall(r"\(howto/index\.md#([\w-]+)\)", (ROOT / "docs" / "index.md").read_text(encoding="utf-8"))
    parts = re.findall(r"^## (.*)$", INDEX.read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert doors == [re.sub(r"\W+", "-", part.lower().replace("'", "")) for part in parts]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_is_one_screen_of_commands_that_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert BLOCK.search(text)
    assert len(BLOCK.sub("", text).split()) <= 260
    lines = [line for kind, code in BLOCK.findall(text) if kind == "sh" for line in code.splitlines() if line]
    for line in lines:
        program, *words = shlex.split(line.removesuffix("&"))
        if program == "ideal-robot":
            given = {word for word in words if word.startswith("-") and len(word) > 1}
            assert given <= options_of(words[0]), line


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_runs_as_printed(page: Path, tmp_path: Path) -> None:
    if "examples/" in page.read_text(encoding="utf-8"):
        (tmp_path / "examples").symlink_to(ROOT / "examples")
    programs = tmp_path / "bin"
    programs.mkdir()
    for name, words in (("ideal-robot", "-m scenes.cli"), ("python", "")):
        (programs / name).write_text(f'#!/bin/sh\nexec {sys.executable} {words} "$@"\n', encoding="utf-8")
        (programs / name).chmod(0o755)
    told = {**os.environ, "PYTHONPATH": str(ROOT), "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}"}
    for kind, code in BLOCK.findall(page.read_text(encoding="utf-8")):
        # A viewer waits for the user otherwise; what runs beside another command is waited for.
        script = re.sub(r"^(ideal-robot view .*)$", r"\1 --once", code, flags=re.MULTILINE) + "\nwait\n"
        call = ["bash", "-e", "-c", script] if kind == "sh" else [sys.executable, "-c", code]
        done = subprocess.run(call, cwd=tmp_path, env=told, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{code}\n{done.stdout[-1500:]}\n{done.stderr[-3000:]}"
