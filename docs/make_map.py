"""Draw the map of the rooms, docs/images/rooms.svg, from the imports under src/vergence.

    python docs/make_map.py

A room is a folder of src/vergence, or a file beside the folders; the files that stand at the very
bottom share one box. A room stands above all rooms that it imports. Arrows that follow from others
are left out: who may import a room, may import what that one imports.
"""

from __future__ import annotations

import ast
import itertools
from pathlib import Path

SOURCES = Path(__file__).parents[1] / "src" / "vergence"
PICTURE = Path(__file__).parent / "images" / "rooms.svg"
HEAVY = ("mujoco", "rerun", "matplotlib", "rich", "tyro")
"""What the core must do without; a room from which one of them can be reached is outside it."""
GROUND = "ground"

BOX_W, BOX_H, STEP_X, STEP_Y, MARGIN = 124, 42, 150, 88, 24
FILL = {"core": "#e3eefb", "twin": "#fbe9d7", "outside": "#ececec"}
MEANING = {
    "core": "the core: runs on any head, cannot see the truth",
    "twin": "the twin: plays the hardware, alone imports MuJoCo",
    "outside": "the outside: experiments, recordings, commands",
}

Graph = dict[str, set[str]]


def room_of(path: Path) -> str:
    """Return the room in which a source file lies."""
    parts = path.relative_to(SOURCES).parts
    return parts[0] if len(parts) > 1 else path.stem


def imports(sources: Path = SOURCES) -> tuple[Graph, Graph]:
    """Return by room which rooms it imports, and which of HEAVY; lazy imports count too."""
    rooms: Graph = {}
    heavy: Graph = {}
    files = [path for path in sorted(sources.rglob("*.py")) if path != sources / "__init__.py"]
    known = {room_of(path) for path in files}
    for path in files:
        room = room_of(path)
        rooms.setdefault(room, set())
        heavy.setdefault(room, set())
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names: list[str] = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module:
                names = [f"{node.module}.{alias.name}" for alias in node.names]
            for first, *rest in (name.split(".") for name in names):
                if first == "vergence" and rest and rest[0] in known - {room}:
                    rooms[room].add(rest[0])
                if first in HEAVY:
                    heavy[room].add(first)
    return rooms, heavy


def with_ground(rooms: Graph) -> tuple[Graph, list[str]]:
    """Return the rooms with the single files at the bottom as one, and the names of these files."""
    ground = {
        room
        for room, below in rooms.items()
        if not (SOURCES / room).is_dir()
        and all(not (SOURCES / other).is_dir() for other in reachable(rooms, room))
    }
    joined = {
        room: {GROUND if other in ground else other for other in below}
        for room, below in rooms.items()
        if room not in ground
    }
    return {GROUND: set(), **joined}, sorted(ground)


def reachable(rooms: Graph, start: str) -> set[str]:
    """Return the rooms that a room imports, directly or through others."""
    found: set[str] = set()
    waiting = [start]
    while waiting:
        for room in rooms[waiting.pop()] - found:
            found.add(room)
            waiting.append(room)
    return found


def reduced(rooms: Graph) -> Graph:
    """Return the imports without those that follow from others."""
    return {
        room: {
            other
            for other in below
            if not any(other in reachable(rooms, third) for third in below - {other})
        }
        for room, below in rooms.items()
    }


def levels(rooms: Graph) -> dict[str, int]:
    """Return how high each room stands: one above the highest room that it imports.

    Raises:
        ValueError: rooms import each other in a circle.
    """
    circle = sorted(room for room in rooms if room in reachable(rooms, room))
    if circle:
        raise ValueError(f"these rooms import each other in a circle: {', '.join(circle)}")
    found: dict[str, int] = {}
    while len(found) < len(rooms):
        for room, below in rooms.items():
            if room not in found and below <= set(found):
                found[room] = max((found[other] + 1 for other in below), default=0)
    return found


Node = tuple[str, ...]
"""(room,), or where an arrow passes a level: (upper room, lower room, level)."""


def laid_out(arrows: Graph, level: dict[str, int]) -> tuple[list[list[Node]], list[list[Node]]]:
    """Return the nodes of each level from left to right, and the arrows as chains of nodes."""
    rows: list[list[Node]] = [[] for _ in range(max(level.values()) + 1)]
    for room in sorted(level):
        rows[level[room]].append((room,))
    chains = []
    for upper in sorted(arrows):
        for lower in sorted(arrows[upper]):
            between = range(level[upper] - 1, level[lower], -1)
            passing: list[Node] = [(upper, lower, str(k)) for k in between]
            for node, k in zip(passing, between, strict=True):
                rows[k].append(node)
            chains.append([(upper,), *passing, (lower,)])
    links = [pair for chain in chains for pair in itertools.pairwise(chain)]
    for sweep in range(24):  # each node towards the mean of its neighbours below, then above
        place = {node: k - len(row) / 2 for row in rows for k, node in enumerate(row)}
        own, other = (0, 1) if sweep % 2 == 0 else (1, 0)
        for row in rows if sweep % 2 == 0 else reversed(rows):
            near = {
                node: [place[link[other]] for link in links if link[own] == node] for node in row
            }
            row.sort(
                key=lambda node: (
                    sum(near[node]) / len(near[node]) if near[node] else place[node],
                    node,
                )
            )
            place.update({node: k - len(row) / 2 for k, node in enumerate(row)})
    return rows, chains


def kinds(rooms: Graph, heavy: Graph) -> dict[str, str]:
    """Return by room whether it is of the core, the twin or the outside."""
    found = {}
    for room in rooms:
        below = {room} | reachable(rooms, room)
        outside = any(heavy.get(other) for other in below)
        found[room] = (
            "twin" if "mujoco" in heavy.get(room, ()) else "outside" if outside else "core"
        )
    return found


def drawing() -> str:
    """Return the map as SVG."""
    every, heavy = imports()
    rooms, ground = with_ground(every)
    kind = kinds(rooms, heavy)
    rows, chains = laid_out(reduced(rooms), levels(rooms))
    width = 2 * MARGIN + STEP_X * max(map(len, rows))
    height = 2 * MARGIN + STEP_Y * len(rows) + 3 * 22
    at = {
        node: (
            width / 2 + STEP_X * (k - (len(row) - 1) / 2),
            height - 3 * 22 - MARGIN - STEP_Y * (level + 0.5),
        )
        for level, row in enumerate(rows)
        for k, node in enumerate(row)
    }
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
        f'width="{width}" height="{height}" font-family="sans-serif" text-anchor="middle">',
        f'<rect width="{width}" height="{height}" fill="white"/>',
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" '
        'markerHeight="7" orient="auto"><path d="M0 0 8 4 0 8z" fill="#555"/></marker></defs>',
        '<g fill="none" stroke="#777" stroke-width="1.2">',
    ]
    lines += [_arrow([at[node] for node in chain]) for chain in chains]
    lines.append("</g>")
    for row in rows:
        for node in row:
            if len(node) == 1:
                small = ground if node[0] == GROUND else sorted(heavy.get(node[0], ()))
                lines += _box(node[0], small, kind[node[0]], *at[node])
    for k, (name, text) in enumerate(MEANING.items()):
        y = height - MARGIN - 22 * (2 - k)
        lines.append(
            f'<rect x="{MARGIN}" y="{y - 11}" width="22" height="14" fill="{FILL[name]}" '
            f'stroke="#555"/><text x="{MARGIN + 30}" y="{y}" font-size="13" '
            f'text-anchor="start">{text}</text>'
        )
    return "\n".join([*lines, "</svg>"]) + "\n"


def _arrow(points: list[tuple[float, float]]) -> str:
    """Return an arrow from the lower edge of the first point's box to the last one's upper edge."""
    (x, y), *rest = points
    path = f"M{x:.0f} {y + BOX_H / 2:.0f}"
    y += BOX_H / 2
    for k, (next_x, next_y) in enumerate(rest):
        last = k == len(rest) - 1
        top = next_y - BOX_H / 2
        bend = (top - y) / 2
        path += f"C{x:.0f} {y + bend:.0f} {next_x:.0f} {top - bend:.0f} {next_x:.0f} {top:.0f}"
        x, y = next_x, top if last else next_y + BOX_H / 2
        path += "" if last else f"V{y:.0f}"
    return f'<path d="{path}" marker-end="url(#tip)"/>'


def _box(room: str, small: list[str], kind: str, x: float, y: float) -> list[str]:
    """Return a box with a room's name, and in small type what it imports of HEAVY."""
    width = max(BOX_W, 7 * len(" ".join(small)) + 20)
    lines = [
        f'<rect x="{x - width / 2:.0f}" y="{y - BOX_H / 2:.0f}" width="{width}" height="{BOX_H}" '
        f'rx="5" fill="{FILL[kind]}" stroke="#555"/>'
    ]
    name_y = y + 5 if not small else y - 2
    lines.append(f'<text x="{x:.0f}" y="{name_y:.0f}" font-size="15">{room}</text>')
    if small:
        text = " ".join(small)
        lines.append(f'<text x="{x:.0f}" y="{y + 14:.0f}" font-size="11" fill="#555">{text}</text>')
    return lines


if __name__ == "__main__":
    PICTURE.write_text(drawing(), encoding="utf-8")
