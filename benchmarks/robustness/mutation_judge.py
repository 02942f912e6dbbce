"""A process that judges: it runs test files in a fork each, with all but the package imported.

Reads lines of JSON, `{"file": …, "limit": seconds}`, and answers each with one, `{"outcome": …,
"by": …, "seconds": …}`: passed, failed (by which test), broken (nothing could be collected) or
hung. It must not import the package under test itself.
"""

import contextlib
import importlib
import json
import os
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path

PRELOADED = (
    "jax",
    "jax.numpy",
    "equinox",
    "diffrax",
    "optimistix",
    "scipy.signal",
    "scipy.optimize",
    "scipy.stats",
    "pandas",
    "xarray",
    "zarr",
    "h5py",
    "msgspec",
    "typer",
    "rich",
    "pytest",
    "hypothesis",
    "beartype",
    "jaxtyping",
)


class FirstFailure:
    """Remembers, in a file, the first test that fails.

    Args:
        path: of the file.
    """

    def __init__(self, path: Path):
        self.path = path

    def pytest_runtest_logreport(self, report) -> None:
        """Called by pytest after each phase of each test."""
        if report.failed and not self.path.exists():
            self.path.write_text(report.nodeid, encoding="utf-8")

    def pytest_collectreport(self, report) -> None:
        """Called by pytest after a file is collected."""
        if report.failed and not self.path.exists():
            self.path.write_text(f"{report.nodeid} (collection)", encoding="utf-8")


def child(file: str, folder: Path) -> None:
    """Run one test file, and leave with pytest's exit status."""
    import pytest

    os.setsid()
    os.environ["EOI_CACHE"] = str(folder / "cache")
    os.environ["TMPDIR"] = str(folder)
    tempfile.tempdir = None
    output = os.open(folder / "output", os.O_CREAT | os.O_WRONLY)
    os.dup2(output, 1)
    os.dup2(output, 2)
    quiet = "-W", "ignore::pytest.PytestAssertRewriteWarning"  # plugins that are imported already
    options = ["-q", "-x", "-n0", "-p", "no:cacheprovider", *quiet, f"--basetemp={folder / 'base'}"]
    code = pytest.main([*options, file], plugins=[FirstFailure(folder / "by")])
    os._exit(int(code))


def judged(file: str, limit: float) -> dict[str, str | float]:
    """Outcome of one test file, in a fork of this process.

    Args:
        file: path from the working directory.
        limit: after which it counts as hung [s].

    Returns:
        What is answered.
    """
    folder = Path(tempfile.mkdtemp(prefix="judged-"))
    start = time.monotonic()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # no backend of JAX runs yet in this process
        pid = os.fork()
    if not pid:
        try:
            child(file, folder)
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(70)
    while True:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done or time.monotonic() - start > limit:
            break
        time.sleep(0.02)
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(pid, signal.SIGKILL)  # and whatever it has started
    if not done:
        os.waitpid(pid, 0)
    by = folder / "by"
    name = by.read_text(encoding="utf-8") if by.exists() else ""
    code = os.waitstatus_to_exitcode(status) if done else 0
    outcome = "hung" if not done else "passed" if code in (0, 5) else "failed" if name else "broken"
    if outcome == "broken":
        print((folder / "output").read_text(encoding="utf-8", errors="replace"), file=sys.stderr)
    shutil.rmtree(folder, ignore_errors=True)
    return {
        "outcome": outcome,
        "by": name or f"exit status {code}",
        "seconds": round(time.monotonic() - start, 2),
    }


def main() -> None:
    """Answer every line."""
    for name in PRELOADED:
        importlib.import_module(name)
    assert "eoi_jax" not in sys.modules
    for line in sys.stdin:
        asked = json.loads(line)
        print(json.dumps(judged(asked["file"], asked["limit"])), flush=True)


if __name__ == "__main__":
    main()
