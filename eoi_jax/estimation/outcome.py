"""How the iterations of an estimate ended, in words."""

from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Float

from eoi_jax._status import Status
from eoi_jax.data.masks import constant
from eoi_jax.data.record import Record
from eoi_jax.estimation.common_factors import CommonFactor
from eoi_jax.estimation.iteration import IterationHistory
from eoi_jax.estimation.regression.least_squares import untraced
from eoi_jax.models.plant import Plant


def outcome(
    plant: Plant,
    history: IterationHistory,
    records: Sequence[Record],
    factors: Sequence[CommonFactor],
) -> Status:
    """The status of a single lane.

    Args:
        plant: as it was declared.
        history: of its iterations.
        records: as used.
        factors: parameters that no record tells apart.
    """
    code, passes = str(history.codes[0]), int(history.passes[0])
    best_pass = int(history.best_pass[0]) + 1
    if code == "no_data":
        all_constant = all(np.all(constant(record)) for record in records)
        names = ", ".join(plant.outputs)
        return Status(code, _CONSTANT_OUTPUTS.format(names) if all_constant else _NO_DATA)
    if code == "diverged":
        return Status(code, _DIVERGED)
    if code == "unidentifiable":
        solution = jax.tree.map(lambda leaf: leaf[0], history.best.solution)
        combinations = untraced(solution, plant.names, plant.free)
        sentences = [factor.sentence for factor in factors]
        if len(combinations) > sum(len(factor.fix) for factor in factors):
            sentences.append(_UNTRACED.format("; ".join(combinations)))
        return Status(code, ". ".join(sentences))
    if passes == 1:
        return Status(code, "one pass only: the nominal values were scored")
    still_falling = _CYCLING if _rises_again(history.index[0, :passes]) else _STILL_FALLING
    messages = {
        "passes_exhausted": still_falling.format(best_pass),
        "converged": f"the index is smallest in pass {best_pass} of {passes}",
        "stalled": _STALLED.format(best_pass, float(history.best.predicted_reduction[0]))
        + (_POOR_OBSERVER if plant.is_affine else _NONLINEAR),
    }
    return Status(code, messages[code])


def _rises_again(
    index: Float[np.ndarray, "passes ny"], rises: int = 3, share: float = 0.25
) -> bool:
    """Whether the index rises again and again: as often, and in that share of the passes."""
    with np.errstate(divide="ignore", invalid="ignore"):  # passes that diverged have none
        changes = np.diff(np.sum(np.log(index), axis=1))
    return bool(np.sum(changes > 0.0) >= max(rises, share * len(changes)))


def sliding_notes(plant: Plant, sliding: Float[np.ndarray, " ny"]) -> tuple[str, ...]:
    """A sentence where outputs leave the sliding mode.

    Args:
        plant: with its outputs.
        sliding: share of scored steps in sliding mode.
    """
    outputs = [name for name, share in zip(plant.outputs, sliding, strict=True) if share < 0.9]
    if not outputs:
        return ()
    shares = ", ".join(f"{share:.0%}" for share in sliding)
    note = (
        f"in sliding mode in only {shares} of the scored steps ({', '.join(outputs)}): the "
        "injection is not the model's error while the relay saturates. Raise its gain"
    )
    return (note,)


_CONSTANT_OUTPUTS = (
    "the outputs ({}) are constant throughout, so that no parameter leaves a trace: excite the "
    "plant, or check which columns are read"
)
_NO_DATA = (
    "no sample is left to score: the record is shorter than the transient, masked, or the plant "
    "stands still throughout. Use a longer record, a shorter `transient`, or more excitation"
)
_STILL_FALLING = "the index is smallest in pass {} and was still to fall: allow more passes"
_CYCLING = (
    "the index rises and falls from pass to pass, smallest in pass {}: more passes hardly help. "
    "The records tell too little of a parameter, or the outputs draw the passes to different "
    "values in turn. Use `refine`, whose standard errors say which parameter stays open, and "
    "excite that"
)
_STALLED = (
    "the index is smallest in pass {}, though least squares promises to lower it by {:.0%} more: "
)
_NONLINEAR = (
    "the model is far from linear in its parameters there. Start from other nominal values, or "
    "set bounds"
)
_POOR_OBSERVER = "the injection of the observer is not the model's error. Try other gains"
_DIVERGED = (
    "the model, or its slope with a parameter, is not finite along the record: check units, "
    "nominal values, and functions such as sqrt or log at the measured outputs"
)
_UNTRACED = (
    "no trace in the data of {}: such a change leaves the outputs as they are. Fix one of the "
    "parameters, or excite the plant so that they differ"
)
