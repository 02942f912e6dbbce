"""A model as text again: the table that `plant_from_text` and a config's [model] take."""

from dataclasses import replace

from eoi_jax._checks import check
from eoi_jax.models.equations.expression import symbols_of
from eoi_jax.models.equations.printer import code_notation, power_operator, written
from eoi_jax.models.equations.system import TextDynamics
from eoi_jax.models.equations.text_model import ModelTable, plant_of
from eoi_jax.models.export.names import identifiers
from eoi_jax.models.export.program import Program, known_starts, program
from eoi_jax.models.plant import Plant

_TEXT = code_notation(
    power=power_operator("**"),
    comparisons={"≤": "<=", "≥": ">=", "=": "==", "≠": "!="},
    logic={"and": "({0} and {1})", "or": "({0} or {1})", "not": "(not {0})"},
    functions={"plain_root": "({0})**0.5"},
)


def table_of(plant: Plant) -> ModelTable:
    """A plant as a table of texts.

    Args:
        plant: any that `program` can write; one of text keeps its texts.

    Raises:
        ValueError: a model that texts cannot say: an operation, a name, two lags of one input.
    """
    model = program(plant, lags_as_states=False)
    for source, limits in model.limits.items():
        rule = f"of {source} has no place in a model as text"
        check(False, f"effect {limits[0][0]}", rule, limits[0][1], _PROGRAM)
    text = plant.dynamics
    table = (
        _of_text(plant, text, model) if isinstance(text, TextDynamics) else _written(plant, model)
    )
    plant_of(table, plant.name)  # what cannot be read back is refused here, with the reason
    return table


_PROGRAM = "Export a program (.py, .c or .m), which says what the input must go through before."


def _of_text(plant: Plant, text: TextDynamics, model: Program) -> ModelTable:
    equations = text.equations
    return ModelTable(
        outputs=plant.outputs,
        parameters=plant.parameters,
        derivatives=dict(equations.derivatives),
        inputs=plant.inputs,
        output=dict(equations.output),
        definitions=dict(equations.definitions),
        initial=dict(equations.initial),
        bounds=_bounds(plant),
        fixed=plant.fixed,
        units=plant.units,
        input_delay=_single(model.delays, "delay"),
        input_lag=_single(model.lags, "lag"),
        name=plant.name,
    )


def _written(plant: Plant, model: Program) -> ModelTable:
    names = identifiers(model, as_text=True)

    notation = replace(_TEXT, symbol=names.__getitem__)
    used = set().union(*(symbols_of(tree) for tree in model.starts.values()))
    definitions = (*model.definitions, *model.output_definitions)
    for trees in (model.rates, model.output_formulas, [tree for _, tree in definitions]):
        used |= set().union(*(symbols_of(tree) for tree in trees))
    variables = (*model.states, *model.inputs, *model.outputs)
    safe = {variable.name: names[variable.symbol] for variable in variables}
    safe |= {variable.name: names[variable.symbol] for variable, _ in model.parameters}
    passed = (*model.delays.values(), *model.lags.values())
    actuator_parameters = {name for names in passed for name in names}
    for variable, _ in model.parameters:
        rule = "must be used by the model to be exported as text"
        check(
            variable.symbol in used or variable.name in actuator_parameters,
            f"parameters[{variable.name}]",
            rule,
            "no use",
        )
    return ModelTable(
        outputs=tuple(safe[name] for name in plant.outputs),
        parameters={safe[name]: value for name, value in plant.parameters.items()},
        derivatives={
            names[variable.symbol]: written(tree, notation)
            for variable, tree in zip(model.states, model.rates, strict=True)
        },
        output={
            names[variable.symbol]: written(tree, notation)
            for variable, tree in zip(model.outputs, model.output_formulas, strict=True)
        },
        inputs=tuple(safe[name] for name in plant.inputs),
        definitions={names[symbol]: written(tree, notation) for symbol, tree in definitions},
        initial={
            **{names[symbol]: written(tree, notation) for symbol, tree in model.starts.items()},
            **{names[symbol]: f"free({value!r})" for symbol, value in model.free_starts.items()},
            **{names[symbol]: value for symbol, value in known_starts(plant).items()},
        },
        bounds={safe[name]: pair for name, pair in _bounds(plant).items()},
        fixed=tuple(safe[name] for name in plant.fixed),
        units={safe[name]: unit for name, unit in plant.units.items() if name in safe},
        input_delay={safe[k]: safe[p] for k, p in _single(model.delays, "delay").items()},
        input_lag={safe[k]: safe[p] for k, p in _single(model.lags, "lag").items()},
        name=plant.name,
    )


def _bounds(plant: Plant) -> dict[str, tuple[float | None, float | None]]:
    """Those that bound anything; JSON has no infinity."""
    limits = zip(plant.names, plant.lower.tolist(), plant.upper.tolist(), strict=True)
    infinity = float("inf")
    return {
        name: (None if low == -infinity else low, None if high == infinity else high)
        for name, low, high in limits
        if low > -infinity or high < infinity
    }


def _single(passed: dict[str, tuple[str, ...]], kind: str) -> dict[str, str]:
    for source, names in passed.items():
        rule = f"must have at most one {kind} to be exported as text"
        check(len(names) == 1, source, rule, ", ".join(names))
    return {source: names[0] for source, names in passed.items()}
