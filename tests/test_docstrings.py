"""Every public function with more than two parameters says of each what it is: shape and unit stand in ``Args``.

The parameters of ``__init__`` stand in the docstring of the class. A method that fills in an interface may refer to
it instead: ``See ``Feedforward.step``.`` What a parameter of the command line is stands in its ``help``, which the
program shows; the docstring of its verb is the help's first paragraph.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache

import pytest

from tests.sources import ROOT, trees

FOLDERS = ("ideal_robot", "planning", "scenes", "sensing", "sim", "studies/strangers", "studies/sensors")
Function = ast.FunctionDef | ast.AsyncFunctionDef


def parameters(function: Function) -> list[str]:
    """Names of all parameters but ``self`` and ``cls``."""
    given = function.args
    every = [*given.posonlyargs, *given.args, *given.kwonlyargs, *filter(None, (given.vararg, given.kwarg))]
    return [one.arg for one in every if one.arg not in ("self", "cls")]


def documented(docstring: str) -> set[str]:
    """Names that the section ``Args:`` has lines for; several may share one: ``q, qd: …``."""
    section = re.search(r"^Args:\n((?:[ ]+.*\n|\n)*)", docstring + "\n", flags=re.MULTILINE)
    lines = re.findall(r"^ {4}([\w*, ]+):", section.group(1), flags=re.MULTILINE) if section else []
    return {name.strip().lstrip("*") for line in lines for name in line.split(",")}


SHARED = {target.id: node.value for tree in trees("scenes/commands").values() for node in tree.body
          if isinstance(node, ast.Assign) for target in node.targets if isinstance(target, ast.Name)}
"""Options whose annotations have names."""


def helped(function: Function) -> set[str]:
    """Names of the parameters whose annotation, ``Annotated[…, typer.Option(help="…")]``, says what they are."""
    return {one.arg for one in (*function.args.args, *function.args.kwonlyargs) if one.annotation
            for call in ast.walk(SHARED.get(getattr(one.annotation, "id", ""), one.annotation))
            if isinstance(call, ast.Call)
            for keyword in call.keywords if keyword.arg == "help"
            # A text, or a call that makes one of what is registered.
            and (isinstance(keyword.value, ast.Call) or getattr(keyword.value, "value", ""))}


def public(tree: ast.Module) -> Iterator[tuple[str, Function, str]]:
    """Public functions but overloads, and methods, with their docstrings; of ``__init__`` the class's."""
    for node in tree.body:
        if isinstance(node, Function) and any(ast.unparse(one) == "overload" for one in node.decorator_list):
            continue
        if isinstance(node, Function) and not node.name.startswith("_"):
            yield node.name, node, ast.get_docstring(node) or ""
        elif isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            for method in node.body:
                if isinstance(method, Function) and (method.name == "__init__" or not method.name.startswith("_")):
                    docstring = ast.get_docstring(node if method.name == "__init__" else method)
                    yield f"{node.name}.{method.name}", method, docstring or ""


@cache
def methods() -> set[str]:
    """``Class.method`` of all public methods."""
    return {name for folder in FOLDERS for tree in trees(folder).values() for name, _, _ in public(tree)}


def undocumented(folder: str) -> list[str]:
    """File, function and missing names of all functions that the rule is broken by."""
    found = []
    for path, tree in trees(folder).items():
        for name, function, docstring in public(tree):
            if any(getattr(mark, "id", "") == "overload" for mark in function.decorator_list):
                continue  # the implementation below says it for all
            names = parameters(function)
            interface = re.match(r"See ``([\w.]+)``", docstring)
            if len(names) <= 2 or (interface and interface.group(1) in methods() - {name}):
                continue
            missing = [parameter for parameter in names if parameter not in documented(docstring) | helped(function)]
            if missing:
                found.append(f"{path.relative_to(ROOT)}:{function.lineno} {name}: {', '.join(missing)}")
    return found


@pytest.mark.parametrize("folder", FOLDERS)
def test_parameters_are_described(folder: str) -> None:
    assert undocumented(folder) == []


def test_an_option_without_help_is_noticed() -> None:
    text = 'def command(a: Annotated[int, Option(help="cycles")], b: Annotated[int, Option()], c: int) -> None: ...'
    (function,) = ast.parse(text).body
    assert isinstance(function, Function)
    assert helped(function) == {"a"}
