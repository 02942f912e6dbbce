"""A run of the command: what it takes from a config, what it says as JSON, what it writes."""

import errno
import json
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from eoi_jax._atomic import make_draft, sweep_up, tidied, write_files
from eoi_jax._checks import RecordWarning, check
from eoi_jax.cli import build
from eoi_jax.cli import config as configs
from eoi_jax.data.inspection import Inspection
from eoi_jax.data.record import Record
from eoi_jax.discovery.diagnose import diagnose
from eoi_jax.discovery.result import Discovery
from eoi_jax.estimation.identify import Identification
from eoi_jax.models.equations.display import equation_latex
from eoi_jax.models.plant import Plant
from eoi_jax.models.storage import save
from eoi_jax.refinement.result import Refinement
from eoi_jax.report import discovery_figures
from eoi_jax.report.discovery import discovery_text
from eoi_jax.report.drawing import save_figure
from eoi_jax.report.figures import identification_figure
from eoi_jax.report.sweep import sweep_figure
from eoi_jax.simulation.validate import Validation

RESULT = "result.npz"  # the run's result, for `eoi_jax.load`
BESIDE = "report.npz"  # what its report shows beside that
SWEEP = "sweep.json"


@dataclass(frozen=True)
class Job:
    """What a config stands for.

    Attributes:
        settings: its tables.
        model: the plant with its nominal parameters.
        records: to identify from.
        held_out: not used by the fit; may be empty.
    """

    settings: configs.Config
    model: Plant
    records: list[Record]
    held_out: list[Record]


@contextmanager
def quiet_records() -> Iterator[None]:
    """No warnings about records: what was done to one is in its notes, and those in the result."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordWarning)
        yield


def job(settings: configs.Config, folder: Path, data: Path | None) -> Job:
    """The plant and the records of a config.

    Args:
        settings: what was loaded.
        folder: of the config.
        data: folder of measured files; None: `folder`, else $EOI_DATA.

    Raises:
        ValueError: what the config names does not exist or does not fit.
    """
    with quiet_records():
        model = build.plant(settings, folder)
        return Job(
            settings,
            model,
            build.records(settings, model, folder, data),
            build.validation_records(settings, model, folder, data),
        )


def check_place(folder: Path, named: str) -> None:
    """A run's folder must be one that can be made: found out before the work, by making it.

    What processes that were killed left beside it goes, or is put back.

    Args:
        folder: the run's, in that of ``--output``; it is left as it is.
        named: the field that its own name is from.

    Raises:
        ValueError: it cannot be made, or not be written.
    """
    made: list[Path] = []

    def undo() -> None:
        for one in reversed(made):
            with suppress(OSError):
                one.rmdir()

    with tidied(undo):
        for one in (*reversed(folder.parents), folder):
            try:
                if one is folder:
                    sweep_up(folder.parent)
                    made.append(make_draft(folder))
                elif not one.is_dir():
                    made.append(one)
                    one.mkdir()
            except OSError as error:
                long = one is folder and error.errno == errno.ENAMETOOLONG
                check(not long, named, "must be short enough for a folder", folder.name)
                there = isinstance(error, FileExistsError)
                cause = f"{one} is a file" if there else error.strerror
                rule = f"must be a folder that can be made and written ({cause})"
                check(False, "--output", rule, folder.parent)


# -- as files ---------------------------------------------------------------------------------


def write_identification(
    folder: Path,
    result: Identification,
    validation: Validation | None,
    summary: dict[str, Any],
    config: str,
) -> None:
    """`result.json`, `figure.png`, `result.npz`, `report.npz` and `config.toml`.

    Args:
        folder: an empty one.
        result: of `identify`.
        validation: on the held-out records, if there are any.
        summary: of `identification_summary`.
        config: text of the config, with the command that was given above it.
    """
    _write_json(folder / "result.json", summary)
    save_figure(folder / "figure.png", lambda: identification_figure(result))
    result.save(folder / RESULT)
    save({"diagnosis": diagnose(result), "validation": validation}, folder / BESIDE)
    _write(folder / "config.toml", config)


def write_refinement(
    folder: Path,
    result: Refinement,
    beside: dict[str, Any],
    summary: dict[str, Any],
    text: str,
    config: str,
) -> None:
    """`result.json`, `report.txt`, `figure.png`, `result.npz`, `report.npz` and `config.toml`.

    Args:
        folder: an empty one.
        result: of `refine`.
        beside: ``start``, the identification it went on from; ``before`` and ``after``, free runs
            on the held-out records, or None.
        summary: of `refinement_summary`.
        text: of `refinement_text`.
        config: text of the config, with the command that was given above it.
    """
    _write_json(folder / "result.json", summary)
    _write(folder / "report.txt", text + "\n")
    save_figure(folder / "figure.png", result.plot)
    result.save(folder / RESULT)
    save({**beside, "diagnosis": diagnose(beside["start"])}, folder / BESIDE)
    _write(folder / "config.toml", config)


def write_discovery(folder: Path, result: Discovery, summary: dict[str, Any], config: str) -> None:
    """`discovery.json`, `report.txt`, `equation.tex`, three figures, two `.npz`, `config.toml`.

    Args:
        folder: an empty one.
        result: of `discover`.
        summary: of `discovery_summary`.
        config: text of the config, with the command that was given above it.
    """
    _write_json(folder / "discovery.json", summary)
    _write(folder / "report.txt", discovery_text(result) + "\n")
    model = result.declared_part
    forms = (equation_latex(model, result.added, numeric=one) for one in (False, True))
    tex = "\n\n".join(f"\\[\n{form}\n\\]" for form in forms)
    _write(folder / "equation.tex", tex + "\n")
    for name, draw in discovery_figures.PARTS.items():
        save_figure(folder / f"{name}.png", partial(draw, result))
    result.save(folder / RESULT)
    last = result.diagnosis if result.diagnosis and not result.added else diagnose(result.found)
    save({"diagnosis": last}, folder / BESIDE)
    _write(folder / "config.toml", config)


def write_sweep(
    folder: Path, result: Any, best: Any, summary: dict[str, Any], text: str, config: str
) -> None:
    """`sweep.json`, `report.txt`, `figure.png` and `config.toml`, beside the store of a sweep.

    Args:
        folder: the run's, which holds the store already; each file is written whole or not at all.
        result: of `sweep`.
        best: its best lane, or None.
        summary: of `sweep_summary`.
        text: of `sweep_text`.
        config: text of the config, with the command that was given above it.
    """

    def fill(draft: Path) -> None:
        _write_json(draft / SWEEP, summary)
        _write(draft / "report.txt", text + "\n")
        save_figure(draft / "figure.png", lambda: sweep_figure(result, best))
        _write(draft / "config.toml", config)

    write_files(folder, SWEEP, fill)


def write_inspection(folder: Path, found: Inspection, summary: dict[str, Any], text: str) -> None:
    """`inspect.json`, `inspect.txt` and `inspect.png`.

    Args:
        folder: an empty one.
        found: of `inspect`.
        summary: of its `summary`.
        text: for a reader.
    """
    _write_json(folder / "inspect.json", summary)
    _write(folder / "inspect.txt", text + "\n")
    save_figure(folder / "inspect.png", found.plot)


def _write_json(path: Path, summary: dict[str, Any]) -> None:
    text = json.dumps(summary, indent=2, allow_nan=False, ensure_ascii=False)
    _write(path, text + "\n")


def _write(path: Path, text: str) -> None:
    """In UTF-8; of a file's name that is none, its codes."""
    path.write_text(text, encoding="utf-8", errors="backslashreplace")
