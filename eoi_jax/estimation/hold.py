r"""The hold and the skew of the inputs by the passes: those with the smallest index (14).

The logarithm of the index is that of the likelihood of a white injection. The power of the
injection is a parabola in a small delay of an input, so three fits find its minimum. An input that
acts later by more than a sample period is delayed by the plant; no plant answers before it is
driven, so that one that acts earlier than it was logged was logged late, by however much.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from eoi_jax.data.holds import (
    SETTINGS,
    HoldChoice,
    chosen_hold,
    clearly_smaller,
    least_of_parabola,
    moving_inputs,
    skew_text,
    undeclared_hold,
    with_hold,
    with_word,
)
from eoi_jax.data.input_holds import HOLDS, Hold, held_inputs, hold_of_each, hold_text
from eoi_jax.data.record import Record
from eoi_jax.estimation.lowpass import LowPass
from eoi_jax.estimation.preparation import PreparedRecords, prepare_records
from eoi_jax.models.augmented import augmented
from eoi_jax.models.effects import InputRate, SecondNode
from eoi_jax.models.jacobians import input_slopes, points_of
from eoi_jax.models.placements import placements
from eoi_jax.models.plant import Plant

Delays = Float[np.ndarray, " nu"]
FitOf = Callable[[Plant, PreparedRecords, int], Any]  # an `Identification`


@dataclass(frozen=True)
class HoldIndices:
    """The index (14) of the declared model with each hold that was tried, on one filter.

    The index is the geometric mean over the outputs; infinite where there is no estimate.

    Attributes:
        choice: the hold with the smallest index, and the indices; that of the rule where its index
            is hardly larger.
        rule: the hold that the samples of the inputs suggest.
        lowpass: the filter.
    """

    choice: HoldChoice
    rule: Hold
    lowpass: LowPass

    @property
    def best(self) -> Hold:
        """The hold with the smallest index; that of the rule where it is hardly larger."""
        return self.choice.best

    @property
    def possible(self) -> tuple[Hold, ...]:
        """Holds that are not refuted, the best one first; linear and smooth are often the same."""
        by_hold, count = self.choice.values, len(self.choice.names)
        smallest = by_hold[self.best]
        holds = sorted(by_hold, key=lambda hold: (hold != self.best, by_hold[hold]))
        kept: list[Hold] = []
        for hold in holds:
            index = by_hold[hold]
            refuted = not index <= SETTINGS.refuted * smallest
            same = any(
                abs(np.log(index / by_hold[accepted])) <= SETTINGS.same
                for accepted in kept
                if held_inputs(accepted, count) == held_inputs(hold, count)
            )
            if not refuted and not same:
                kept.append(hold)
        return tuple(kept) or (self.rule,)

    @property
    def evidence(self) -> tuple[str, ...]:
        """The ratios as sentences."""
        return self.choice.evidence("the index")


def hold_indices(
    plant: Plant, records: Sequence[Record], fit_of: FitOf, lowpass: LowPass | None = None
) -> HoldIndices | None:
    """The index with each hold, of all inputs and of each.

    Args:
        plant: with its nominal parameters.
        records: checked against the plant; one logger is taken to have made all of them.
        fit_of: fits the plant to prepared records in a few passes.
        lowpass: F of the fits; None: chosen from the records.

    Returns:
        None where every record declares its hold, or the plant has no inputs.
    """
    rule = undeclared_hold(records)
    if rule is None:
        return None
    # Indices of different filters cannot be compared: that of the first fit is the filter of all.
    first = prepare_records(plant, with_hold(records, rule), lowpass)
    filtered = first.lowpass

    def index(hold: Hold) -> float:
        prepared = first
        if hold != rule:
            prepared = prepare_records(plant, with_hold(records, hold), filtered)
        return trial_index(fit_of(plant, prepared, SETTINGS.passes))

    def better(index: float, reference: float) -> bool:
        return _clearly_smaller(index, reference, records, filtered)

    return HoldIndices(chosen_hold(index, rule, records, better), rule, filtered)


@dataclass(frozen=True)
class Skew:
    """How far the inputs are from the outputs in the log.

    Attributes:
        hold: of the inputs, with which the delays were found; of all or of each.
        delays: by which each input acts later than it was logged, shape (nu,) [s].
        index: with them; infinite where they were not found by it.
        ratio: of the index without them to that with them; None as well.
        rival: the same of a plant without a lead but with a faster part; infinite if not asked.
    """

    hold: Hold
    delays: Float[np.ndarray, " nu"]
    index: float = np.inf
    ratio: float | None = None
    rival: float = np.inf

    def evidence(self, record: Record) -> str:
        """The delays in one of the records, and the ratio, as a sentence."""
        text = skew_text(record, self.delays)
        if self.ratio is None:
            return f"{text}: a delay this short is taken for one of the logger"
        text += f": without this shift the index is {self.ratio:.3g} times as large"
        unsure = self.rival < SETTINGS.least_lead
        return text + _UNSURE.format(self.rival) if unsure else text


def best_skew(
    plant: Plant, records: Sequence[Record], hold: Hold, fit_of: FitOf, lowpass: LowPass
) -> Skew | None:
    """The hold and the skew with the smallest index, where the inputs have any skew.

    A held input that acts early and one that goes on and acts late are nearly the same, so the
    other holds of an input are tried once the best one without a skew has shown some. What the
    samples suggest counts where no other one fits clearly better.

    Args:
        plant: with its nominal parameters.
        records: as they were read.
        hold: that fits best without a skew.
        fit_of: as for `hold_indices`.
        lowpass: F of the fits.
    """
    best = channel_skew(plant, records, hold, fit_of, lowpass)
    if best is None:
        return None
    rule = hold_of_each(undeclared_hold(records) or hold, len(best.delays))
    for j in np.flatnonzero(best.delays).tolist():
        trials, words = [], hold_of_each(best.hold, len(best.delays))
        for word in HOLDS:
            if word != words[j]:
                changed, delays = with_word(best.hold, j, word, len(words)), best.delays.copy()
                delays[j] = 0.0
                trials.append(channel_skew(plant, records, changed, fit_of, lowpass, delays, (j,)))
        candidates = [best, *filter(None, trials)]
        closest = min(candidates, key=lambda skew: skew.index)
        if _clearly_smaller(closest.index, best.index, records, lowpass):
            best = closest
        for skew in candidates:
            suggested = hold_of_each(skew.hold, len(words))[j] == rule[j]
            if suggested and not _clearly_smaller(best.index, skew.index, records, lowpass):
                best = skew
    return best


def _clearly_smaller(
    index: float, reference: float, records: Sequence[Record], lowpass: LowPass
) -> bool:
    """Whether an index is smaller by more than chance, and by enough to matter.

    In a band of ω_c there are ω_c T / π independent values in the time T.
    """
    duration = sum(len(record) * record.sample_period for record in records)
    return clearly_smaller(index, reference, lowpass.cutoff * duration / np.pi)


def channel_skew(
    plant: Plant,
    records: Sequence[Record],
    hold: Hold,
    fit_of: FitOf,
    lowpass: LowPass,
    start: Float[np.ndarray, " nu"] | None = None,
    inputs: Sequence[int] | None = None,
) -> Skew | None:
    """The skew of the inputs with the smallest index, one input after the other.

    Args:
        plant: with its nominal parameters.
        records: as they were read; those that declare their hold are not shifted.
        hold: of the other ones.
        fit_of: as for `hold_indices`.
        lowpass: F of the fits.
        start: delays to begin with, shape (nu,) [s]; None: none.
        inputs: whose delays are found; None: of all that move.

    Returns:
        None where no shift lowers the index clearly: what acts later than it was logged by more
        than a sample period is a delay of the plant; what acts earlier was logged late.
    """

    def fit(delays: Delays, model: Plant = plant) -> Any:
        shifted = with_hold(records, hold, delays)
        return fit_of(model, prepare_records(model, shifted, lowpass), SETTINGS.passes)

    def index(delays: Delays) -> float:
        return trial_index(fit(delays))

    period = min(record.sample_period for record in records)
    moving = moving_inputs(records) if inputs is None else inputs
    unshifted = np.zeros(records[0].inputs.shape[1])
    delays = unshifted if start is None else start
    without = smallest = index(unshifted)
    if np.any(delays):
        smallest = index(delays)
    first = delays
    earliest = SETTINGS.earliest * period
    delays, smallest = _least(index, delays, smallest, moving, period, earliest)
    rival = np.inf
    for j in moving:
        late = _logged_late(index, first, smallest, j, records)
        if late is None or late[1] * SETTINGS.least_lead > smallest:
            continue
        fitted = fit(late[0]).plant
        if not keeps_direction(plant, fitted, records, j):
            continue
        faster = faster_plants(fitted, j, -float(late[0][j]))
        closest = (
            min([trial_index(fit(first, model)) for model in faster], default=np.inf) / late[1]
        )
        if closest > 1.0:
            (delays, smallest), rival = late, min(rival, closest)
    seen = np.max(np.abs(delays)) >= SETTINGS.least_skew * period
    if not seen or not _clearly_smaller(smallest, without, records, lowpass):
        return None
    return Skew(hold, delays, smallest, without / smallest, rival)


def _least(
    index: Callable[[Delays], float],
    delays: Delays,
    smallest: float,
    inputs: Sequence[int],
    period: float,
    earliest: float,
) -> tuple[Delays, float]:
    """Delays with the smallest index, by parabolas from where they are, and that index.

    Args:
        index: of delays [s].
        delays: to begin with.
        smallest: their index.
        inputs: whose delays are found.
        period: of the samples [s].
        earliest: by which an input may act earlier than it was logged [s]; later by a `period`.
    """
    for step in SETTINGS.trial_skews:
        for j in inputs:
            shift = period * step * (np.arange(len(delays)) == j)
            values = index(delays - shift), smallest, index(delays + shift)
            place = least_of_parabola(values)
            if place is None:
                continue
            trial = delays + place * shift
            within = np.max(trial) <= period and np.min(trial) >= -earliest
            if within and (value := index(trial)) < smallest:
                delays, smallest = trial, value
        if not np.any(delays):
            break
    return delays, smallest


def _logged_late(
    index: Callable[[Delays], float],
    delays: Delays,
    smallest: float,
    j: int,
    records: Sequence[Record],
) -> tuple[Delays, float] | None:
    """Delays with an input that was logged late by more than a sample, with their index.

    A lead is doubled as long as the index falls, and then searched in steps of half the size.

    Args:
        index: of delays [s].
        delays: of the other inputs; zero for this one.
        smallest: index with shifts within a sample.
        j: the input.
        records: as they were read.
    """
    period = min(record.sample_period for record in records)
    longest = longest_lead(records)

    def earlier(lead: float) -> Delays:
        return np.where(np.arange(len(delays)) == j, -lead * period, delays)

    lead = step = 2.0
    if lead * period > longest or not (lowest := index(earlier(lead))) < smallest:
        return None
    while (lead + step) * period <= longest and (value := index(earlier(lead + step))) < lowest:
        lead, lowest, step = lead + step, value, 2.0 * step
    while step > 0.5:
        step *= 0.5
        value, place = min((index(earlier(trial)), trial) for trial in (lead - step, lead + step))
        if value < lowest:
            lead, lowest = place, value
    return _least(index, earlier(lead), lowest, (j,), period, longest)


def longest_lead(records: Sequence[Record]) -> float:
    """Time by which an input may have been logged late [s].

    Args:
        records: as they were read.
    """
    period = min(record.sample_period for record in records)
    shortest = min(len(record) for record in records)
    return period * min(SETTINGS.longest_lead, shortest / SETTINGS.shortest_record)


def keeps_direction(plant: Plant, fitted: Plant, records: Sequence[Record], j: int) -> bool:
    """Whether an input acts in a fit in the direction in which the declared model has it.

    Behind feedback u = -k y inputs to come tell the motion to come, by a gain of the other sign.

    Args:
        plant: as it is declared.
        fitted: the same one with the parameters of a fit.
        records: along which the slopes of both are compared.
        j: the input.
    """
    total = 0.0
    for record in records:
        points = points_of(record, plant.rows, SETTINGS.instants)
        nominal, found = (np.asarray(input_slopes(model, *points, j)) for model in (plant, fitted))
        total += float(np.nansum(nominal * found))
    return total > 0.0


def faster_plants(plant: Plant, j: int, lead: float) -> list[Plant]:
    """The plant with what makes it answer an input as early as if that had been logged late.

    A response to the rate of the input; a store that is not measured behind an output of first
    order. Where one of them explains as much, it is as likely as a lead of many samples.

    Args:
        plant: fitted with the lead.
        j: the input.
        lead: by which it would have been logged late [s].
    """
    if plant.sampled is not None:  # no effect can be added
        return []
    share = SETTINGS.share
    rates = [at for at in placements(plant, [InputRate()]) if at.channel == j]
    laws = [(at, (lead, share * lead)) for at in rates]
    laws += [(at, (share / lead, share / lead)) for at in placements(plant, [SecondNode()])]
    return [augmented(plant, (at,), dict(zip(at.names, start, strict=True))) for at, start in laws]


def numerical_power(fit: Any) -> Float[np.ndarray, " ny"]:
    """Power of the injection below which it is an error of the discretisation, shape (ny,).

    Records without noise come down to it, and of two holds its ratio tells nothing: the inputs may
    change in steps alone that do not count, as at rest. Outputs of relative degree 0, whose samples
    are compared as they are, have none.

    Args:
        fit: an `Identification`.
    """
    observed = np.zeros(len(fit.unexplained))
    is_derivative = (fit.unexplained > 0.0) & (np.asarray(fit.plant.degrees) > 0)
    np.divide(fit.index[fit.best_pass], fit.unexplained**2, observed, where=is_derivative)
    return SETTINGS.numerical**2 * observed


def trial_index(fit: Any) -> float:
    """Geometric mean over the outputs of the index, or of `numerical_power` where that is larger.

    Args:
        fit: an `Identification`; without an estimate the index is infinite.
    """
    if not fit.status.fits:
        return np.inf
    return geometric_mean(np.maximum(fit.index[fit.best_pass], numerical_power(fit)))


def geometric_mean(index: Float[np.ndarray, " ny"]) -> float:
    """Over the outputs."""
    return float(np.exp(np.mean(np.log(np.maximum(index, 1e-300)))))


def decided(
    plant: Plant, records: Sequence[Record], fit_of: FitOf, lowpass: LowPass | None = None
) -> tuple[tuple[Record, ...], tuple[str, ...]]:
    """Records with the hold and the skew that the model fits best, and the evidence as sentences.

    Arguments are those of `hold_indices`.
    """
    indices = hold_indices(plant, records, fit_of, lowpass)
    if indices is None or not np.isfinite(indices.choice.values[indices.best]):
        return tuple(records), ()
    skew = best_skew(plant, records, indices.best, fit_of, indices.lowpass)
    if skew is None:
        return with_hold(records, indices.best), indices.evidence
    shifted = with_hold(records, skew.hold, skew.delays)
    changed = (f"hold {hold_text(skew.hold, records[0].input_names)}",)
    notes = indices.evidence if skew.hold == indices.best else changed
    return shifted, (*notes, skew.evidence(records[0]))


_UNSURE = (
    ", and {:.3g} times with a response to the rate of the input, or a store that is not measured, "
    "in its place: the model may lack either"
)
