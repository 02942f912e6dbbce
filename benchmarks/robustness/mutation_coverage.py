"""Which test file runs which lines of the package: taken once, and again for a file that changed.

A line is known by what it says, so that the map outlives moves of code.
"""

import ast
import hashlib
import json
import os
import re
import subprocess
import sys
import time
from collections import defaultdict
from functools import cache
from pathlib import Path

from benchmarks.robustness.mutation_faults import PACKAGES

LIMIT = 1200.0  # [s] of one test file under measurement
USUAL = 60.0  # [s] of one that was not measured


class CoverageMap:
    """Lines inside functions that each test file ran, its time, and whether it passed.

    Args:
        root: copy of the repository that is run.
        path: JSON file that keeps the map.
    """

    def __init__(self, root: Path, path: Path):
        self.root, self.path = root, path
        known = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
        self.entries: dict[str, dict] = {
            file: entry for file, entry in known.items() if (root / file).exists()
        }

    def files(self) -> list[str]:
        """Every test file of the copy."""
        found = (self.root / "tests").rglob("test_*.py")
        return sorted(path.relative_to(self.root).as_posix() for path in found)

    def update(self) -> None:
        """Measure the files that are new or have changed."""
        for file in self.files():
            digest = hashlib.sha256((self.root / file).read_bytes()).hexdigest()[:16]
            if self.entries.get(file, {}).get("digest") != digest:
                self.entries[file] = {"digest": digest, **self._measured(file)}
                self.path.write_text(json.dumps(self.entries), encoding="utf-8")

    def _measured(self, file: str) -> dict:
        folder = self.path.parent / "coverage" / file.replace("/", "-")
        folder.mkdir(parents=True, exist_ok=True)
        sources = "\n    ".join(str(self.root / name) for name in PACKAGES)
        (folder / "rc").write_text(
            f"[run]\nsource =\n    {sources}\npatch = subprocess\nparallel = true\n"
            f"data_file = {folder / 'data'}\n",
            encoding="utf-8",
        )
        command = [sys.executable, "-m", "coverage", "run", f"--rcfile={folder / 'rc'}", "-m"]
        command += ["pytest", "-q", "-n", "0", "-p", "no:cacheprovider", file]
        start = time.monotonic()
        try:
            done = subprocess.run(
                command,
                cwd=self.root,
                env=environment(self.root),
                capture_output=True,
                timeout=LIMIT,
            )
            passes = done.returncode in (0, 5)
        except subprocess.TimeoutExpired:
            passes = False
        return {
            "seconds": round(time.monotonic() - start, 1),
            "passes": passes,
            "rows": rows_run(self.root, folder),
        }

    def ranked(self, module: str, text: str, first: int, last: int) -> list[str]:
        """Test files that may notice a change of some lines, the likeliest and quickest first.

        Args:
            module: path of the changed file in the repository.
            text: what it says without the change.
            first, last: lines of the change, from 1.

        Returns:
            Paths of test files that pass without it, or were not measured.
        """
        known = self.entries
        inside, rows, names = statement(text, first, last)
        lines = text.splitlines()
        touched = {lines[row - 1].strip() for row in rows}
        pattern = re.compile("|".join(rf"\b{re.escape(name)}\b" for name in names) or "(?!)")
        weights = {file: self._unknown(file, module) for file in self.files() if file not in known}
        most = max((len(entry["rows"].get(module, ())) for entry in known.values()), default=0)
        for file, entry in known.items():
            if not entry["passes"]:
                continue
            ran = entry["rows"].get(module, ())
            if inside:
                reached = not touched.isdisjoint(ran)
            else:
                reached = any(
                    pattern.search(row) for part in entry["rows"].values() for row in part
                )
            if reached:
                share = 0.05 + len(ran) / (most + 1)
                weights[file] = (1 + 9 * _beside(file, module)) * share / entry["seconds"] ** 0.5
        if not weights and not inside:
            weights = {file: 1.0 / entry["seconds"] for file, entry in known.items()}
        return sorted(weights, key=lambda file: -weights[file])

    def _unknown(self, file: str, module: str) -> float:
        """Weight of a file that was not measured: it may run anything."""
        return (1 + 9 * _beside(file, module)) * 0.2 / USUAL**0.5

    def seconds(self, file: str) -> float:
        """Time of a file without a fault [s]."""
        return self.entries[file]["seconds"] if file in self.entries else USUAL


def _beside(file: str, module: str) -> bool:
    return Path(module).stem in Path(file).stem


def environment(root: Path) -> dict[str, str]:
    """Variables of a process that runs the tests of a copy."""
    variables = {
        key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"
    }
    return variables | {
        "PYTHONPATH": str(root),
        "PYTHONPYCACHEPREFIX": str(root.parent / "bytecode"),
        "EOI_CACHE": str(root.parent / "cache"),
    }


@cache
def _function_rows(text: str) -> frozenset[int]:
    """Rows of the bodies of functions, those of nested ones too."""
    return frozenset(
        row
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        for row in range(node.body[0].lineno, (node.end_lineno or node.lineno) + 1)
    )


def rows_run(root: Path, folder: Path) -> dict[str, list[str]]:
    """What the rows inside functions say that ran, by module."""
    from coverage import CoverageData  # pyright: ignore[reportMissingImports]

    rows: dict[str, set[str]] = defaultdict(set)
    for path in sorted(folder.glob("data*")):
        data = CoverageData(str(path))
        data.read()
        for name in (one for one in data.measured_files() if one.endswith(".py")):
            text = Path(name).read_text(encoding="utf-8")
            inside, lines = _function_rows(text), text.splitlines()
            module = Path(name).relative_to(root).as_posix()
            rows[module] |= {
                lines[row - 1].strip()
                for row in data.lines(name) or ()
                if row in inside and row <= len(lines)
            }
    return {module: sorted(part) for module, part in rows.items() if part}


def statement(text: str, first: int, last: int) -> tuple[bool, range, tuple[str, ...]]:
    """The innermost statement around a change.

    Args:
        text: of the module.
        first, last: lines of the change, from 1.

    Returns:
        Whether it runs when a function is called (else when the module is imported); its rows, of
        a compound statement those of its head; the names that it gives something to, with those of
        the function or class that it heads or stands in.
    """
    rows, names, inside = range(first, last + 1), list[str](), False

    def visit(node: ast.AST, called: bool, owner: str) -> None:
        nonlocal rows, names, inside
        for child in ast.iter_child_nodes(node):
            below, named = called, owner
            if isinstance(child, ast.stmt):
                start, end = _rows(child)
                if not start <= first <= end:
                    continue
                body = getattr(child, "body", None)
                in_head = bool(body) and first < body[0].lineno
                rows = range(start, (body[0].lineno if body and in_head else end + 1))
                inside = called
                if isinstance(child, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                    named = child.name
                    below = called or not (in_head or isinstance(child, ast.ClassDef))
                    names = [named]
                else:
                    names = [owner, *_targets(child)]
            visit(child, below, named)

    visit(ast.parse(text), False, "")
    return inside, rows, tuple(name for name in names if name)


def _rows(node: ast.stmt) -> tuple[int, int]:
    """First and last row, decorators included."""
    decorators = getattr(node, "decorator_list", ())
    return min([node.lineno, *(one.lineno for one in decorators)]), node.end_lineno or node.lineno


def _targets(node: ast.AST) -> list[str]:
    """Names that a statement gives something to."""
    return [
        part.id
        for part in ast.walk(node)
        if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store)
    ]
