"""Commands that are killed at any moment: nothing lost, nothing half-written, nothing left behind.

python benchmarks/robustness/killed_commands.py [--quick] [--write]

`eoi discover`, `refine`, `report` and `sweep` are ended by SIGKILL, SIGTERM and SIGHUP by turns, at
seeded moments: every other one anywhere between start and end, the others while the run is written
(from the moment on that a draft appears). Every other time a run stands already, marked, so that
the old one and the new one are told apart.
"""

import filecmp
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from benchmarks.common import ROOT, Report, arguments, table

COUNT = 50  # of each command
COMMANDS = ("sweep", "discover", "refine", "report")
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGHUP)
START = (sys.executable, "-c", "from eoi_jax.cli.main import main; main()")
MARK = "mark"  # a file beside those of the run that stands already
LIMIT = 300.0  # [s]
_PNG_END = b"IEND\xaeB`\x82"

CONFIG = """
name = "rig"
plant = "mass_spring_damper"

[lowpass]
cutoff = 40.0

[identify]
passes = 2

[discover]
effects = ["coulomb_friction"]
most = 1

[simulate]
sample_period = 0.005
duration = 4.0
increments = { alpha = -20.0, beta = -2.0, rho = -0.2 }
effects = { coulomb_friction = 0.3 }
noise = { position = 1e-4 }
seed = 1

[simulate.input.voltage]
kind = "square"
amplitude = 1.0
frequency = 0.5

[simulate.held_out.voltage]
kind = "square"
amplitude = 0.8
frequency = 0.7

[sweep]
observers = [{ kind = "second_order", gains = { c1 = 20.0, c2 = 100.0, c3 = { low = 50.0, high = 5000.0, count = 12 } } }]
chunk = 4
"""  # noqa: E501


@dataclass
class Seen:
    """What the kills of one command by one signal showed.

    Attributes:
        ends: of the process, by exit status.
        stands: of the run afterwards: absent, old, new.
        leftovers: kills that left something beside the run, which the next run may take away.
        wrong: whatever must not be, in words.
    """

    ends: Counter = field(default_factory=Counter)
    stands: Counter = field(default_factory=Counter)
    leftovers: int = 0
    wrong: list[str] = field(default_factory=list)


class Bench:
    """A folder in which one command is run again and again.

    Args:
        folder: an empty one.
        command: of `COMMANDS`.
    """

    def __init__(self, folder: Path, command: str):
        self.folder, self.command = folder, command
        self.run = folder / "runs" / "rig"
        (folder / "rig.toml").write_text(CONFIG, encoding="utf-8")
        (folder / "tmp").mkdir()
        known = {**os.environ, "PYTHONPATH": str(ROOT), "EOI_CACHE": str(folder.parent / "cache")}
        self.environment = {**known, "TMPDIR": str(folder / "tmp")}
        if command == "report":
            self._finish(("identify", "rig.toml"))
        self.words = ("report", "runs/rig") if command == "report" else (command, "rig.toml")
        self._finish(self.words)  # compiles
        if command == "sweep":
            shutil.rmtree(self.run)
        self.seconds, self.writing = self._timed()
        self.whole = folder / "whole"
        shutil.copytree(self.run, self.whole)

    def _start(self, words: tuple[str, ...]) -> subprocess.Popen:
        return subprocess.Popen(
            [*START, *words, "--quiet"], cwd=self.folder, env=self.environment,
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
            preexec_fn=_hear,
        )  # fmt: skip

    def _finish(self, words: tuple[str, ...]) -> None:
        process = self._start(words)
        _, said = process.communicate(timeout=LIMIT)
        if process.returncode:
            raise RuntimeError(f"{words}: {process.returncode}: {said}")

    def _timed(self) -> tuple[float, float]:
        """How long a run takes, and how long of that it writes [s]."""
        began = time.perf_counter()
        process = self._start(self.words)
        self._await_draft(process)
        written = time.perf_counter()
        process.communicate(timeout=LIMIT)
        ended = time.perf_counter()
        return ended - began, max(ended - written, 0.2)

    def _await_draft(self, process: subprocess.Popen) -> None:
        """Wait until a draft is being filled, or the process has ended."""
        places = (self.run.parent, self.run)
        while process.poll() is None:
            if any((draft / "new").exists() for one in places for draft in one.glob(".*.draft")):
                return
            time.sleep(0.002)

    def prepare(self, standing: bool) -> None:
        """A run that stands already, marked, or none."""
        if self.command == "sweep" and standing:  # begun, and to be gone on with
            return
        if standing or self.command == "report":
            if not self.run.exists():
                shutil.copytree(self.whole, self.run)
            (self.run / MARK).touch()
            if self.command == "report":
                (self.run / "report.html").unlink(missing_ok=True)
        else:
            shutil.rmtree(self.run, ignore_errors=True)

    def kill(self, draw: random.Random, number: signal.Signals, seen: Seen) -> None:
        """Start the command and end it at a random moment.

        Args:
            draw: of the moment.
            number: the signal.
            seen: gets the exit status.
        """
        process = self._start(self.words)
        if draw.random() < 0.5:
            wait = draw.uniform(0.0, self.seconds)
        else:
            self._await_draft(process)
            wait = draw.uniform(0.0, self.writing)
        try:
            process.wait(wait)
        except subprocess.TimeoutExpired:
            process.send_signal(number)
        _, said = process.communicate(timeout=LIMIT)
        status = process.returncode
        seen.ends[status] += 1
        # Ended by the signal itself: SIGKILL, or the interpreter was still starting.
        expected = (0, -number) if number == signal.SIGKILL else (0, 130, -number)
        if status not in expected or "Traceback" in said:
            seen.wrong.append(f"status {status}: {said[-300:]}")

    def look(self, standing: bool, seen: Seen) -> bool:
        """What stands after a kill; whether something lies beside it.

        Args:
            standing: whether a run stood before.
            seen: gets what is found.
        """
        stands = "absent"
        if self.run.exists():
            stands = "old" if (self.run / MARK).exists() else "new"
            seen.wrong += self._damage(stands == "old")
        elif standing and self.command != "sweep":
            seen.wrong.append("the run that stood is gone")
        seen.stands[stands] += 1
        beside = self._beside()
        seen.leftovers += bool(beside)
        return bool(beside)

    def again(self, seen: Seen) -> None:
        """The next run: it ends well, it is whole, and nothing lies beside it.

        Args:
            seen: gets what is wrong.
        """
        try:
            self._finish(self.words)
        except RuntimeError as error:
            seen.wrong.append(f"the next run: {error}")
        seen.wrong += self._damage(False)
        seen.wrong += [f"after the next run there is {one}" for one in self._beside()]
        missing = {one.name for one in self.whole.iterdir()}
        missing -= {one.name for one in self.run.iterdir()}
        seen.wrong += [f"the next run lacks {one}" for one in missing]

    def _beside(self) -> list[str]:
        """Whatever is neither the run nor part of it."""
        known = {path.relative_to(self.whole) for path in self.whole.rglob("*")} | {Path(MARK)}
        inside = [path for path in self.run.rglob("*") if path.relative_to(self.run) not in known]
        runs = [one for one in self.folder.glob("runs/*") if one != self.run]
        runs += self.folder.glob("runs/.*")
        known_here = {"rig.toml", "runs", "tmp", "whole"}
        here = [one for one in self.folder.iterdir() if one.name not in known_here]
        here += list((self.folder / "tmp").iterdir())
        return [str(one.relative_to(self.folder)) for one in (*inside, *runs, *here)]

    def _damage(self, old: bool) -> list[str]:
        """Files of the run that are missing or not whole."""
        wrong = []
        partly = self.command in ("sweep", "report")  # their files come one by one
        said = self.run / "sweep.json"
        begun = said.exists() and not json.loads(said.read_text(encoding="utf-8"))["finished"]
        for whole in self.whole.iterdir():
            path = self.run / whole.name
            if not path.exists():
                if not partly:
                    wrong.append(f"{path.name} is missing")
            elif path.is_file() and not _is_whole(path, whole, self.command, begun):
                wrong.append(f"{'old' if old else 'new'} {path.name} is not whole")
        return wrong


def _hear() -> None:
    """A benchmark under `nohup` ignores SIGHUP, and so would what it starts."""
    for number in SIGNALS[1:]:
        signal.signal(number, signal.SIG_DFL)


def _is_whole(path: Path, whole: Path, command: str, begun: bool) -> bool:
    """Whether a file is what the command writes without a kill: everything is seeded."""
    if begun and path.suffix in (".csv", ".md", ".png"):  # an interrupted sweep's, of what is done
        data = path.read_bytes()
        return data.endswith(_PNG_END if path.suffix == ".png" else b"\n")
    if path.suffix == ".json" and command == "sweep":
        # A sweep that was killed goes on: how much was left is what differs.
        return isinstance(json.loads(path.read_text(encoding="utf-8")), dict)
    if path.suffix == ".json":
        return json.loads(path.read_text("utf-8")) == json.loads(whole.read_text("utf-8"))
    if path.suffix == ".npz":  # the time of writing is in it
        import numpy as np

        with np.load(path) as one, np.load(whole) as other:
            return all(np.array_equal(one[key], other[key], equal_nan=one[key].dtype.kind in "fc")
                       for key in other.files)  # fmt: skip
    return filecmp.cmp(path, whole, shallow=False)


def campaign(command: str, count: int, folder: Path) -> dict[signal.Signals, Seen]:
    """Kill one command many times.

    Args:
        command: of `COMMANDS`.
        count: of kills.
        folder: an empty one.
    """
    bench, draw = Bench(folder, command), random.Random(command)
    seen = {number: Seen() for number in SIGNALS}
    for i in range(count):
        number, standing = SIGNALS[i % 3], bool(i // 3 % 2)
        bench.prepare(standing)
        bench.kill(draw, number, seen[number])
        if bench.look(standing, seen[number]) or i == count - 1:
            bench.again(seen[number])
        print(command, i + 1, number.name, *seen[number].wrong[-1:], file=sys.stderr, flush=True)
    return seen


def main() -> int:
    """All commands; the exit status says whether nothing was wrong."""
    options = arguments(__doc__)
    report = Report("Commands that are killed at any moment")
    rows, wrong = [], []
    with tempfile.TemporaryDirectory() as place:
        for command in COMMANDS:
            folder = Path(place) / command
            folder.mkdir()
            seen = campaign(command, 6 if options.quick else COUNT, folder)
            for number, one in seen.items():
                ends = ", ".join(f"{key}: {n}" for key, n in sorted(one.ends.items()))
                stands = ", ".join(f"{key} {n}" for key, n in sorted(one.stands.items()))
                kills = sum(one.ends.values())
                rows.append([command, number.name, kills, ends, stands, one.leftovers,
                             len(one.wrong)])  # fmt: skip
                wrong += [f"{command}, {number.name}: {text}" for text in one.wrong]
                print(rows[-1], *wrong, file=sys.stderr, flush=True)
    report.add(
        "Exit status: 0 where the command was done before, 130 where it ended itself, negative "
        "where the signal did (always for SIGKILL; for the others while Python is starting). "
        "*Stands*: the run that is found afterwards; every file of it is compared with that of a "
        "run that nobody killed. *Leftovers*: kills after which something else was found; then, "
        "and after the last kill, the command is run again, and nothing may be left. *Wrong*: "
        "a run that is gone, a file that is missing or not whole, something left after the next "
        "run, a traceback, another exit status.",
        table(("command", "signal", "kills", "exit status", "stands", "leftovers", "wrong"), rows),
        "\n".join(f"* {one}" for one in wrong[:20]) or "Nothing was wrong.",
    )
    report.close(__file__, options.write)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
