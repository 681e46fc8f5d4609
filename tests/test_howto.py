"""How-to pages: a question and one screen each, with commands that run as printed."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from scenes.cli import function_of
from tests.sources import ROOT

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
