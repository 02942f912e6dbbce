"""The report of a run from the files of its folder: neither data nor model are needed."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from eoi_jax._atomic import sweep_up, write_file
from eoi_jax._checks import check
from eoi_jax.cli.run_folder import REPORT_DATA, RESULT, SWEEP
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
_ContentsFunction = Callable[[Any, Mapping[str, Any]], Contents]
_CONTENTS: Mapping[str, tuple[type, _ContentsFunction]] = {
    "discover": (Discovery, discovery_contents),
    "identify": (Identification, identification_contents),
    "refine": (Refinement, refinement_contents),
}
# Entries of the summary that the page shows, with their types.
_PAGE_FIELDS = {"name": str, "answer": str, "status": dict, "versions": dict, "records": list,
          "held_out_records": list, "equation": dict}  # fmt: skip
_SUMMARIES = ("discovery.json", "result.json")
_RERUN = "Run the command at the top of its config.toml again."


def write_report(folder: Path) -> Path:
    """Write ``report.html`` into the folder of a run, all or nothing.

    Args:
        folder: written by `eoi discover`, `identify` or `refine`.

    Returns:
        Path of the page.

    Raises:
        ValueError: no such folder, an interrupted run, not a run, a run that an older or a newer
            version wrote, or a damaged one.
    """
    summary, config = _read(folder)
    result_type, contents = _CONTENTS[summary["kind"]]
    result, extra = load(folder / RESULT), load(folder / REPORT_DATA)
    valid = isinstance(result, result_type) and isinstance(extra, dict) and "diagnosis" in extra
    value = f"{folder}, where it belongs to another command"
    check(valid, "RUN", f"must hold the {RESULT} of {summary['kind']}", value, _RERUN)
    first_line, _, config_text = config.partition("\n")
    command = first_line.removeprefix("# ")
    try:
        with np.errstate(all="ignore"):  # values of a damaged run
            text = page(summary, contents(result, extra), command, config_text, summary["kind"])
    except Exception as error:  # e.g. of valid files that belong to different runs
        cause = f"{folder}, whose files do not match ({type(error).__name__}: {error})"
        check(False, "RUN", f"must hold the {RESULT} of the same run", cause, _RERUN)
        raise
    path = folder / REPORT
    write_file(path, lambda draft: _write_text(draft, text))
    return path


def _write_text(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8", errors="backslashreplace")


def _read(folder: Path) -> tuple[dict[str, Any], str]:
    """The JSON object of the run and the text of its config, checked."""
    if not folder.exists():
        sweep_up(folder.parent)  # restores a run whose replacement was interrupted
    check(folder.is_dir(), "RUN", "must be the folder of a run", folder,
          "Runs are in runs/<name>/.")  # fmt: skip
    check(
        not (folder / SWEEP).is_file(),
        "RUN",
        "must be a run of discover, identify or refine",
        f"{folder}, a run of sweep",
        "Its results are in figure.png and report.txt.",
    )
    names = [name for name in _SUMMARIES if (folder / name).is_file()]
    check(
        bool(names),
        "RUN",
        f"must hold {' or '.join(_SUMMARIES)}",
        f"{folder}, which has neither",
        "It is not the folder of a run, or the run was interrupted: run the same command again.",
    )
    try:
        summary = json.loads((folder / names[0]).read_text(encoding="utf-8"))
    except ValueError:
        summary = None
    damaged = f"{folder}, where it is damaged"
    check(isinstance(summary, dict), "RUN", f"must hold a complete {names[0]}", damaged, _RERUN)
    assert isinstance(summary, dict)
    version = summary.get("format")
    check(
        version == SUMMARY_FORMAT and summary.get("kind") in _CONTENTS,
        "RUN",
        f"must be of format {SUMMARY_FORMAT}, which this version of eoi_jax reads",
        f"{folder}, of format {version or 'none (an older version)'}",
        _RERUN,
    )
    complete = all(isinstance(summary.get(name), kind) for name, kind in _PAGE_FIELDS.items())
    check(complete, "RUN", f"must hold a complete {names[0]}", damaged, _RERUN)
    for name in (RESULT, REPORT_DATA, "config.toml"):
        missing = f"{folder}, where it is missing"
        check((folder / name).is_file(), "RUN", f"must hold {name}", missing, _RERUN)
    return summary, (folder / "config.toml").read_text(encoding="utf-8", errors="replace")
