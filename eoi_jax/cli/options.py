"""Options that several commands share, with shell completion of their values."""

from pathlib import Path
from typing import Annotated

import typer

from eoi_jax.cli.built_in import built_in_names

RUNS = Path("runs")
# Those of `eoi_jax.export`, which completion does not import.
LANGUAGES = ("python", "c", "matlab", "latex", "json", "idnlgrey")
DATA_FILES = (
    ".csv", ".tsv", ".txt", ".dat", ".mpt", ".lvm", ".gz", ".parquet", ".mat", ".h5", ".hdf5",
    ".npz", ".xlsx",
)  # fmt: skip


def _paths(incomplete: str, suffixes: tuple[str, ...]) -> list[str]:
    """Folders, and files with one of the suffixes, that begin with the typed text."""
    typed = Path(incomplete)
    folder = typed if incomplete.endswith(("/", "\\")) or not incomplete else typed.parent
    paths = []
    try:
        for path in sorted(folder.iterdir()):
            if path.name.startswith("."):
                continue
            if path.is_dir():
                paths.append(f"{path}/")
            elif path.suffix.lower() in suffixes:
                paths.append(str(path))
    except OSError:
        return []
    return [text for text in paths if text.startswith(incomplete)]


def complete_config(incomplete: str) -> list[str]:
    """Configs and folders.

    Args:
        incomplete: the typed text.
    """
    return _paths(incomplete, (".toml",))


def complete_source(incomplete: str) -> list[str]:
    """Configs, folders, and names of built-in configs that no file or folder hides.

    Args:
        incomplete: the typed text.
    """
    names = [name for name in built_in_names() if name.startswith(incomplete)]
    return [*complete_config(incomplete), *(name for name in names if not Path(name).exists())]


def complete_language(incomplete: str) -> list[str]:
    """Languages of `eoi export`.

    Args:
        incomplete: the typed text.
    """
    return [name for name in LANGUAGES if name.startswith(incomplete)]


def complete_data(incomplete: str) -> list[str]:
    """Data files and folders.

    Args:
        incomplete: the typed text.
    """
    return _paths(incomplete, DATA_FILES)


def complete_robot(incomplete: str) -> list[str]:
    """Robot descriptions and folders.

    Args:
        incomplete: the typed text.
    """
    return _paths(incomplete, (".urdf", ".xml", ".mjcf"))


def complete_folder(incomplete: str) -> list[str]:
    """Folders, such as that of a run.

    Args:
        incomplete: the typed text.
    """
    return _paths(incomplete, ())


Source = Annotated[
    Path | None,
    typer.Argument(
        help="TOML file, or the name of a built-in config; default: a built-in example.",
        autocompletion=complete_source,
        show_default=False,
    ),
]
DataFile = Annotated[
    Path, typer.Argument(help="Data file, as of `eoi_jax.read_record`.",
                         autocompletion=complete_data)
]  # fmt: skip
DataFiles = Annotated[
    list[Path],
    typer.Argument(help="Data files, as of `eoi_jax.read_record`; records of the same columns.",
                   autocompletion=complete_data, show_default=False)
]  # fmt: skip
Run = Annotated[
    Path,
    typer.Argument(help="Folder of a run, or a file with a model.", autocompletion=complete_folder),
]
RunFolder = Annotated[Path, typer.Argument(help="Folder of a run.", autocompletion=complete_folder)]
RunsAndFiles = Annotated[
    list[Path],
    typer.Argument(metavar="RUN RUN… [FILE…]",
                   help="Folders of runs, then data files; default: what the first run held out.",
                   autocompletion=complete_data, show_default=False)
]  # fmt: skip
Initial = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME=VALUE",
        help="An output at the start, in the unit of the model; may be repeated. "
        "Default: as measured in the first row, else as the model declares.",
        show_default=False,
    ),
]
Trust = Annotated[
    bool, typer.Option("--trust", help="Execute the Python file that defines the model.")
]
Data = Annotated[
    Path | None,
    typer.Option(
        help="Folder of measured files; default: that of the config, then $EOI_DATA.",
        autocompletion=complete_folder,
        show_default=False,
    ),
]
Output = Annotated[
    Path,
    typer.Option(
        help="Folder in which the folder of the run is written.", autocompletion=complete_folder
    ),
]
AsJson = Annotated[
    bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else.")
]
Quiet = Annotated[bool, typer.Option("--quiet", help="Print only the path of the result.")]
# The default is that of `data/readers/limits.py`, which help does not import.
MaxGigabytes = Annotated[
    float | None,
    typer.Option(
        help="Limit of the unpacked size of a compressed file [GB]; inf: no limit; default: 4.",
        show_default=False,
    ),
]
Sheet = Annotated[
    str | None,
    typer.Option(
        help="Sheet of an Excel file; default: the first that is not empty.", show_default=False
    ),
]
TimeColumn = Annotated[
    str | None, typer.Option(help="Column of time; default: guessed.", show_default=False)
]

# Options of `eoi export`, in the panels of its help.
_CONTENT, _OF_ESTIMATOR = "Content: one of these", "With --estimator"
Language = Annotated[
    str | None,
    typer.Option(
        help=f"The model: {', '.join(LANGUAGES)}; default: by suffix.",
        show_default=False,
        autocompletion=complete_language,
        rich_help_panel=_CONTENT,
    ),
]
ParametersOnly = Annotated[
    bool,
    typer.Option(
        "--parameters",
        help="Parameters only, as numbers: .json or .csv.",
        rich_help_panel=_CONTENT,
    ),
]
Estimator = Annotated[
    bool,
    typer.Option(
        "--estimator",
        help="The estimator for a loop in real time, as C.",
        rich_help_panel=_CONTENT,
    ),
]
Robot = Annotated[
    Path | None,
    typer.Option(
        help="URDF or MJCF file: a copy with values in its joints.",
        autocompletion=complete_robot,
        show_default=False,
        rich_help_panel=_CONTENT,
    ),
]
Precision = Annotated[
    str | None,
    typer.Option(
        help="double or single; default: double.",
        show_default=False,
        rich_help_panel=_OF_ESTIMATOR,
    ),
]
EstimatorData = Annotated[
    Path | None,
    typer.Option(
        help="Folder of the data; default: as in the config.",
        autocompletion=complete_folder,
        show_default=False,
        rich_help_panel=_OF_ESTIMATOR,
    ),
]
Joints = Annotated[
    list[str] | None,
    typer.Option(
        help="joint:attribute=formula,…; may be repeated.",
        show_default=False,
        rich_help_panel="With --robot",
    ),
]
ExportFile = Annotated[
    Path | None,
    typer.Option(
        help="File to write; default: in the folder of the run.",
        show_default=False,
    ),
]
