"""A plant from equations that are text: nothing in it is run as code."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
import numpy as np

from eoi_jax._checks import check, check_choice, real
from eoi_jax._schema import struct
from eoi_jax.models.augmented import Placed, acting
from eoi_jax.models.effects import ActuatorLag, InputDelay
from eoi_jax.models.equations.system import Equations, TextDynamics, TextInternal, TextStart
from eoi_jax.models.plant import Plant

FORMAT = 1
KIND = "eoi_jax model"


class ModelTable(msgspec.Struct, frozen=True, omit_defaults=True):
    """[model]: a plant as text; the arguments of `plant_from_text`, which says what they are."""

    outputs: tuple[str, ...]
    parameters: dict[str, float]
    derivatives: dict[str, str] = {}
    output: dict[str, str] = {}
    inputs: tuple[str, ...] = ()
    definitions: dict[str, str] = {}
    initial: dict[str, float | str] = {}
    bounds: dict[str, tuple[float | None, float | None]] = {}
    fixed: tuple[str, ...] = ()
    units: dict[str, str] = {}
    kinds: dict[str, str] = {}
    input_delay: dict[str, str] = {}
    input_lag: dict[str, str] = {}
    name: str = ""


def plant_from_text(
    derivatives: Mapping[str, str],
    parameters: Mapping[str, float],
    outputs: Sequence[str],
    inputs: Sequence[str] = (),
    *,
    output: Mapping[str, str] | None = None,
    definitions: Mapping[str, str] | None = None,
    initial: Mapping[str, float | str | None] | None = None,
    bounds: Mapping[str, tuple[float | None, float | None]] | None = None,
    fixed: Sequence[str] = (),
    units: Mapping[str, str] | None = None,
    kinds: Mapping[str, str] | None = None,
    input_delay: Mapping[str, str] | None = None,
    input_lag: Mapping[str, str] | None = None,
    name: str = "model",
) -> Plant:
    r"""A plant whose equations are text, such as ``"-a*sin(angle) - b*rate + d*voltage"``.

    Each state has its derivative in time. Where the derivative of an output is the name of another
    state, ``angle = "rate"``, that state is its rate and not measured; the last one of such a chain
    has the equation, and the chain's length is the relative degree. A state in no chain is an
    internal one, with a value at the start of a record.

    An output that is no state is a function of the states, the other outputs and the inputs, of
    relative degree 0: ``output={"voltage": "3.4 + 0.7*soc - R0*current - v1"}``. At a sample it has
    the value of the inputs that holds from there on. A definition with the name of an output that
    has no derivative is taken as its equation.

    Equations hold declared names, ``t`` [s], ``pi``, numbers, ``+ - * / **``, comparisons, ``and or
    not``, ``a if condition else b`` and the functions sin cos tan asin acos atan atan2 sinh cosh
    tanh asinh acosh atanh exp expm1 log log1p sqrt cbrt abs sign min max clip where floor ceil
    round trunc rem. ``sqrt`` is 0 below 0; of a state that reaches zero write other powers as
    ``max(x, 0)**n``, for ``x**n`` of a negative x is no number unless n is whole. Dry friction is
    ``c*sign(rate)``: it sticks, as with any other plant. No text is run: it is read by a grammar of
    its own.

    Args:
        derivatives: equation by state [unit of the state / s].
        parameters: names and nominal values θ_0.
        outputs: names of what is measured, in the order of the record's columns.
        inputs: names.
        output: equations of outputs that are functions of the states [units of the outputs].
        definitions: parts of equations by name, in any order.
        initial: at the start of a record: internal states, a number or a text in the parameters
            [their units], or None or ``"free"``: estimated of each record by itself, from zero on,
            or from 0.8 on by ``"free(0.8)"``; outputs and their rates where they are known, a
            number: ``{"rate": 0.0}`` is released from rest, as of `Plant`.
        bounds: ``{name: (lower, upper)}`` of parameters; None for no bound.
        fixed: parameters that keep their nominal value.
        units: ``{name: unit}`` of parameters, inputs, outputs and states.
        kinds: what an output is, as of `Plant`.
        input_delay: by input: the parameter that is its delay [s].
        input_lag: by input: the parameter that is the time constant of its first-order lag [s].
        name: what to call it.

    Returns:
        A `Plant`, equal to the one that the same functions in Python make.

    Raises:
        ValueError: a text that is no such equation (shown with the column marked), an unknown
            name, an output with two equations or one that depends on itself, a parameter,
            definition or internal state that is not used, and what `Plant` objects to.
    """
    derivatives, outputs = dict(derivatives), tuple(outputs)
    starts = {key: _text(key, value) for key, value in (initial or {}).items()}
    parts, formulas = dict(definitions or {}), dict(output or {})
    for key in outputs:
        if key in parts and key not in derivatives and key not in formulas:
            formulas[key] = parts.pop(key)
    equations = Equations(
        tuple(derivatives.items()),
        tuple(parts.items()),
        tuple(starts.items()),
        outputs,
        tuple(inputs),
        tuple(parameters),
        tuple(formulas.items()),
    )
    check(len(outputs) > 0, "model.outputs", "must name at least one output", "none")
    check(len(set(outputs)) == len(outputs), "model.outputs", "must have different names", outputs)
    placed = _placed(input_lag or {}, input_delay or {}, equations)
    equations.check(elsewhere=[actuator.names[0] for actuator in placed])
    names = (*parameters, *derivatives, *inputs, *formulas)
    for key in units or {}:
        check_choice("model.units", key, names)
    moving = bool(equations.states)
    return Plant(
        TextDynamics(equations),
        dict(parameters),
        relative_degree=equations.degrees,
        inputs=tuple(inputs),
        outputs=outputs,
        internal=TextInternal(equations) if moving else None,
        internal_initial=TextStart(equations) if moving else None,
        initial=equations.known_starts,
        bounds={key: _limits(pair) for key, pair in (bounds or {}).items()},
        fixed=tuple(fixed),
        units=units,
        kinds=kinds,
        name=name,
        actuator=acting(placed) if placed else None,
    )


def _text(name: str, value: float | str | None) -> str:
    if value is None or isinstance(value, str):
        return "free" if value is None else value
    rule = "must be a number, a text in the parameters, or None where it is free"
    check(not np.isnan(real(value)), f"model.initial.{name}", rule, value)
    return repr(float(value))


def _limits(pair: tuple[float | None, float | None]) -> tuple[float, float]:
    low, high = pair
    return -np.inf if low is None else float(low), np.inf if high is None else float(high)


def _placed(
    lags: Mapping[str, str], delays: Mapping[str, str], equations: Equations
) -> tuple[Placed, ...]:
    actuators = []
    for field, items, effect in (
        ("input_lag", lags, ActuatorLag()),
        ("input_delay", delays, InputDelay()),
    ):
        for key, parameter in items.items():
            check_choice(f"model.{field}", key, equations.inputs)
            check_choice(f"model.{field}.{key}", parameter, equations.parameters)
            actuators.append(Placed(effect, equations.inputs.index(key), (parameter,)))
    return tuple(actuators)


# -- files ------------------------------------------------------------------------------------


def plant_of(table: ModelTable, name: str) -> Plant:
    """The plant of a table.

    Args:
        table: [model] of a config, or of a file that `export` wrote.
        name: what to call a plant without a name.

    Raises:
        ValueError: what `plant_from_text` objects to.
    """
    arguments = msgspec.structs.asdict(table)
    derivatives, parameters = arguments.pop("derivatives"), arguments.pop("parameters")
    return plant_from_text(derivatives, parameters, **{**arguments, "name": table.name or name})


def model_json(table: ModelTable, version: str) -> str:
    """A model as JSON, which `plant_from_json` reads.

    Args:
        table: the model.
        version: of the package that writes it.
    """
    content = {"kind": KIND, "format": FORMAT, "version": version, "model": table}
    return json.dumps(msgspec.to_builtins(content), indent=2, ensure_ascii=False) + "\n"


def plant_from_json(text: str, field: str = "path") -> Plant:
    """The plant that `model_json` wrote.

    Args:
        text: of the file.
        field: what to call it in messages.

    Raises:
        ValueError: no such file, one of a newer version, or a model with a mistake.
    """
    try:
        content: Any = json.loads(text)
    except (ValueError, RecursionError):
        content = None
    good = isinstance(content, dict) and content.get("kind") == KIND
    check(
        good, field, "must be a model that `export` wrote", "other JSON" if content else "no JSON"
    )
    written = content.get("format")
    check(
        isinstance(written, int) and written <= FORMAT,
        field,
        f"must be of format {FORMAT} or older",
        f"format {written}, written by eoi_jax {content.get('version')}",
        "Update eoi_jax.",
    )
    return plant_of(struct(ModelTable, content.get("model"), "model"), "model")
