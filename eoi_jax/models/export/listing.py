"""What the program languages share: names, expressions, comments, and what of a model they use."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from eoi_jax.models.equations.expression import (
    Expression,
    Symbol,
    functions_of,
    is_flag,
    symbols_of,
)
from eoi_jax.models.equations.printer import Notation, written
from eoi_jax.models.export.names import comment, header, identifiers
from eoi_jax.models.export.program import Program


@dataclass(frozen=True)
class Listing:
    """A model in one language.

    Attributes:
        model: what is written.
        notation: of the language, its own names apart.
        assigned: a line that gives a name (first) a value (second).
        remark: of a unit, at the end of such a line.
        assigned_flag: as `assigned`, for what is true or false.
    """

    model: Program
    notation: Notation
    assigned: str
    remark: str
    assigned_flag: str = ""

    @cached_property
    def names(self) -> dict[Symbol, str]:
        """Identifier of every variable."""
        return identifiers(self.model)

    @cached_property
    def called(self) -> set[str]:
        """Functions that the equations call."""
        return set().union(*map(functions_of, self._trees))

    @cached_property
    def used(self) -> set[Symbol]:
        """Variables that the equations read."""
        return set().union(*map(symbols_of, self._trees))

    @property
    def _trees(self) -> list[Expression]:
        return [tree for _, tree in self.model.definitions] + list(self.model.rates)

    def code(self, tree: Expression) -> str:
        """An expression."""
        return written(tree, replace(self.notation, symbol=self.names.__getitem__))

    def reading(self, trees: Sequence[Expression]) -> "Listing":
        """The same, of a model that has these formulas too.

        Args:
            trees: of its variables.
        """
        return replace(self, model=replace(self.model, rates=(*self.model.rates, *trees)))

    def top(
        self,
        mark: str,
        indices: tuple[str, str, str],
        version: str,
        vectors: tuple[str, str, str] = ("states", "inputs", "outputs"),
    ) -> list[str]:
        """What the file is, as comments: brackets of an index, and the first one; vectors."""
        text = header(self.model, self.names, indices, version, vectors)
        return [f"{mark} {line}".rstrip() for line in text.splitlines()]

    def parameters(self) -> list[str]:
        """Values of those that are used."""
        return [
            self.assigned.format(self.names[variable.symbol], self.notation.number(value))
            + (self.remark.format(comment(remark)) if remark else "")
            for variable, value in self.model.parameters
            if variable.symbol in self.used
            for remark in (", ".join(filter(None, (variable.unit, variable.note))),)
        ]

    def elements(self, element: Callable[[str, int], str]) -> list[str]:
        """States and inputs that are used, from their vectors."""
        return [
            self.assigned.format(self.names[variable.symbol], element(vector, k))
            for vector, variables in (("states", self.model.states), ("inputs", self.model.inputs))
            for k, variable in enumerate(variables)
            if variable.symbol in self.used
        ]

    def definitions(self) -> list[str]:
        """What is worked out before the rates."""
        return [
            form.format(self.names[symbol], self.code(tree))
            for symbol, tree in self.model.definitions
            for form in (self.assigned_flag if is_flag(tree) else self.assigned,)
        ]
