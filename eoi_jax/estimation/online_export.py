"""The estimator for a loop in real time as one C file: `init` and `step`, without allocation.

The step is that of `OnlineEstimator`, traced as models are: there is no second implementation. What
no result depends on, such as the sums of a whole pass, is left out.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version as version_of
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from eoi_jax._checks import check, check_choice, check_kind
from eoi_jax.compiler.graph import Graph, Node, Untranslatable, topological_order
from eoi_jax.compiler.trace import translate
from eoi_jax.estimation.online import OnlineEstimator
from eoi_jax.models.equations.expression import Symbol
from eoi_jax.models.equations.from_plant import shared_formulas, unused_names
from eoi_jax.models.export.c import DOUBLE, SINGLE, c_listing, helper_functions
from eoi_jax.models.export.files import write_content
from eoi_jax.models.export.names import comment, identifier
from eoi_jax.models.export.program import Program, Variable

_UNDELAYED = """
 * Delays and lags of inputs are part of the state: pass inputs as they are sent."""
PRECISIONS = {"double": DOUBLE, "single": SINGLE}

_TEXT = """\
/*
 * Recursive estimator of {model}:
 * sliding-mode observer, low-pass filter, recursive least squares{with_alarm}.
 * Written by eoi_jax {version}, in {precision} precision.
 *
 * {name}_init once, then {name}_step at every sample, each {period:.9g} s:
 *   outputs[{ny}]: {outputs}, as measured at the sample; NaN where one is missing
 *   inputs[{nu}]: {inputs}, as they are from the sample on{undelayed}
 * Nothing is allocated, and every call does the same operations. NaN needs a compiler without
 * -ffast-math. Parameters, at the start:
{parameters}
 */
#include <math.h>

typedef struct {{
    {real} memory[{size}];
}} {name}_state;

typedef struct {{
    {real} parameters[{np}];
    {real} injection[{ny}]; /* the model's error, filtered */
    {real} power;        /* of the injection over that of its noise; 0 without an alarm */
    int alarm;           /* 1: the model holds no longer */
}} {name}_estimate;

{helpers}void {name}_init({name}_state *state);
void {name}_step({name}_state *state, const {real} *outputs, const {real} *inputs,
    {name}_estimate *estimate);

void {name}_init({name}_state *state)
{{
    static const {real} start[{size}] = {{
{start}
    }};
    int k;
    for (k = 0; k < {size}; k++) state->memory[k] = start[k];
}}

void {name}_step({name}_state *state, const {real} *outputs, const {real} *inputs,
    {name}_estimate *estimate)
{{
{body}
}}
"""


def export_estimator(
    estimator: OnlineEstimator, path: str | Path, precision: str = "double"
) -> Path:
    """Write an estimator as C99 (`math.h` and nothing else), for a controller or a logger.

    The file has ``NAME_init(state)`` and ``NAME_step(state, outputs, inputs, estimate)`` with NAME
    that of the file; its step is that of `estimator.step`.

    Args:
        estimator: of `online_estimator`, or of its own.
        path: of the file, ``….c``; an existing one is replaced.
        precision: ``"double"`` or ``"single"``. In single precision time stands still after 2^24
            samples, and an output that hardly varies around a large value loses digits: let the
            model be one of the difference (0.05 V at 3.6 V: errors of 3e-5 in the parameters).

    Returns:
        The path.

    Raises:
        ValueError: another suffix, a name that is none of C, a folder that cannot be written, or a
            model or an observer that holds what is no arithmetic (which).
    """
    check_kind("estimator", estimator, OnlineEstimator, "an OnlineEstimator")
    check_choice("precision", precision, PRECISIONS)
    path = Path(path)
    check(path.suffix == ".c", "path", "must end in .c", path)
    fitting = identifier(path.stem)
    rule = "must be named as a function can be"
    check(path.stem == fitting, "path", rule, path.stem, f"For example {fitting}.c.")
    write_content(path, estimator_text(estimator, path.stem, precision).encode())
    return path


def estimator_text(estimator: OnlineEstimator, name: str, precision: str = "double") -> str:
    """What `export_estimator` writes.

    Args:
        estimator: any.
        name: of its functions.
        precision: one of `PRECISIONS`.
    """
    plant, traced = estimator.plant, _traced(estimator, precision == "double")
    real, ny = PRECISIONS[precision], len(estimator.plant.outputs)
    listing = c_listing(traced.model, real)

    def element(vector: str, k: int) -> str:
        if vector == "states":
            return f"state->memory[{k}]"
        return f"outputs[{k}]" if k < ny else f"inputs[{k - ny}]"

    reading = listing.elements(element)
    unused = not any("= inputs[" in line for line in reading)
    assigned = zip(traced.targets, traced.model.rates, strict=True)
    body = [
        *(["(void)inputs;"] if unused else []),
        *reading,
        *listing.definitions(),
        *(f"{target} = {listing.code(tree)};" for target, tree in assigned),
    ]
    values = [f"{real.number(value)}," for value in traced.start]
    parameters = enumerate(zip(plant.names, estimator.theta, strict=True))
    return _TEXT.format(
        model=comment(plant.name),
        undelayed=_UNDELAYED if estimator.inputs.stages else "",
        with_alarm=", alarm" if estimator.alarm is not None else "",
        version=version_of("eoi_jax"),
        precision=precision,
        real=real.name,
        name=name,
        period=estimator.sample_period,
        outputs=comment(", ".join(plant.outputs)),
        inputs=comment(", ".join(plant.inputs) or "none"),
        ny=ny,
        nu=len(plant.inputs),
        np=len(plant.names),
        parameters="\n".join(
            f" *   parameters[{k}] {comment(parameter)}: {value:.9g}"
            for k, (parameter, value) in parameters
        ),
        size=len(values),
        start="\n".join(f"        {' '.join(values[k : k + 4])}" for k in range(0, len(values), 4)),
        helpers=helper_functions(listing.called, real),
        body="\n".join(f"    {line}" for line in body),
    )


@dataclass(frozen=True)
class _Traced:
    """The step as formulas.

    Attributes:
        model: its states are those of the estimator, its inputs outputs and inputs of the plant.
        start: of the states.
        targets: what each formula of `model` is assigned to.
    """

    model: Program
    start: list[float]
    targets: list[str]


def _traced(estimator: OnlineEstimator, double: bool) -> _Traced:
    with jax.enable_x64(double):  # on which depends what counts as rounding
        return _as_formulas(estimator)


def _as_formulas(estimator: OnlineEstimator) -> _Traced:
    graph, plant = Graph(as_written=True), estimator.plant
    leaves, structure = jax.tree.flatten(estimator.init())
    ny, nu = len(plant.outputs), len(plant.inputs)
    states = [Symbol(f"s{k}") for k in range(sum(np.size(leaf) for leaf in leaves))]
    signals = [Symbol(f"{kind}{k}") for kind, count in (("y", ny), ("u", nu)) for k in range(count)]
    shapes = [*map(np.shape, leaves), (ny,), (nu,)]
    arguments = _as_nodes(graph, [*states, *signals], shapes)

    def step(*arrays: Any) -> list[Any]:
        after, estimate = estimator.step(jax.tree.unflatten(structure, arrays[:-2]), *arrays[-2:])
        parts = estimate.parameters, estimate.injection, estimate.power, estimate.alarm
        return [*jax.tree.leaves(after), *map(jnp.asarray, parts)]

    dtype = jnp.result_type(float)
    try:
        types = [jax.ShapeDtypeStruct(shape, dtype) for shape in shapes]
        results = translate(graph, step, types, arguments)
    except Untranslatable as error:
        rule = "must be arithmetic on measurements, inputs and parameters to be exported"
        check(False, "estimator", rule, f"the operation {error}")
        raise
    nodes = [node for array in results for node in np.ravel(array)]
    following, wanted = dict(zip(states, nodes, strict=False)), nodes[len(states) :]
    memorised = _needed(wanted, following)
    start = dict(zip(states, np.concatenate([np.ravel(leaf) for leaf in leaves]), strict=True))
    names = unused_names([symbol.name for symbol in (*states, *signals)])
    formulas = [*(following[symbol] for symbol in memorised), *wanted]
    trees, definitions = shared_formulas(formulas, names, flags=True)
    model = Program(
        name=plant.name,
        states=tuple(Variable(symbol, symbol.name, "") for symbol in memorised),
        rates=tuple(trees),
        starts={},
        start_values={},
        inputs=tuple(Variable(symbol, symbol.name, "") for symbol in signals),
        parameters=(),
        definitions=tuple(definitions),
        delays={},
        lags={},
        limits={},
        rough=(),
        arguments=(),
    )
    targets = [
        *(f"state->memory[{k}]" for k in range(len(memorised))),
        *(f"estimate->parameters[{k}]" for k in range(len(plant.names))),
        *(f"estimate->injection[{k}]" for k in range(ny)),
        "estimate->power",
        "estimate->alarm",
    ]
    return _Traced(model, [float(start[symbol]) for symbol in memorised], targets)


def _as_nodes(
    graph: Graph, symbols: Sequence[Symbol], shapes: Sequence[tuple[int, ...]]
) -> list[np.ndarray]:
    """Arrays of input nodes, one symbol for each element in order."""
    arrays, remaining = [], iter(symbols)
    for shape in shapes:
        array = np.empty(shape, object)
        for place in np.ndindex(shape):
            array[place] = graph.input(next(remaining))
        arrays.append(array)
    return arrays


def _needed(wanted: Sequence[Node], following: Mapping[Symbol, Node]) -> list[Symbol]:
    """States on which a result depends, now or later, in order."""
    needed: set[Symbol] = set()
    pending = list(wanted)
    while pending:
        read = {node.value for node in topological_order(pending) if node.op == "input"}
        added = [symbol for symbol in read if symbol in following and symbol not in needed]
        needed.update(added)
        pending = [following[symbol] for symbol in added]
    return [symbol for symbol in following if symbol in needed]
