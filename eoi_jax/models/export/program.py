"""A plant's right-hand side as named formulas: what every language prints.

f and g are traced whatever they are written in and whatever effects were added; what is used twice
gets a name.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import jax.numpy as jnp

from eoi_jax._checks import check
from eoi_jax.compiler.graph import Node, Untranslatable
from eoi_jax.models.augmented import actuator_effects
from eoi_jax.models.effects import ActuatorLag, InputDelay, InputPlay, RateLimit
from eoi_jax.models.effects.effect import internal_names
from eoi_jax.models.equations.expression import Expression, Symbol
from eoi_jax.models.equations.from_plant import (
    SymbolicPlant,
    plain_formulas,
    shared_formulas,
    unused_names,
)
from eoi_jax.models.equations.system import TextDynamics
from eoi_jax.models.input_strength import input_strengths
from eoi_jax.models.plant import Plant
from eoi_jax.models.velocities import velocity_rows


@dataclass(frozen=True)
class Variable:
    """One name of a model.

    Attributes:
        symbol: as formulas have it.
        name: as its owner knows it; any text.
        unit: any text; "" where unknown.
        note: what it is, for a comment; may be empty.
    """

    symbol: Symbol
    name: str
    unit: str
    note: str = ""


@dataclass(frozen=True)
class Program:
    """d/dt of all states of a plant, and the outputs that are functions of the states.

    Attributes:
        name: of the plant.
        states: of each output itself and its derivatives below r; internal states; lags of inputs.
        rates: of the states, one each.
        starts: the internal states at the start, in the parameters.
        start_values: the same as numbers, and known starts of the outputs and their derivatives.
        inputs: as measured.
        parameters: with their values.
        definitions: parts that formulas share, each using earlier ones only.
        delays: by input, the parameters whose sum it is late by.
        lags: by input, the parameters that are its time constants.
        limits: by input, kind and parameter of what it goes through before the model: a limit of
            its rate (``"rate_limit"``) or a play (``"input_play"``), in this order. A right-hand
            side has no place for what moves no faster, or not at all.
        rough: states whose change of sign makes a rate jump: dry friction.
        outputs: those that are functions of the states.
        output_formulas: what they are.
        output_definitions: parts that these share.
        arguments: what the formulas depend on besides states, inputs and parameters.
        estimated_starts: internal states that free runs start elsewhere where a record shows it.
        measured_starts: outputs without a known start, where the first record begins.
        free_starts: internal states without one, and where a search for it begins.
    """

    name: str
    states: tuple[Variable, ...]
    rates: tuple[Expression, ...]
    starts: dict[Symbol, Expression]
    start_values: dict[Symbol, float]
    inputs: tuple[Variable, ...]
    parameters: tuple[tuple[Variable, float], ...]
    definitions: tuple[tuple[Symbol, Expression], ...]
    delays: dict[str, tuple[str, ...]]
    lags: dict[str, tuple[str, ...]]
    limits: dict[str, tuple[tuple[str, str], ...]]
    rough: tuple[Symbol, ...]
    outputs: tuple[Variable, ...] = ()
    output_formulas: tuple[Expression, ...] = ()
    output_definitions: tuple[tuple[Symbol, Expression], ...] = ()
    arguments: tuple[Symbol, ...] = (Symbol("t"),)
    estimated_starts: tuple[Symbol, ...] = ()
    measured_starts: Mapping[Symbol, float] = field(default_factory=dict)
    free_starts: Mapping[Symbol, float] = field(default_factory=dict)

    @property
    def of_outputs(self) -> "Program":
        """The same with the formulas of the outputs in the place of the rates."""
        return replace(self, rates=self.output_formulas, definitions=self.output_definitions)

    @property
    def of_both(self) -> "Program":
        """The same with the formulas of the outputs behind the rates."""
        return replace(
            self,
            rates=(*self.rates, *self.output_formulas),
            definitions=(*self.definitions, *self.output_definitions),
        )


# Operations of `jax.numpy.linalg` that are not written out, by their names in JAX.
_OF_MATRICES = (
    "qr",
    "householder_product",
    "eigh",
    "eig",
    "svd",
)
_MATRICES = (
    "It belongs to `jax.numpy.linalg`, of which `solve`, `inv`, `det` and `cholesky` can be "
    "written out; `discover`, `refine` and `simulate` work as it is."
)
_ARITHMETIC = "Write it with + - * / **, comparisons, `where`, and functions such as sin or sqrt."


def program(plant: Plant, *, lags_as_states: bool = True) -> Program:
    """The formulas of a plant.

    Args:
        plant: any, with effects or without.
        lags_as_states: whether a lag of an input is a state behind the others; else formulas have
            the input as it comes out of the lag.

    Raises:
        ValueError: the model holds what is no arithmetic on its states (which operation), an
            actuator of the user's own, or a channel with the name of the time.
    """
    _check_exportable(plant)
    symbolic = SymbolicPlant(plant)
    delays, lags, limits = _on_inputs(plant)
    added, inputs = _lagged(symbolic, lags) if lags_as_states else ([], symbolic.inputs)
    try:
        f = symbolic.nodes(plant.derivative, inputs)
        g = symbolic.nodes(plant.internal_rate, inputs)
        start = symbolic.nodes(lambda _t, _x, _u, theta: plant.internal_start(theta), inputs)
    except Untranslatable as error:
        rule = "must be arithmetic on states, inputs and parameters to be exported"
        matrix = str(error) in _OF_MATRICES
        check(False, "plant", rule, f"the operation {error}", _MATRICES if matrix else _ARITHMETIC)
        raise
    states, rates = _chains(symbolic, f)
    for name, node in zip(internal_names(plant), g, strict=True):
        states.append(_variable(plant, Symbol(name), name, "internal state, not measured"))
        rates.append(node)
    for name, node, source in added:
        note = f"{source} behind its lag; starts at the first value of {source}"
        states.append(Variable(Symbol(name), name, plant.units.get(source, ""), note))
        rates.append(node)
    unused = unused_names((*plant.names, *plant.inputs, *(variable.name for variable in states)))
    trees, definitions = shared_formulas(rates, unused)
    algebraic = [j for j, degree in enumerate(plant.degrees) if degree == 0]
    output_trees, output_definitions = shared_formulas([f[j] for j in algebraic], unused)
    names = [Symbol(name) for name in internal_names(plant)]
    strengths = {
        strength.parameter: strength.text(plant.parameters[strength.parameter])
        for strength in input_strengths(plant)
    }
    values = dict(zip(names, plant.initial_internal.tolist(), strict=True))
    free = {name: values.pop(name) for name, is_free in
            zip(names, plant.free_internal, strict=True) if is_free}  # fmt: skip
    dry = zip(plant.outputs, velocity_rows(plant.degrees), plant.dry_friction, strict=True)
    return Program(
        plant.name,
        tuple(states),
        tuple(trees),
        dict(zip(names, plain_formulas(start), strict=True)),
        {**values, **known_starts(plant)},
        tuple(_variable(plant, Symbol(name), name) for name in plant.inputs),
        tuple(
            (_variable(plant, Symbol(name, parameter=True), name, strengths.get(name, "")), value)
            for name, value in plant.parameters.items()
        ),
        tuple(definitions),
        delays,
        lags,
        limits,
        tuple(Symbol(name, row) for name, row, rough in dry if rough),
        tuple(_variable(plant, Symbol(name), name) for name in
              (plant.outputs[j] for j in algebraic)),
        tuple(output_trees),
        tuple(output_definitions),
        estimated_starts=tuple(name for name, is_open in
                               zip(names, plant.open_internal, strict=True) if is_open),
        free_starts=free,
    )  # fmt: skip


def _check_exportable(plant: Plant) -> None:
    """Check the precision, and that no channel is called t."""
    double = jnp.result_type(float) == jnp.float64
    advice = "Call `eoi_jax.configure()` before JAX is used."
    check(double, "precision", "must be double to export a model", "single", advice)
    for kind, names in (("inputs", plant.inputs), ("outputs", plant.outputs)):
        rule = "must not be called t to be exported, which is the time in equations"
        check("t" not in names, f"plant.{kind}", rule, ", ".join(names), "Give it another name.")


def _variable(plant: Plant, symbol: Symbol, name: str, note: str = "") -> Variable:
    return Variable(symbol, name, plant.units.get(name, ""), note)


def known_starts(plant: Plant) -> dict[Symbol, float]:
    """Known starts of outputs and their derivatives."""
    return {
        Symbol(name, row): value
        for name, values in plant.start_items
        for row, value in enumerate(values)
        if value is not None
    }


def _chains(symbolic: SymbolicPlant, f: Sequence[Node]) -> tuple[list[Variable], list[Node]]:
    """States of the outputs, output by output, and their rates."""
    plant = symbolic.plant
    text = plant.dynamics.equations.chains if isinstance(plant.dynamics, TextDynamics) else {}
    states, rates = [], []
    for j, (output, degree) in enumerate(zip(plant.outputs, plant.degrees, strict=True)):
        for i in range(degree):
            name = text[output][i] if text else _derivative_name(output, i)
            output_unit = plant.units.get(output, "")
            power = "" if i < 2 else f"^{i}"
            unit = f"{output_unit}/s{power}" if output_unit and i else output_unit
            note = "" if i == 0 else f"derivative {i} of {output}"
            states.append(Variable(Symbol(output, i), name, unit, note))
            rates.append(symbolic.y[i + 1, j] if i + 1 < degree else f[j])
    return states, rates


def _derivative_name(output: str, order: int) -> str:
    return output + ("", "_rate")[min(order, 1)] + (f"_{order}" if order > 1 else "")


ByInput = dict[str, tuple[str, ...]]


def _on_inputs(plant: Plant) -> tuple[ByInput, ByInput, dict[str, tuple[tuple[str, str], ...]]]:
    """Delays, lags and limits by input. Delays commute with all; a limit behind a lag does not."""
    delays: ByInput = {}
    lags: ByInput = {}
    limits: dict[str, tuple[tuple[str, str], ...]] = {}
    rule = "must be made of the effects input_delay, actuator_lag, rate_limit and input_play"
    for placed in actuator_effects(plant, rule):
        source, name = plant.inputs[placed.channel], placed.names[0]
        match placed.effect:
            case ActuatorLag():
                lags[source] = (*lags.get(source, ()), name)
            case InputDelay():
                delays[source] = (*delays.get(source, ()), name)
            case RateLimit() | InputPlay():
                order = f"must act before the lag of {source} to be exported"
                check(source not in lags, placed.effect.name, order, "behind it", _BEHIND_LAG)
                limits[source] = (*limits.get(source, ()), (placed.effect.name, name))
            case _:
                check(False, "actuator", rule, placed.effect.name, _WITHOUT)
    return delays, lags, limits


_BEHIND_LAG = "`simulate` runs the model as it is."
_WITHOUT = (
    "Export the model without that effect, and let the inputs go through it before they reach the "
    "model; `simulate` runs it as it is."
)


def _lagged(
    symbolic: SymbolicPlant, lags: Mapping[str, Sequence[str]]
) -> tuple[list[tuple[str, Node, str]], list[Node]]:
    """T dz/dt = u - z for each lag: names, rates and sources; and the inputs behind them."""
    plant, graph = symbolic.plant, symbolic.graph
    added, changed = [], list(symbolic.inputs)
    for source, names in lags.items():
        j = plant.inputs.index(source)
        for name in names:
            value = plant.parameters[name]
            rule = "must be positive to be exported: a lag of no time is none"
            check(value > 0, f"parameters[{name}]", rule, value, "Leave the lag out.")
            state = f"{source}_behind_{name}"
            lagged = graph.input(Symbol(state))
            time = symbolic.theta[plant.names.index(name)]
            rate = graph.make("div", graph.make("sub", changed[j], lagged), time)
            added.append((state, rate, source))
            changed[j] = lagged
    return added, changed
