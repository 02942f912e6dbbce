"""Write a model to a file of another language."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.metadata import version as version_of
from pathlib import Path
from typing import Any

from eoi_jax._checks import check, check_choice
from eoi_jax.data.record import Record
from eoi_jax.models.equations.display import equation_lines
from eoi_jax.models.equations.expression import Symbol
from eoi_jax.models.equations.right_sides import right_sides
from eoi_jax.models.equations.text_model import model_json
from eoi_jax.models.export.c import c_text
from eoi_jax.models.export.files import write_content
from eoi_jax.models.export.idnlgrey import idnlgrey_function, idnlgrey_script
from eoi_jax.models.export.matlab import matlab_text
from eoi_jax.models.export.names import identifier
from eoi_jax.models.export.numpy_python import python_text
from eoi_jax.models.export.program import Program, program
from eoi_jax.models.export.table import table_of
from eoi_jax.models.export.tex import latex_text
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.traced_step import step_program, with_sticking_outputs

_FUNCTIONS: dict[str, Callable[[Program, str, str], str]] = {
    "python": python_text,
    "matlab": matlab_text,
}
SUFFIXES = {".py": "python", ".c": "c", ".m": "matlab", ".tex": "latex", ".json": "json"}
LANGUAGES = (*SUFFIXES.values(), "idnlgrey")


def export(model: Any, path: str | Path, language: str | None = None) -> Path:
    r"""Write a model, with the effects that were found, to a file that other tools run.

    Python, C and MATLAB (and GNU Octave) get a function of t [s], the states and the inputs that
    gives the rates d/dt of the states: ``name(t, states, inputs)``, in C ``void name(t, states,
    inputs, rates)`` with arrays of double, named as the file. States are each output followed by
    its derivatives, then internal states, then one for each lag of an input; the file says which,
    with units, values at the start, delays of inputs and where dry friction makes it set-valued.
    Outputs that are functions of the states come from a second function, ``name_outputs``, in
    MATLAB as a second result.

    The C file also has ``void name_step(t, h, substeps, states, inputs, next_inputs)``, which moves
    the states on by a sample period h [s] as `rollout` does: the same Runge-Kutta steps, as many,
    with dry friction that sticks. Lags of inputs are states in it, which `rollout` follows exactly,
    and inputs behind delays are given as they come out of them. It allocates nothing. Where the
    simulation does not cover the friction of a plant, the file says so instead.

    Parameters are named constants. LaTeX gets the equations and a table of the parameters, JSON the
    model as text, which `load` reads back to a plant that simulates equally.

    ``"idnlgrey"`` is for MATLAB's System Identification Toolbox: a function ``[dx, y] = name(t, x,
    u, p1, p2, …, varargin)``, and beside it the script ``name_idnlgrey.m``, which builds the object
    with parameters, bounds, units and initial states: known ones, and of a result otherwise the
    first samples of its first record.

    The formulas are those that JAX traces, so any model of arithmetic on states, inputs and
    parameters can be exported; values agree to rounding where they are real and finite.

    Args:
        model: a `Plant`, or any result with a `plant` (`Identification`, `Discovery`, …).
        path: of the file; the suffix says the language where `language` is None.
        language: ``"python"``, ``"c"``, ``"matlab"``, ``"latex"``, ``"json"`` or ``"idnlgrey"``.

    Returns:
        The path.

    Raises:
        ValueError: no plant, an unknown language, a name that is none for a function, a folder
            that cannot be written, a file in its place that eoi_jax did not write, or a model that
            holds what is no such arithmetic (which).
    """
    plant = model if isinstance(model, Plant) else getattr(model, "plant", None)
    rule = "must be a Plant or a result that has one"
    check(isinstance(plant, Plant), "model", rule, type(model).__name__)
    path = Path(path)
    if language is None:
        advice = "Or name the `language`."
        rule = f"must end in {', '.join(SUFFIXES)}"
        check(path.suffix in SUFFIXES, "path", rule, path, advice)
        language = SUFFIXES[path.suffix]
    check_choice("language", language, LANGUAGES)
    records = getattr(model, "records", ())
    texts = model_texts(plant, language, path.stem, records[:1])  # type: ignore[arg-type]
    for name, text in texts.items():
        write_content(path.with_stem(name), text.encode())
    return path


def suffix_of(language: str) -> str:
    """That of a file in a language.

    Args:
        language: one of `LANGUAGES`.
    """
    return next((key for key, value in SUFFIXES.items() if value == language), ".m")


def model_texts(
    plant: Plant, language: str, name: str, records: Sequence[Record] = ()
) -> dict[str, str]:
    """What `export` writes.

    Args:
        plant: any that can be exported.
        language: one of `LANGUAGES`.
        name: of the function.
        records: the first one, where states begin that have no known start; none is no matter.

    Returns:
        The text of each file, by its name without suffix.
    """
    version = version_of("eoi_jax")
    if language == "json":
        return {name: model_json(table_of(plant), version)}
    if language == "latex":
        return {name: _latex_text(plant, version)}
    fitting = identifier(name)
    rule = "must be named as a function can be"
    check(name == fitting, "path", rule, name, f"For example {fitting}.")
    model = _begun(program(plant), plant.outputs, records)
    if language == "idnlgrey":
        script = idnlgrey_script(plant, model, name, version)
        function = idnlgrey_function(plant, model, name, version)
        return {f"{name}_idnlgrey": script, name: function}
    if language == "c":
        return {name: _c_text(plant, model, name, version)}
    return {name: _FUNCTIONS[language](model, name, version)}


def _begun(model: Program, outputs: Sequence[str], records: Sequence[Record]) -> Program:
    """With the first measured samples of outputs whose start is not known."""
    known = {symbol.name for symbol in model.start_values if not symbol.order}
    states = {variable.symbol for variable in model.states}
    starts = {}
    for record in records[:1]:
        for j, name in enumerate(outputs):
            measured = record.outputs[record.output_valid[:, j], j]
            if Symbol(name) in states and name not in known and measured.size:
                starts[Symbol(name)] = float(measured[0])
    return replace(model, measured_starts=starts)


def _latex_text(plant: Plant, version: str) -> str:
    """With matrix equations, where the model solves such; a lag would be none of their names."""
    model = program(plant)
    sides = None if model.lags else right_sides(plant)
    if sides is None or not sides.coupled:
        return latex_text(model, version)
    lines, _ = equation_lines(plant)
    return latex_text(model, version, [(lhs, rhs) for lhs, rhs, _ in lines])


def _c_text(plant: Plant, model: Program, name: str, version: str) -> str:
    """With the step of the simulation, where it covers the plant."""
    try:
        model = with_sticking_outputs(plant, model)
        step, reason = step_program(plant, model), ""
    except ValueError as error:
        step, reason = None, str(error)
    return c_text(model, name, version, step, reason)
