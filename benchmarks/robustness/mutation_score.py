"""Which small faults in the package does the test suite notice? A seeded sample, by room.

python benchmarks/robustness/mutation_score.py [--commit COMMIT] [--folder FOLDER] [--faults 300]
    [--seed 1] [--seconds S] [--again] [--only FILE …] [--unmeasured] [--report] [--write]

The faults are drawn once, from the commit of the first run, and stand with their fate in
results/mutation_score.jsonl; a later run goes on where this one stopped. Each is put into a copy of
the repository and judged by the test files that run its lines, the likeliest first, until one
fails. `--seconds`: go on to the next fault after so long (the rest is judged by a later run);
`--again`: judge the survivors once more; `--only`: by these test files alone; `--unmeasured`: do
not measure first which file runs which lines (one that was not measured may run any); `--report`:
judge nothing. Needs the extras `benchmarks` and `dev`, and an hour and more of one processor.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from benchmarks.robustness import mutation_faults as faults
from benchmarks.robustness.mutation_coverage import CoverageMap, environment

ROOT = Path(__file__).resolve().parents[2]
SESSION = Path(__file__).parent / "results" / "mutation_score.jsonl"
JUDGE = Path(__file__).with_name("mutation_judge.py")
SLACK, SLOWER = 30.0, 4.0  # [s], and times as long as without a fault, after which a test hangs


@dataclass
class Fate:
    """A fault of the sample and what became of it.

    Attributes:
        fault: which.
        after: what its line says with it.
        status: open, killed, survived, equivalent, or gone (its line is no longer in the code).
        by: the test that killed it.
        why: where it survived or is equivalent, the reason, written by hand.
        first: status by the tests that were there when it was drawn; untried where none was run.
        passed: test files that did not notice it, while it is open.
        commit: at which it was judged last.
    """

    fault: faults.Fault
    after: str = ""
    status: str = "open"
    by: str = ""
    why: str = ""
    first: str = "open"
    passed: list[str] = field(default_factory=list)
    commit: str = ""

    def line(self) -> str:
        """As the session file keeps it."""
        rest = {one.name: getattr(self, one.name) for one in fields(self) if one.name != "fault"}
        return json.dumps({**asdict(self.fault), **rest}, ensure_ascii=False)

    @staticmethod
    def read(line: str) -> "Fate":
        """From a line of the session file."""
        values = json.loads(line)
        names = [one.name for one in fields(faults.Fault)]
        fault = faults.Fault(**{name: values.pop(name) for name in names})
        return Fate(fault, **values)


def load() -> tuple[str, list[Fate]]:
    """Commit that the session's faults were drawn from, and the faults; nothing without a file."""
    if not SESSION.exists():
        return "", []
    head, *lines = SESSION.read_text(encoding="utf-8").splitlines()
    return json.loads(head)["drawn"], [Fate.read(line) for line in lines]


def save(drawn: str, session: list[Fate]) -> None:
    """Write the session file, whole."""
    head = json.dumps({"drawn": drawn})
    text = "\n".join([head, *(fate.line() for fate in session)]) + "\n"
    temporary = SESSION.with_suffix(".new")
    temporary.write_text(text, encoding="utf-8")
    temporary.replace(SESSION)


class Judge:
    """The copy of the repository, and the process that runs its tests.

    Args:
        folder: where the copy, the map of coverage and the caches stand.
        commit: that is judged.
    """

    def __init__(self, folder: Path, commit: str):
        self.copy = folder / "copy"
        if not self.copy.exists():
            subprocess.run(["git", "clone", "-q", "--shared", ROOT, self.copy], check=True)
        _git(self.copy, "fetch", "-q", "origin")
        _git(self.copy, "checkout", "-q", "--force", "--detach", commit)
        self.commit = _git(self.copy, "rev-parse", "--short", "HEAD").strip()
        self.map = CoverageMap(self.copy, folder / "coverage.json")
        self.process: subprocess.Popen | None = None
        self._stamp = time.time()

    def outcome(self, file: str) -> dict:
        """What the process answers for one test file."""
        if self.process is None or self.process.poll() is not None:
            self.process = subprocess.Popen(
                [sys.executable, JUDGE],
                cwd=self.copy,
                env=environment(self.copy),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        limit = SLACK + SLOWER * self.map.seconds(file)
        self.process.stdin.write(json.dumps({"file": file, "limit": limit}) + "\n")
        self.process.stdin.flush()
        return json.loads(self.process.stdout.readline())

    def judge(self, fate: Fate, seconds: float, only: list[str]) -> None:
        """Put the fault in, run the files that may notice it, and take it out again."""
        path = self.copy / fate.fault.module
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        changed = faults.mutated(text, fate.fault) if text else None
        if changed is None:
            fate.status, fate.passed, fate.commit = "gone", [], self.commit
            return
        fate.after = next((after for _, after in faults.difference(text, changed[0])), "")
        where = changed[1]
        files = self.map.ranked(fate.fault.module, text, where.first, where.last)
        files = [file for file in files if file not in fate.passed and (not only or file in only)]
        start = time.monotonic()
        try:
            self._write(path, changed[0])
            for file in files:
                if time.monotonic() - start > seconds:
                    return
                answer = self.outcome(file)
                if answer["outcome"] != "passed":
                    fate.status, fate.passed = "killed", []
                    fate.by = (
                        answer["by"]
                        if answer["outcome"] == "failed"
                        else (f"{file} ({answer['outcome']})")
                    )
                    return
                fate.passed.append(file)
            if not only:
                fate.status, fate.passed = "survived", []
        finally:
            fate.commit = self.commit
            self._write(path, text)

    def _write(self, path: Path, text: str) -> None:
        # Python believes its compiled code by whole seconds and sizes: no two texts share a time.
        path.write_text(text, encoding="utf-8")
        self._stamp += 2.0
        os.utime(path, (self._stamp, self._stamp))


def _git(folder: Path, *words: str) -> str:
    command = ["git", "-C", str(folder), *words]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


# -- report -----------------------------------------------------------------------------------


def score(session: list[Fate], name: str) -> str:
    """Share killed of those that any test file was run against and that are not equivalent."""
    tried = [one for one in session if one.status in ("killed", "survived") or one.passed]
    tried = [one for one in tried if getattr(one, name) != "untried"]
    killed = sum(getattr(one, name) == "killed" for one in tried)
    return f"{killed} of {len(tried)}, {killed / len(tried):.0%}" if tried else "–"


def write_report(session: list[Fate], drawn: str, write: bool) -> None:
    """Score by room, and the survivors with why."""
    from benchmarks.common import Report, eoi, table

    eoi.configure()
    report = Report("Small faults, and whether the tests notice them")
    rows = []
    for room in [*sorted(faults.ROOMS), "all"]:
        part = [fate for fate in session if room in (fate.fault.room, "all")]
        count = Counter(fate.status for fate in part)
        begun = sum(fate.status == "open" and bool(fate.passed) for fate in part)
        rows.append([room, len(part), score(part, "first"), score(part, "status"),
                     count["survived"], begun, count["open"] - begun, count["equivalent"],
                     count["gone"]])  # fmt: skip
    report.add(
        f"{len(session)} faults, drawn from {drawn}. Each is judged by every test file that runs "
        "its line, the likeliest first, until one fails. *Killed at first*: by a test that was "
        "there when they were drawn; *now*: also by those written since; of those tried, so that a "
        "fault that the likeliest files do not notice counts against the score. *Survived*: all "
        "files that run the line pass. *Begun*: some did, and the others have not been run. "
        "*Equivalent*: cannot change what the package computes or says, for the reason below; "
        "these do not count. *Gone*: the line has changed since.",
        table(("room", "faults", "killed at first", "killed now", "survived", "begun", "not tried",
               "equivalent", "gone"), rows),
    )  # fmt: skip
    for status in ("survived", "begun", "equivalent"):
        lines = [
            [f"{one.fault.module} {one.fault.definition}".replace("|", "\\|"),
             *(f"`{text}`".replace("|", "\\|") for text in (one.fault.line, one.after)),
             one.why or ", ".join(one.passed)]
            for one in session
            if one.status == status or (status == "begun" and one.status == "open" and one.passed)
        ]  # fmt: skip
        if lines:
            last = "passed by" if status == "begun" else "why"
            report.add(f"## {status.capitalize()}", table(("where", "line", "fault", last), lines))
    report.close(__file__, write)


def main() -> None:
    """Draw or take up the session, judge what is open, and say the score."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--commit", default="HEAD", help="that is judged")
    parser.add_argument("--folder", type=Path, help="of the copy and its caches, kept for later")
    parser.add_argument("--faults", type=int, default=300, help="of the sample")
    parser.add_argument("--seed", type=int, default=1, help="of the sample")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="a fault, at most")
    parser.add_argument("--again", action="store_true", help="judge the survivors once more")
    parser.add_argument("--only", nargs="*", default=[], help="test files")
    parser.add_argument("--unmeasured", action="store_true", help="take no map of coverage first")
    parser.add_argument("--report", action="store_true", help="judge nothing")
    parser.add_argument("--write", action="store_true", help="update the result file")
    options = parser.parse_args()
    commit = _git(ROOT, "rev-parse", options.commit).strip()
    drawn, session = load()
    folder = (options.folder or Path(tempfile.mkdtemp(prefix="mutation-"))).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    if not options.report:
        judge = Judge(folder, commit)
        if not session:
            drawn = judge.commit
            session = [Fate(one) for one in faults.sample(judge.copy, options.faults, options.seed)]
        if not options.unmeasured:
            judge.map.update()
        for fate in sorted(session, key=lambda one: len(one.passed)):  # the least judged first
            if fate.status != "open" and not (options.again and fate.status == "survived"):
                continue
            judge.judge(fate, options.seconds, options.only)
            if fate.first == "open":
                fate.first = fate.status
            save(drawn, session)
            print(fate.status, fate.fault.module, fate.after, fate.by, sep=" | ", flush=True)
    write_report(session, drawn, options.write)


if __name__ == "__main__":
    main()
