"""A model's equations as text and LaTeX: the declared part, and what was added to it.

The declared part is traced (a model of text is its own formula), and so are effects. What has no
formula, because it looks into a table or runs until something happens, is shown as f(…) with the
names of what it may depend on.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from eoi_jax.models.augmented import Placed, instant, split_parameters
from eoi_jax.models.effects import INPUT_EFFECTS, ActuatorLag, InputDelay
from eoi_jax.models.effects.effect import (
    AbstractActuator,
    AbstractEffect,
    AbstractInputEffect,
    AbstractInternalEffect,
    internal_names,
)
from eoi_jax.models.equations.expression import Call, Expression, Number, Operation, Symbol
from eoi_jax.models.equations.from_plant import SymbolicPlant
from eoi_jax.models.equations.printer import (
    LATEX,
    TEXT,
    Notation,
    valued,
    written,
    written_term,
)
from eoi_jax.models.equations.system import TextDynamics, TextInternal
from eoi_jax.models.plant import Plant, State, parameter_type, velocity_rows


@dataclass(frozen=True)
class Equation:
    """One equation of a model.

    Attributes:
        left: the derivative that it gives.
        declared: its right side; None for the state of an effect.
        added: what effects add to it.
    """

    left: Symbol
    declared: Expression | None
    added: list[Expression] = field(default_factory=list)


def equation_text(plant: Plant, added: Sequence[Any] = (), *, numeric: bool = False) -> str:
    """The equations of a declared plant and of what was added to it, a line for each.

    Args:
        plant: as declared, with the parameter values that `numeric` shows.
        added: what was found: each has `effect`, `output` (or the input) and `parameters`.
        numeric: values instead of names.

    Returns:
        ``angle'' = -a·sin(angle) - b·angle' + d·voltage - coulomb_friction·sign(angle')``; states
        of the model's own and of effects, and effects of an input, are lines under it.
    """
    lines, changes = _lines(plant, added, numeric, TEXT, "→")
    equations = [" ".join([f"{left} = {right}".rstrip(), *terms]) for left, right, terms in lines]
    return "\n".join([*equations, *(f"with {change}" for change in changes)])


def equation_latex(plant: Plant, added: Sequence[Any] = (), *, numeric: bool = False) -> str:
    r"""The same as the body of an ``aligned`` environment; arguments as in `equation_text`."""
    parts, changes = equation_lines(plant, added, numeric=numeric)
    lines = [" ".join([f"{left} &= {right}".rstrip(), *terms]) for left, right, terms in parts]
    lines += [rf"&\text{{with }} {change}" for change in changes]
    return "\\begin{aligned}\n" + " \\\\\n".join(lines) + "\n\\end{aligned}"


def equation_lines(
    plant: Plant, added: Sequence[Any] = (), *, numeric: bool = False
) -> tuple[list[tuple[str, str, list[str]]], list[str]]:
    """The equations in LaTeX, with what was added apart; arguments as in `equation_text`.

    Returns:
        Left side, declared right side ("" where it is nothing but what was added) and the terms that were
        added, of each equation; then what happens to inputs.
    """
    return _lines(plant, added, numeric, LATEX, r"\to")


def _lines(
    plant: Plant, added: Sequence[Any], numeric: bool, notation: Notation, arrow: str
) -> tuple[list[tuple[str, str, list[str]]], list[str]]:
    values: dict[str, float] = plant.parameters if numeric else {}
    for item in added:
        values = {**values, **item.parameters} if numeric else values
    equations, changes = equations_of(plant, added)
    lines = []
    for equation in equations:
        terms = [valued(term, values) for term in equation.added]
        right, first = "", written
        if equation.declared is not None and not (terms and equation.declared == Number(0.0)):
            right, first = written(valued(equation.declared, values), notation), written_term
        shown = [first(term, notation) for term in terms[:1]]
        shown += [written_term(term, notation) for term in terms[1:]]
        lines.append((written(equation.left, notation), right, shown))
    return lines, [
        f"{written(drive, notation)} {arrow} {written(valued(changed, values), notation)}"
        for drive, changed in changes
    ]


# -- the equations ----------------------------------------------------------------------------


def equations_of(
    plant: Plant, added: Sequence[Any] = ()
) -> tuple[list[Equation], list[tuple[Symbol, Expression]]]:
    """The equations of a plant and of what was added to it, as formulas.

    Args:
        plant: as declared.
        added: as in `equation_text`.

    Returns:
        Equations of the outputs, of internal states, of states of effects; then inputs with what
        the model gets instead.
    """
    states = internal_names(plant)
    outer = zip(plant.outputs, plant.degrees, _declared(plant), strict=True)
    equations = [Equation(Symbol(name, degree), right) for name, degree, right in outer]
    rates = zip(states, _internal(plant, len(states)), strict=True)
    equations += [Equation(Symbol(name, 1), right) for name, right in rates]
    changes: list[tuple[Symbol, Expression]] = []
    count = len(states)
    for item in added:
        effects = AddedEffect(plant, _placed(plant, item), count)
        count += item.effect.states
        place, terms = effects.placed, effects.terms()
        if place.on_input:
            changes.append((Symbol(item.output), terms[0]))
        elif place.through is not None:
            drive = Symbol(plant.inputs[place.through])
            changes.append((drive, Operation("+", drive, terms[0])))
        elif place.on_state:
            equations[len(plant.outputs) + place.channel].added.append(effects.change())
        if not place.on_input and place.through is None and terms[0] != Number(0.0):
            equations[place.output].added.append(terms[0])
        own = zip(effects.states, effects.rates(), strict=True)
        equations += [Equation(Symbol(name, 1), None, [rate]) for name, rate in own]
    return equations, changes


def _declared(plant: Plant) -> Sequence[Expression]:
    """y^(r) of the outputs."""
    found: Sequence[Expression | None] | None
    if isinstance(plant.dynamics, TextDynamics):
        text = plant.dynamics.equations
        found = [text.written_out(tree) for tree in text.highest]
    else:
        found = SymbolicPlant(plant).formulas(plant.derivative)
    if found is not None and None not in found:
        return found  # type: ignore[return-value]
    several = len(plant.outputs) > 1
    return [_unknown(plant, f"f{j + 1}" if several else "f") for j in range(len(plant.outputs))]


def _internal(plant: Plant, count: int) -> Sequence[Expression]:
    """Rates of the internal states."""
    if not count:
        return []
    found: Sequence[Expression | None] | None
    if isinstance(plant.internal, TextInternal):
        text = plant.internal.equations
        found = [text.written_out(tree) for tree in text.internal]
    else:
        found = SymbolicPlant(plant).formulas(plant.internal_rate)
    if found is not None and None not in found:
        return found  # type: ignore[return-value]
    return [_unknown(plant, f"g{j + 1}" if count > 1 else "g") for j in range(count)]


def _unknown(plant: Plant, name: str) -> Expression:
    """A function of all that a model may depend on."""
    outputs = [
        Symbol(output, i)
        for output, degree in zip(plant.outputs, plant.degrees, strict=True)
        for i in range(degree)
    ]
    names = (*internal_names(plant), *plant.inputs, *plant.names)
    return Call(name, (*outputs, *map(Symbol, names)))


# -- effects ----------------------------------------------------------------------------------


def _placed(plant: Plant, item: Any) -> Placed:
    """Where something that was found acts."""
    effect: AbstractEffect = item.effect
    if isinstance(effect, INPUT_EFFECTS):
        return Placed(effect, plant.inputs.index(item.output), tuple(item.parameters))
    if isinstance(effect, AbstractInternalEffect):
        channel = internal_names(plant).index(item.output)
        return Placed(effect, channel, tuple(item.parameters))
    channel = plant.outputs.index(item.output)
    return Placed(
        effect,
        channel,
        tuple(item.parameters),
        velocity_rows(plant.degrees)[channel],
        plant.outputs.index(item.against) if item.against else None,
        plant.inputs.index(item.through) if item.through else None,
    )


class AddedEffect:
    """An effect at its place in a plant, as formulas.

    Attributes:
        placed: what and where.
        states: names of its own states.
    """

    def __init__(self, plant: Plant, placed: Placed, first: int):
        """The symbols; `first` is the number of internal states before its own."""
        inner = internal_names(plant)
        count = placed.effect.states
        numbered = first > 0 or count > 1
        self.placed = placed
        self.states = tuple(f"z{first + i + 1}" if numbered else "z" for i in range(count))
        self._inner = len(inner)
        self._symbolic = SymbolicPlant(plant, placed.names, (*inner, *self.states))

    def terms(self) -> list[Expression]:
        """What it adds to y^(r), or what the model gets instead of the input."""
        effect = self.placed.effect
        drive = self._symbolic.inputs[self.placed.channel].value if self.placed.on_input else None
        parameters = [Symbol(name, parameter=True) for name in self.placed.names]
        if isinstance(effect, InputDelay):
            return [Call(drive.name, (Operation("-", Symbol("t"), parameters[0]),))]
        if isinstance(effect, ActuatorLag):
            # In Laplace's s, as lags are written.
            lag = Operation("+", Operation("*", parameters[0], Symbol("s")), Number(1.0))
            return [Operation("/", drive, lag)]
        if isinstance(effect, AbstractActuator):
            return [Call(effect.name, (drive, *parameters))]
        if isinstance(effect, AbstractInputEffect):
            return self._formulas(lambda at, _, shapes: effect.changed(at, shapes))
        return self._formulas(effect.term)

    def change(self) -> Expression:
        """What it adds to the rate of the internal state that it acts on."""
        effect = self.placed.effect
        (found,) = self._formulas(lambda at, _, shapes: effect.change(at, shapes))
        return found

    def rates(self) -> list[Expression]:
        """Rates of its own states."""
        if not self.states:
            return []
        effect = self.placed.effect
        return self._formulas(lambda at, _, shapes: effect.rate(at, shapes))

    def _formulas(self, function: Callable[[Any, Any, Any], Any]) -> list[Expression]:
        def computed(t: Any, x: State, u: Any, theta: Any) -> Any:
            named = parameter_type(self.placed.names)(*theta)
            base = State(x.y, x.z[: self._inner])
            at = instant(self.placed, t, base, u, x.z[self._inner :])
            return function(at, *split_parameters(self.placed, named))

        found = self._symbolic.formulas(computed)
        names = [Symbol(name, parameter=True) for name in self.placed.names]
        return found or [Call(self.placed.effect.name, tuple(names))]
