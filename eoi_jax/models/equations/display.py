"""A model's equations as text and LaTeX: the declared part, and what was added to it.

The declared part is traced (a model of text is its own formula), and so are effects. What a model
solves for its accelerations is shown as the matrix equation that it is; lines with ``where`` say
what its entries are, and what a long formula repeats. What has no formula, because it looks into a
table or runs until something happens, is shown as f(…) with the names of what it may depend on.
"""

import math
import re
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from eoi_jax.models.augmented import Placed, augmented, instant, split_parameters
from eoi_jax.models.effects import INPUT_EFFECTS, ActuatorLag, Curve, InputCurve, InputDelay
from eoi_jax.models.effects.effect import (
    AbstractActuator,
    AbstractCascade,
    AbstractEffect,
    AbstractInputEffect,
    AbstractInternalEffect,
    AbstractParameterEffect,
    AbstractTerm,
    internal_names,
)
from eoi_jax.models.equations.expression import (
    Call,
    Expression,
    Number,
    Operation,
    Symbol,
    cancelled,
    substituted,
)
from eoi_jax.models.equations.from_plant import SymbolicPlant
from eoi_jax.models.equations.printer import (
    LATEX,
    TEXT,
    Notation,
    valued,
    written,
    written_term,
)
from eoi_jax.models.equations.right_sides import MatrixEquation, RightSides, right_sides
from eoi_jax.models.equations.system import Equations, TextDynamics
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
        of the model's own and of effects, and effects of an input, are lines under it. Coupled
        inertia is ``M·[q1''; q2''] = F``, with lines ``where M11 = …``.
    """
    lines, changes = _lines(plant, added, numeric, _IN_TEXT)
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
    return _lines(plant, added, numeric, _IN_LATEX)


@dataclass(frozen=True)
class _Form:
    """How lines are written.

    Attributes:
        notation: of formulas.
        arrow: between an input and what the model gets instead.
        explains: before a name that a line explains.
        coupled: lines of a matrix equation: left side and right side.
    """

    notation: Notation
    arrow: str
    explains: str
    coupled: Callable[[MatrixEquation, Collection[str]], list[tuple[str, str]]]


def _lines(
    plant: Plant, added: Sequence[Any], numeric: bool, form: _Form
) -> tuple[list[tuple[str, str, list[str]]], list[str]]:
    values: dict[str, float] = plant.parameters if numeric else {}
    for item in added:
        values = {**values, **item.parameters} if numeric else values
    notation = form.notation
    system = equations_of(plant, added)
    lines, entries = [], []
    reserved = {*plant.names, *plant.inputs, *plant.outputs, *internal_names(plant)}
    for coupled in system.coupled:
        first, *named = form.coupled(_with_values(coupled, values), reserved)
        reserved |= {name for names, _ in named for name in names.split(" = ")}
        lines.append((*first, []))
        entries += [(f"{form.explains}{name}", rhs, []) for name, rhs in named]
    for equation in system.equations:
        terms = [valued(term, values) for term in equation.added]
        rhs, write_first = "", written
        if equation.declared is not None and not (terms and equation.declared == Number(0.0)):
            rhs, write_first = written(valued(equation.declared, values), notation), written_term
        term_texts = [write_first(term, notation) for term in terms[:1]]
        term_texts += [written_term(term, notation) for term in terms[1:]]
        lines.append((written(equation.lhs, notation), rhs, term_texts))
    for symbol, tree in system.definitions:
        name = f"{form.explains}{written(symbol, notation)}"
        entries.append((name, written(valued(tree, values), notation), []))
    return [*lines, *entries], [
        f"{written(drive, notation)} {form.arrow} {written(valued(changed, values), notation)}"
        for drive, changed in system.changes
    ]


def _with_values(equation: MatrixEquation, values: dict[str, float]) -> MatrixEquation:
    matrix = tuple(tuple(valued(tree, values) for tree in row) for row in equation.matrix)
    right = tuple(valued(tree, values) for tree in equation.right)
    return MatrixEquation(matrix, equation.unknown, right)


def _coupled_text(equation: MatrixEquation, reserved: Collection[str]) -> list[tuple[str, str]]:
    """``M·[x; y] = F``, and an entry a line, equal ones together."""
    matrix, right = _letter("MAHDEG", reserved), _letter("FbhrpQ", reserved)
    unknown = "; ".join(written(symbol, TEXT) for symbol in equation.unknown)
    size = len(equation.unknown)
    named = [
        (f"{matrix}{i + 1}{j + 1}", equation.matrix[i][j]) for i in range(size) for j in range(size)
    ]
    alike: dict[str, list[str]] = {}
    for name, tree in named:
        alike.setdefault(written(tree, TEXT), []).append(name)
    lines = [(f"{matrix}·[{unknown}]", right)]
    lines += [(" = ".join(names), entry) for entry, names in alike.items()]
    return lines + [
        (f"{right}{i + 1}", written(tree, TEXT)) for i, tree in enumerate(equation.right)
    ]


def _letter(letters: str, reserved: Collection[str]) -> str:
    """One that names nothing else, alone or with indices."""
    first_parts = {re.sub(r"_?\d+$", "", name) for name in reserved}
    return next((letter for letter in letters if letter not in first_parts), f"{letters[0]}_")


def _coupled_latex(equation: MatrixEquation, reserved: Collection[str]) -> list[tuple[str, str]]:
    """One line, with matrices."""
    del reserved
    columns = ([(entry,) for entry in side] for side in (equation.unknown, equation.right))
    unknown, right = map(_matrix_latex, columns)
    return [(f"{_matrix_latex(equation.matrix)} {unknown}", right)]


def _matrix_latex(rows: Iterable[Sequence[Expression]]) -> str:
    lines = (" & ".join(written(entry, LATEX) for entry in row) for row in rows)
    body = r" \\ ".join(lines)
    return rf"\begin{{pmatrix}} {body} \end{{pmatrix}}"


_IN_TEXT = _Form(TEXT, "→", "where ", _coupled_text)
_IN_LATEX = _Form(LATEX, r"\to", r"\text{where } ", _coupled_latex)


# -- the equations ----------------------------------------------------------------------------


@dataclass(frozen=True)
class _System:
    """All equations.

    Attributes:
        equations: of outputs, of internal states, of states of effects.
        coupled: matrix equations, for outputs that have none of their own, or for names.
        definitions: named parts of all these.
        changes: inputs with what the model gets instead.
    """

    equations: list[Equation]
    coupled: Sequence[MatrixEquation]
    definitions: Sequence[tuple[Symbol, Expression]]
    changes: list[tuple[Symbol, Expression]]


def equations_of(plant: Plant, added: Sequence[Any] = ()) -> _System:
    """The equations of a plant and of what was added to it, as formulas.

    Args:
        plant: as declared.
        added: as in `equation_text`.
    """
    if any(isinstance(item.effect, AbstractCascade) for item in added):
        return _equations_in_series(plant, added)
    states = internal_names(plant)
    placements = [_placed(plant, item) for item in added]
    extended = {p.output for p in placements if _adds_term(p)}
    sides = _with_replaced_parameters(plant, _right_sides(plant, extended), placements)
    outer = zip(plant.outputs, plant.degrees, sides.f, strict=True)
    equations = [Equation(Symbol(name, degree), rhs) for name, degree, rhs in outer]
    inner = zip(states, sides.g, strict=True)
    equations += [Equation(Symbol(name, 1), rhs) for name, rhs in inner]
    changes: list[tuple[Symbol, Expression]] = []
    count = len(states)
    for placed in placements:
        formulas = _EffectFormulas(plant, placed, count)
        count += placed.effect.states
        if placed.on_input:
            drive = Symbol(plant.inputs[placed.channel])
            changes.append((drive, formulas.changed(drive)))
        elif isinstance(placed.effect, AbstractParameterEffect):
            continue
        elif placed.through is not None:
            drive = Symbol(plant.inputs[placed.through])
            changes.append((drive, Operation("+", drive, formulas.term())))
        elif (term := formulas.term()) != Number(0.0):
            equations[placed.output].added.append(term)
        if placed.on_state:
            equations[len(plant.outputs) + placed.channel].added.append(formulas.change())
        rates = zip(formulas.states, formulas.rates(), strict=True)
        equations += [Equation(Symbol(name, 1), None, [rate]) for name, rate in rates]
    shown = [equation for equation in equations if equation.declared is not None or equation.added]
    return _System(shown, sides.coupled, sides.definitions, changes)


def _equations_in_series(plant: Plant, added: Sequence[Any]) -> _System:
    """Equations of a plant with effects that nothing is a term beside: all of it is written."""
    actuators = [item for item in added if isinstance(item.effect, AbstractActuator)]
    remainder = [item for item in added if item not in actuators]
    placed = [_placed(plant, item) for item in remainder]
    values = {name: value for item in remainder for name, value in item.parameters.items()}
    model = augmented(plant, placed, values, dict.fromkeys(values, (-math.inf, math.inf)))
    system = equations_of(model, actuators)
    parts: dict[Symbol, Expression] = {}
    for symbol, tree in system.definitions:  # else terms that cancel would stand in several
        parts[symbol] = substituted(tree, parts)
    equations = [
        replace(item, declared=cancelled(substituted(item.declared, parts)))
        if item.declared
        else item
        for item in system.equations
    ]
    return replace(system, equations=equations, definitions=())


def _right_sides(plant: Plant, extended: Collection[int]) -> RightSides:
    """What f and g of a plant return; a model of text is its own formula."""
    if isinstance(plant.dynamics, TextDynamics):
        return _of_text(plant.dynamics.equations)
    sides = right_sides(plant, extended)
    if sides is not None:
        return sides
    ny, nz = len(plant.outputs), len(internal_names(plant))
    f = (_unknown(plant, "f" if ny == 1 else f"f{j + 1}") for j in range(ny))
    g = (_unknown(plant, "g" if nz == 1 else f"g{j + 1}") for j in range(nz))
    return RightSides(tuple(f), tuple(g))


def _adds_term(placed: Placed) -> bool:
    """Whether an effect adds something to the equation of its output."""
    changes = placed.on_input or isinstance(placed.effect, AbstractParameterEffect)
    return not changes and placed.through is None


def _with_replaced_parameters(
    plant: Plant, sides: RightSides, placements: Sequence[Placed]
) -> RightSides:
    """With what stands in place of parameters."""
    replaced: dict[Symbol, Expression] = {}
    for placed in placements:
        if isinstance(placed.effect, AbstractParameterEffect):
            parameter = Symbol(placed.effect.parameter, parameter=True)
            factor = _EffectFormulas(plant, placed, len(internal_names(plant))).factor()
            replaced[parameter] = Operation("*", replaced.get(parameter, parameter), factor)
    if not replaced:
        return sides

    def all_of(trees: Iterable[Expression]) -> tuple[Expression, ...]:
        return tuple(substituted(tree, replaced) for tree in trees)

    coupled = (
        replace(item, matrix=tuple(map(all_of, item.matrix)), right=all_of(item.right))
        for item in sides.coupled
    )
    f = tuple(tree and substituted(tree, replaced) for tree in sides.f)
    definitions = ((symbol, substituted(tree, replaced)) for symbol, tree in sides.definitions)
    return RightSides(f, all_of(sides.g), tuple(coupled), tuple(definitions))


def _of_text(text: Equations) -> RightSides:
    """With definitions put in; where that would be too long to read, with the definitions."""
    f, g = ([text.written_out(tree) for tree in trees] for trees in (text.highest, text.internal))
    if None not in (*f, *g):
        return RightSides(tuple(f), tuple(g))  # type: ignore[arg-type]
    definitions = ((Symbol(name), tree) for name, tree in text.defined.items())
    used = tuple(pair for pair in definitions if not isinstance(pair[1], Number))
    return RightSides(text.highest, text.internal, (), used)


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
        channel, names = plant.inputs.index(item.output), tuple(item.parameters)
        driver = plant.inputs.index(item.through) if item.through else None
        return Placed(effect, channel, names, through=driver)
    if isinstance(effect, AbstractInternalEffect):
        channel = internal_names(plant).index(item.output)
        return Placed(effect, channel, tuple(item.parameters))
    channel = plant.outputs.index(item.output)
    if isinstance(effect, AbstractCascade):
        streams = effect.streams(plant, channel)
        return Placed(effect, channel, tuple(item.parameters), streams=streams)
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
        self.placed, self._plant = placed, plant
        self.states = internal_names(plant, first + placed.effect.states - len(inner))[first:]
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
            velocity = Symbol(output, self.placed.row)
            signals: dict[str, Expression] = {"y": Symbol(output), "v": velocity}
            signals["u"] = Symbol((*self._plant.inputs, "u")[self.placed.through or 0])
            signals["sign"] = Call("sign", (velocity,))
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
        driver = self.placed.through
        past = () if driver is None else (Symbol(self._plant.inputs[driver]),)
        return Call(effect.name, (drive, *past, *parameters))

    def factor(self) -> Expression:
        """What stands in place of a parameter, over it."""
        effect = self.placed.effect
        assert isinstance(effect, AbstractParameterEffect)
        return self._formulas(lambda at, _, shapes: effect.factor(at, shapes))[0]

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
