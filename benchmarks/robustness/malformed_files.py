"""Malformed and foreign files: one sentence, nothing executed, nothing half-written, in bounds.

python benchmarks/robustness/malformed_files.py [--quick] [--write]

Every file of `malformed_cases.py` is read in a process of its own, as the library reads it and,
every third time and for all configs, as the command does. Wrong is: any exception but ValueError,
a death, an event that Python's audit reports of running, importing or writing elsewhere, more than
`MEMORY` or `SECONDS`, from the command another status than 0, 1 or 2, an error that it did not
foresee, or anything left beside a whole answer.
"""

import contextlib
import gc
import json
import os
import pickle
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
import eoi_jax as eoi
from benchmarks.common import ROOT, Report, table
from benchmarks.robustness import malformed_cases
from benchmarks.robustness.malformed_cases import Case
from eoi_jax._checks import FigureWarning, RecordWarning

MEMORY = 2.0e9  # [bytes] above what the process has before
SECONDS = 60.0  # of processor time
EVERY = 3  # files go to the command, too
# Beginnings of what Python's audit reports where something is run that no reader has to run.
FORBIDDEN = (
    "os.system", "os.exec", "os.posix_spawn", "os.spawn", "os.fork", "socket.",
    "pickle.find_class", "webbrowser.open", "urllib.Request",
)  # fmt: skip
START = (sys.executable, "-c", "from eoi_jax.cli.main import main; main()")


@dataclass
class Outcome:
    """What one file showed.

    Attributes:
        said: the exception's sentence; empty where the file was read.
        wrong: what must not be, in words.
        memory: the most above the beginning [bytes].
        seconds: of processor time.
    """

    said: str = ""
    wrong: list[str] = field(default_factory=list)
    memory: float = 0.0
    seconds: float = 0.0


def use(case: Case, path: Path) -> None:
    """Read a file as the library does, and look at what comes of it."""
    if case.use == "result":
        str(eoi.load(path))
    elif case.use == "data":
        read(case, path)
    elif case.use == "config":
        from eoi_jax.cli import config, run_folder

        run_folder.job(config.load(path), path.parent, None)
    else:
        from eoi_jax.cli.exports import export
        from eoi_jax.cli.html_report import write_report

        try:
            write_report(path.parent)
        finally:
            export(path.parent, None, path.parent / "model.json")


def read(case: Case, path: Path) -> None:
    """Inspect a table, read its first columns, and draft a config for it."""
    from eoi_jax.cli.template import draft
    from eoi_jax.data.readers.read_record import read_table

    table = read_table(path, case.max_gigabytes)
    names = list(table.columns)
    found = None
    with contextlib.suppress(ValueError):
        found = eoi.inspect(path, case.max_gigabytes)
        str(found.summary())
        str(found)
        draft([found], path.with_suffix(".toml"))
    for name in names[:6]:
        if not name.isprintable():
            raise AssertionError(f"{name!r} would reach a terminal")
        with contextlib.suppress(ValueError):
            eoi.read_record(path, names[0], names[1:2], [name], max_gigabytes=case.max_gigabytes)


def apart(case: Case, path: Path, work: Callable[[Case, Path], None]) -> Outcome:
    """Do it in a process of its own, watched."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        outcome = watched(case, path, work)
        with os.fdopen(writing, "wb") as stream:
            pickle.dump(outcome, stream)
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb") as stream:
        data = stream.read()
    _, status, usage = os.wait4(child, 0)
    if not data:
        ended = os.waitstatus_to_exitcode(status)
        return Outcome(wrong=[f"died: {signal.Signals(-ended).name if ended < 0 else ended}"],
                       seconds=usage.ru_utime + usage.ru_stime)  # fmt: skip
    return pickle.loads(data)


def watched(case: Case, path: Path, work: Callable[[Case, Path], None]) -> Outcome:
    """Do it, and say what happened."""
    outcome = Outcome()
    resource.setrlimit(resource.RLIMIT_CPU, (int(SECONDS), int(SECONDS) + 5))
    before = _peak()
    with open(os.devnull, "w") as nowhere, contextlib.redirect_stderr(nowhere):
        sys.addaudithook(lambda event, _: outcome.wrong.append(event)
                         if event.startswith(FORBIDDEN) else None)  # fmt: skip
        try:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                work(case, path)
            loud = [one for one in caught if one.category not in (RecordWarning, FigureWarning)]
            outcome.wrong += [f"{one.category.__name__}: {one.message}" for one in loud]
        except ValueError as error:
            outcome.said = str(error)
            if type(error) is not ValueError:
                outcome.wrong.append(f"{type(error).__name__}: {error}")
        except BaseException as error:  # what must not happen is counted
            outcome.wrong.append(f"{type(error).__name__}: {error}")
    outcome.memory = _peak() - before
    outcome.seconds = time.process_time()
    if outcome.memory > MEMORY:
        outcome.wrong.append(f"{outcome.memory / 1e9:.1f} GB")
    return outcome


def _peak() -> float:
    return 1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def command(case: Case, path: Path) -> None:
    """Read a file as the command does."""
    from typer.testing import CliRunner

    from eoi_jax.cli.commands import app

    top = path.parent.parent if case.use == "run" else path.parent
    output = str(top / "runs")
    words = {
        "data": ["inspect", str(path), "--output", output],
        "config": ["identify", str(path), "--output", output, "--passes", "1"],
        "result": ["export", str(path), "--language", "c", "--output", str(top / "model.c")],
        "run": ["report", str(path.parent)],
    }[case.use]
    before = _listed(top)
    done = CliRunner().invoke(app, [*words, "--json"])
    assert done.exit_code in (0, 1, 2), f"status {done.exit_code}: {done.exception!r}"
    assert isinstance(done.exception, SystemExit | None), repr(done.exception)
    assert "internal error" not in done.stderr, done.stderr[:400]
    assert all(one.isprintable() or one in "\n\t" for one in done.stderr), repr(done.stderr[:400])
    json.loads(done.stdout)
    more = _listed(top) - before
    assert not (done.exit_code == 2 and more), f"left {sorted(more)}"
    assert not any(".draft" in one for one in more), f"left {sorted(more)}"


def _listed(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def tried(case: Case, number: int, run: Path, place: Path) -> Outcome:
    """One file: made, read, taken away."""
    folder = place / "case"
    folder.mkdir()
    if case.use == "run":
        shutil.copytree(run, folder / "run")
    path = folder / case.file
    case.make(path)
    before = _listed(folder)
    outcome = apart(case, path, use)
    known = before | ({"run/model.json", "run/report.html"} if case.use == "run" else set())
    more = _listed(folder) - known
    outcome.wrong += [f"left {sorted(more)}"] if more else []
    if number % EVERY == 0 or case.use == "config":
        second = apart(case, path, command)
        outcome.wrong += [f"the command: {one}" for one in (second.said, *second.wrong) if one]
    shutil.rmtree(folder)
    return outcome


def prepared(place: Path) -> Path:
    """A run, and its model as JSON beside it; made elsewhere, so that JAX does not run here."""
    (place / "rig.toml").write_text(malformed_cases.CONFIG)
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "EOI_CACHE": str(place / "cache")}
    for words in (["identify", "rig.toml"], ["export", "runs/rig", "--output", "model.json"]):
        subprocess.run([*START, *words, "--quiet"], cwd=place, env=environment, check=True,
                       stdout=subprocess.DEVNULL)  # fmt: skip
    return place / "runs" / "rig"


def warm(place: Path) -> None:
    """Load here what every process would have to load: readers, figures, the command."""
    folder = place / "warm"
    folder.mkdir()
    for suffix, data in malformed_cases.bases(folder).items():
        path = folder / f"run{suffix}"
        path.write_bytes(data)
        read(Case("", "", path.name, malformed_cases.content(data)), path)
    command(Case("", "", path.name, malformed_cases.content(data)), path)
    shutil.rmtree(folder)
    gc.freeze()


def campaign(quick: bool, seen: Callable[[Case, Outcome], Any]) -> None:
    """All files.

    Args:
        quick: a tenth of them.
        seen: gets every file and its outcome.
    """
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        run = prepared(place)
        stored, model = (run / "result.npz").read_bytes(), (place / "model.json").read_bytes()
        warm(place)
        chosen = list(malformed_cases.cases(place, stored, model))
        if quick:
            chosen = random.Random(0).sample(chosen, len(chosen) // 10)
        for number, case in enumerate(chosen):
            seen(case, tried(case, number, run, place))
            if number % 50 == 49:
                print(number + 1, "of", len(chosen), file=sys.stderr, flush=True)


def main() -> int:
    """Every file; the exit status says whether nothing was wrong."""
    quick, write = "--quick" in sys.argv, "--write" in sys.argv
    report = Report("Malformed and foreign files")
    by_kind: dict[str, list[Outcome]] = {}
    wrong: list[str] = []

    def seen(case: Case, outcome: Outcome) -> None:
        by_kind.setdefault(case.kind, []).append(outcome)
        for text in outcome.wrong:
            wrong.append(f"{case.kind}, {case.name}: {text}")
            print(wrong[-1].encode("unicode_escape").decode(), file=sys.stderr, flush=True)

    campaign(quick, seen)
    rows = [
        [kind, len(found), sum(not one.said and not one.wrong for one in found),
         sum(bool(one.said) for one in found), sum(bool(one.wrong) for one in found),
         f"{max(one.memory for one in found) / 1e6:.0f}",
         f"{max(one.seconds for one in found):.1f}"]
        for kind, found in by_kind.items()
    ]  # fmt: skip
    total = sum(len(found) for found in by_kind.values())
    report.add(
        "*Read*: without objection, as far as the file is right. *Refused*: by a ValueError of one "
        "sentence. *Wrong*: another exception, a warning of another library, a death, something "
        f"run, more than {MEMORY / 1e9:g} GB or {SECONDS:g} s, something left behind, and from the "
        f"command (every {EVERY}th file, and every config) a status but 0, 1 and 2, an error that "
        "it did not foresee, or a control character. The most memory above the beginning, and the "
        "most processor time, of one file.",
        table(("kind", "files", "read", "refused", "wrong", "memory [MB]", "time [s]"), rows),
        f"{total} files, {sum(bool(one.wrong) for kind in by_kind.values() for one in kind)} of "
        "them with something wrong.",
        *(["\n".join(f"* {one.encode('unicode_escape').decode()[:200]}" for one in wrong[:40])]
          if wrong else []),
    )  # fmt: skip
    report.close(__file__, write)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
