"""The report of a run, made from the run's folder alone: neither data nor model are needed."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from eoi_jax._atomic import sweep_up, write_file
from eoi_jax._checks import check
from eoi_jax.cli.run_folder import BESIDE, RESULT, SWEEP
from eoi_jax.cli.summary import SUMMARY_FORMAT
from eoi_jax.discovery.result import Discovery
from eoi_jax.estimation.identify import Identification
from eoi_jax.models.storage import load
from eoi_jax.refinement.result import Refinement
from eoi_jax.report.contents import (
    Contents,
    discovery_contents,
    identification_contents,
    refinement_contents,
)
from eoi_jax.report.page import page

REPORT = "report.html"
_Maker = Callable[[Any, Mapping[str, Any]], Contents]
_MAKERS: Mapping[str, tuple[type, _Maker]] = {
    "discover": (Discovery, discovery_contents),
    "identify": (Identification, identification_contents),
    "refine": (Refinement, refinement_contents),
}
# Entries of the summary that the page shows, with their kinds.
_SHOWN = {"name": str, "answer": str, "status": dict, "versions": dict, "records": list,
          "held_out_records": list, "equation": dict}  # fmt: skip
_SUMMARIES = ("discovery.json", "result.json")
_AGAIN = "Run the command at the top of its config.toml again."


def write_report(folder: Path) -> Path:
    """Write ``report.html`` into a run's folder, whole or not at all.

    Args:
        folder: that `eoi discover`, `identify` or `refine` wrote.

    Returns:
        Path of the page.

    Raises:
        ValueError: no such folder, an interrupted run, a folder of something else, a run that an
            older or a newer version wrote, or one that is damaged.
    """
    summary, config = _read(folder)
    kind, maker = _MAKERS[summary["kind"]]
    result, beside = load(folder / RESULT), load(folder / BESIDE)
    good = isinstance(result, kind) and isinstance(beside, dict) and "diagnosis" in beside
    other = f"{folder}, whose one is of something else"
    check(good, "RUN", f"must hold the {RESULT} of {summary['kind']}", other, _AGAIN)
    first, _, rest = config.partition("\n")
    command = first.removeprefix("# ")
    try:
        with np.errstate(all="ignore"):  # of a damaged run
            text = page(summary, maker(result, beside), command, rest, summary["kind"])
    except Exception as error:  # parts that are each as declared, and of different results
        cause = f"{folder}, whose parts do not fit together ({type(error).__name__}: {error})"
        check(False, "RUN", f"must hold the {RESULT} that it was written with", cause, _AGAIN)
        raise
    path = folder / REPORT
    write_file(path, lambda draft: _write_text(draft, text))
    return path


def _write_text(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8", errors="backslashreplace")


def _read(folder: Path) -> tuple[dict[str, Any], str]:
    """The run's JSON object and the text of its config, after every check that they allow."""
    if not folder.exists():
        sweep_up(folder.parent)  # a run that was being replaced when its process was killed
    check(folder.is_dir(), "RUN", "must be the folder of a run", folder,
          "Runs lie in runs/<name>/.")  # fmt: skip
    check(
        not (folder / SWEEP).is_file(),
        "RUN",
        "must be of discover, identify or refine",
        f"{folder}, which is of sweep",
        "Its figure.png and report.txt say what it found.",
    )
    found = [name for name in _SUMMARIES if (folder / name).is_file()]
    check(
        bool(found),
        "RUN",
        f"must hold {' or '.join(_SUMMARIES)}",
        f"{folder}, which has neither",
        "It is not the folder of a run, or the run was interrupted before its end: then run the "
        "same command again.",
    )
    try:
        summary = json.loads((folder / found[0]).read_text(encoding="utf-8"))
    except ValueError:
        summary = None
    damaged = f"{folder}, whose one is damaged"
    check(isinstance(summary, dict), "RUN", f"must hold a whole {found[0]}", damaged, _AGAIN)
    assert isinstance(summary, dict)
    written = summary.get("format")
    check(
        written == SUMMARY_FORMAT and summary.get("kind") in _MAKERS,
        "RUN",
        f"must be of format {SUMMARY_FORMAT}, which this version of eoi_jax reads",
        f"{folder}, of format {written or 'none (an older version)'}",
        _AGAIN,
    )
    whole = all(isinstance(summary.get(name), kind) for name, kind in _SHOWN.items())
    check(whole, "RUN", f"must hold a whole {found[0]}", damaged, _AGAIN)
    for name in (RESULT, BESIDE, "config.toml"):
        missing = f"{folder}, which has none"
        check((folder / name).is_file(), "RUN", f"must hold {name}", missing, _AGAIN)
    return summary, (folder / "config.toml").read_text(encoding="utf-8", errors="replace")
