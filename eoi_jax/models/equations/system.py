"""A set of equations as text: what each name in it is, and the functions that it stands for.

    d/dt of every state = an expression

The states of an output form a chain, output, rate, …, as long as the derivative of one is nothing
but the name of the next; the last derivative of the chain is y^(r). All other states are internal.
An output with an equation of its own, y = an expression, is no state: its relative degree is 0. In
other equations its name stands for that expression, as the name of a definition does.
"""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from graphlib import CycleError, TopologicalSorter
from keyword import iskeyword
from typing import Any

import jax.numpy as jnp
import numpy as np

from eoi_jax._checks import check
from eoi_jax.models.equations.expression import (
    Call,
    Expression,
    Number,
    Operation,
    Symbol,
    parts_of,
    symbols_of,
    value_of,
)
from eoi_jax.models.equations.parser import good_name, parse, words
from eoi_jax.models.plant import State

MOST_TEXT = 40_000  # characters of all equations together

_EITHER = "An output either has a derivative or is a function of the states."

Items = tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Equations:
    """The text of a model; equal (and compiled once) for equal texts.

    Attributes:
        derivatives: by state.
        definitions: by name.
        initial: of internal states, in the parameters, or "free"; of outputs and their rates,
            numbers.
        outputs, inputs, parameters: names.
        output: expressions of outputs that are no states, by name.
    """

    derivatives: Items
    definitions: Items
    initial: Items
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    output: Items = ()

    # -- what the names are ---------------------------------------------------------------

    @cached_property
    def chains(self) -> dict[str, tuple[str, ...]]:
        """By output: its states, from itself to the one before y^(r); none of relative degree 0."""
        rates = dict(self.derivatives)
        placed_names = set(self.outputs)
        chains: dict[str, tuple[str, ...]] = {}
        for output in self.outputs:
            if output in self.algebraic:
                chains[output] = ()
                continue
            chain = [output]
            while (
                following := rates[chain[-1]].strip()
            ) in rates and following not in placed_names:
                chain.append(following)
                placed_names.add(following)
            chains[output] = tuple(chain)
        return chains

    @cached_property
    def algebraic(self) -> frozenset[str]:
        """Outputs that are functions of the states."""
        return frozenset(name for name, _ in self.output)

    @property
    def degrees(self) -> tuple[int, ...]:
        """Relative degree of each output."""
        return tuple(len(self.chains[output]) for output in self.outputs)

    @cached_property
    def states(self) -> tuple[str, ...]:
        """Names of the internal states, in order."""
        chained = {name for chain in self.chains.values() for name in chain}
        return tuple(name for name, _ in self.derivatives if name not in chained)

    @cached_property
    def internal_rates(self) -> dict[str, str]:
        """By output whose first derivative is a formula of one internal state alone: that state."""
        pairs = {}
        for output in (name for name, chain in self.chains.items() if len(chain) == 1):
            symbols = symbols_of(self.rates[output])
            signals = [symbol.name for symbol in symbols if not symbol.parameter]
            if len(signals) == 1 and signals[0] in self.states:
                pairs[output] = signals[0]
        return pairs

    @cached_property
    def internal_integrals(self) -> dict[str, str]:
        """By internal state whose derivative is the name of a state alone: that state."""
        rates = {name: text.strip() for name, text in self.derivatives}
        return {name: rates[name] for name in self.states if rates[name] in rates}

    @cached_property
    def symbols(self) -> dict[str, Expression]:
        """What each name stands for, definitions apart."""
        chains = self.chains.items()
        return {
            **{name: Symbol(y, i) for y, chain in chains for i, name in enumerate(chain)},
            **{name: Symbol(name) for name in (*self.states, *self.inputs)},
            **{name: Symbol(name, parameter=True) for name in self.parameters},
        }

    # -- trees ----------------------------------------------------------------------------

    @cached_property
    def defined(self) -> dict[str, Expression]:
        """Trees of the definitions, in an order in which each uses earlier ones only.

        Those of outputs that are functions of the states are among them.
        """
        texts, names, trees = dict((*self.definitions, *self.output)), dict(self.symbols), {}
        for name in _in_order(texts, self.algebraic):
            group = "output" if name in self.algebraic else "definitions"
            tree = parse(texts[name], names, f"model.{group}.{name}")
            names[name] = _known_as(name, tree)
            trees[name] = tree
        return trees

    @cached_property
    def names(self) -> dict[str, Expression]:
        """What each name stands for in an equation."""
        definitions = {name: _known_as(name, tree) for name, tree in self.defined.items()}
        return {**self.symbols, **definitions}

    @cached_property
    def rates(self) -> dict[str, Expression]:
        """Trees of the derivatives."""
        return {
            name: parse(text, self.names, f"model.derivatives.{name}")
            for name, text in self.derivatives
        }

    @cached_property
    def starts(self) -> dict[str, Expression]:
        """Trees of the initial values; of a free one that with which a search begins."""
        parameters: dict[str, Expression] = {
            name: Symbol(name, parameter=True) for name in self.parameters
        }
        texts = {**dict(self.initial), **self.guesses}
        return {
            name: parse(texts[name], parameters, f"model.initial.{name}") for name in self.states
        }

    @cached_property
    def guesses(self) -> dict[str, str]:
        """By state whose start is free: the number with which a search for it begins, as text.

        Raises:
            ValueError: a guess that is no number, or of an output, which the records show.
        """
        guesses = {}
        for name, text in self.initial:
            word, field = text.strip(), f"model.initial.{name}"
            if word == "free" and word not in self.parameters:
                guesses[name] = "0.0"
            elif word.startswith("free("):
                guesses[name] = word[5:].removesuffix(")")
                rule = "must be free without a number: what a record shows begins as it does"
                check(name in self.states, field, rule, f'"{text}"', f'Write {name} = "free".')
                rule = "must have a number in brackets, with which a search for the start begins"
                _number(name, text, guesses[name], rule, 'For example "free(0.5)", or "free".')
        return guesses

    @cached_property
    def known_starts(self) -> dict[str, tuple[float | None, ...]]:
        """By output: known starts of its states, None where not known; outputs without any apart.

        Raises:
            ValueError: a start that is no number.
        """
        texts, starts = dict(self.initial), {}
        for name in self.guesses:
            texts.pop(name)
        for output, chain in self.chains.items():
            values = tuple(
                _number(name, texts[name], texts[name], _KNOWN, _UNKNOWN) if name in texts else None
                for name in chain
            )
            if any(value is not None for value in values):
                starts[output] = values
        return starts

    @property
    def highest(self) -> tuple[Expression, ...]:
        """y^(r) of each output."""
        return tuple(
            self.names[output] if output in self.algebraic else self.rates[self.chains[output][-1]]
            for output in self.outputs
        )

    @property
    def internal(self) -> tuple[Expression, ...]:
        """Rates of the internal states."""
        return tuple(self.rates[name] for name in self.states)

    def written_out(self, expression: Expression, max_size: int = 200) -> Expression | None:
        """A formula with the definitions put in; None where that would be too long to read.

        Args:
            expression: of the system.
            max_size: parts of a formula that can be read.
        """
        trees: dict[str, Expression] = {}
        sizes: dict[str, int] = {}
        for name, tree in self.defined.items():
            sizes[name] = _size(tree, sizes, max_size)
            if sizes[name] <= max_size:
                trees[name] = _put_in(tree, trees)
        size = _size(expression, sizes, max_size)
        return _put_in(expression, trees) if size <= max_size else None

    # -- checks ---------------------------------------------------------------------------

    def check(self, elsewhere: Iterable[str] = ()) -> None:
        """Every equation can be read, every name is used.

        Args:
            elsewhere: parameters that are used outside the equations.

        Raises:
            ValueError: what is wrong, in which equation, at which column.
        """
        self._check_names()
        _ = self.rates, self.starts, self.known_starts  # a mistake in them is found here
        used = {*self._reached(), *elsewhere}
        advice = "Use it in an equation, or leave it out."
        for name in self.parameters:
            check(name in used, f"model.parameters.{name}", "must be used", "no use", advice)
        for name in self.defined:
            check(name in used, f"model.definitions.{name}", "must be used", "no use", advice)
        for name in self.states:
            rule = "must be used on the way to an output"
            check(name in used, f"model.derivatives.{name}", rule, "no use", advice)

    def _check_names(self) -> None:
        groups = {
            "derivatives": tuple(name for name, _ in self.derivatives),
            "inputs": self.inputs,
            "parameters": self.parameters,
            "definitions": tuple(name for name, _ in self.definitions),
            "output": tuple(name for name, _ in self.output),
        }
        group_of_name: dict[str, str] = {}
        for name in self.inputs:
            rule = f"must not have the input {name}: what is recorded has no equation"
            advice = (
                "An equation that needs the derivative of an input cannot be written; give the "
                "model a state behind the input, or record the derivative as an input."
            )
            check(name not in groups["derivatives"], "model.derivatives", rule, repr(name), advice)
        for group, names in groups.items():
            for name in names:
                advice = "t, pi and the names of functions have a meaning already"
                advice += (
                    f", and so has {name} in Python: take {name}_." if iskeyword(name) else "."
                )
                rule = "must have names that are identifiers"
                check(good_name(name), f"model.{group}", rule, repr(name), advice)
                rule = f"must not have a name of `{group_of_name.get(name)}`"
                advice = _EITHER if group == "output" else ""
                check(name not in group_of_name, f"model.{group}", rule, repr(name), advice)
                group_of_name[name] = group
        texts = dict(self.derivatives)
        groups_of_texts = self.derivatives, self.definitions, self.initial, self.output
        size = sum(len(text) for items in groups_of_texts for _, text in items)
        rule = f"must have at most {MOST_TEXT} characters of equations"
        check(size <= MOST_TEXT, "model", rule, size)
        for name in self.algebraic:
            rule = f"must have outputs only ({', '.join(self.outputs)})"
            advice = "Give parts of equations names under `definitions`."
            check(name in self.outputs, "model.output", rule, repr(name), advice)
        for name in self.outputs:
            advice = (
                f'Add it: {name} = "…", or the name of its rate. If it is a function of the '
                f'states, write it under [model.output]: {name} = "…".'
            )
            stated = name in texts or name in self.algebraic
            got = ", ".join(texts) or "nothing"
            check(stated, "model.derivatives", f"must have {name}", got, advice)
        self._check_twins(texts)
        starts = dict(self.initial)
        for name in self.states:
            advice = "Give its value at the start of a record, or "
            advice += f'{name} = "free" to have it estimated, of each record by itself.'
            check(name in starts, "model.initial", f"must have the internal state {name}",
                  ", ".join(starts) or "nothing", advice)  # fmt: skip
        for name in starts:
            rule = f"must have states only ({', '.join(texts)})"
            advice = "An output that is a function of the states starts where they do."
            check(name in texts, "model.initial", rule, repr(name), advice)

    def _check_twins(self, texts: Mapping[str, str]) -> None:
        """An output with the rate of an internal state would be that state but for a constant."""
        for output in self.outputs:
            rate = texts.get(output, "").strip()
            if len(self.chains[output]) < 2:
                continue
            for state in self.states:
                check(
                    texts[state].strip() != rate,
                    f"model.derivatives.{output}",
                    f"must not have the derivative of the state {state}, from which {output} would "
                    "differ by a constant",
                    f'"{rate}"',
                    f"If {output} is a function of the states, write it under [model.output]: "
                    f'{output} = "…".',
                )

    def _reached(self) -> set[str]:
        """Names that the outputs depend on."""
        reached: set[str] = set()
        tables = [dict(items) for items in
                  (self.derivatives, self.definitions, self.initial, self.output)]  # fmt: skip
        ahead = list(self.outputs)
        while ahead:
            name = ahead.pop()
            if name not in reached:
                reached.add(name)
                for texts in tables:
                    ahead += words(texts.get(name, ""))
        return reached

    # -- values ---------------------------------------------------------------------------

    def values(self, t: Any, x: State, u: Any, p: Any) -> dict[Symbol, Any]:
        """What the names of all equations are worth."""
        values: dict[Symbol, Any] = {Symbol("t"): t}
        for j, (output, chain) in enumerate(self.chains.items()):
            values |= {Symbol(output, i): x.y[i, j] for i in range(len(chain))}
        values |= {Symbol(name): x.z[i] for i, name in enumerate(self.states)}
        values |= {Symbol(name): u[i] for i, name in enumerate(self.inputs)}
        values |= {Symbol(name, parameter=True): getattr(p, name) for name in self.parameters}
        for name, tree in self.defined.items():
            values[Symbol(name)] = value_of(tree, values, jnp)
        return values


@dataclass(frozen=True)
class TextDynamics:
    """f of a text model, a model function of `Plant`."""

    equations: Equations

    def __call__(self, t: Any, x: State, u: Any, p: Any) -> Any:
        """y^(r) of the outputs, shape (ny,)."""
        values = self.equations.values(t, x, u, p)
        return _stacked(self.equations.highest, values, x.y.dtype)


@dataclass(frozen=True)
class TextInternal:
    """g of a text model."""

    equations: Equations

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the internal states."""
        return self.equations.states

    def __call__(self, t: Any, x: State, u: Any, p: Any) -> Any:
        """Rates of the internal states, shape (nz,)."""
        values = self.equations.values(t, x, u, p)
        return _stacked(self.equations.internal, values, x.y.dtype)


@dataclass(frozen=True)
class TextStart:
    """Internal states of a text model at the start of a record."""

    equations: Equations

    @property
    def free(self) -> tuple[bool, ...]:
        """Which of them are estimated, of each record by itself."""
        return tuple(name in self.equations.guesses for name in self.equations.states)

    def __call__(self, p: Any) -> Any:
        """Internal states, shape (nz,)."""
        names = self.equations.parameters
        values = {Symbol(name, parameter=True): getattr(p, name) for name in names}
        trees = [self.equations.starts[name] for name in self.equations.states]
        return _stacked(trees, values, jnp.result_type(*p))


def _stacked(trees: Iterable[Expression], values: Mapping[Symbol, Any], dtype: Any) -> Any:
    # A constant alone has no type of its own: it takes that of the states.
    return jnp.stack([jnp.asarray(value_of(tree, values, jnp), dtype) for tree in trees])


# -- trees ------------------------------------------------------------------------------------


_KNOWN = "must be a number: the start of an output or of its rate is known or not"
_UNKNOWN = (
    "Leave it out to have it estimated, of each record by itself. A start that parameters give, as "
    "a dose in a volume, is one of an internal state, which `[model.output]` shows."
)


def _number(name: str, text: str, part: str, rule: str, advice: str) -> float:
    """The number in a part of a start as text."""
    uses = words(part) - {"pi"} or not part.strip()
    number = np.nan if uses else float(value_of(parse(part, {}, f"model.initial.{name}"), {}, np))
    check(bool(np.isfinite(number)), f"model.initial.{name}", rule, f'"{text}"', advice)
    return number


def _known_as(name: str, tree: Expression) -> Expression:
    # A constant is what it is, so that what it makes constant is worked out, and its size known.
    return tree if isinstance(tree, Number) else Symbol(name)


def _in_order(texts: Mapping[str, str], outputs: Collection[str]) -> list[str]:
    """Names of definitions and of `outputs`, each behind those that it uses."""
    uses = {name: words(text) & set(texts) for name, text in texts.items()}
    for name in outputs:
        rule = "must not depend on itself"
        advice = "Solve the equation for it, or make it a state with a derivative."
        check(name not in uses[name], f"model.output.{name}", rule, f'"{texts[name]}"', advice)
    try:
        return list(TopologicalSorter(uses).static_order())
    except CycleError as error:
        ring = error.args[1]
    group = "output" if set(ring) & set(outputs) else "definitions"
    raise ValueError(f"`model.{group}` must not go in a circle, got {' → '.join(ring)}.")


def _size(expression: Expression, sizes: Mapping[str, int], max_size: int) -> int:
    """Number of parts of a formula, those of definitions included; counted to `max_size` + 1."""
    if isinstance(expression, Symbol):
        return sizes.get(expression.name, 1)
    return min(1 + sum(_size(part, sizes, max_size) for part in parts_of(expression)), max_size + 1)


def _put_in(expression: Expression, trees: Mapping[str, Expression]) -> Expression:
    match expression:
        case Symbol(name=name):
            return trees.get(name, expression)
        case Operation(sign=sign, lhs=lhs, rhs=rhs):
            return Operation(sign, _put_in(lhs, trees), _put_in(rhs, trees))
        case Call(name=name, arguments=arguments):
            return Call(name, tuple(_put_in(argument, trees) for argument in arguments))
    return expression
