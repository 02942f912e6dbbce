"""Small faults to put into the package one at a time: where they may stand, and a seeded sample.

The changes themselves are those of cosmic-ray. A fault is remembered by what its line says, not by
the line's number, so that a session goes on when the code around it has moved.
"""

import ast
import random
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("eoi_jax",)

# Rooms of the package: its folders; the files at its root are the ground.
ROOMS = {
    "command": "cli",
    "report": "report",
    "discovery": "discovery",
    "comparison": "comparison",
    "uncertainty": "uncertainty",
    "refinement": "refinement",
    "estimation": "estimation",
    "simulation": "simulation",
    "models": "models",
    "data": "data",
    "compiler": "compiler",
    "ground": "",
}
REST = "ground"
ROOM = {name: room for room, names in ROOMS.items() for name in names.split()}

# Only changes that still compute: the tool's others (a shift of floats, `is` of numbers) raise at
# once, and would flatter the score.
BINARY = {
    "Add": ("Sub",),
    "Sub": ("Add",),
    "Mul": ("Div",),
    "Div": ("Mul",),
    "FloorDiv": ("Mul",),
    "Mod": ("FloorDiv",),
    "Pow": ("Mul",),
    "BitOr": ("BitAnd",),
    "BitAnd": ("BitOr",),
}
COMPARISONS = {
    "Eq": ("NotEq",),
    "NotEq": ("Eq",),
    "Lt": ("LtE", "GtE"),
    "LtE": ("Lt", "Gt"),
    "Gt": ("GtE", "LtE"),
    "GtE": ("Gt", "Lt"),
    "Is": ("IsNot",),
    "IsNot": ("Is",),
}
OPERATORS = (
    *(f"core/ReplaceBinaryOperator_{a}_{b}" for a, to in BINARY.items() for b in to),
    *(f"core/ReplaceComparisonOperator_{a}_{b}" for a, to in COMPARISONS.items() for b in to),
    "core/ReplaceUnaryOperator_Delete_USub",
    "core/ReplaceUnaryOperator_Delete_Invert",
    "core/ReplaceUnaryOperator_Delete_Not",
    "core/AddNot",
    "core/ReplaceTrueWithFalse",
    "core/ReplaceFalseWithTrue",
    "core/ReplaceAndWithOr",
    "core/ReplaceOrWithAnd",
    "core/ReplaceBreakWithContinue",
    "core/ReplaceContinueWithBreak",
    "core/ExceptionReplacer",
    "core/NumberReplacer",
    "core/ZeroIterationForLoop",
)

# Looks of a figure: matters of taste, which no test should hold.
LOOKS = frozenset(
    (
        "figsize", "linewidth", "linewidths", "lw", "alpha", "fontsize", "s", "ms", "markersize",
        "rotation", "ncols", "nbins", "numticks", "length", "height", "width", "dpi", "capsize",
        "zorder", "pad", "labelpad",
    )
)  # fmt: skip


@dataclass(frozen=True)
class Fault:
    """One change of one line.

    Attributes:
        room, module: where; the module's path in the repository.
        definition: function or class around it, empty outside.
        line: what the line says.
        place: how many like it (same operator) stand before it on that line.
        repeat: which of the lines of the module that say the same.
        operator: of cosmic-ray.
    """

    room: str
    module: str
    definition: str
    line: str
    place: int
    repeat: int
    operator: str


@dataclass(frozen=True)
class Place:
    """Where a fault stands in today's file: the operator's occurrence, and lines (1-based)."""

    occurrence: int
    first: int
    last: int


def modules(root: Path) -> dict[str, list[Path]]:
    """Files of each room.

    Args:
        root: the repository.

    Returns:
        Sorted paths by room; a module that no room names is of the ground.
    """
    rooms: dict[str, list[Path]] = defaultdict(list)
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            parts = path.relative_to(root).with_suffix("").parts
            if path.stem not in ("__init__", "__main__"):
                rooms[ROOM.get(parts[1], REST)].append(path)
    return dict(rooms)


def _cannot_matter(node: Any, operator: str, in_report: bool) -> bool:
    """A type annotation, a decorator, an `assert`, `strict=` of `zip`, a figure's looks, a nudge.

    Assertions narrow types for the checker; `strict` says again what holds already; a nudge changes
    a constant of the module or a default, such as a count of trials, by a tenth or less.
    """
    child, parent = node, node.parent
    if node.type == "assert_stmt":
        return True
    if parent is not None and parent.type in ("parameters", "typedargslist", "lambdef"):
        return True  # the star of a signature, no product
    outside = parent is not None and (
        parent.search_ancestor("funcdef", "lambdef") is None
        or (parent.type == "param" and node is parent.default)
    )
    if outside and operator == "core/NumberReplacer" and abs(ast.literal_eval(node.value)) >= 10:
        return True
    while parent is not None:
        if parent.type in ("decorator", "assert_stmt", "tfpdef"):
            return True
        if parent.type == "annassign" and child is parent.children[1]:
            return True
        if parent.type == "funcdef" and child is parent.annotation:
            return True
        if parent.type == "param" and child is parent.annotation:
            return True
        if parent.type == "argument" and parent.children[1] == "=":
            name = parent.children[0].value
            if name == "strict" or (in_report and name in LOOKS):
                return True
        child, parent = parent, parent.parent
    return False


@cache
def _faults(text: str, module: str, room: str) -> dict[Fault, Place]:
    from cosmic_ray.ast import ast_nodes, get_ast  # pyright: ignore[reportMissingImports]
    from cosmic_ray.ast.ast_query import ASTQuery  # pyright: ignore[reportMissingImports]
    from cosmic_ray.plugins import get_operator  # pyright: ignore[reportMissingImports]

    nodes = list(ast_nodes(get_ast(text)))
    lines = text.splitlines()
    found: dict[Fault, Place] = {}
    for name in OPERATORS:
        operator = get_operator(name)()
        positions = ((node, *span) for node in nodes for span in operator.mutation_positions(node))
        before: dict[int, int] = defaultdict(int)
        for occurrence, (node, start, end) in enumerate(positions):
            row = start[0]
            place, before[row] = before[row], before[row] + 1
            if _cannot_matter(node, name, room == "report"):
                continue
            line = lines[row - 1]
            fault = Fault(
                room,
                module,
                ASTQuery(node).get_definition_name() or "",
                line.strip(),
                place,
                lines[: row - 1].count(line),
                name,
            )
            found[fault] = Place(occurrence, row, end[0])
    return found


def faults(path: Path, root: Path, room: str) -> dict[Fault, Place]:
    """Every fault that may be put into a file, and where it stands today."""
    return _faults(path.read_text(encoding="utf-8"), path.relative_to(root).as_posix(), room)


def sample(root: Path, count: int, seed: int) -> list[Fault]:
    """Faults drawn without replacement: as many of each room, every place in it as likely.

    Args:
        root: the repository.
        count: of all rooms together.
        seed: of the draw.

    Returns:
        Room by room in turn, so that any beginning of the list is a sample too.
    """
    drawn: list[list[Fault]] = []
    size = count // len(ROOMS)
    for room, paths in sorted(modules(root).items()):
        draw = random.Random(f"{seed} {room}")
        places: dict[tuple[str, int, int, str], list[Fault]] = defaultdict(list)
        for path in paths:
            for fault, where in faults(path, root, room).items():
                kind = fault.operator.split("_")[0]
                places[fault.module, where.first, fault.place, kind].append(fault)
        shuffled = draw.sample(sorted(places), len(places))
        chosen = (draw.choice(places[key]) for key in shuffled)
        drawn.append(list(islice((one for one in chosen if _compiles(root, one)), size)))
    return [fault for turn in zip(*drawn, strict=True) for fault in turn]


def _compiles(root: Path, fault: Fault) -> bool:
    """Whether Python takes it: `{*a}` for `{**a}` it does not."""
    changed = mutated((root / fault.module).read_text(encoding="utf-8"), fault)
    try:
        return changed is not None and bool(compile(changed[0], fault.module, "exec"))
    except SyntaxError:
        return False


def mutated(text: str, fault: Fault) -> tuple[str, Place] | None:
    """The module's text with the fault in it, and where; None where its line is no longer there."""
    from cosmic_ray.mutating import mutate_code  # pyright: ignore[reportMissingImports]
    from cosmic_ray.plugins import get_operator  # pyright: ignore[reportMissingImports]

    where = _faults(text, fault.module, fault.room).get(fault)
    if where is None:
        return None
    changed = mutate_code(text, get_operator(fault.operator)(), where.occurrence)
    return (changed, where) if changed is not None else None


def difference(text: str, changed: str) -> Iterator[tuple[str, str]]:
    """Lines that differ, before and after."""
    for before, after in zip(text.splitlines(), changed.splitlines(), strict=False):
        if before != after:
            yield before.strip(), after.strip()
