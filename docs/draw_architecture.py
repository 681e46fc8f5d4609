"""Draws ``docs/pictures/architecture.svg`` from the imports: folders, their rooms, and who imports whom.

``python docs/draw_architecture.py`` writes the picture. An arrow leads from the one that imports to the one imported;
arrows that follow from others are left out, as are modules that stand beside the rooms and serve them all.
"""

from __future__ import annotations

import ast
import itertools
from collections.abc import Iterable, Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from html import escape
from pathlib import Path
from textwrap import wrap

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs" / "pictures" / "architecture.svg"
FOLDERS = ("ideal_robot", "sensing", "planning", "sim", "scenes")
FILLS = {"ideal_robot": "#e3edf7", "sensing": "#e6f3e6", "planning": "#fdf1dc", "sim": "#f3e6f0", "scenes": "#f0f0f0"}
BOX, GAP, ROW = (154, 62), 18, 44
"""Size of a room, distance beside it, and distance between layers [px]."""
PAD, HEAD = 16, 30
"""Border inside a folder and height of its name [px]."""
Graph = dict[str, set[str]]
"""For each name the names that it imports."""
Places = dict[str, tuple[float, float]]
"""Middle of each box [px]."""


def rooms(folder: str) -> list[str]:
    """Packages inside a folder, which are its rooms; the folder itself if it has none."""
    packages = sorted(path.parent.name for path in (ROOT / folder).glob("*/__init__.py"))
    return [f"{folder}.{name}" for name in packages] or [folder]


def room_of(module: str, known: set[str]) -> str | None:
    """The room that a module is in; None beside the rooms or outside the project."""
    parts = module.split(".")
    return next((name for name in (".".join(parts[:2]), parts[0]) if name in known), None)


@cache
def trees(folder: str) -> dict[Path, ast.Module]:
    """Files of a folder and what is in them, each read once."""
    return {path: ast.parse(path.read_text(encoding="utf-8")) for path in sorted((ROOT / folder).rglob("*.py"))}


def statements(node: ast.AST) -> Iterator[ast.AST]:
    """All statements inside a node, a tenth of what ``ast.walk`` goes through: expressions hold none."""
    for part in ("body", "handlers", "orelse", "finalbody", "cases"):
        for inner in getattr(node, part, ()):
            yield inner
            yield from statements(inner)


def _froms(folder: str) -> Iterator[tuple[Path, ast.ImportFrom]]:
    """``from … import`` of the files of a folder."""
    return ((path, node) for path, tree in trees(folder).items() for node in statements(tree)
            if isinstance(node, ast.ImportFrom))


def imports(folder: str) -> Graph:
    """Which rooms, of whatever folder, the rooms of a folder import."""
    known = {room for each in FOLDERS for room in rooms(each)}
    graph: Graph = {room: set() for room in rooms(folder)}
    for path, node in _froms(folder):
        here = room_of(".".join(path.relative_to(ROOT).with_suffix("").parts), known)
        if here is not None and node.module:
            modules = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
            graph[here] |= {room for room in (room_of(module, known) for module in modules) if room} - {here}
    return graph


def between_folders() -> Graph:
    """Which folders a folder imports, by its rooms or by its modules beside them."""
    graph: Graph = {}
    for folder in FOLDERS:
        named = {str(node.module).split(".")[0] for _, node in _froms(folder)}
        graph[folder] = (named & set(FOLDERS)) - {folder}
    return graph


def layers(graph: Graph) -> dict[str, int]:
    """How many imports lie below a name at most; raises ``ValueError`` where imports go in a circle."""
    sorter, depth = TopologicalSorter(graph), dict[str, int]()
    try:
        sorter.prepare()
    except CycleError as error:
        raise ValueError(f"imports go in a circle: {' → '.join(reversed(error.args[1]))}") from error
    while sorter:
        ready = sorter.get_ready()
        depth |= dict.fromkeys(ready, 1 + max(depth.values(), default=-1))
        sorter.done(*ready)
    return depth


def reduced(graph: Graph) -> Graph:
    """The graph without what follows from the rest of it."""
    reach: Graph = {}
    for name in sorted(graph, key=layers(graph).__getitem__):
        reach[name] = graph[name].union(*(reach[other] for other in graph[name]))
    return {name: {other for other in below if not any(other in reach[third] for third in below)}
            for name, below in graph.items()}


def structure() -> tuple[set[str], set[tuple[str, str]]]:
    """All rooms and all arrows of the picture."""
    drawn = {room for folder in FOLDERS for room in rooms(folder)}
    return drawn, {(name, other) for graph in (between_folders(), *map(_inside, FOLDERS))
                   for name, below in reduced(graph).items() for other in below}


def _inside(folder: str) -> Graph:
    graph = imports(folder)
    return {name: below & set(graph) for name, below in graph.items()}


def _arranged(graph: Graph) -> tuple[list[list[str]], dict[tuple[str, str], list[str]]]:
    """Names by layer from the top, each layer in an order with short arrows, and the names that each arrow passes."""
    depth = layers(graph)
    rows: list[list[str]] = [[] for _ in range(max(depth.values()) + 1)]
    for name in sorted(graph):
        rows[depth[name]].append(name)
    ways: dict[tuple[str, str], list[str]] = {}
    for name in sorted(graph):
        for other in sorted(graph[name]):
            bends = {layer: f"{name}>{other}@{layer}" for layer in range(depth[name] - 1, depth[other], -1)}
            for layer, bend in bends.items():
                rows[layer].append(bend)
            ways[name, other] = [name, *bends.values(), other]
    beside: Graph = {name: set() for row in rows for name in row}
    for way in ways.values():
        for upper, lower in itertools.pairwise(way):
            beside[upper].add(lower)
            beside[lower].add(upper)
    for sweep in range(24):
        order = range(1, len(rows)) if sweep % 2 == 0 else range(len(rows) - 2, -1, -1)
        for layer in order:
            near = rows[layer + (-1 if sweep % 2 == 0 else 1)]
            place = {name: i / max(len(near) - 1, 1) for i, name in enumerate(near)}
            where = {name: [place[other] for other in beside[name] if other in place] for name in rows[layer]}
            old = {name: i / max(len(rows[layer]) - 1, 1) for i, name in enumerate(rows[layer])}
            rows[layer].sort(key=lambda name: sum(where[name]) / len(where[name]) if where[name] else old[name])
    return rows[::-1], ways


class Panel:
    """A folder with its rooms, placed in its own coordinates.

    Args:
        folder: name of the folder.
    """

    def __init__(self, folder: str) -> None:
        self.folder = folder
        self.arrows = reduced(_inside(folder))
        rows, self.ways = _arranged(self.arrows)
        widths = [sum(self._width(name) + GAP for name in row) - GAP for row in rows]
        self.width = max(widths) + 2 * PAD
        self.height = HEAD + len(rows) * BOX[1] + (len(rows) - 1) * ROW + PAD
        self.places: Places = {}
        for i, (row, width) in enumerate(zip(rows, widths, strict=True)):
            x = 0.5 * (self.width - width)
            for name in row:
                self.places[name] = (x + 0.5 * self._width(name), HEAD + i * (BOX[1] + ROW) + 0.5 * BOX[1])
                x += self._width(name) + GAP

    @staticmethod
    def _width(name: str) -> float:
        return 12 if "@" in name else BOX[0]

    def draw(self, x0: float, y0: float) -> list[str]:
        """SVG elements with the panel's upper left corner at a place [px]."""
        parts = [f'<rect x="{x0:.0f}" y="{y0:.0f}" width="{self.width:.0f}" height="{self.height:.0f}" rx="10" '
                 f'fill="{FILLS[self.folder]}" stroke="#888"/>',
                 f'<text x="{x0 + PAD:.0f}" y="{y0 + 21:.0f}" class="folder">{self.folder}/</text>']
        for (start, end), way in sorted(self.ways.items()):
            points = [(x0 + self.places[name][0], y0 + self.places[name][1]) for name in way]
            parts.append(_arrow(start, end, points))
        for name in sorted(self.arrows):
            x, y = x0 + self.places[name][0] - 0.5 * BOX[0], y0 + self.places[name][1] - 0.5 * BOX[1]
            parts.append(_box(name, x, y))
        return parts


def _box(name: str, x: float, y: float) -> str:
    lines = wrap(_summary(name), 29, max_lines=3, placeholder=" …")
    text = "".join(f'<tspan x="{x + 8:.0f}" dy="11">{escape(line)}</tspan>' for line in lines)
    return (f'<g class="room" data-name="{name}"><rect x="{x:.0f}" y="{y:.0f}" width="{BOX[0]}" height="{BOX[1]}" '
            f'rx="5" fill="#fff" stroke="#555"/><text x="{x + 8:.0f}" y="{y + 17:.0f}" class="name">'
            f'{name.split(".")[-1]}</text><text x="{x + 8:.0f}" y="{y + 21:.0f}" class="about">{text}</text></g>')


def _summary(name: str) -> str:
    """First sentence of a package's docstring."""
    tree = ast.parse((ROOT / name.replace(".", "/") / "__init__.py").read_text(encoding="utf-8"))
    return (ast.get_docstring(tree) or "").split("\n")[0].split(". ")[0].rstrip(".")


def _arrow(start: str, end: str, points: list[tuple[float, float]], wide: bool = False) -> str:
    """A smooth arrow from box to box, through the points between."""
    first, last = points[0], points[-1]
    half = 0.0 if wide else 0.5 * BOX[1]
    y1, y2 = first[1] + half, last[1] - half
    path, here = f"M{first[0]:.0f},{y1:.0f}", (first[0], y1)
    for x, y in [*points[1:-1], (last[0], y2 - 7)]:
        # Through a layer straight down, between layers in an S.
        enter = y - (0.5 * BOX[1] if (x, y) in points[1:-1] else 0.0)
        bend = 0.5 * (enter - here[1])
        path += f" C{here[0]:.0f},{here[1] + bend:.0f} {x:.0f},{enter - bend:.0f} {x:.0f},{enter:.0f}"
        here = (x, enter)
        if (x, y) in points[1:-1]:
            path += f" L{x:.0f},{y + 0.5 * BOX[1]:.0f}"
            here = (x, y + 0.5 * BOX[1])
    look = "wide arrow" if wide else "arrow"
    return f'<path class="{look}" data-from="{start}" data-to="{end}" d="{path}" marker-end="url(#head)"/>'


def picture() -> str:
    """The whole picture as SVG."""
    graph = reduced(between_folders())
    rows, ways = _arranged(graph)
    panels = {folder: Panel(folder) for folder in FOLDERS}
    across = max(sum(panels[name].width + 3 * GAP for name in row if name in panels) for row in rows) - GAP
    y, corners = 60.0, {}
    bends: Places = {}
    for row in rows:
        names = [name for name in row if name in panels]
        free = across - sum(panels[name].width for name in names)
        x = free / (len(names) + 1)
        for name in names:
            corners[name] = (x, y)
            x += panels[name].width + free / (len(names) + 1)
        tallest = max(panels[name].height for name in names)
        for name in set(row) - set(names):
            bends[name] = (across - 2 * GAP, y + 0.5 * tallest)
        y += tallest + 56
    parts = []
    for (start, end), way in sorted(ways.items()):
        (x1, y1), (x2, y2) = corners[start], corners[end]
        a, b = panels[start], panels[end]
        # Where both lie above each other, straight down; else between their middles.
        left, right = max(x1, x2), min(x1 + a.width, x2 + b.width)
        straight = 0.5 * (left + right)
        top, foot = (straight, straight) if right - left > 40 else (x1 + 0.5 * a.width, x2 + 0.5 * b.width)
        parts.append(_arrow(start, end, [(top, y1 + a.height), *(bends[name] for name in way[1:-1]), (foot, y2)], True))
    for folder, (x, y0) in sorted(corners.items()):
        parts += panels[folder].draw(x, y0)
    return "\n".join([*_head(across, y), *parts, "</svg>", ""])


def _head(width: float, height: float) -> Iterable[str]:
    yield (f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height - 36:.0f}" '
           f'width="{width:.0f}" height="{height - 36:.0f}" font-family="Helvetica, Arial, sans-serif">')
    yield ("<style>.folder{font-size:15px;font-weight:bold}.name{font-size:13px;font-weight:bold}"
           ".about{font-size:9.5px;fill:#444}.arrow{fill:none;stroke:#456;stroke-width:1.3}"
           ".wide{stroke:#222;stroke-width:3}.title{font-size:13px;fill:#333}</style>")
    yield ('<defs><marker id="head" viewBox="0 0 8 8" refX="1" refY="4" markerWidth="7" markerHeight="7" '
           'markerUnits="userSpaceOnUse" orient="auto"><path d="M0,0 L8,4 L0,8 z" fill="#345"/></marker></defs>')
    yield f'<rect width="{width:.0f}" height="{height:.0f}" fill="#fff"/>'
    yield ('<text x="18" y="26" class="title">Folders and their rooms. An arrow leads from the one that imports to the '
           "one imported; what follows from other arrows is left out.</text>")


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")
    print(f"written: {PICTURE.relative_to(ROOT)}")
