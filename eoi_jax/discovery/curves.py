r"""A curve where no law of the library fits: what is missing depends on a single signal.

The declared model, and the answer so far, are refined with a natural cubic spline of each signal in
turn (`models/effects/curve.py`): every output, every velocity, every input. A spline takes the
place of the answer, or stands beside it, where that lowers the errors of free runs on held-out
records as much as what confirms an effect elsewhere: a law that is nearly right then gives way, and
one that is right does not, since a curve can only do the same. A law that is like the curve takes
its place where it predicts as well; else the law that comes nearest is named beside it.
"""

from collections.abc import Container, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from eoi_jax.data.holds import with_hold
from eoi_jax.data.record import Record
from eoi_jax.discovery.additions import has_size, smallest_values
from eoi_jax.discovery.confirm import beyond_noise
from eoi_jax.discovery.free_run_search import FreeRunAnswer
from eoi_jax.discovery.free_run_trials import Search, refined
from eoi_jax.discovery.in_free_runs import answered, contradicts_injection, placed_effects
from eoi_jax.discovery.judge import Judge, Judged, mean_error
from eoi_jax.discovery.result import Added, Discovery
from eoi_jax.discovery.rules import RULES
from eoi_jax.estimation.lowpass import LowPass
from eoi_jax.models.augmented import Placed, augmented, place
from eoi_jax.models.effects import ConstantOffset, Curve, InputCurve, standard, wider
from eoi_jax.models.effects.curve import knots_of, varies
from eoi_jax.models.effects.effect import (
    AbstractEffect,
    AbstractInputEffect,
    AbstractInternalEffect,
    AbstractTerm,
    At,
    Seen,
)
from eoi_jax.models.placements import placements
from eoi_jax.refinement.score_test import LinearisedRuns

_RULES = RULES.curves
_SHAPES = (
    Curve("y", ()), Curve("v", ()), Curve("y", (), "v"), Curve("y", (), "sign"),
    Curve("y", (), "u"),
)  # fmt: skip


def misses_a_law(discovery: Discovery) -> bool:
    """Whether curves are tried: more than noise is left, held out, or many effects have been added.

    What an effect does to an internal state no curve of a measured
    signal does.
    """
    plant = discovery.declared.nominal
    if discovery.in_sample or plant.has_algebraic or plant.sampled is not None:
        return False
    if any(isinstance(item.effect, AbstractInternalEffect) for item in discovery.added):
        return False
    answers = ("unexplained", "partial", "complete")
    runs = discovery.windows_after or discovery.after
    unexplained = beyond_noise(runs, plant=discovery.plant)
    return discovery.status.code in answers and (bool(unexplained) or _crowded(discovery.added))


def with_curves(
    discovery: Discovery, records: tuple[Record, ...], lowpass: LowPass | None
) -> Discovery:
    """The discovery, with curves of single signals where they predict far better.

    Args:
        discovery: the answer so far.
        records: to fit, as given.
        lowpass: F of the fits; None: chosen from the records.
    """
    declared, judging = discovery.declared, discovery.held_out
    skew, judge = judging[0].skew, Judge.of(judging, declared.plant)
    fitted = with_hold(records, judging[0].hold, skew if np.any(skew) else None)
    if judge is None:
        return discovery
    search = Search.begun([declared.plant, declared.nominal], fitted, judge)
    if search is None:
        return discovery
    named = search.base
    if discovery.added:
        placed = placed_effects(discovery)
        named = refined(discovery.plant, placed, fitted, search.judge)
        if named is None:
            return discovery
        if not (beyond_noise(named.short_runs, plant=named.refinement.plant) or _crowded(placed)):
            return discovery
    explained = discovery.status.code == "complete"
    best = _with_best_curve(search, named, explained)
    # The answer may be of a fit that its own refinement does not come to.
    answers = mean_error(judge.runs(discovery.plant)) if discovery.added else np.inf
    if best is named or best.error > answers + _RULES.as_good:
        return discovery
    best = _as_law(search, best)
    settled = search.settled(search.leanest(best))
    if settled is None or not tells_its_curve(settled):
        return discovery
    answer = FreeRunAnswer.of(search, settled, declared.plant)
    outcome = answered(discovery, answer, (), lowpass)
    if outcome is discovery or (explained and contradicts_injection(outcome, discovery)):
        return discovery
    notes = dict.fromkeys((*outcome.notes, *_nearest_laws(answer.best)))
    return replace(outcome, ambiguous_with=(), advice="", notes=tuple(notes))


def tells_its_curve(model: Judged) -> bool:
    """Whether a fit tells the size of the curves in it.

    A curve that was found over runs of one length may be of another shape over runs of another
    one: then the records do not tell it.
    """
    curves = [at for at in model.placed if isinstance(at.effect, Curve | InputCurve)]
    return all(has_size(at, model.refinement) for at in curves)


def _with_best_curve(search: Search, named: Judged, explained: bool) -> Judged:
    """The model with the curve that predicts far better; the named one without any.

    In place of the named effects, where that is enough; else beside them. Where these explain the
    injection, only in their place, and only a curve of a signal that one of them depends on.
    """
    signals = {law.effect.depends_on for law in named.placed} if explained else {*"yvu"}
    for origin in [search.base] if explained or not named.placed else [search.base, named]:
        least = max(_RULES.share, _share_to_reach(named, origin))
        trials = [trial for placed in _curves(origin, signals, least)
                  if (trial := _fitted(search, origin, placed)) is not None]  # fmt: skip
        if not trials:
            continue
        best = search.judge.plainest(trials)
        better = _is_far_better(best, named) or _replaces_sum(search, best, named)
        left = beyond_noise(best.short_runs, plant=best.refinement.plant)
        is_close = best.error < named.error + np.log(_RULES.finer)
        if (_crowded(named.placed) and is_close) or (better and left):
            best = _finest(search, best)
            better = _is_far_better(best, named) or _replaces_sum(search, best, named)
        if better and search.accepts(best, origin, ()):
            return best
    return named


def _share_to_reach(named: Judged, origin: Judged) -> float:
    """Share that a curve takes of the power of the errors at least, to get near what decides.

    A score test is linear, and says so within a factor.
    """
    decides = _RULES.as_good if len(_laws(named)) > 1 else np.log(RULES.answer.confirmed)
    fall = origin.error - named.error - decides - np.log(_RULES.linear)
    return float(min(1.0 - np.exp(-2.0 * fall), _RULES.sure))


def _is_far_better(trial: Judged, rival: Judged) -> bool:
    """Whether the errors fall by as much as what confirms an effect elsewhere."""
    return bool(trial.error < rival.error + np.log(RULES.answer.confirmed))


def _replaces_sum(search: Search, trial: Judged, rival: Judged) -> bool:
    """Whether a single curve does as well as many laws, or better than several of its signal.

    Many laws of which one alone comes near the curve are that law, and small ones beside it.
    """
    laws = _laws(rival)
    if len(trial.placed) != 1 or len(laws) < 2:
        return False
    if _crowded(laws):
        as_good = trial.error < rival.error + _RULES.as_good
        return bool(as_good and not any(
            single is not None and not _is_far_better(trial, single)
            for single in (search.with_only((law,), rival) for law in laws)
        ))  # fmt: skip
    curve = trial.placed[0]
    signal = curve.effect.depends_on, curve.channel
    of_signal = all((law.effect.depends_on, law.channel) == signal for law in laws)
    return bool(of_signal and trial.error < rival.error)


def _laws(model: Judged) -> list[Placed]:
    """Effects of a model, an offset apart."""
    return [law for law in model.placed if not isinstance(law.effect, ConstantOffset)]


def _crowded(effects: Sequence[Placed | Added]) -> bool:
    """Whether there are so many effects, an offset apart, that they may stand for a single law."""
    laws = sum(not isinstance(item.effect, ConstantOffset) for item in effects)
    return laws >= _RULES.several


def _finest(search: Search, model: Judged) -> Judged:
    """The model, or that with points between those of its curve if it predicts better."""
    *earlier, last = model.placed
    effect = last.effect
    assert isinstance(effect, Curve | InputCurve)
    knots = np.array(effect.knots)
    knots = np.sort(np.concatenate([knots, 0.5 * (knots[1:] + knots[:-1])]))
    fine = replace(effect, knots=tuple(knots.tolist()))
    values, declared = model.refinement.parameters, search.base.refinement.plant
    declared = declared.with_parameters({name: values[name] for name in declared.names})
    plant = augmented(declared, earlier, values)
    placed = place(plant, fine, last.channel)
    coarse = effect.curve(knots, [values[name] for name in last.names])
    units = np.stack([fine.curve(knots, unit) for unit in np.eye(len(placed.names))], axis=1)
    begin = np.linalg.lstsq(units, coarse, rcond=None)[0]
    plant = augmented(plant, [placed], dict(zip(placed.names, begin.tolist(), strict=True)))
    trial = search.fitted(plant, (placed,), replace(model, placed=tuple(earlier)))
    return trial if trial and search.judge.prefers(trial.runs, model.runs) else model


def _curves(model: Judged, signals: Container[str], least: float) -> list[Placed]:
    """Curves of some signals that have none, each with the straight line that the model lacks.

    Those of which a score test says most, and which take at least a share of the errors' power.
    """
    plant, runs = model.refinement.plant, LinearisedRuns.from_refinement(model.refinement)
    present = {(placed.effect.kind, placed.channel) for placed in model.placed}
    longest = max(len(record) for record in runs.records)
    count = int(np.clip(longest // _RULES.samples, _RULES.fewest, _RULES.knots))
    shares: dict[Placed, float] = {}
    for placed in placements(plant, [*_SHAPES, InputCurve(())]):
        effect, channel = placed.effect, placed.channel
        passed_over = (effect.kind, channel) in present or effect.depends_on not in signals
        if passed_over or placed.through is not None:
            continue
        signal = _signal(runs.signal_statistics(placed), placed)
        if not varies(signal):
            continue
        knots = knots_of(signal, count)
        if isinstance(effect, InputCurve):
            offset = bool(runs.tries(place(plant, ConstantOffset(), placed.output)))
            curve = place(plant, InputCurve(knots, offset), channel)
            # The score test knows terms of the first input: to first order a force in its path.
            force = place(plant, Curve("u", knots, offset=False), 0, through=channel)
            share = 1.0 if channel else _share(runs, force)
        else:
            assert isinstance(effect, Curve)
            lines = (replace(effect, offset=not rises, slope=rises) for rises in (False, True))
            offset, slope = (bool(runs.tries(place(plant, line, channel))) for line in lines)
            curve = place(plant, replace(effect, knots=knots, offset=offset, slope=slope), channel)
            share = _share(runs, curve)
        shares[curve] = share
    largest = max(shares.values(), default=0.0)
    smallest = max(least, 1.0 - _RULES.remainder * (1.0 - largest))
    ranked = sorted(shares, key=lambda curve: -shares[curve])
    return [curve for curve in ranked if shares[curve] >= smallest][: _RULES.trials]


def _share(runs: LinearisedRuns, placed: Placed) -> float:
    """Of the power of the errors, by the score test; 0 where the effect is nothing new."""
    tries = runs.tries(placed)
    return (runs.share(tries) or 0.0) if tries else 0.0


def _fitted(search: Search, origin: Judged, placed: Placed) -> Judged | None:
    """A model with a curve that starts from zero; None where parts of it leave no trace."""
    plant = augmented(origin.refinement.plant, [placed], smallest_values(placed))
    trial = search.fitted(plant, (placed,), origin)
    traced = trial is not None and trial.refinement.status.code != "unidentifiable"
    return trial if traced else None


def _signal(seen: Seen, placed: Placed) -> Float[np.ndarray, " samples"]:
    """What a curve is a function of, along the free runs."""
    return getattr(seen, placed.effect.depends_on)


# -- the nearest law --------------------------------------------------------------------------


@dataclass(frozen=True)
class _Likeness:
    """A law beside a curve, at its best shape.

    Attributes:
        law: at the curve's place.
        share: of the curve's power, less a straight line, that it has.
        values: its gains and shape there.
    """

    law: Placed
    share: float
    values: dict[str, float]


def _as_law(search: Search, model: Judged) -> Judged:
    """The model with a law in place of its last curve, where that predicts as well.

    A search that adds one effect after another may not come to it: what is the best one alone, and
    stands in for the law, can hide it.
    """
    *earlier, last = model.placed
    values, declared = model.refinement.parameters, search.base.refinement.plant
    declared = declared.with_parameters({name: values[name] for name in declared.names})
    plant, origin = augmented(declared, earlier, values), replace(model, placed=tuple(earlier))
    likenesses = sorted(_likenesses(model, last), key=lambda item: -item.share)
    trials = [
        trial
        for item in likenesses[: _RULES.trials]
        if item.share > _RULES.likeness
        and (trial := search.fitted(augmented(plant, [item.law], item.values), (item.law,), origin))
    ]
    if not trials:
        return model
    best = search.judge.plainest(trials)
    return best if search.judge.is_as_good(best.runs, model.runs) else model


def _nearest_laws(model: Judged) -> list[str]:
    """A sentence for each curve that is nearly a law of the library."""
    plant, notes = model.refinement.plant, []
    for placed in model.placed:
        if not isinstance(placed.effect, Curve | InputCurve):
            continue
        likenesses = _likenesses(model, placed)
        largest = max((item.share for item in likenesses), default=0.0)
        alternatives = [
            (len(item.law.names), -item.share, item.law.effect.name)
            for item in likenesses
            if item.share > max(_RULES.likeness, largest - _RULES.tie)
        ]
        if alternatives:
            _, negative, name = min(alternatives)
            signal, law = placed.effect.channels(plant)[placed.channel], name.replace("_", " ")
            notes.append(_NEAREST.format(signal, law, -100.0 * negative))
    return notes


def _likenesses(model: Judged, placed: Placed) -> list[_Likeness]:
    """Laws of the signal of a curve, beside it; none of a curve that multiplies another signal."""
    if getattr(placed.effect, "times", ""):
        return []
    plant, runs = model.refinement.plant, LinearisedRuns.from_refinement(model.refinement)
    seen = runs.signal_statistics(placed)
    values = [model.refinement.parameters[name] for name in placed.names]
    laws = [
        law
        for law in placements(plant, (*standard(), *wider()))
        if law.channel == placed.channel and law.against is None and law.through is None
        and type(law.effect).depends_on == placed.effect.depends_on
        and law.on_input == placed.on_input and not law.on_state and not law.effect.states
        and isinstance(law.effect, AbstractTerm | AbstractInputEffect)
    ]  # fmt: skip
    return [_likeness(placed, values, law, seen) for law in laws]


def _likeness(placed: Placed, values: list[float], law: Placed, seen: Seen) -> _Likeness:
    """A law beside a curve, by least squares at each shape of its grid."""
    effect = law.effect
    signal = np.sort(_signal(seen, placed))[:: max(len(seen.y) // _RULES.points, 1)]
    zero = np.zeros_like(signal)
    y, v, u = (signal if key == placed.effect.depends_on else zero for key in "yvu")
    at = At(zero, y, v, u, zero[:0])
    line = np.stack([np.ones_like(signal), signal], axis=1)
    bent = _detrended(_force(placed.effect, at, values), line)
    ranges = [(gain.lower, gain.upper) for gain in effect.gains] or [(0.0, np.inf)]
    low, high = np.transpose(ranges)
    units = np.eye(len(effect.gains)) if effect.gains else np.zeros((1, 0))
    best = _Likeness(law, 0.0, {})
    for shape in np.asarray(effect.grid(seen), dtype=float):
        columns = [_force(effect, at, [*unit, *shape]) for unit in units]
        columns = _detrended(np.stack(columns, axis=1), line)
        gains = np.linalg.lstsq(columns, bent, rcond=None)[0]
        if np.all((low <= gains) & (gains <= high)):
            difference = bent - columns @ gains
            share = 1.0 - float(difference @ difference) / float(bent @ bent)
            if share > best.share:
                own = [*(gains if effect.gains else ()), *shape]
                best = _Likeness(law, share, dict(zip(law.names, map(float, own), strict=True)))
    return best


def _force(effect: AbstractEffect, at: At, values: Sequence[float]) -> np.ndarray:
    """The term of an effect, or what it changes of an input."""
    count = len(effect.gains)
    if isinstance(effect, AbstractTerm):
        term = effect.term(at, list(values[:count]), list(values[count:]))
        return np.broadcast_to(np.asarray(term), np.shape(at.y))
    assert isinstance(effect, AbstractInputEffect)
    return np.asarray(effect.changed(at, list(values))) - at.u


def _detrended(values: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Values less a straight line."""
    return values - line @ np.linalg.lstsq(line, values, rcond=None)[0]


_NEAREST = "of the laws of the library the curve of {} is nearest to {}, which gives {:.3g} % of it"
