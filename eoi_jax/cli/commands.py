"""The commands of ``eoi``: their options, their help with examples, their completion.

What a command does is in `cli.actions`, which is imported when one of its functions is called: help
and a shell that completes a word do not wait for JAX.
"""

import sys
import webbrowser
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from eoi_jax import cli
from eoi_jax.cli.options import (
    MAX_GIGABYTES,
    RUNS,
    AsJson,
    Data,
    DataFile,
    MaxGigabytes,
    Output,
    Quiet,
    Run,
    Source,
    complete_config,
)
from eoi_jax.cli.terminal import Commands, Shown, debug, failures, heard, progress, show

app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["--help", "-h"]},
)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"eoi_jax {cli.version.installed()}")
        raise typer.Exit


def _examples(*lines: tuple[str, str]) -> str:
    """Calls and what they do, below a command's help."""
    width = max(len(call) for call, _ in lines)
    shown = [f"  [cyan]{call:{width}}[/cyan]  {what}" for call, what in lines]
    return "\n".join(["[bold]Examples[/bold]", *shown])


def _answer(as_json: bool, quiet: bool, action: Callable[[Shown | None], Any]) -> None:
    """Run an action, which is given the callback that shows progress, and show how it ended."""
    with failures(as_json):
        with progress(not quiet) as shown:
            ending = action(shown)
        show(ending, as_json, quiet)


@app.callback(
    epilog=_examples(
        ("eoi discover", "a built-in example: a hidden effect"),
        ("eoi inspect run.csv", "what is in a file of yours"),
        ("eoi init run.csv", "writes run.toml, which runs as it is"),
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
        bool, typer.Option("--debug", help="Show where in the program an error comes from.")
    ] = False,
) -> None:
    """Identify a plant, and find what its model lacks, from the equivalent output injection.

    Exit status: 0 answer found, 1 no answer (says why), 2 wrong call, config or data, 130 stopped.
    """
    del version
    debug(with_traceback)


@app.command(
    epilog=_examples(
        ("eoi identify", "the built-in pendulum"),
        ("eoi identify rig.toml", "results go to runs/<its name>/"),
        ("eoi identify rig.toml --data DIR", "its data files lie in DIR"),
        ("eoi identify rig.toml --json > rig.json", "for a program"),
    )
)
def identify(
    config: Source = None,
    data: Data = None,
    output: Output = RUNS,
    as_json: AsJson = False,
    quiet: Quiet = False,
    passes: Annotated[
        int | None, typer.Option(min=1, help="Instead of the config's.", show_default=False)
    ] = None,
) -> None:
    """Identify a plant's parameters from simulated or measured records."""
    _answer(as_json, quiet, lambda shown: cli.actions.identify(config, data, output, passes, shown))


@app.command(
    epilog=_examples(
        ("eoi discover", "the built-in example, which hides dry friction"),
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
    """Find what a plant's model lacks: name the effect, add it, compare before and after."""
    _answer(as_json, quiet, lambda shown: cli.actions.discover(config, data, output, shown))


@app.command(
    epilog=_examples(
        ("eoi refine", "the built-in pendulum"),
        ("eoi refine rig.toml", "passes first, then the free run itself"),
    )
)
def refine(
    config: Source = None,
    data: Data = None,
    output: Output = RUNS,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Identify, then fit the free run itself: output error, with what it is sure of."""
    _answer(as_json, quiet, lambda shown: cli.actions.refine(config, data, output, shown))


@app.command(
    epilog=_examples(
        ("eoi sweep", "the built-in example, 1200 lanes"),
        ("eoi sweep rig.toml", "interrupted, the same command goes on"),
        ("eoi sweep rig.toml --part 3/10", "one of ten jobs on one store"),
    )
)
def sweep(
    config: Source = None,
    data: Data = None,
    output: Output = RUNS,
    part: Annotated[
        str, typer.Option(help="i/n: every n-th chunk from the i-th (0 … n-1), for a job array.")
    ] = "0/1",
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Try many gains, filters, starts and resamples; interrupted, the same command goes on."""
    with failures(as_json):
        with heard():
            bar = not quiet and sys.stderr.isatty()
            ending = cli.actions.sweep(config, data, output, part, bar)
        show(ending, as_json, quiet)


@app.command(
    epilog=_examples(
        ("eoi inspect run.csv", "what is in it: columns, clock, noise, guesses"),
        ("eoi inspect run.csv --json", "for a program"),
    )
)
def inspect(
    file: DataFile,
    output: Output = RUNS,
    max_gigabytes: MaxGigabytes = MAX_GIGABYTES,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Look at a data file before anything is configured: a table, and a picture."""
    _answer(as_json, quiet, lambda shown: cli.actions.inspect(file, output, shown, max_gigabytes))


@app.command(
    epilog=_examples(
        ("eoi init run.csv", "writes run.toml, for identify and discover"),
        ("eoi init run.csv --output rig.toml", "under another name"),
    )
)
def init(
    file: DataFile,
    output: Annotated[
        Path | None,
        typer.Option(
            help="The config to write; left out: <file>.toml here.",
            show_default=False,
            autocompletion=complete_config,
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a config that is there.")] = False,
    max_gigabytes: MaxGigabytes = MAX_GIGABYTES,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Write a commented config for a data file; it runs as it is, and says what is guessed."""
    _answer(as_json, quiet, lambda _: cli.actions.init(file, output, force, max_gigabytes))


@app.command(
    epilog=_examples(
        ("eoi report runs/hidden_friction --open", "made anew, and opened in the browser"),
    )
)
def report(
    run: Run,
    opened: Annotated[bool, typer.Option("--open", help="Open it in the browser.")] = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Make the report of a run anew: one HTML page, from the run's folder alone."""
    with failures(as_json):
        ending = cli.actions.report(run)
        show(ending, as_json, quiet)
        if opened and ending.place is not None:
            webbrowser.open(ending.place.resolve().as_uri())


@app.command(
    epilog=_examples(
        ("eoi export runs/emps --language c", "model.c beside the run's files"),
        ("eoi export runs/emps --output rig.m", "by the suffix: MATLAB and Octave"),
    )
)
def export(
    run: Run,
    language: Annotated[
        str | None,
        typer.Option(help="python, c, matlab, latex or json; else by the file's suffix."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            help="File to write; else model.* beside the run's files.", show_default=False
        ),
    ] = None,
    trust: Annotated[
        bool, typer.Option("--trust", help="Run the Python file that holds the run's model.")
    ] = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Write the model of a run, with the effects that were found, for another tool."""
    with failures(as_json):
        ending = cli.actions.export(run, language, output, trust)
        show(ending, as_json, quiet)
