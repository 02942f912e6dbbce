"""A model for `idnlgrey` of MATLAB's System Identification Toolbox: its function, and a script."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

from eoi_jax.models.equations.expression import Symbol, symbols_of
from eoi_jax.models.export.matlab import filled, helpers, listing_of
from eoi_jax.models.export.names import LIMITED, comment, on_input
from eoi_jax.models.export.program import Program, Variable
from eoi_jax.models.plant import Plant

# Names of the function itself, with an order that no name of a model has.
_ARGUMENTS = ("x", "u", "dx", "y", "varargin")


def idnlgrey_function(plant: Plant, model: Program, name: str, version: str) -> str:
    """The file: ``[dx, y] = name(t, x, u, p1, p2, …, varargin)``; without inputs there is no u.

    Args:
        plant: whose right-hand side `model` is.
        model: that.
        name: of the function, an identifier; MATLAB finds it by the name of the file.
        version: of this package.
    """
    arguments = (*model.arguments, *(Symbol(argument, -1) for argument in _ARGUMENTS))
    outputs = tuple(
        Variable(Symbol(output), output, plant.units.get(output, "")) for output in plant.outputs
    )
    listing = listing_of(replace(model.of_both, arguments=arguments, outputs=outputs))
    formulas = dict(zip((v.name for v in model.outputs), model.output_formulas, strict=True))
    shown = [formulas.get(output, Symbol(output)) for output in plant.outputs]
    elements = {"states": "x", "inputs": "u"}
    names = [listing.names[variable.symbol] for variable, _ in _parameters(model)]
    given = ", ".join(["t", "x", *(["u"] if model.inputs else []), *names, "varargin"])
    seen = listing.reading(shown)
    body = [
        *listing.top("%", ("(", ")", "1"), version, ("x", "u", "y")),
        *seen.elements(lambda vector, k: f"{elements[vector]}({k + 1})"),
        *listing.definitions(),
        *filled(listing, "dx", model.rates),
        *filled(listing, "y", shown),
    ]
    lines = "\n".join([f"function [dx, y] = {name}({given})", *body, "end"])
    return f"{lines}\n{helpers(listing)}"


def idnlgrey_script(plant: Plant, model: Program, name: str, version: str) -> str:
    """A script that builds the object `model` of that function.

    Args:
        plant: with values, bounds and units.
        model: its right-hand side.
        name: of the function.
        version: of this package.
    """
    order = f"[{len(plant.outputs)} {len(model.inputs)} {len(model.states)}]"
    outputs = [(output, plant.units.get(output, "")) for output in plant.outputs]
    inputs = [(variable.name, variable.unit) for variable in model.inputs]
    options = [f"'Name', {_quoted(plant.name)}"]
    for channel, pairs in (("Input", inputs), ("Output", outputs)):
        if pairs:
            channels, units = zip(*pairs, strict=True)
            options += [f"'{channel}Name', {_column(map(_quoted, channels))}"]
            options += [f"'{channel}Unit', {_column(map(_quoted, units))}"]
    lines = [
        f"% The model of {name}.m as an object of the System Identification Toolbox.",
        f"% Written by eoi_jax {version}.",
        *(f"% {line}" for line in _remarks(model)),
        "",
        *_parameter_lines(plant, model),
        *_state_lines(model),
        f"model = idnlgrey('{name}', {order}, parameters, initial_states, 0, ...",
        *(f"    {option}, ..." for option in options),
        "    'TimeUnit', 's');",
    ]
    return "\n".join(lines) + "\n"


def _parameters(model: Program) -> list[tuple[Variable, float]]:
    """Those of the formulas: a delay, or a limit before the model, has no place in them."""
    on_inputs = on_input(model)
    return [pair for pair in model.parameters if pair[0].name not in on_inputs]


def _remarks(model: Program) -> list[str]:
    lines = []
    values = {variable.name: value for variable, value in model.parameters}
    for source, names in model.delays.items():
        late = sum(values[name] for name in names)
        lines.append(f"The input {comment(source)} acts {late!r} s late: delay it in the data.")
    for source, limits in model.limits.items():
        lines.append(f"The input {comment(source)} of the data must first become")
        lines += [f"  {LIMITED[kind].format(repr(values[name]))}." for kind, name in limits]
    for symbol, start in model.starts.items():
        if symbols_of(start):
            name = comment(symbol.name)
            lines.append(f"{name} starts where parameters say: here at their values.")
    if model.rough:
        lines.append("Dry friction makes dx jump with the sign of a velocity: a solver with small")
        lines.append("steps chatters there, and does not stick.")
    return lines


def _parameter_lines(plant: Plant, model: Program) -> list[str]:
    limits = {
        key: (low, high)
        for key, low, high in zip(
            plant.names, plant.lower.tolist(), plant.upper.tolist(), strict=True
        )
    }
    rows = [
        (
            _quoted(variable.name),
            _quoted(variable.unit),
            _number(value),
            *map(_number, limits[variable.name]),
            _flag(variable.name in plant.fixed),
        )
        for variable, value in _parameters(model)
    ]
    return _structure("parameters", rows)


def _state_lines(model: Program) -> list[str]:
    """Known starts are fixed; others begin where the first record does, free ones at a guess."""
    starts = {**model.free_starts, **model.measured_starts, **model.start_values}
    rows = [
        (
            _quoted(variable.name),
            _quoted(variable.unit),
            _number(starts.get(variable.symbol, 0.0)),
            "-Inf",
            "Inf",
            _flag(variable.symbol in model.start_values),
        )
        for variable in model.states
    ]
    return _structure("initial_states", rows)


def _structure(name: str, rows: Sequence[Sequence[str]]) -> list[str]:
    """A column of structures, a line a field."""
    if not rows:
        return [f"{name} = [];"]
    fields = ("Name", "Unit", "Value", "Minimum", "Maximum", "Fixed")
    columns = zip(fields, zip(*rows, strict=True), strict=True)
    lines = [f"    '{field}', {_column(column)}" for field, column in columns]
    return [f"{name} = struct( ...", ", ...\n".join(lines) + ");"]


def _column(entries: Iterable[str]) -> str:
    return "{" + "; ".join(entries) + "}"


def _quoted(text: str) -> str:
    quoted = comment(text).replace("'", "''")
    return f"'{quoted}'"


def _number(value: float) -> str:
    return {float("inf"): "Inf", -float("inf"): "-Inf"}.get(value, repr(value))


def _flag(value: bool) -> str:
    return "true" if value else "false"
