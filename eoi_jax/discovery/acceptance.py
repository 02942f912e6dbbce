"""The status of a set of effects, from the residual before and after it is added."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from eoi_jax._status import Status
from eoi_jax.discovery.regression import Base, fitted, within_bounds
from eoi_jax.discovery.round import RoundResult
from eoi_jax.discovery.round_start import RoundStart
from eoi_jax.discovery.rules import RULES
from eoi_jax.models.algebraic_outputs import highest_derivative
from eoi_jax.models.augmented import Placed

_RULES = RULES.answer
_MEDIAN_OF_SQUARE = 0.455  # of the square of a normal variable
_UNNAMED = ": nothing that the data can name"
_NO_EFFECT = (
    "{}, more than noise, and none of the tested effects explains it. `diagnosis` "
    "shows where it lives; "
)
_OTHER_MOTIONS = "more records, of other motions, may tell"
_NO_STATE = (
    "no output is a state, so that what acts on states (springs, friction, losses) was not tried. "
    "Write such a term into the equations, that of the output too where it shows a force, or "
    "measure the state as an output"
)
_UNTRIED = (
    "{}, more than noise, and no effect was tried: those that are asked for need "
    "held-out records. Give `validation`"
)
_EXPLAINED_TEXT = "the effects take {:.1%} of the residual's power; {}"
_REST_UNEXPLAINED = (
    ", more than noise. No other tested effect comes near the first of them, and free runs on "
    "other data confirm it; the rest stays unexplained"
)
_PARTLY = (
    "the best of the tested effects, {}, takes only {:.0%} of the residual's power; "
    "{}: not the whole story, so nothing was added"
)

_DENIED = (
    "{} would explain {:.1%} of the residual's power, but the held-out records do not confirm it: "
    "with it the error on them grows. Hold out a record that moves as those of the fit do"
)


def explained(
    rounds: Sequence[RoundResult], plain: RoundStart | None = None
) -> tuple[float, float, bool]:
    """How much of the residual is explained.

    Evaluated for the result of the rounds, or for a simpler `plain` model that replaces it and from
    which no search was made; with all parameters within their bounds.

    Returns:
        Share of the residual's power above the noise that is explained; rms of the remaining
        residual over that of y^(r); whether the remaining residual is noise: white as predicted, or
        below the noise.
    """
    first, last = rounds[0], rounds[-1]
    residual_before, residual_after = first.declared.residual, _final_residual(last)
    if plain is not None:
        power = last.ranked.scores.power
        residual_after = within_bounds(plain.base, fitted(plain.base, [], power), power).residual
    return _power_explained(first, last, residual_before, residual_after)


def remaining_power(rounds: Sequence[RoundResult], share: float, noise_like: bool) -> float:
    """Power of the residual that is left beyond the noise.

    Args:
        rounds: of the search.
        share: that is explained.
        noise_like: whether the remaining residual is noise.
    """
    first, last = rounds[0], rounds[-1]
    noise = _noise_scale(last.base, _final_residual(last)) * first.base.noise_power
    excess = first.base.signal_power(first.declared.residual) - noise
    return 0.0 if noise_like else max((1.0 - share) * excess, 0.0)


def _final_residual(last: RoundResult) -> Float[np.ndarray, " rows"]:
    return last.declared.residual if not last.chosen.atoms else last.bounded_fit.residual


def denied(first: RoundResult) -> tuple[tuple[Placed, ...], Status] | None:
    """The set that would be the answer, if only the held-out records refuse it; and that status."""
    fit = first.decision.denied
    if fit is None or first.chosen.atoms:
        return None
    share, _, _ = _power_explained(first, first, first.declared.residual, fit.residual)
    placed = tuple(atom.placed for atom in fit.atoms)
    status = Status("unexplained", _DENIED.format(labels_of(placed), share))
    return (placed, status) if share >= _RULES.half else None


def _power_explained(
    first: RoundResult,
    last: RoundResult,
    residual_before: Float[np.ndarray, " rows"],
    residual_after: Float[np.ndarray, " rows"],
) -> tuple[float, float, bool]:
    """`explained`, from the residuals of the first and of the last model."""
    noise = _noise_scale(last.base, residual_after) * first.base.noise_power
    excess = first.base.signal_power(residual_before) - noise
    unexplained = max(first.base.signal_power(residual_after) - noise, 0.0)
    total = first.base.output_power - noise
    if not (excess > 0.0 and total > 0.0 and np.isfinite(unexplained)):
        return 0.0, 0.0 if np.isfinite(unexplained) else np.inf, last.exhausted
    share = float(np.clip(1.0 - unexplained / excess, 0.0, 1.0))
    return share, float(np.sqrt(unexplained / total)), last.exhausted or unexplained <= noise


def _noise_scale(base: Base, residual: Float[np.ndarray, " rows"]) -> float:
    """Share of the predicted noise that is present: a record's estimate is an upper bound."""
    ratio = residual**2 / np.maximum(base.noise, 1e-300)
    return float(min(1.0, np.median(ratio) / _MEDIAN_OF_SQUARE))


def judged(
    placed: Sequence[Placed],
    share: float,
    relative_residual: float,
    noise_like: bool,
    degrees: Sequence[int],
    unrivalled: bool = False,
    tried: bool = True,
) -> Status:
    """Whether a set of effects is the answer, with the reason.

    Args:
        placed: the set; may be empty.
        share: share of the residual's power that the set explains.
        relative_residual: rms of the remaining residual over that of y^(r).
        noise_like: whether the remaining residual is noise.
        degrees: relative degree of each output.
        unrivalled: whether half can be enough: no other effect explains nearly as much, and free
            runs on held-out data decide.
        tried: whether any effect was tried, or will be in free runs.
    """
    is_negligible, description = (
        noise_like or relative_residual <= _RULES.negligible,
        _residual_text(relative_residual, degrees),
    )
    if not placed:
        if is_negligible:
            unnamed = _UNNAMED if relative_residual > 0.0 else ""
            return Status("nothing_missing", f"{description}{unnamed}")
        reason = _UNTRIED
        if tried:
            reason = _NO_EFFECT + (_OTHER_MOTIONS if any(degrees) else _NO_STATE)
        return Status("unexplained", reason.format(description))
    if share >= _RULES.explained or is_negligible:
        return answered(share, relative_residual, degrees)
    if unrivalled and share >= _RULES.half:
        return Status("complete", _EXPLAINED_TEXT.format(share, description) + _REST_UNEXPLAINED)
    return Status("unexplained", _PARTLY.format(labels_of(placed), share, description))


def answered(share: float, relative_residual: float, degrees: Sequence[int]) -> Status:
    """The status of a set that is the answer, whatever its share."""
    remaining = _residual_text(relative_residual, degrees)
    return Status("complete", _EXPLAINED_TEXT.format(share, remaining))


def _residual_text(relative_residual: float, degrees: Sequence[int]) -> str:
    if not relative_residual > 0.0:
        return "nothing is left beyond the noise"
    derivative = highest_derivative(degrees)
    if relative_residual > 1.0:
        return f"the rms of what is left is {relative_residual:.2g} times that of the {derivative}"
    return f"what is left is {relative_residual:.2g} of the {derivative} (rms)"


def labels_of(placed: Sequence[Placed]) -> str:
    """The effects as words of a sentence, with their forms and without duplicates."""
    return " and ".join(dict.fromkeys(location.effect.label for location in placed))


def names_of(placed: Sequence[Placed]) -> tuple[str, ...]:
    """Names of the effects without duplicates, in their order."""
    return tuple(dict.fromkeys(location.effect.name for location in placed))
