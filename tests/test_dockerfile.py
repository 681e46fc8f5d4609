"""The image is built and started by commands that README and Makefile have too; Docker itself is not needed here."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import pinocchio

ROOT = Path(__file__).resolve().parents[1]
LINES = [line for line in (ROOT / "Dockerfile").read_text(encoding="utf-8").splitlines() if line.strip()]
STEPS = [tuple(line.split(maxsplit=1)) for line in LINES if not line.startswith("#")]
README = (ROOT / "README.md").read_text(encoding="utf-8")
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")


def test_it_has_only_known_instructions_and_a_python_the_package_takes() -> None:
    assert {step for step, _ in STEPS} <= {"FROM", "RUN", "WORKDIR", "COPY", "ENV", "CMD"}
    image = re.fullmatch(r"python:(\d+)\.(\d+)-slim", STEPS[0][1])
    assert image is not None
    required = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["requires-python"]
    assert (int(image[1]), int(image[2])) >= tuple(map(int, required.removeprefix(">=").split(".")))


def test_what_it_makes_are_targets_of_the_makefile_and_what_it_starts_is_readmes_first_command() -> None:
    targets = set(re.findall(r"^([.\w/-]+):", MAKEFILE, re.M))
    made = [word for step, text in STEPS if step == "RUN" for word in re.findall(r"\bmake ([.\w/-]+)", text)]
    assert made == [".venv/installed"]
    assert set(made) <= targets
    start = json.loads(next(text for step, text in STEPS if step == "CMD"))
    first = re.search(r"```sh\n(make \w+)", README)
    assert first is not None
    assert " ".join(start) == first[1]


def test_the_environment_of_the_image_is_the_one_that_is_installed() -> None:
    folder = next(text for step, text in STEPS if step == "WORKDIR")
    assert f"ENV PATH={folder}/.venv/bin:$PATH" in LINES
    assert "BIN := .venv/bin" in MAKEFILE


def test_what_wheels_need_of_the_system_is_installed() -> None:
    """Debian's slim image has the C and C++ libraries, but not OpenMP's, which Pinocchio's wheel does not bring."""
    compiled = next(Path(pinocchio.__path__[0]).glob("pinocchio_pywrap_default*.so")).read_bytes()
    bundled = [path for path in Path(pinocchio.__path__[0]).parents[2].glob("libgomp*")]
    if b"libgomp.so.1\0" in compiled and not bundled:
        assert any("libgomp1" in text.split() for step, text in STEPS if step == "RUN")


def test_readme_says_the_commands_of_its_heading_and_nothing_private_goes_in() -> None:
    commands = [line.removeprefix("#").strip() for line in LINES if line.startswith("#   ")]
    assert len(commands) == 2
    assert all(command in README for command in commands)
    left_out = (ROOT / ".dockerignore").read_text(encoding="utf-8").split()
    assert {".git", ".venv", "out"} <= set(left_out)
