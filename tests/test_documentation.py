"""What the documentation names exists: files, modules, functions, verbs of the command line, links."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from typer.main import get_command

from docs.draw_architecture import trees
from scenes.cli import VERBS, app
from scenes.schema import keys_pages
from tests.sources import ROOT

PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
PACKAGES = ("ideal_robot", "sensing", "planning", "sim", "scenes", "studies")
FOLDERS = (*PACKAGES, "docs", "examples", "tests")
DATA = {"toml", "json", "html", "urdf", "md", "py"}
"""What a dotted name may end with that is a file."""


def defined(tree: ast.Module | ast.ClassDef) -> dict[str, ast.stmt]:
    """Names that a module or class defines, the ones it imports among them."""
    names: dict[str, ast.stmt] = {}
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names[node.name] = node
        elif isinstance(node, ast.Assign):
            names.update({target.id: node for target in node.targets if isinstance(target, ast.Name)})
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            names[node.target.id] = node
        elif isinstance(node, ast.ImportFrom | ast.Import):
            names.update({alias.asname or alias.name: node for alias in node.names})
    return names


def name_exists(dotted: str) -> bool:
    """Whether a dotted name is a package, a module, or something defined in one."""
    parts = dotted.split(".")
    here = ROOT
    while parts and (here / parts[0]).is_dir():
        here /= parts.pop(0)
    if parts and here.joinpath(parts[0] + ".py").is_file():
        file = here / (parts.pop(0) + ".py")
    else:
        file = here / "__init__.py"
    if not parts:
        return True
    tree: ast.Module | ast.stmt = ast.parse(file.read_text(encoding="utf-8")) if file.is_file() else ast.Module([], [])
    lazily = re.findall(r'"(\w+)"', file.read_text(encoding="utf-8")) if file.name == "__init__.py" else []
    if parts[0] in lazily:
        return True
    for part in parts:
        if not isinstance(tree, ast.Module | ast.ClassDef):
            return False
        member = defined(tree).get(part)
        if member is None:
            return False
        tree = member
    return True


def path_exists(path: str) -> bool:
    """Whether a path, perhaps with ``*``, is in the repository."""
    return any(ROOT.glob(path)) if "*" in path else (ROOT / path).exists()


@cache
def options(verb: str) -> frozenset[str]:
    """Options of a verb of the command line."""
    params = get_command(app).get_command(None, verb).params  # type: ignore[attr-defined]
    return frozenset(["--help", *(name for param in params for name in (*param.opts, *param.secondary_opts))])


def missing_options(text: str) -> list[str]:
    """Options in a page's commands that their verbs do not have."""
    commands = re.findall(r"(?:`|^ *)ideal-robot ([a-z-]+)((?:\\\n|[^`\n|#;&])*)", text, re.MULTILINE)
    return [f"ideal-robot {verb} {word}" for verb, words in commands if verb in VERBS
            for word in re.findall(r"(?<![\w./-])--?[a-z][a-z0-9-]*", words) if word not in options(verb)]


def missing_in(text: str, folder: Path) -> list[str]:
    """Files, dotted names and links of a page that are not there."""
    missing = [link for link in re.findall(r"\]\(([^)#:\s]+)(?:#[^)\s]*)?\)", text)
               if not (folder / link).exists() and link not in keys_pages()]
    code = re.findall(r"```.*?```", text, flags=re.DOTALL)
    spans = re.findall(r"`([^`\n]+)`", re.sub(r"```.*?```", "", text, flags=re.DOTALL))
    for span in [*spans, *code]:
        for path in re.findall(r"(?<![\w./-])(?:" + "|".join(FOLDERS) + r")/[\w*./-]*\w", span):
            missing += [] if path_exists(path) else [path]
        for dotted in re.findall(r"(?<![\w./-])(?:" + "|".join(PACKAGES) + r")(?:\.\w+)+", span):
            missing += [] if dotted.split(".")[-1] in DATA or name_exists(dotted) else [dotted]
        for module, names in re.findall(r"from ((?:" + "|".join(PACKAGES) + r")[\w.]*) import ([\w, ]+)", span):
            missing += [f"{module}.{name.strip()}" for name in names.split(",")
                        if not name_exists(f"{module}.{name.strip().split(' as ')[0]}")]
    for span in spans:
        if re.fullmatch(r"[\w-]+(/[\w-]+)+\.py", span) and not path_exists(span):
            missing.append(span)
        if re.fullmatch(r"\w+\.py", span) and not any(any((ROOT / folder).rglob(span)) for folder in FOLDERS):
            missing.append(span)
    verbs = re.findall(r"`ideal-robot ([a-z-]+)", text) + re.findall(r"^ *ideal-robot ([a-z-]+)", text, re.MULTILINE)
    missing += [f"ideal-robot {verb}" for verb in verbs if verb not in VERBS] + missing_options(text)
    return list(dict.fromkeys(missing))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_what_a_page_names_exists(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert missing_in(text, page.parent) == []


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda file: file.stem)
def test_what_a_notebook_tells_to_type_exists(notebook: Path) -> None:
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    text = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
    assert missing_in(text, notebook.parent) == []


def test_what_is_not_there_is_noticed() -> None:
    text = ("[a](nowhere.md) `sim/arm/arm.py` `sim/arm/legs.py` `sim.arm.arm.SimulatedArm.cycle` "
            "`sim.arm.arm.Leg` `a/b.py`")
    assert missing_in(text, ROOT) == ["nowhere.md", "sim/arm/legs.py", "sim.arm.arm.Leg", "a/b.py"]
    assert missing_in("`ideal-robot run line` `ideal-robot dance` `nowhere.py`", ROOT) == [
        "nowhere.py", "ideal-robot dance"]
    assert missing_in("`ideal-robot fetch emps -o there`\n\n```sh\nideal-robot run line \\\n  --spede 1 --seed 2\n```",
                      ROOT) == ["ideal-robot fetch -o", "ideal-robot run --spede"]


# Every public function with more than two parameters says of each what it is: shape and unit stand in ``Args``.
#
# The parameters of ``__init__`` stand in the docstring of the class. A method that fills in an interface may refer to
# it instead: ``See ``Feedforward.step``.`` What a parameter of the command line is stands in its ``help``, which the
# program shows; the docstring of its verb is the help's first paragraph.

PUBLIC = ("ideal_robot", "planning", "scenes", "sensing", "sim", "studies/strangers", "studies/sensors")
Function = ast.FunctionDef | ast.AsyncFunctionDef


def parameters(function: Function) -> list[str]:
    """Names of all parameters but ``self`` and ``cls``."""
    args = function.args
    every = [*args.posonlyargs, *args.args, *args.kwonlyargs, *filter(None, (args.vararg, args.kwarg))]
    return [arg.arg for arg in every if arg.arg not in ("self", "cls")]


def documented(docstring: str) -> set[str]:
    """Names that the section ``Args:`` has lines for; several may share one: ``q, qd: …``."""
    return named(docstring, "Args")


def named(docstring: str, section: str) -> set[str]:
    """Names that a section of a docstring, ``Args`` or ``Attributes``, has lines for."""
    found = re.search(rf"^{section}:\n((?:[ ]+.*\n|\n)*)", docstring + "\n", flags=re.MULTILINE)
    lines = re.findall(r"^ {4}([\w*][\w*, ]*):", found.group(1), flags=re.MULTILINE) if found else []
    return {name.strip().lstrip("*") for line in lines for name in line.split(",")}


SHARED = {target.id: node.value for tree in trees("scenes/commands").values() for node in tree.body
          if isinstance(node, ast.Assign) for target in node.targets if isinstance(target, ast.Name)}
"""Options whose annotations have names."""


def says(annotation: ast.expr) -> bool:
    """Whether an annotation, ``Annotated[…, typer.Option(help="…")]``, says what it is of."""
    return any(keyword.arg == "help" and (isinstance(keyword.value, ast.Call) or getattr(keyword.value, "value", ""))
               for call in ast.walk(SHARED.get(getattr(annotation, "id", ""), annotation)) if isinstance(call, ast.Call)
               for keyword in call.keywords)


def helped(function: Function) -> set[str]:
    """Names of the parameters whose annotations say what they are."""
    return {parameter.arg for parameter in (*function.args.args, *function.args.kwonlyargs)
            if parameter.annotation and says(parameter.annotation)}


def public(tree: ast.Module) -> Iterator[tuple[str, Function, str]]:
    """Public functions, and methods, with their docstrings; of ``__init__`` the class's."""
    for node in tree.body:
        if isinstance(node, Function) and not node.name.startswith("_"):
            yield node.name, node, ast.get_docstring(node) or ""
        elif isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            for method in node.body:
                if isinstance(method, Function) and (method.name in ("__init__", "__call__") or method.name[0] != "_"):
                    docstring = ast.get_docstring(node if method.name == "__init__" else method)
                    yield f"{node.name}.{method.name}", method, docstring or ""


@cache
def methods() -> set[str]:
    """``Class.method`` of all public methods."""
    return {name for folder in PUBLIC for tree in trees(folder).values() for name, _, _ in public(tree)}


def undocumented(folder: str) -> list[str]:
    """File, function and missing names of all functions that the rule is broken by."""
    lacking = []
    for path, tree in trees(folder).items():
        for name, function, docstring in public(tree):
            if any(getattr(mark, "id", "") == "overload" for mark in function.decorator_list):
                continue  # the implementation below says it for all
            names = parameters(function)
            interface = re.search(r"\b[Ss]ee ``([\w.]+)``", docstring)
            if len(names) <= 2 or (interface and interface.group(1) in methods() - {name}):
                continue
            missing = [parameter for parameter in names if parameter not in documented(docstring) | helped(function)]
            if missing:
                lacking.append(f"{path.relative_to(ROOT)}:{function.lineno} {name}: {', '.join(missing)}")
    return lacking


@pytest.mark.parametrize("folder", PUBLIC)
def test_parameters_are_described(folder: str) -> None:
    assert undocumented(folder) == []


# And a docstring says nothing of a parameter or field that is no longer there.

def fields_of(class_: ast.ClassDef) -> set[str]:
    """Names of annotated, assigned or computed attributes of a class, and of those that its ``__init__`` sets."""
    fields = {name.id for node in class_.body for target in (
        node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else [])
        for name in (target.elts if isinstance(target, ast.Tuple) else [target]) if isinstance(name, ast.Name)}
    fields |= {node.name for node in class_.body if isinstance(node, Function)}
    return fields | {node.attr for node in ast.walk(class_) if isinstance(node, ast.Attribute)
                     and isinstance(node.ctx, ast.Store) and getattr(node.value, "id", "") == "self"}


def outdated_in(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Line, and names in docstrings that the function has no parameter, or the class no field of."""
    for node in ast.walk(tree):
        docstring = (ast.get_docstring(node) or "") if isinstance(node, (Function, ast.ClassDef)) else ""
        if isinstance(node, Function):
            gone = named(docstring, "Args") - set(parameters(node))
        elif isinstance(node, ast.ClassDef):
            made = [method for method in node.body if isinstance(method, Function) and method.name == "__init__"]
            gone = named(docstring, "Args") - set(parameters(made[0])) if made else set()
            if not any(getattr(base, "id", "") not in ("ABC", "NamedTuple") for base in node.bases):
                gone |= named(docstring, "Attributes") - fields_of(node)
        else:
            continue
        if gone:
            yield node.lineno, f"{node.name}: {', '.join(sorted(gone))}"


@pytest.mark.parametrize("folder", [*PUBLIC, "studies"])
def test_docstrings_name_parameters_that_exist(folder: str) -> None:
    assert [f"{path.relative_to(ROOT)}:{line} {text}" for path, tree in trees(folder).items()
            for line, text in outdated_in(tree)] == []


def test_a_parameter_that_is_gone_is_noticed() -> None:
    text = """
def function(a, *, b):
    \"\"\"Does.

    Args:
        a, c: one of them is gone.
        b: stays.
    \"\"\"

class Record(NamedTuple):
    \"\"\"Holds.

    Attributes:
        x, y, z: one of them is gone.
    \"\"\"

    x: float
    z, other = 1.0, None
"""
    assert [words for _, words in outdated_in(ast.parse(text))] == ["function: c", "Record: y"]


def test_an_option_without_help_is_noticed() -> None:
    text = 'def command(a: Annotated[int, Option(help="cycles")], b: Annotated[int, Option()], c: int) -> None: ...'
    (function,) = ast.parse(text).body
    assert isinstance(function, Function)
    assert helped(function) == {"a"}


def test_every_option_of_an_object_of_options_has_help() -> None:
    options = [(node.name, field.target.id, field.annotation) for tree in trees("scenes/commands").values()
               for node in tree.body if isinstance(node, ast.ClassDef)
               for field in node.body if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)]
    assert len(options) > 100
    assert [(owner, name) for owner, name, annotation in options if not says(annotation)] == []
