"""The model that a finished run ended with: from the files in its folder, and to other tools."""

import json
import re
from pathlib import Path
from typing import Any

from eoi_jax._atomic import sweep_up
from eoi_jax._checks import check, check_choice
from eoi_jax.cli import build
from eoi_jax.cli import config as configs
from eoi_jax.models.export.export import LANGUAGES, SUFFIXES, export
from eoi_jax.models.plant import Plant
from eoi_jax.models.storage import has_all_functions, load

_NEW = (
    "Run `eoi identify`, `eoi refine` or `eoi discover` first, and name the folder that it wrote."
)


def export_run(
    run: Path, output: Path | None = None, language: str | None = None, trust: bool = False
) -> Path:
    """Write the model of a run for another tool: what `eoi export` does.

    Args:
        run: as of `plant_of_run`.
        output: file to write; None: ``model`` with the suffix of the language, beside the run's.
        language: as of `export`; None: by the suffix of `output`.
        trust: as of `plant_of_run`.

    Returns:
        The file.

    Raises:
        ValueError: what `plant_of_run` and `export` object to, or neither file nor language.
    """
    if output is None:
        rule, advice = "must be given without --output", f"Choose of {', '.join(LANGUAGES)}."
        check(language is not None, "--language", rule, "nothing", advice)
        check_choice("--language", str(language), LANGUAGES)
        suffix = next(key for key, value in SUFFIXES.items() if value == language)
        output = (run if run.is_dir() else run.parent) / f"model{suffix}"
    return export(plant_of_run(run, trust), output, language)


def plant_of_run(run: Path, trust: bool = False) -> Plant:
    """The estimated model of a run, with the effects that were found.

    It is read from what is stored. Only a model that is a function in a Python file is not stored.

    Args:
        run: its folder, or one file: a result that was saved, or a model that was exported as JSON.
        trust: whether such a file, named in the run's config, may be run.

    Returns:
        The plant with its estimate.

    Raises:
        ValueError: no such run, one that was interrupted, files that were changed by hand, or a
            model in a Python file that is gone, or that is not trusted.
    """
    if not run.exists():
        sweep_up(run.parent)  # a run that was being replaced when its process was killed
    check(run.exists(), "run", "must be a folder or a file that exists", run, _NEW)
    if run.is_file():
        return _model_of(load(run), run)
    config = run / "config.toml"
    check(config.is_file(), "run", "must be the folder of a finished run", run, _NEW)
    stored = run / "result.npz"
    if stored.is_file():
        plant = _model_of(load(stored), stored)
        if has_all_functions(plant):
            return plant
        return _model_of(load(stored, plant=_declared(config, trust)), stored)
    result = run / "result.json"
    rule = "must hold result.npz or result.json"
    check(result.is_file(), "run", rule, run, "A sweep ends with no single model. " + _NEW)
    declared = _declared(config, trust)
    try:
        values = json.loads(result.read_text(encoding="utf-8"))["parameters"]
        return declared.with_parameters({name: float(value) for name, value in values.items()})
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(
            f"`run` must hold a result.json that this library wrote: {error}"
        ) from None


def _model_of(found: Any, path: Path) -> Plant:
    plant = found if isinstance(found, Plant) else getattr(found, "plant", None)
    check(isinstance(plant, Plant), "run", "must end with a model", path)
    return plant  # type: ignore[return-value]


def _declared(copy: Path, trust: bool) -> Plant:
    """The declared model; a Python file is beside the config that the copy was made of."""
    settings = configs.load(copy)
    check(
        trust or ":" not in (settings.plant or ""),
        "run",
        "must hold its whole model",
        f"{copy.parent}, whose model is a function in {settings.plant}",
        "Look at this file; --trust runs it.",
    )
    command = re.match(r"# eoi \w+ (.*\.toml)", copy.read_text(encoding="utf-8"))
    return build.plant(settings, _folder(Path(command[1]), copy) if command else copy.parent)


def _folder(config: Path, copy: Path) -> Path:
    """The folder of a config, named as in the folder that the command was given in.

    That one is above the run's, where results go by default; or the one to work in now.
    """
    bases = (*copy.resolve().parents, Path.cwd())
    return next((base / config for base in bases if (base / config).is_file()), copy).parent
