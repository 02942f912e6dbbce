"""What the commands of ``eoi`` do: a config in; a table, figures and a JSON file out.

Nothing is printed here: an action returns how it ended, and `terminal.show` prints that.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from eoi_jax._atomic import write_file, write_folder
from eoi_jax._checks import check
from eoi_jax.cli import build, html_report, run_folder
from eoi_jax.cli import config as configs
from eoi_jax.cli import summary as summaries
from eoi_jax.cli.run_model import export_run
from eoi_jax.cli.template import checked, draft
from eoi_jax.compiler import jax_setup
from eoi_jax.data.inspection import inspect as look
from eoi_jax.data.readers.limits import MAX_GIGABYTES
from eoi_jax.discovery.discover import discover as run_discovery
from eoi_jax.discovery.result import Discovery
from eoi_jax.estimation.identify import Identification
from eoi_jax.estimation.identify import identify as run_passes
from eoi_jax.estimation.sweep.best import best
from eoi_jax.estimation.sweep.sweep import sweep as run_sweep
from eoi_jax.refinement.refine import refine as run_refinement
from eoi_jax.refinement.result import Refinement
from eoi_jax.report.discovery import answer, discovery_text
from eoi_jax.report.sweep import sweep_text
from eoi_jax.report.tables import identification_text, refinement_text
from eoi_jax.simulation.validate import Validation, validate

_NO_ANSWER, _INTERRUPTED = 1, 130
_MORE_STARTS = "`starts = 200` under [refine] tries so many points around the nominal values"
# Ends of a discovery that are worth a folder.
_ANSWERS = ("explained", "nothing_missing", "unexplained")

# A stage of the work, how much of it is done, how much there is (None: unknown), a remark.
Shown = Callable[[str, int, int | None, str], None]


@dataclass(frozen=True)
class Ending:
    """How a command ended.

    Attributes:
        summary: what a program wants, as JSON.
        text: what a reader wants.
        place: the folder or file that was written; None: nothing was, and `complaint` says why.
        code: exit status.
        complaint: what is wrong, if the status is not 0.
    """

    summary: dict[str, Any]
    text: str = ""
    place: Path | None = None
    code: int = 0
    complaint: str = ""


def identify(
    config: Path | None, data: Path | None, output: Path, passes: int | None, shown: Shown | None
) -> Ending:
    """Identify a plant's parameters.

    Args:
        config: TOML file; None: the built-in pendulum.
        data: folder of measured files, if it is not that of the config.
        output: folder that the run's folder goes into.
        passes: instead of the config's.
        shown: is told how far the work is.

    Returns:
        How it ended.

    Raises:
        ValueError: a wrong config or wrong data.
    """
    source, given = _given(config, "pendulum", data, output, shown, passes)
    with run_folder.quiet_records():
        result, validation = _identified(given, shown)
    summary = summaries.identification_summary(given, result, validation)
    if not result.status.ok:
        return Ending(summary, code=_NO_ANSWER, complaint=f"no answer ({result.status})")
    folder = output / given.settings.name
    option = "" if passes is None else f" --passes {passes}"
    text = _with_command(f"eoi identify{_named(config)}{option}", source)

    def fill(draft: Path) -> None:
        run_folder.write_identification(draft, result, validation, summary, text)
        html_report.write_report(draft)

    write_folder(folder, fill)
    lines = [identification_text(result), "" if validation is None else str(validation)]
    return Ending(summary, "\n\n".join(filter(None, lines)), folder)


def discover(config: Path | None, data: Path | None, output: Path, shown: Shown | None) -> Ending:
    """Find what a plant's model lacks.

    Args:
        config: TOML file; None: the built-in example.
        data: folder of measured files, if it is not that of the config.
        output: folder that the run's folder goes into.
        shown: is told how far the work is.

    Returns:
        How it ended.

    Raises:
        ValueError: a wrong config or wrong data.
    """
    source, given = _given(config, "hidden_friction", data, output, shown)
    with run_folder.quiet_records():
        result = _discovered(given, shown)
    summary = summaries.discovery_summary(given, result)
    if not (result.status.ok or result.status.code in _ANSWERS):
        return Ending(summary, code=_NO_ANSWER, complaint=f"no answer ({result.status})")
    folder = output / given.settings.name
    text = _with_command(f"eoi discover{_named(config)}", source)

    def fill(draft: Path) -> None:
        run_folder.write_discovery(draft, result, summary, text)
        html_report.write_report(draft)

    write_folder(folder, fill)
    if result.status.code == "unexplained":
        # The maps of the residual are written all the same: they are what is known.
        return Ending(summary, discovery_text(result), folder, _NO_ANSWER, answer(result))
    return Ending(summary, discovery_text(result), folder)


def refine(config: Path | None, data: Path | None, output: Path, shown: Shown | None) -> Ending:
    """Identify, then fit the free run itself.

    Args:
        config: TOML file; None: the built-in pendulum.
        data: folder of measured files, if it is not that of the config.
        output: folder that the run's folder goes into.
        shown: is told how far the work is.

    Returns:
        How it ended.

    Raises:
        ValueError: a wrong config or wrong data.
    """
    source, given = _given(config, "pendulum", data, output, shown)
    with run_folder.quiet_records():
        start, before = _identified(given, shown)
        if not start.status.ok and given.settings.refine.starts is None:
            summary = summaries.identification_summary(given, start, before)
            complaint = f"nothing to refine ({start.status})"
            if start.status.code != "no_data":
                complaint += f". {_MORE_STARTS}"
            return Ending(summary, code=_NO_ANSWER, complaint=complaint)
        if shown is not None:
            shown("step of the free runs' fit", 0, None, "compiling")
        result, after = _refined(given, start, shown)
    summary = summaries.refinement_summary(given, start, before, result, after)
    if not result.status.ok:
        return Ending(summary, code=_NO_ANSWER, complaint=f"no answer ({result.status})")
    folder = output / given.settings.name
    text = refinement_text(result, before, after)
    copy = _with_command(f"eoi refine{_named(config)}", source)
    beside = {"start": start, "before": before, "after": after}

    def fill(draft: Path) -> None:
        run_folder.write_refinement(draft, result, beside, summary, text, copy)
        html_report.write_report(draft)

    write_folder(folder, fill)
    return Ending(summary, text, folder)


def sweep(
    config: Path | None, data: Path | None, output: Path, part: str, progress: bool
) -> Ending:
    """Try many gains, filters, starts and resamples.

    Args:
        config: TOML file; None: the built-in example.
        data: folder of measured files, if it is not that of the config.
        output: folder that the run's folder goes into.
        part: ``i/n``: every n-th chunk from the i-th.
        progress: show a bar.

    Returns:
        How it ended.

    Raises:
        ValueError: a wrong config or wrong data.
    """
    source, given = _given(config, "pendulum_sweep", data, output, None)
    folder = output / given.settings.name
    with run_folder.quiet_records():
        result = run_sweep(
            given.model,
            given.records,
            **build.sweep(given.settings, given.model),
            store=folder / "sweep.zarr",
            part=_part(part),
            progress=progress,
        )
        done = bool(result["ok"].any())
        chosen = best(result, given.model, given.held_out or None) if done else None
    summary = summaries.sweep_summary(given, result, chosen)
    text = sweep_text(result, chosen)
    copy = _with_command(f"eoi sweep{_named(config)}", source)
    run_folder.write_sweep(folder, result, chosen, summary, text, copy)
    if not result.attrs["finished"]:
        left = f"{summary['statuses'].get('not_run', 0)} of {summary['lanes']} lanes left"
        complaint = f"interrupted with {left}; the same command goes on from there"
        return Ending(summary, code=_INTERRUPTED, complaint=complaint)
    if chosen is None:
        return Ending(summary, code=_NO_ANSWER, complaint=f"no answer: {text}")
    return Ending(summary, text, folder)


def inspect(
    path: Path, output: Path, shown: Shown | None, max_gigabytes: float = MAX_GIGABYTES
) -> Ending:
    """Look at a data file before anything is configured.

    Args:
        path: of the file.
        output: folder that a folder with the picture goes into.
        shown: is told how far the work is.
        max_gigabytes: what a compressed file may unpack to [1e9 bytes].

    Returns:
        How it ended.

    Raises:
        ValueError: a file that cannot be read.
    """
    folder = output / f"{_stem(path)}.inspect"
    run_folder.check_place(folder, "file")
    if shown is not None:
        shown("reading", 0, None, "")
    found = look(path, max_gigabytes)
    if shown is not None:
        shown("drawing", 0, None, "")
    summary, text = found.summary(), str(found)
    write_folder(folder, lambda draft: run_folder.write_inspection(draft, found, summary, text))
    return Ending(summary, text, folder)


def init(
    path: Path, target: Path | None, force: bool, max_gigabytes: float = MAX_GIGABYTES
) -> Ending:
    """Write a config for a data file: one that runs as it is, with every guess said.

    Args:
        path: of the data file.
        target: of the config; None: named after the file, in the working folder.
        force: replace a config that is there.
        max_gigabytes: what a compressed file may unpack to [1e9 bytes].

    Returns:
        How it ended.

    Raises:
        ValueError: a file that cannot be read, or a config that is there already.
    """
    is_text = path.name == path.name.encode("utf-8", "replace").decode()
    check(is_text, "file", "must have a name that is text", path, "Rename it.")
    goal = target or Path(f"{_stem(path)}.toml")
    rule = "must be a new file"
    check(force or not goal.exists(), "--output", rule, goal, "Replace it with --force.")
    check(not goal.is_dir(), "--output", "must be a file", goal)
    run_folder.check_place(goal, "--output")
    with run_folder.quiet_records():
        found = look(path, max_gigabytes)
        text = checked(draft(found, goal), goal)

    def fill(new: Path) -> None:
        new.write_text(text, encoding="utf-8")

    goal.parent.mkdir(parents=True, exist_ok=True)
    write_file(goal, fill)
    facts = {"time": found.clock.column, "inputs": found.inputs, "outputs": found.outputs}
    guesses = "\n".join(
        f"  {one.name}: {one.role}, {one.why}"
        for one in found.channels
        if one.role in ("time", "input", "output")
    )
    said = "\n".join(f"- {line}" for line in (*found.notes, *found.advice))
    text = f"Guesses:\n{guesses}\n{said}\n\n{goal} is written; next: eoi identify {goal}"
    return Ending({"config": str(goal), **facts}, text, goal)


def report(run: Path) -> Ending:
    """Make the report of a run anew, from its folder alone.

    Args:
        run: folder of a run.

    Returns:
        How it ended.

    Raises:
        ValueError: no run, an interrupted one, or a folder of something else.
    """
    path = html_report.write_report(run)
    return Ending({"report": str(path)}, str(path), path)


def export(run: Path, language: str | None, target: Path | None, trust: bool = False) -> Ending:
    """Write the model of a run for another tool.

    Args:
        run: folder of a run, or a file with a model.
        language: of `LANGUAGES`; None: by the suffix of `target`.
        target: the file; None: ``model.*`` beside the run's files.
        trust: whether the Python file that holds the run's model may be run.

    Returns:
        How it ended.

    Raises:
        ValueError: neither language nor target, no model there, one that cannot be written so.
    """
    jax_setup.configure()
    path = export_run(run, target, language, trust)
    return Ending({"model": str(path)}, str(path), path)


def _stem(path: Path) -> str:
    name = path.name[:-3] if path.name.lower().endswith(".gz") else path.name
    return Path(name).stem


def _part(text: str) -> tuple[int, int]:
    number, _, count = text.partition("/")
    check(number.isdigit() and count.isdigit(), "--part", "must be i/n, such as 0/10", text)
    return int(number), int(count)


# -- the run ----------------------------------------------------------------------------------


def _given(
    config: Path | None,
    example: str,
    data: Path | None,
    output: Path,
    shown: Shown | None,
    passes: int | None = None,
) -> tuple[Path, run_folder.Job]:
    """The config's file, and what it stands for."""
    jax_setup.configure()
    source = config or _default_config(example)
    settings = _settings(source, passes)
    run_folder.check_place(output / settings.name, "name")
    if shown is not None:
        shown("reading", 0, None, "")
    return source, run_folder.job(settings, source.parent, data)


def _default_config(name: str) -> Path:
    """A shipped config: inside an installed package, beside it in a source tree."""
    package = Path(__file__).parents[1]
    candidates = [package / "configs", package.parent / "configs"]
    return next((one for one in candidates if one.is_dir()), candidates[0]) / f"{name}.toml"


def _settings(source: Path, passes: int | None) -> configs.Config:
    settings = configs.load(source)
    if passes is None:
        return settings
    table = msgspec.structs.replace(settings.identify, passes=passes)
    return msgspec.structs.replace(settings, identify=table)


def _identified(
    given: run_folder.Job, shown: Shown | None
) -> tuple[Identification, Validation | None]:
    """The passes, and the held-out error of what they end with."""
    table = given.settings.identify

    def passed(number: int, passes: int, index: Any) -> None:
        values = "  ".join(f"{value:.3g}" for value in np.atleast_1d(index))
        assert shown is not None
        shown("pass", number, passes, f"P = {values}")

    if shown is not None:
        shown("pass", 0, None, "compiling")
    result = run_passes(
        given.model,
        given.records,
        build.observer(given.settings),
        build.lowpass(given.settings),
        table.passes,
        transient=table.transient,
        substeps=table.substeps,
        smoothing=table.smoothing,
        instruments=table.instruments,
        callback=None if shown is None else passed,
    )
    known = result.status.ok and given.held_out
    return result, validate(result.plant, given.held_out) if known else None


def _discovered(given: run_folder.Job, shown: Shown | None) -> Discovery:
    """Fit, search, add, fit again."""
    table = given.settings.discover

    def told(stage: str, done: int, stages: int) -> None:
        assert shown is not None
        shown("discover", done, stages, stage)

    found = run_discovery(
        given.model,
        given.records,
        validation=given.held_out or None,
        effects=build.effects(given.settings),
        lowpass=build.lowpass(given.settings),
        alpha=table.alpha,
        most=table.most,
        window=table.window,
        refine=table.refine,
        callback=None if shown is None else told,
    )
    return replace(found, notes=(*found.notes, *_unused(given.settings)))


def _unused(settings: configs.Config) -> list[str]:
    """What a config sets for `identify` and a discovery chooses itself."""
    tables = {"[observer]": settings.observer, "[identify]": settings.identify}
    given = [name for name, table in tables.items() if table not in (None, configs.IdentifyTable())]
    if not given:
        return []
    verb = "is" if len(given) == 1 else "are"
    return [f"{' and '.join(given)} {verb} not used: a discovery chooses these for every model"]


def _refined(
    given: run_folder.Job, start: Identification, shown: Shown | None
) -> tuple[Refinement, Validation | None]:
    """Output error from the estimate of the passes on, and its held-out error."""
    table = given.settings.refine

    def stepped(number: int, most: int) -> None:
        assert shown is not None
        shown("step of the free runs' fit", number, most, "at most")

    result = run_refinement(
        start.plant if start.status.ok else start.nominal,
        given.records,
        window=table.window,
        substeps=table.substeps,
        max_steps=table.max_steps,
        starts=table.starts,
        rounds=table.rounds,
        callback=None if shown is None else stepped,
    )
    known = result.status.ok and given.held_out
    return result, validate(result.plant, given.held_out) if known else None


def _named(config: Path | None) -> str:
    """The config of a command as it was given: left out where it was left out."""
    return "" if config is None else f" {config}"


def _with_command(command: str, source: Path) -> str:
    """The config's text under the command that it was run by."""
    config = source.read_text(encoding="utf-8-sig")
    return f"# {command}\n{config}"
