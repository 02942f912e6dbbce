"""A model's equations as text and LaTeX: the declared part, and what was added to it.

The declared part is traced (a model of text is its own formula), and so are effects. What has no
formula, because it looks into a table or runs until something happens, is shown as f(…) with the
names of what it may depend on.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from eoi_jax.models.augmented import Placed, instant, split_parameters
from eoi_jax.models.effects import INPUT_EFFECTS, ActuatorLag, Curve, InputCurve, InputDelay
from eoi_jax.models.effects.effect import (
    AbstractEffect,
    AbstractInputEffect,
    AbstractInternalEffect,
    AbstractTerm,
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
from eoi_jax.models.parameters import parameter_type
from eoi_jax.models.plant import Plant, State
from eoi_jax.models.velocities import velocity_rows


@dataclass(frozen=True)
class Equation:
    """One equation of a model.

    Attributes:
        lhs: the derivative that it gives.
        declared: its right side; None for the state of an effect.
        added: what effects add to it.
    """

    lhs: Symbol
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
    equations = [" ".join([f"{lhs} = {rhs}".rstrip(), *terms]) for lhs, rhs, terms in lines]
    return "\n".join([*equations, *(f"with {change}" for change in changes)])


def equation_latex(plant: Plant, added: Sequence[Any] = (), *, numeric: bool = False) -> str:
    r"""The same as the body of an ``aligned`` environment; arguments as in `equation_text`."""
    parts, changes = equation_lines(plant, added, numeric=numeric)
    lines = [" ".join([f"{lhs} &= {rhs}".rstrip(), *terms]) for lhs, rhs, terms in parts]
    lines += [rf"&\text{{with }} {change}" for change in changes]
    return "\\begin{aligned}\n" + " \\\\\n".join(lines) + "\n\\end{aligned}"


def equation_lines(
    plant: Plant, added: Sequence[Any] = (), *, numeric: bool = False
) -> tuple[list[tuple[str, str, list[str]]], list[str]]:
    """The equations in LaTeX, with what was added apart; arguments as in `equation_text`.

    Returns:
        Left side, declared right side ("" where there is nothing but what was added) and the terms
        that were added, of each equation; then what happens to inputs.
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
        rhs, write_first = "", written
        if equation.declared is not None and not (terms and equation.declared == Number(0.0)):
            rhs, write_first = written(valued(equation.declared, values), notation), written_term
        term_texts = [write_first(term, notation) for term in terms[:1]]
        term_texts += [written_term(term, notation) for term in terms[1:]]
        lines.append((written(equation.lhs, notation), rhs, term_texts))
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
    f = _right_sides(plant, plant.dynamics, plant.derivative, "f", len(plant.outputs))
    g = _right_sides(plant, plant.internal, plant.internal_rate, "g", len(states))
    outer = zip(plant.outputs, plant.degrees, f, strict=True)
    equations = [Equation(Symbol(name, degree), rhs) for name, degree, rhs in outer]
    equations += [Equation(Symbol(name, 1), rhs) for name, rhs in zip(states, g, strict=True)]
    changes: list[tuple[Symbol, Expression]] = []
    count = len(states)
    for item in added:
        formulas = _EffectFormulas(plant, _placed(plant, item), count)
        count += item.effect.states
        placed = formulas.placed
        if placed.on_input:
            drive = Symbol(plant.inputs[placed.channel])
            changes.append((drive, formulas.changed(drive)))
        elif placed.through is not None:
            drive = Symbol(plant.inputs[placed.through])
            changes.append((drive, Operation("+", drive, formulas.term())))
        elif (term := formulas.term()) != Number(0.0):
            equations[placed.output].added.append(term)
        if placed.on_state:
            equations[len(plant.outputs) + placed.channel].added.append(formulas.change())
        rates = zip(formulas.states, formulas.rates(), strict=True)
        equations += [Equation(Symbol(name, 1), None, [rate]) for name, rate in rates]
    return equations, changes


def _right_sides(
    plant: Plant, model: Any, function: Callable[..., Any], letter: str, count: int
) -> Sequence[Expression]:
    """What f or g of a plant returns; a model of text is its own formula."""
    trees: Sequence[Expression | None] | None
    if isinstance(model, TextDynamics | TextInternal):
        text = model.equations
        written_trees = text.highest if isinstance(model, TextDynamics) else text.internal
        trees = [text.written_out(tree) for tree in written_trees]
    else:
        trees = SymbolicPlant(plant).formulas(function) if count else []
    if trees is not None and None not in trees:
        return trees  # type: ignore[return-value]
    return [_unknown(plant, letter if count == 1 else f"{letter}{j + 1}") for j in range(count)]


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


class _EffectFormulas:
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
        self.placed, self._plant = placed, plant
        self.states = tuple(f"z{first + i + 1}" if numbered else "z" for i in range(count))
        self._inner = len(inner)
        slope = (f"{plant.outputs[placed.output]}'",) if placed.effect.follows_slope else ()
        self._symbolic = SymbolicPlant(plant, placed.names, (*inner, *self.states, *slope))
        self._parameters = [Symbol(name, parameter=True) for name in placed.names]

    def term(self) -> Expression:
        """What it adds to y^(r)."""
        effect = self.placed.effect
        assert isinstance(effect, AbstractTerm | AbstractInternalEffect)
        if isinstance(effect, Curve):
            output = self._plant.outputs[self.placed.output]
            signals = {"y": Symbol(output), "v": Symbol(output, self.placed.row)}
            signals["u"] = Symbol((*self._plant.inputs, "u")[self.placed.through or 0])
            curve = Call("curve", (signals[effect.over],))
            return Operation("*", curve, signals[effect.times]) if effect.times else curve
        return self._formulas(effect.term)[0]

    def change(self) -> Expression:
        """What it adds to the rate of the internal state that it acts on."""
        effect = self.placed.effect
        assert isinstance(effect, AbstractInternalEffect)
        return self._formulas(lambda at, _, shapes: effect.change(at, shapes))[0]

    def changed(self, drive: Symbol) -> Expression:
        """What the model gets instead of an input; what depends on its past has a notation."""
        effect, parameters = self.placed.effect, self._parameters
        if isinstance(effect, InputCurve):
            return Operation("+", drive, Call("curve", (drive,)))
        if isinstance(effect, InputDelay):
            return Call(drive.name, (Operation("-", Symbol("t"), parameters[0]),))
        if isinstance(effect, ActuatorLag):  # in Laplace's s
            lag = Operation("+", Operation("*", parameters[0], Symbol("s")), Number(1.0))
            return Operation("/", drive, lag)
        if isinstance(effect, AbstractInputEffect):
            return self._formulas(lambda at, _, shapes: effect.changed(at, shapes))[0]
        return Call(effect.name, (drive, *parameters))

    def rates(self) -> list[Expression]:
        """Rates of its own states."""
        effect = self.placed.effect
        return self._formulas(lambda at, _, shapes: effect.rate(at, shapes)) if self.states else []

    def _formulas(self, function: Callable[[Any, Any, Any], Any]) -> list[Expression]:
        """A function of the instant, gains and shapes; by its name where it has no formula."""

        def at_instant(t: Any, x: State, u: Any, theta: Any) -> Any:
            named = parameter_type(self.placed.names)(*theta)
            declared = State(x.y, x.z[: self._inner])
            at = instant(self.placed, t, declared, u, x.z[self._inner :])
            if self.placed.effect.follows_slope:
                at = at._replace(z=at.z[:-1], slope=at.z[-1])
            return function(at, *split_parameters(self.placed, named))

        unknown: Expression = Call(self.placed.effect.name, tuple(self._parameters))
        return self._symbolic.formulas(at_instant) or [unknown] * max(len(self.states), 1)
