"""What the residual before and after says of a set of effects, as a status with its sentence."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from eoi_jax._status import Status
from eoi_jax.discovery.regression import Base, fitted, within_bounds
from eoi_jax.discovery.round import Round
from eoi_jax.models.augmented import Placed

_EXPLAINED = 0.9  # share of the residual's power from which on a set is an answer
# Where no other effect comes near the first one (in power that it takes alone), half is enough if
# free runs on held-out data confirm it.
_MAINLY = 0.5
_MEDIAN = 0.455  # of the square of a normal variable
_MATERIAL = 0.01  # residual over y^(r), both rms, below which nothing is missing
_NOTHING = "what is left is {}: nothing that the data can name"
_UNKNOWN = (
    "what is left is {}, more than noise, and no effect of the library explains it. `diagnosis` "
    "shows where it lives; more records with other inputs may tell"
)
_FOUND = "the effects take {:.1%} of the residual's power; what is left is {}"
_REST = (
    ", more than noise. No other effect comes near the first of them, and free runs on other data "
    "confirm it; the rest stays unexplained"
)
_PARTLY = (
    "the best that the library has, {}, takes only {:.0%} of the residual's power and leaves "
    "{}: not the whole story, so nothing was added"
)

DENIED = "but the held-out records do not confirm it"  # tells such a status from others
_DENIED = (
    "{} explains {:.1%} of the residual's power, " + DENIED + ": with it the error on them grows. "
    "Hold out a record that moves as those of the fit do"
)


def explained(rounds: Sequence[Round], plain: Round | None = None) -> tuple[float, float, bool]:
    """Share of the residual's power above the noise that is gone; what is left over y^(r), rms.

    And whether that is noise: white as predicted, or less than the noise is. Of what the rounds
    found, or of a `plain` model that stands in its place, which was not searched; all of them with
    their parameters within the bounds.
    """
    first, last = rounds[0], rounds[-1]
    before = first.declared.residual
    after = last.declared.residual if not last.chosen.atoms else last.kept.residual
    if plain is not None:
        power = last.found.power
        after = within_bounds(plain.base, fitted(plain.base, [], power), power).residual
    return _taken(first, last, before, after)


def unless_denied(status: Status, first: Round) -> Status:
    """The status, or that a set would be the answer, were it not for the held-out records."""
    fit = first.denied
    if status.code != "unexplained" or fit is None or first.chosen.atoms:
        return status
    share, _, _ = _taken(first, first, first.declared.residual, fit.residual)
    names = " and ".join(names_of([one.placed for one in fit.atoms]))
    told = Status("unexplained", _DENIED.format(names, share))
    return told if share >= _MAINLY else status


def _taken(
    first: Round,
    last: Round,
    before: Float[np.ndarray, " rows"],
    after: Float[np.ndarray, " rows"],
) -> tuple[float, float, bool]:
    """`explained`, from the residuals of the first and of the last model."""
    noise = _noise_scale(last.base, after) * first.base.noise_power
    excess = first.base.signal_power(before) - noise
    rest = max(first.base.signal_power(after) - noise, 0.0)
    whole = first.base.output_power - noise
    if not (excess > 0.0 and whole > 0.0 and np.isfinite(rest)):
        return 0.0, 0.0 if np.isfinite(rest) else np.inf, last.exhausted
    share = float(np.clip(1.0 - rest / excess, 0.0, 1.0))
    return share, float(np.sqrt(rest / whole)), last.exhausted or rest <= noise


def _noise_scale(base: Base, residual: Float[np.ndarray, " rows"]) -> float:
    """How much of the predicted noise is there: a record's noise estimate is an upper bound."""
    ratio = residual**2 / np.maximum(base.noise, 1e-300)
    return float(min(1.0, np.median(ratio) / _MEDIAN))


def judged(
    placed: Sequence[Placed], share: float, left: float, noise_like: bool, alone: bool = False
) -> Status:
    """Whether a set of effects is the answer, and in words why.

    Args:
        placed: the set, or nothing.
        share: of the residual's power that it takes.
        left: what is left over y^(r), both rms.
        noise_like: whether that is noise.
        alone: whether half can be enough: no other effect comes near, and free runs on held-out
            data will judge.
    """
    good, rest = noise_like or left <= _MATERIAL, _rest(left)
    if not placed:
        if good:
            return Status("nothing_missing", _NOTHING.format(rest))
        return Status("unexplained", _UNKNOWN.format(rest))
    if share >= _EXPLAINED or good:
        return answered(share, left)
    if alone and share >= _MAINLY:
        return Status("explained", _FOUND.format(share, rest) + _REST)
    return Status("unexplained", _PARTLY.format(" and ".join(names_of(placed)), share, rest))


def answered(share: float, left: float) -> Status:
    """Of a set that is the answer, whatever its share."""
    return Status("explained", _FOUND.format(share, _rest(left)))


def _rest(left: float) -> str:
    share = f"{left:.2g} of the highest derivative (rms)"
    return share if left > 0.0 else "nothing beyond the noise"


def names_of(placed: Sequence[Placed]) -> tuple[str, ...]:
    """Each name once, in the order in which the effects came."""
    return tuple(dict.fromkeys(one.effect.name for one in placed))
