"""Who may import whom: the table of docs/architecture.md, checked on the code."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from functools import cache

import pytest

from docs.draw_architecture import PICTURE, layers, picture, reduced, statements, structure, trees
from tests.sources import ROOT

OURS = {"ideal_robot", "sensing", "planning", "sim", "scenes", "studies", "examples", "tests", "docs"}
IMPORTED_AS = {"dask[distributed]": "dask", "griffelib": "griffe", "opencv-python-headless": "cv2", "pin": "pinocchio",
               "import-linter": "importlinter", "pillow": "PIL", "rerun-sdk": "rerun", "franky-sim": "franky_sim",
               "airo-fanuc": "airo_fanuc", "abb-robot-client": "abb_robot_client", "ros-rclpy": "rclpy",
               "ros-sensor-msgs": "sensor_msgs", "ros-std-msgs": "std_msgs", "ros-geometry-msgs": "geometry_msgs",
               "ros-trajectory-msgs": "trajectory_msgs"}
"""Where a package's name is not its module's."""
PACKAGES = ("ideal_robot", "sensing", "planning", "sim", "scenes", "studies")
"""Where files import without circles, and at their top."""
IMPORTED_LATE = {"abb_robot_client", "airo_fanuc", "dartpy", "dask", "franky_sim", "geometry_msgs", "harvesters",
                 "importlib.metadata", "lz4", "matplotlib", "mujoco", "pandas", "pyarrow", "pylibfranka", "rclpy",
                 "rerun", "rosbags", "scipy.signal", "scipy.stats.qmc", "sensor_msgs", "std_msgs", "svgpathtools",
                 "trajectory_msgs", "trimesh", "viser"}
"""Heavy packages that few users need, or a process that leads an arm does not: imported where they are used."""
STARTS_FAST = ("scenes.commands.", "scenes.pytest_plugin.", "scenes.scene_file.")
"""The verbs import what they need when they are called, and a scene's file is looked for before what plays it is
loaded: ``ideal-robot --help`` must not load the whole program, nor may every pytest of a user's."""
RUN_NOT_IMPORTED = {"mypy", "pandas-stubs", "pytest-xdist", "ruff", "import-linter", "mkdocs-material",
                    "mkdocstrings[python]", "setuptools", "ipykernel", "ipywidgets", "jupyterlab", "RSIPI", "ur-rtde",
                    "ABBRobotEGM", "ros-rmw-fastrtps-cpp"}
"""Tools of development, counterparts in tests, that are started as programs, and what others load."""


@cache
def imports(tree: ast.AST) -> list[str]:
    """Full names of what is imported anywhere in a tree, whole modules and what is taken from them."""
    names = []
    for node in statements(tree):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    return names


def files() -> dict[str, ast.Module]:
    """Modules of all folders by their dotted names."""
    return {".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): tree
            for folder in PACKAGES for path, tree in trees(folder).items()}


def circle(graph: dict[str, set[str]]) -> list[str]:
    """One way from a file over its imports back to itself; empty if there is none."""
    done: set[str] = set()

    def visit(name: str, way: list[str]) -> list[str]:
        if name in way:
            return [*way[way.index(name) :], name]
        if name not in done:
            for other in sorted(graph[name]):
                if path := visit(other, [*way, name]):
                    return path
            done.add(name)
        return []

    return next((path for name in sorted(graph) if (path := visit(name, []))), [])


def test_no_file_imports_itself_over_others() -> None:
    """Also what is imported for types alone, or inside functions."""
    every, graph = files(), {}
    for name, tree in every.items():
        modules = {module if module in every else module.rpartition(".")[0] for module in imports(tree)}
        graph[name] = (modules & set(every)) - {name}
    assert " → ".join(circle(graph)) == ""
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == ["b", "c", "b"]


def test_imports_stand_at_the_top() -> None:
    late = []
    for name, tree in files().items():
        if f"{name}.".startswith(STARTS_FAST):
            continue
        functions = [node for node in statements(tree) if isinstance(node, ast.FunctionDef)]
        modules = {module for function in functions for module in imports(function)}
        if not any(isinstance(node, ast.FunctionDef) and node.name == "__getattr__" for node in tree.body):
            late += [f"{name}: {module}" for module in sorted(modules)
                     if not {module.split(".")[0], module} & IMPORTED_LATE]
    assert late == []


def third_party_imports() -> dict[str, str]:
    """Top-level modules that are neither ours nor Python's, each with a file that imports it."""
    importers: dict[str, str] = {}
    for folder in sorted(OURS):
        for path, tree in trees(folder).items():
            for name in {name.split(".")[0] for name in imports(tree)}:
                if name not in OURS and name not in sys.stdlib_module_names:
                    importers.setdefault(name, str(path.relative_to(ROOT)))
    return importers


def declared() -> set[str]:
    """Modules of the packages that pyproject.toml asks for, its tools left out."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    lines = [*project["dependencies"], *(line for group in project["optional-dependencies"].values() for line in group)]
    names = {re.split(r"[<>=~! ]", line)[0] for line in lines}
    return {IMPORTED_AS.get(name, name) for name in names - RUN_NOT_IMPORTED}


def test_what_is_imported_is_declared_and_the_other_way_round() -> None:
    imported = third_party_imports()
    undeclared = {name: file for name, file in imported.items() if name not in declared()}
    assert not undeclared, "imported, but not in pyproject.toml"
    assert declared() <= set(imported), "in pyproject.toml, but imported nowhere"


PHYSICS = ("ideal_robot/loop", "ideal_robot/feedforward", "ideal_robot/friction", "ideal_robot/dynamics",
           "ideal_robot/model", "ideal_robot/elasticity", "ideal_robot/execution", "planning/path")
"""Folders whose numerical tolerances stand in one table."""
TINY = 1e-5
"""Below this a named number is a tolerance: no unit of these folders makes anything that an arm shows so small."""


def named_numbers(tree: ast.Module) -> dict[str, list[float]]:
    """Numbers in the values of a module's names in capitals."""
    return {ast.unparse(node.targets[0]): [number.value for number in ast.walk(node.value) if isinstance(
        number, ast.Constant) and isinstance(number.value, float)]
            for node in tree.body if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]).isupper()}


def test_numerical_tolerances_stand_in_one_table() -> None:
    own = {f"{path.name}: {name}" for folder in PHYSICS for path, tree in trees(folder).items()
           for name, numbers in named_numbers(tree).items() if any(0.0 < abs(number) < TINY for number in numbers)}
    assert not own, f"to ideal_robot/tolerances.py: {sorted(own)}"
    table = named_numbers(trees("ideal_robot")[ROOT / "ideal_robot" / "tolerances.py"])
    used = {name.rpartition(".")[2] for tree in files().values() for name in imports(tree)
            if name.startswith("ideal_robot.tolerances.")}
    assert len(table) > 10
    assert set(table) == used


def test_importing_the_packages_is_cheap() -> None:
    """Importing a package must not pull in plotting, PyBullet or the command line."""
    program = (
        "import sys, ideal_robot, sensing, planning, sim, scenes;"
        "heavy = {'matplotlib', 'pybullet', 'typer', 'numba', 'cv2', 'pandas', 'cvxpy'} & set(sys.modules);"
        "raise SystemExit(f'imported: {heavy}' if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


# The picture of the architecture is what its generator draws from today's imports.

def drawn(svg: str) -> tuple[set[str], set[tuple[str, str]]]:
    """Rooms and arrows of a picture."""
    boxes = re.findall(r'class="room" data-name="([\w.]+)"', svg)
    arrows = re.findall(r'data-from="([\w.]+)" data-to="([\w.]+)"', svg)
    assert len(boxes) == len(set(boxes))
    return set(boxes), set(arrows)


def test_the_committed_picture_is_up_to_date() -> None:
    """Where this fails: ``python docs/draw_architecture.py``."""
    assert drawn(PICTURE.read_text(encoding="utf-8")) == drawn(picture()) == structure()


def test_circles_are_named() -> None:
    with pytest.raises(ValueError, match="a → b → a"):
        layers({"a": {"b"}, "b": {"a"}})


def test_what_follows_from_other_arrows_is_left_out() -> None:
    assert reduced({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == {"a": {"b"}, "b": {"c"}, "c": set()}
