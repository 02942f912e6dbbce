"""One step of a free run as named formulas: the step of `rollout`, traced as a model is.

What is written to a file is the very scheme that runs here, dry friction that sticks included: no
second implementation has to be kept equal.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import jax.numpy as jnp

from eoi_jax._checks import check
from eoi_jax._types import Input, Scalar, Theta
from eoi_jax.compiler.graph import Untranslatable
from eoi_jax.models.effects.effect import internal_names
from eoi_jax.models.equations.expression import Symbol
from eoi_jax.models.equations.from_plant import SymbolicPlant, shared_formulas, unused_names
from eoi_jax.models.export.program import Program, Variable
from eoi_jax.models.plant import Plant, State
from eoi_jax.simulation.integrator import advanced, frictional, output_of

# Orders below zero, which no derivative has, keep these symbols apart from those of a model.
STEP_LENGTH = Symbol("h", -1)
_INSTANTS = ("start", "middle", "end")


def with_sticking_outputs(plant: Plant, model: Program) -> Program:
    """The same, its outputs with the reaction of what sticks, as `simulate` shows them.

    Args:
        plant: as of `step_program`.
        model: its right-hand side.
    """
    friction = frictional(plant)
    if not (model.outputs and any(friction)):
        return model
    stepped = _Stepped(plant, model)
    shown = stepped.symbolic.nodes(
        lambda t, x, u, theta: output_of(stepped.plant, theta, t, x, u, friction)
    )
    algebraic = [node for node, degree in zip(shown, plant.degrees, strict=True) if degree == 0]
    trees, definitions = shared_formulas(algebraic, stepped.names, flags=True)
    return replace(model, output_formulas=tuple(trees), output_definitions=tuple(definitions))


def step_program(plant: Plant, model: Program) -> Program:
    """The states at the end of a Runge-Kutta step, from those at its start.

    Lags of inputs are states here, as they are in `model`; `simulate` follows them exactly.

    Args:
        plant: any of which `program` gives the right-hand side.
        model: that, with lags as states.

    Returns:
        The same with the states at the end of the step in place of the rates, and as inputs their
        values at the start, the middle and the end; formulas also depend on `STEP_LENGTH`.

    Raises:
        ValueError: dry friction that the simulation does not cover, or an operation that is no
            arithmetic.
    """
    stepped = _Stepped(plant, model)
    symbolic, friction = stepped.symbolic, frictional(stepped.plant)
    inputs = tuple(
        Variable(Symbol(variable.name, -1 - k), f"{variable.name}_{instant}", variable.unit)
        for k, instant in enumerate(_INSTANTS)
        for variable in model.inputs
    )

    def following(t: Scalar, x: State, u: Input, theta: Theta) -> Any:
        stages = u[1:].reshape(len(_INSTANTS), len(model.inputs))
        end = advanced(stepped.plant, theta, t, u[0], stages, x, friction)
        return jnp.concatenate([jnp.ravel(end.y), end.z])

    drive = [symbolic.graph.input(symbol) for symbol in (STEP_LENGTH, *(v.symbol for v in inputs))]
    try:
        nodes = symbolic.nodes(following, drive)
    except Untranslatable as error:
        rule = "must be arithmetic on states, inputs and parameters for its step to be written"
        check(False, "plant", rule, f"the operation {error}")
        raise
    ny = len(plant.outputs)
    chained = [nodes[i * ny + j] for j, degree in enumerate(plant.degrees) for i in range(degree)]
    wanted = [*chained, *nodes[plant.rows * ny :]]
    trees, definitions = shared_formulas(wanted, stepped.names, flags=True)
    return replace(
        model,
        rates=tuple(trees),
        definitions=tuple(definitions),
        inputs=inputs,
        arguments=(*model.arguments, STEP_LENGTH),
    )


class _Stepped:
    """A plant with lags of inputs as internal states, and its symbols.

    Attributes:
        plant: that one.
        symbolic: with the names of the model's states.
        names: for parts of formulas.
    """

    def __init__(self, plant: Plant, model: Program):
        """Lags and the names of their states are those of `model`."""
        lags = sum(len(names) for names in model.lags.values())
        added = [variable.name for variable in model.states[len(model.states) - lags :]]
        self.plant = _with_lags_as_states(plant, model.lags)
        self.symbolic = SymbolicPlant(self.plant, states=(*internal_names(plant), *added))
        variables = (*model.states, *model.inputs, *model.outputs)
        self.names = unused_names((*plant.names, *(variable.name for variable in variables)))


def _with_lags_as_states(plant: Plant, lags: Mapping[str, tuple[str, ...]]) -> Plant:
    """T dz/dt = u - z for each lag, behind the plant's own internal states."""
    if plant.actuator is None:
        return plant
    rule = "must have no states that change at samples behind a lag for its step to be written"
    check(plant.sampled is None, "plant", rule, plant.name)
    places = tuple((plant.inputs.index(source), names) for source, names in lags.items())
    count = len(plant.initial_internal)
    lagged = _Lagged(plant, places, count)
    size = count + sum(len(names) for names in lags.values())
    return Plant(
        lagged,
        plant.parameters,
        relative_degree=plant.degrees,
        inputs=plant.inputs,
        outputs=plant.outputs,
        internal=lagged.internal if size else None,
        internal_initial=[0.0] * size if size else None,  # not read
        name=plant.name,
    )


@dataclass(frozen=True)
class _Lagged:
    """f and g of a plant with lags of inputs as states."""

    plant: Plant
    places: tuple[tuple[int, tuple[str, ...]], ...]
    count: int

    def __call__(self, t: Any, x: State, u: Any, p: Any) -> Any:
        u, _ = self._behind(x, u, p)
        return self.plant.dynamics(t, State(x.y, x.z[: self.count]), u, p)

    def internal(self, t: Any, x: State, u: Any, p: Any) -> Any:
        """Rates of the plant's own internal states, then of the lags."""
        u, rates = self._behind(x, u, p)
        if self.plant.internal is None:
            return jnp.stack(rates)
        declared = self.plant.internal(t, State(x.y, x.z[: self.count]), u, p)
        declared = jnp.reshape(jnp.asarray(declared), (self.count,))
        return jnp.concatenate([declared, jnp.stack(rates)]) if rates else declared

    def _behind(self, x: State, u: Any, p: Any) -> tuple[Any, list[Any]]:
        """Inputs as they come out of their lags, and the rates of the lags."""
        rates = []
        for channel, names in self.places:
            for name in names:
                state = x.z[self.count + len(rates)]
                rates.append((u[channel] - state) / getattr(p, name))
                u = u.at[channel].set(state)
        return u, rates
