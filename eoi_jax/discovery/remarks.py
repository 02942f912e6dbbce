"""What a discovery says beside its answer, by kind: notes, and reasons why candidates were refused.

A note is a sentence for the reader. Its class says on what it is, and with that when it no longer
holds.
"""

from dataclasses import dataclass
from enum import StrEnum

from eoi_jax._status import FitNote


class GridNote(str):
    """A sentence on a shape at an end of the values that were searched; a refinement keeps it."""

    __slots__ = ()


class HoldNote(str):
    """A sentence on the hold and the skew of the inputs: it goes with records made in this way."""

    __slots__ = ()


class RecordNote(str):
    """A sentence on a parameter that differs from record to record, with its values."""

    __slots__ = ()


def is_on_fit(note: str) -> bool:
    """Whether a note is on a fitted model, and goes with it."""
    return isinstance(note, FitNote | GridNote)


class Reason(StrEnum):
    """Why a candidate was not added."""

    IN_MODEL = "in model"
    NOT_EVALUATED = "not evaluated"
    WRONG_SIGN = "wrong sign"
    HELD_OUT = "held out"  # the residual of held-out records grows
    LESS_PROBABLE = "less probable"  # held-out records prefer another set
    PRODUCT = "product"  # of signals, which the library does not have, explains more
    NO_FREE_RUN = "no free run"
    FREE_RUN = "free run"  # it gets worse on held-out records
    SIMPLER_LAW = "simpler law"  # does as well in free runs


@dataclass(frozen=True)
class Refusal:
    """Why a candidate was not added.

    Attributes:
        reason: the kind.
        text: in words.
    """

    reason: Reason
    text: str


IN_MODEL = Refusal(Reason.IN_MODEL, "already in the model")
NOT_EVALUATED = Refusal(Reason.NOT_EVALUATED, "not to be evaluated")
WRONG_SIGN = Refusal(Reason.WRONG_SIGN, "wrong sign")
HELD_OUT = Refusal(Reason.HELD_OUT, "held-out error grows")
PRODUCT_OF_REST = Refusal(Reason.PRODUCT, "a product of signals takes most of the rest")
PRODUCT_ALONE = Refusal(Reason.PRODUCT, "a product of signals takes more, alone")
NO_FREE_RUN = Refusal(Reason.NO_FREE_RUN, "its free run cannot be simulated")
FREE_RUN = Refusal(Reason.FREE_RUN, "held-out free run gets worse")
SIMPLER_LAW = Refusal(Reason.SIMPLER_LAW, "in free runs no better than a simpler law")


def less_probable(preferred: str) -> Refusal:
    """The refusal of an effect in whose place held-out records prefer another one."""
    return Refusal(Reason.LESS_PROBABLE, f"the held-out records prefer {preferred}")
