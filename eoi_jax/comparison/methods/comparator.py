"""The interface of comparators: named methods that estimate a plant's parameters from records."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from eoi_jax._status import Status
from eoi_jax.data.record import Record
from eoi_jax.models.plant import Plant


@dataclass(frozen=True)
class Estimate:
    """Answer of a comparator.

    Attributes:
        parameters: estimate by name; None without an answer.
        standard_errors: by name; None if the method gives none.
        status: how it ended.
    """

    parameters: dict[str, float] | None
    standard_errors: dict[str, float] | None
    status: Status


class AbstractComparator(ABC):
    """Interface of the methods of `compare`.

    Attributes:
        name: one word for tables.
        description: one sentence.
    """

    name: ClassVar[str]
    description: ClassVar[str]

    @abstractmethod
    def estimate(self, plant: Plant, records: Sequence[Record]) -> Estimate:
        """Estimate the free parameters of a plant.

        Args:
            plant: with its nominal parameters.
            records: one or several, checked against the plant; all enter one estimate.

        Returns:
            The estimate; without parameters where the method has no answer, or does not apply to
            the plant. It may raise: `compare` turns exceptions into a status.
        """


def algebraic_answer(plant: Plant) -> Estimate | None:
    """No answer, for a plant with outputs of relative degree 0; None for any other.

    Args:
        plant: the plant.
    """
    names = [name for name, on in zip(plant.outputs, plant.algebraic, strict=True) if on]
    if not names:
        return None
    return not_applicable(
        f"the method differentiates outputs, and {', '.join(names)} is a function of the states "
        "(relative degree 0)"
    )


def not_applicable(reason: str) -> Estimate:
    """No answer, because the method does not apply to the plant or the records.

    Args:
        reason: a sentence without a full stop.
    """
    return Estimate(None, None, Status("not_applicable", reason))


def named(plant: Plant, values: Float[np.ndarray, " np"]) -> dict[str, float]:
    """Values in the order of the plant's parameters, by name."""
    return {name: float(value) for name, value in zip(plant.names, values, strict=True)}
