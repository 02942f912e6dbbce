"""The files of a run in its folder: what the next run replaces, and what stays where it is."""

import re
from collections.abc import Iterable
from pathlib import Path

from eoi_jax._checks import check, counted

_FIT = r"config\.toml|report\.html|(result|report)\.npz"
# Names of the files that each command writes.
WRITTEN = {
    "identify": rf"{_FIT}|result\.json|figure\.png|history\.(csv|png)",
    "refine": rf"{_FIT}|result\.json|report\.txt|figure\.png",
    "discover": rf"{_FIT}|discovery\.json|report\.txt|equation\.tex|"
    r"(residual|effect|free_run)\.png",
    "sweep": r"config\.toml|sweep\.(json|zarr)|report\.txt|figure\.png",
    "inspect": r"inspect\.(json|txt|png)",
    "validate": r"validate\.(json|txt)|(validate|correlation)(_\d+)?\.png|prediction(_\d+)?\.csv",
    "compare": r"compare\.(json|txt)|(compare|correlation)(_\d+)?\.png",
    "predict": r"predict\.(json|txt)|prediction\.(csv|png)",
}
# Commands whose run may stand in the place of another one, which is kept beside it.
_ARCHIVING = ("identify", "refine", "discover")
_ARCHIVED = (*_ARCHIVING, "sweep")
_ADVICE = (
    "Give another folder with --output (for a config also another `name`), or move what is there."
)


def command_of_run(folder: Path) -> str:
    """The command line whose run is in a folder; empty without a run of a config.

    Args:
        folder: of the run.
    """
    try:
        with (folder / "config.toml").open(encoding="utf-8") as stream:
            line = stream.readline().strip()
    except (OSError, UnicodeDecodeError):
        return ""
    return line.removeprefix("# ") if line.startswith("# eoi ") else ""


def files_of_run(folder: Path) -> list[str]:
    """Names in a folder that the run in it wrote, in order; none without a run.

    Args:
        folder: any, which need not exist.
    """
    pattern = WRITTEN.get(_command(folder))
    return [] if pattern is None else _matching(pattern, _names(folder))


def files_beside_run(folder: Path) -> list[str]:
    """Names in a folder that the run in it did not write, without hidden ones, in order.

    Args:
        folder: any, which need not exist.
    """
    written = files_of_run(folder)
    return [name for name in _names(folder) if name not in written and name[0] != "."]


def archive_of(folder: Path, command: str) -> Path | None:
    """Where the run of another command goes that stands in a folder; None: there is none.

    Args:
        folder: for the new run.
        command: of the new run.
    """
    former = _command(folder)
    is_moved = command in _ARCHIVING and former in _ARCHIVED and former != command
    return folder.with_name(f"{folder.name}.{former}") if is_moved else None


def check_replaceable(folder: Path, command: str) -> None:
    """Check that the files of a new run take the place of no file that no run wrote.

    Args:
        folder: for the new run; it is not changed.
        command: of the new run.

    Raises:
        ValueError: a file, a folder with files and no run, or with the run of a command that is not
            kept beside the new one, or with files beside a run that have names of the new run's.
    """
    former, archive = _command(folder), archive_of(folder, command)
    is_run = former == command or archive is not None
    foreign = files_beside_run(folder) if is_run else [n for n in _names(folder) if n[0] != "."]
    if is_run:
        foreign = _matching(WRITTEN[command], foreign)
    is_file = folder.exists() and not folder.is_dir()
    value = f"{folder}, {'a file' if is_file else f'which holds {listed(foreign)}'}"
    rule = "must lead to a folder in which nothing but an earlier run of the command is replaced"
    check(not (is_file or foreign), "--output", rule, value, _ADVICE)
    if archive is not None:
        check_replaceable(archive, former)


def listed(names: Iterable[str], most: int = 3) -> str:
    """Names of files, for a message, of which only the first ones are said."""
    names = list(names)
    more = counted(len(names) - most, "other") if len(names) > most else ""
    return " and ".join(filter(None, [", ".join(names[:most]), more]))


def _command(folder: Path) -> str:
    """The command whose run is in a folder; empty without a run."""
    words = command_of_run(folder).split()
    if words:
        return words[1] if words[1] in WRITTEN else ""
    for name in ("inspect", "validate", "compare", "predict"):
        if (folder / f"{name}.json").is_file():
            return name
    return "sweep" if (folder / "sweep.zarr").is_dir() else ""


def _names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []


def _matching(pattern: str, names: Iterable[str]) -> list[str]:
    return [name for name in names if re.fullmatch(pattern, name)]
