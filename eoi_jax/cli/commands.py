"""The commands of ``eoi``: options, help with examples, completion.

Their actions are in `cli.actions`, which is imported when one of them is called: help and shell
completion do not wait for JAX.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import lazy_loader
import typer

import eoi_jax
from eoi_jax import cli
from eoi_jax.cli.options import (
    RUNS,
    AsJson,
    Data,
    DataFile,
    DataFiles,
    Estimator,
    EstimatorData,
    ExportFile,
    Initial,
    Joints,
    Language,
    MaxGigabytes,
    Output,
    ParametersOnly,
    Precision,
    Quiet,
    Robot,
    Run,
    RunFolder,
    RunsAndFiles,
    Sheet,
    Source,
    TimeColumn,
    Trust,
    complete_config,
)
from eoi_jax.cli.terminal import (
    Commands,
    Outcome,
    ProgressCallback,
    debug,
    failures,
    keyboard_interrupts,
    progress,
    show,
)

webbrowser: Any = lazy_loader.load("webbrowser")  # one command needs it, and none to begin

app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["--help", "-h"]},
)


def _show_version(requested: bool) -> None:
    if requested:
        typer.echo(f"eoi_jax {eoi_jax.__version__}")
        raise typer.Exit


def _examples(*lines: tuple[str, str]) -> str:
    """Example calls with their purpose, below the help of a command."""
    width = max(len(call) for call, _ in lines)
    examples = [f"  [cyan]{call:{width}}[/cyan]  {purpose}" for call, purpose in lines]
    return "\n".join(["[bold]Examples[/bold]", *examples])


def _answer(
    as_json: bool, quiet: bool, action: Callable[[ProgressCallback | None], Outcome]
) -> None:
    """Run an action with a callback that shows its progress, and print its outcome."""
    with failures(as_json):
        with progress(not quiet) as update:
            outcome = action(update)
        show(outcome, as_json, quiet)


@app.callback(
    epilog=_examples(
        ("eoi discover", "built-in example: a hidden effect"),
        ("eoi inspect run.csv", "the contents of a data file"),
        ("eoi init run.csv", "writes run.toml, ready to run"),
        ("eoi discover run.toml", "what its model lacks"),
        ("eoi --install-completion", "the tab key completes commands and paths"),
    )
)
def options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version."),
    ] = False,
    with_traceback: Annotated[
        bool, typer.Option("--debug", help="Show the traceback of an error.")
    ] = False,
) -> None:
    """Identify a plant, and find what its model lacks, from the equivalent output injection.

    Exit status: 0 answer, 1 no answer (with the reason), 2 invalid call or data, 130 interrupted.
    """
    del version
    debug(with_traceback)


@app.command(
    epilog=_examples(
        ("eoi identify", "the built-in pendulum"),
        ("eoi identify rig.toml", "results are written to runs/<name>/"),
        ("eoi identify rig.toml --data DIR", "data files are in DIR"),
        ("eoi identify rig.toml --json > rig.json", "results as JSON"),
    )
)
def identify(
    config: Source = None,
    data: Data = None,
    output: Output = RUNS,
    as_json: AsJson = False,
    quiet: Quiet = False,
    passes: Annotated[
        int | None,
        typer.Option(
            min=1, help="Number of passes; default: that of the config.", show_default=False
        ),
    ] = None,
    recursive: Annotated[
        bool, typer.Option("--recursive", help="Also give the parameters over time.")
    ] = False,
) -> None:
    """Identify a plant's parameters from simulated or measured records."""

    def action(update: ProgressCallback | None) -> Outcome:
        return cli.actions.identify(config, data, output, passes, recursive, update)

    _answer(as_json, quiet, action)


@app.command(
    epilog=_examples(
        ("eoi discover", "the built-in example, with hidden dry friction"),
        ("eoi discover rig.toml", "what the model of rig.toml lacks"),
    )
)
def discover(
    config: Source = None,
    data: Data = None,
    output: Output = RUNS,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Find what the model of a plant lacks: name the effect, add it, compare before and after."""
    _answer(as_json, quiet, lambda update: cli.actions.discover(config, data, output, update))


@app.command(
    epilog=_examples(
        ("eoi refine", "the built-in pendulum"),
        ("eoi refine rig.toml", "passes, then minimisation of the free-run error"),
    )
)
def refine(
    config: Source = None,
    data: Data = None,
    output: Output = RUNS,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Identify, then minimise the free-run error (output error), with uncertainties."""
    _answer(as_json, quiet, lambda update: cli.actions.refine(config, data, output, update))


@app.command(
    epilog=_examples(
        ("eoi sweep", "the built-in example, 1200 lanes"),
        ("eoi sweep rig.toml", "if interrupted, the same command continues"),
        ("eoi sweep rig.toml --part 3/10", "one of ten jobs that share a store"),
    )
)
def sweep(
    config: Source = None,
    data: Data = None,
    output: Output = RUNS,
    part: Annotated[
        str, typer.Option(help="i/n: every n-th chunk from the i-th (0 … n-1), for job arrays.")
    ] = "0/1",
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Try many gains, filters, starting points and resamples; resumes an interrupted sweep."""
    with failures(as_json):
        with keyboard_interrupts():
            bar = not quiet and sys.stderr.isatty()
            outcome = cli.actions.sweep(config, data, output, part, bar)
        show(outcome, as_json, quiet)


@app.command(
    epilog=_examples(
        ("eoi inspect run.csv", "columns, time axis, noise, guesses"),
        ("eoi inspect run.csv --json", "the same as JSON"),
    )
)
def inspect(
    file: DataFile,
    output: Output = RUNS,
    time: TimeColumn = None,
    max_gigabytes: MaxGigabytes = None,
    sheet: Sheet = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Inspect a data file: a table of its columns and a figure."""
    _answer(
        as_json,
        quiet,
        lambda update: cli.actions.inspect(file, output, update, max_gigabytes, sheet, time),
    )


@app.command(
    epilog=_examples(
        ("eoi init run.csv", "writes run.toml, for identify and discover"),
        ("eoi init run.csv --output rig.toml", "under another name"),
        ("eoi init a.csv b.csv --inputs volt", "b.csv is held out"),
    )
)
def init(
    files: DataFiles,
    output: Annotated[
        Path | None,
        typer.Option(
            help="Config to write; default: <file>.toml in the working folder.",
            show_default=False,
            autocompletion=complete_config,
        ),
    ] = None,
    time: TimeColumn = None,
    inputs: Annotated[
        str | None,
        typer.Option(help="Columns of inputs, separated by commas.", show_default=False),
    ] = None,
    outputs: Annotated[
        str | None,
        typer.Option(help="Columns of outputs, separated by commas.", show_default=False),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing config.")] = False,
    max_gigabytes: MaxGigabytes = None,
    sheet: Sheet = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Write a commented config for data files: ready to run, with every guess marked.

    Of several files of the same columns the last one is held out.
    """
    u, y = _columns(inputs), _columns(outputs)
    _answer(
        as_json,
        quiet,
        lambda _: cli.actions.init(
            files, output, force, max_gigabytes, time=time, inputs=u, outputs=y, sheet=sheet
        ),
    )


def _columns(text: str | None) -> list[str] | None:
    """Names of columns that are separated by commas; "" names none."""
    if text is None:
        return None
    return [name.strip() for name in text.split(",") if name.strip()]


@app.command(
    epilog=_examples(
        ("eoi validate runs/rig new.csv", "the model of the run on new data"),
        ("eoi validate runs/rig a.csv b.csv --json", "on several records, as JSON"),
    )
)
def validate(
    run: RunFolder,
    files: DataFiles,
    output: Output = RUNS,
    trust: Trust = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Judge a saved model on data files: errors of its free runs, and their correlation."""
    _answer(
        as_json, quiet, lambda update: cli.saved_models.validate(run, files, output, trust, update)
    )


@app.command(
    epilog=_examples(
        ("eoi predict runs/rig tomorrow.csv", "from its first row on"),
        ("eoi predict runs/rig u.csv --initial T=41", "a file of inputs only"),
    )
)
def predict(
    run: RunFolder,
    file: DataFile,
    initial: Initial = None,
    output: Output = RUNS,
    trust: Trust = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Predict the outputs of a saved model from planned inputs: numbers and a figure."""
    _answer(
        as_json,
        quiet,
        lambda update: cli.saved_models.predict(run, file, initial or [], output, trust, update),
    )


@app.command(
    epilog=_examples(
        ("eoi compare runs/a runs/b", "on the records that the first run held out"),
        ("eoi compare runs/a runs/b new.csv", "on new data"),
    )
)
def compare(
    paths: RunsAndFiles,
    output: Output = RUNS,
    trust: Trust = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Compare saved models on the same records: fit per cent in a table and a figure."""
    _answer(as_json, quiet, lambda update: cli.saved_models.compare(paths, output, trust, update))


@app.command(
    epilog=_examples(
        ("eoi report runs/hidden_friction --open", "regenerated, and opened in the browser"),
    )
)
def report(
    run: Run,
    opened: Annotated[bool, typer.Option("--open", help="Open it in the browser.")] = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Regenerate the report of a run, one HTML page, from the folder of the run."""
    with failures(as_json):
        outcome = cli.actions.report(run)
        show(outcome, as_json, quiet)
        if opened and outcome.place is not None:
            webbrowser.open(outcome.place.resolve().as_uri())


@app.command(
    epilog=_examples(
        ("eoi export runs/emps --language c", "model.c in the folder of the run"),
        ("eoi export runs/emps --output rig.m", "language by suffix: MATLAB and Octave"),
        ("eoi export runs/emps --parameters", "numbers: .json or .csv"),
        ("eoi export runs/emps --estimator", "recursive, with an alarm: in C"),
        ("eoi export runs/arm --robot arm.urdf …", "joints: --joint elbow:damping=b"),
    )
)
def export(
    run: Run,
    language: Language = None,
    parameters: ParametersOnly = False,
    estimator: Estimator = False,
    robot: Robot = None,
    precision: Precision = None,
    data: EstimatorData = None,
    joint: Joints = None,
    output: ExportFile = None,
    trust: Trust = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Export the model of a run, its parameters, or its estimator, for other tools."""
    with failures(as_json):
        contents = {"--language": language, "--parameters": parameters, "--robot": robot}
        cli.exports.check_single({**contents, "--estimator": estimator})
        cli.exports.check_precision(precision, estimator)
        if robot is not None or joint:
            outcome = cli.exports.robot(run, robot, joint or [], output, trust)
        elif estimator:
            outcome = cli.exports.estimator(run, output, precision or "double", data, trust)
        elif parameters:
            outcome = cli.exports.parameters(run, output, trust)
        else:
            outcome = cli.exports.export(run, language, output, trust)
        show(outcome, as_json, quiet)
