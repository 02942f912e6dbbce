"""A plant's right-hand side as named formulas: what every language prints.

f and g are traced by JAX to scalar operations, whatever they are written in and whatever effects
were added; operations become trees, and what is used twice gets a name.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from eoi_jax._checks import check
from eoi_jax.compiler.graph import Graph, Node, Untranslatable, topological_order
from eoi_jax.compiler.trace import translate
from eoi_jax.models.augmented import actuators
from eoi_jax.models.effects import ActuatorLag
from eoi_jax.models.effects.effect import internal_names
from eoi_jax.models.equations.expression import Call, Expression, Number, Operation, Symbol
from eoi_jax.models.equations.system import TextDynamics
from eoi_jax.models.plant import Plant, State, velocity_rows

_DEEPEST = 25  # levels of one formula; deeper ones are hard to read, and to parse


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
    """d/dt of all states of a plant.

    Attributes:
        name: of the plant.
        states: of each output itself and its derivatives below r; internal states; lags of inputs.
        rates: of the states, one each.
        starts: the internal states at the start, in the parameters.
        start_values: the same as numbers.
        inputs: as measured.
        parameters: with their values.
        definitions: parts that formulas share, each using earlier ones only.
        delays: by input, the parameters whose sum it is late by.
        lags: by input, the parameters that are its time constants.
        rough: states whose change of sign makes a rate jump: dry friction.
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
    rough: tuple[Symbol, ...]


def program(plant: Plant, *, lags_as_states: bool = True) -> Program:
    """The formulas of a plant.

    Args:
        plant: any, with effects or without.
        lags_as_states: whether a lag of an input is a state behind the others; else formulas have
            the input as it comes out of the lag.

    Raises:
        ValueError: the model holds what is no arithmetic on its states (which operation), or an
            actuator of the user's own.
    """
    double = jnp.result_type(float) == jnp.float64
    advice = "Call `eoi_jax.configure()` before JAX is used."
    check(double, "precision", "must be double to export a model", "single", advice)
    graph = Graph()
    theta = [graph.input(Symbol(name, parameter=True)) for name in plant.names]
    inputs = [graph.input(Symbol(name)) for name in plant.inputs]
    delays, lags = _passed(plant)
    added, changed = _lagged(graph, plant, lags, theta, inputs) if lags_as_states else ([], inputs)
    try:
        f, g, start = _traced(graph, plant, theta, changed)
    except Untranslatable as error:
        rule = "must be arithmetic on states, inputs and parameters to be exported"
        check(False, "plant", rule, f"the operation {error}")
        raise
    states, rates = _chains(graph, plant, f)
    for name, node in zip(internal_names(plant), g, strict=True):
        states.append(_variable(plant, Symbol(name), name, "internal state, not measured"))
        rates.append(node)
    for name, node, source in added:
        note = f"{source} behind its lag; starts at the first value of {source}"
        states.append(Variable(Symbol(name), name, plant.units.get(source, ""), note))
        rates.append(node)
    taken = {*plant.names, *plant.inputs, *(one.name for one in states)}
    trees, definitions = _trees(rates, taken)
    names = [Symbol(name) for name in internal_names(plant)]
    first = np.asarray(plant.internal_start(jnp.asarray(plant.theta)), dtype=float).tolist()
    dry = zip(plant.outputs, velocity_rows(plant.degrees), plant.dry_friction, strict=True)
    return Program(
        plant.name,
        tuple(states),
        tuple(trees),
        dict(zip(names, _trees(start, None)[0], strict=True)),
        dict(zip(names, first, strict=True)),
        tuple(_variable(plant, Symbol(name), name) for name in plant.inputs),
        tuple(
            (_variable(plant, Symbol(name, parameter=True), name), value)
            for name, value in plant.parameters.items()
        ),
        tuple(definitions),
        delays,
        lags,
        tuple(Symbol(name, row) for name, row, rough in dry if rough),
    )


def _variable(plant: Plant, symbol: Symbol, name: str, note: str = "") -> Variable:
    return Variable(symbol, name, plant.units.get(name, ""), note)


def _chains(graph: Graph, plant: Plant, f: Sequence[Node]) -> tuple[list[Variable], list[Node]]:
    """States of the outputs, output by output, and their rates."""
    text = plant.dynamics.equations.chains if isinstance(plant.dynamics, TextDynamics) else {}
    states, rates = [], []
    for j, (output, degree) in enumerate(zip(plant.outputs, plant.degrees, strict=True)):
        for i in range(degree):
            name = text[output][i] if text else _derivative_name(output, i)
            own = plant.units.get(output, "")
            power = "" if i < 2 else f"^{i}"
            unit = f"{own}/s{power}" if own and i else own
            note = "" if i == 0 else f"derivative {i} of {output}"
            states.append(Variable(Symbol(output, i), name, unit, note))
            rates.append(graph.input(Symbol(output, i + 1)) if i + 1 < degree else f[j])
    return states, rates


def _derivative_name(output: str, order: int) -> str:
    return output + ("", "_rate")[min(order, 1)] + (f"_{order}" if order > 1 else "")


def _passed(plant: Plant) -> tuple[dict[str, tuple[str, ...]], dict[str, tuple[str, ...]]]:
    """Delays and lags by input; they commute."""
    delays: dict[str, tuple[str, ...]] = {}
    lags: dict[str, tuple[str, ...]] = {}
    for one in actuators(plant):
        kind = lags if isinstance(one.effect, ActuatorLag) else delays
        source = plant.inputs[one.channel]
        kind[source] = (*kind.get(source, ()), one.names[0])
    return delays, lags


def _lagged(
    graph: Graph,
    plant: Plant,
    lags: dict[str, tuple[str, ...]],
    theta: Sequence[Node],
    inputs: Sequence[Node],
) -> tuple[list[tuple[str, Node, str]], list[Node]]:
    """T dz/dt = u - z for each lag: names, rates and sources; and the inputs behind them."""
    added, changed = [], list(inputs)
    for source, names in lags.items():
        j = plant.inputs.index(source)
        for name in names:
            value = plant.parameters[name]
            rule = "must be positive to be exported: a lag of no time is none"
            check(value > 0, f"parameters[{name}]", rule, value, "Leave the lag out.")
            state = f"{source}_behind_{name}"
            own = graph.input(Symbol(state))
            time = theta[plant.names.index(name)]
            rate = graph.make("div", graph.make("sub", changed[j], own), time)
            added.append((state, rate, source))
            changed[j] = own
    return added, changed


def _traced(
    graph: Graph, plant: Plant, theta: Sequence[Node], inputs: Sequence[Node]
) -> tuple[list[Node], list[Node], list[Node]]:
    """f, g and the start of the internal states as nodes."""
    r, ny = plant.relative_degree, len(plant.outputs)
    y = np.empty((r, ny), object)
    for i, j in np.ndindex(r, ny):
        owned = i < plant.degrees[j]
        y[i, j] = graph.input(Symbol(plant.outputs[j], i)) if owned else graph.constant(0.0)
    z = [graph.input(Symbol(name)) for name in internal_names(plant)]

    def rates(theta, t, y, z, u):
        x = State(y, z)
        f, g = (rate(t, x, u, theta) for rate in (plant.derivative, plant.internal_rate))
        return [f, g, plant.internal_start(theta)]

    arguments = [_row(theta), np.asarray(graph.input(Symbol("t")), object), y, _row(z)]
    arguments.append(_row(inputs))
    dtype = jnp.result_type(float)
    shapes = [jax.ShapeDtypeStruct(one.shape, dtype) for one in arguments]
    f, g, start = translate(graph, rates, shapes, arguments)
    return list(f.ravel()), list(g.ravel()), list(start.ravel())


def _row(nodes: Sequence[Node]) -> np.ndarray:
    row = np.empty(len(nodes), object)
    row[:] = nodes
    return row


# -- from nodes to trees ----------------------------------------------------------------------

_SIGNS = {
    "add": "+",
    "sub": "-",
    "mul": "*",
    "div": "/",
    "pow": "^",
    "and": "and",
    "or": "or",
    "lt": "<",
    "le": "≤",
    "eq": "=",
    "ne": "≠",
}
_RENAMED = {"round_even": "round"}
_SHORT = ("neg", "sign", "abs")  # of a name: as short as a name for it


def _trees(
    roots: Sequence[Node], taken: set[str] | None
) -> tuple[list[Expression], list[tuple[Symbol, Expression]]]:
    """Trees of nodes, and of what several of them share (without `taken` nothing is shared)."""
    uses: dict[int, int] = {}
    open_nodes, seen = list(roots), set()
    while open_nodes:
        node = open_nodes.pop()
        uses[node.order] = uses.get(node.order, 0) + 1
        if node.order not in seen:
            seen.add(node.order)
            open_nodes.extend(_form(node)[1])
    trees: dict[int, tuple[Expression, int]] = {}
    definitions: list[tuple[Symbol, Expression]] = []
    free = (name for i in range(1, 10**6) if (name := f"w{i}") not in (taken or ()))
    for node in topological_order(roots):
        if node.order not in seen:
            continue
        kind, args = _form(node)
        parts = [trees[arg.order] for arg in args]
        tree = _tree(node, kind, [part for part, _ in parts])
        depth = 1 + max((deep for _, deep in parts), default=0)
        simple = not args or (kind in _SHORT and not _form(args[0])[1])
        shared = uses[node.order] > 1 and not simple
        if taken is not None and (shared or depth > _DEEPEST) and not node.is_bool:
            definitions.append((Symbol(next(free)), tree))
            tree, depth = definitions[-1][0], 1
        trees[node.order] = tree, depth
    return [trees[node.order][0] for node in roots], definitions


def _form(node: Node) -> tuple[str, tuple[Node, ...]]:
    """What an operation is to a reader, and its operands: powers and guarded roots are one."""
    if node.op == "mul":
        base, power = _power(node)
        if power > 1:
            return f"power {power}", (base,)
    if node.op == "select":
        wet, first, second = node.args
        if first.op == "sqrt" and _is(second, 0.0) and wet.op == "lt" and _is(wet.args[0], 0.0):
            inner = first.args[0]
            x = wet.args[1]
            if inner is x or (inner.op == "select" and inner.args[:2] == (wet, x)):
                return "root", (x,)
    return node.op, node.args


def _power(node: Node) -> tuple[Node, int]:
    if node.op != "mul":
        return node, 1
    (first, m), (second, n) = _power(node.args[0]), _power(node.args[1])
    return (first, m + n) if first is second else (node, 1)


def _is(node: Node, value: float) -> bool:
    return node.op == "constant" and not node.is_bool and node.value == value


def _tree(node: Node, kind: str, args: list[Expression]) -> Expression:
    match kind:
        case "input":
            return node.value
        case "constant":
            return _constant(node)
        case "neg":
            return Operation("-", Number(0.0), args[0])
        case "root":
            return Call("sqrt", (args[0],))
        case "sqrt":  # not a number below zero, unlike the root of a text model
            return Call("plain_root", (args[0],))
        case "exp2":
            return Operation("^", Number(2.0), args[0])
        case "xor":
            a, b = args
            return Operation("or", Operation("and", a, _not(b)), Operation("and", _not(a), b))
        case "select" if node.is_bool:
            which, a, b = args
            return Operation("or", Operation("and", which, a), Operation("and", _not(which), b))
        case "select":
            return Call("where", tuple(args))
        case "eq" | "ne" if node.args[1].is_bool and node.args[1].op == "constant":
            return args[0] if node.args[1].value == (kind == "eq") else _not(args[0])
    if kind.startswith("power "):
        return Operation("^", args[0], Number(float(kind.split()[1])))
    if kind in _SIGNS:
        return _arranged(_SIGNS[kind], *args)
    return Call(_RENAMED.get(kind, kind), tuple(args))


def _arranged(sign: str, left: Expression, right: Expression) -> Expression:
    """As one writes it: 2·k for k·2, -(2·k) for k·(-2), x > 0 for 0 < x. Values stay the same."""
    if sign == "*" and isinstance(right, Number):
        left, right = right, left
    if sign == "*" and isinstance(left, Number) and left.value < 0:
        return Operation("-", Number(0.0), Operation("*", Number(-left.value), right))
    if sign in ("<", "≤") and isinstance(left, Number):
        return Operation({"<": ">", "≤": "≥"}[sign], right, left)
    return Operation(sign, left, right)


def _not(flag: Expression) -> Expression:
    return Call("not", (flag,))


def _constant(node: Node) -> Expression:
    if node.is_bool:
        return Operation("<", Number(0.0), Number(1.0 if node.value else -1.0))
    rule = "must hold finite constants to be exported"
    check(bool(np.isfinite(node.value)), "plant", rule, node.value)
    return Number(node.value)
