"""A pytest plugin: runs scenes in tests, asserts on errors, and compares them with the last accepted ones.

    @pytest.mark.ideal_scene("straight", world="bench", speed=0.4)
    def test_the_line_is_followed(path_error, baseline):
        runs = path_error(seeds=range(1, 6))
        assert runs.mean("control_error_mm.mean") < 0.1
        baseline(runs)

Runs are kept in pytest's cache under what they depend on (program, scene, model, seed, method), so that a test that
changes only its assertions plays nothing. A test has its baseline in a file of its own, ``baselines`` beside it, so
that processes of pytest-xdist do not meet.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from ideal_robot.errors import InputError

if TYPE_CHECKING:
    from scenes.regression.results import Results
    from scenes.scene_files.scene import Scene

MARKER = "ideal_scene"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Adds the plugin's command-line options."""
    group = parser.getgroup("ideal-robot")
    group.addoption("--update-path-errors", action="store_true", help="write the path errors of the tests that are run "
                                                                       "as their new baselines")
    group.addoption("--no-path-error-cache", action="store_true", help="play every run, whether one like it is kept or "
                                                                        "not")


def pytest_configure(config: pytest.Config) -> None:
    """Registers the marker."""
    config.addinivalue_line("markers", f"{MARKER}(name, **changes): scene that the fixtures play, and keys to change")


@pytest.fixture
def ideal_scene(request: pytest.FixtureRequest) -> Scene:
    """The scene of the marker with its changes; a relative path starts from the test's folder."""
    from scenes.program import check_rooms

    marker = request.node.get_closest_marker(MARKER)
    if marker is None or not marker.args:
        pytest.fail(f'say which scene is played: @pytest.mark.{MARKER}("straight")', pytrace=False)
    name = str(marker.args[0])
    beside = request.path.parent / name
    try:
        check_rooms()
        from scenes.scene_file import load_scene

        scene = load_scene(beside if name.endswith(".toml") and beside.is_file() else name)
        return scene.changed(**marker.kwargs) if marker.kwargs else scene
    except InputError as error:
        message = str(error)
    # Outside of the exception's handling: within, pytest also shows the error and its causes.
    pytest.fail(message, pytrace=False)


@pytest.fixture
def path_error(request: pytest.FixtureRequest, ideal_scene: Scene) -> Callable[..., Results]:
    """Runs the marker's scene: ``path_error(seeds=…, method=…)`` gives the results, one row per seed."""
    from scenes.models import cache_folder
    from scenes.regression.results import Results

    cache = getattr(request.config, "cache", None)
    folder = cache_folder() / "pytest" if cache is None else Path(cache.mkdir("ideal_robot"))
    fresh = bool(request.config.getoption("--no-path-error-cache"))

    def played(*, seeds: Iterable[int] = (1,), method: str | None = None) -> Results:
        return Results.of([_answer(ideal_scene.changed(seed=seed), method, folder, fresh) for seed in seeds],
                          request.node.nodeid)

    return played


def _answer(scene: Scene, method: str | None, folder: Path, fresh: bool) -> dict[str, Any]:
    """A run's answer, from the cache where one of the same content is kept."""
    from ideal_robot.bounded_values import read_json
    from ideal_robot.results import plain
    from scenes.models import digest_of, identity
    from scenes.program import program
    from scenes.report.page import write_json
    from scenes.sweep import Job, play

    place = folder / f"{digest_of([program()['digest'], identity(scene), scene.model_dump(), method])}.json"
    if place.is_file() and not fresh:
        return dict(read_json(place, "a kept run"))
    answer: dict[str, Any] = plain(play(Job(scene, method, None, None)))
    write_json(place, answer)
    return answer


@pytest.fixture
def baseline(request: pytest.FixtureRequest) -> Callable[[Results], None]:
    """A check: ``baseline(results)`` fails the test where they are worse than the last accepted ones."""
    from scenes.regression.comparison import compared
    from scenes.regression.formats import markdown
    from scenes.regression.results import read_results

    name = re.sub(r"[^\w.-]+", "_", f"{request.path.stem}.{request.node.name}").strip("_")
    place = request.path.parent / "baselines" / f"{name}.json"

    def compare(results: Results) -> None:
        if request.config.getoption("--update-path-errors"):
            results.write(place)
            return
        if not place.is_file():
            pytest.fail(f"no baseline at {place}; pytest --update-path-errors writes it", pytrace=False)
        try:
            comparison = compared(read_results(place), results, title=request.node.nodeid)
            message = "" if comparison.verdict in ("better", "same") else markdown(comparison)
        except InputError as error:
            message = f"{error}; pytest --update-path-errors accepts these results"
        if message:
            pytest.fail(message, pytrace=False)

    return compare
