"""Whether an answer of the injection leaves it open what is missing."""

from collections.abc import Sequence
from dataclasses import replace
from types import UnionType

import numpy as np

from eoi_jax._status import Status
from eoi_jax.discovery.confirm import beyond_noise, explained_by_inputs, is_undecided
from eoi_jax.discovery.judge import mean_error
from eoi_jax.discovery.remarks import Reason
from eoi_jax.discovery.result import Added, Discovery
from eoi_jax.discovery.rules import RULES
from eoi_jax.models.effects import (
    AbstractInternalEffect,
    ActuatorLag,
    ConstantOffset,
    Curve,
    Drift,
    InputCurve,
    InputDelay,
    InputQuadratic,
    Leak,
    Overflow,
    ParameterDependence,
    SinusoidalDisturbance,
    StribeckFriction,
)
from eoi_jax.models.used_inputs import product_inputs
from eoi_jax.simulation.sensor_noise import sensor_noise
from eoi_jax.simulation.validation import Validation

_RULES = RULES.questions


def leaves_open(discovery: Discovery) -> bool:
    """Whether free runs are searched: without an answer, or with one that may stand in for another.

    Also where the injection lacks nothing, and free runs miss by more than noise. A disturbance in
    time may stand in for what the library lacks, a straight loss with a kink for one that bends,
    which the injection does not try, and a loss to a constant level for a store that warms slowly.
    Only records that are held out can judge, and the score test of free runs knows no outputs that
    are functions of the states. Effects that explain all but have no free run would be stood in
    for by others.
    """
    if discovery.in_sample or discovery.declared.nominal.has_algebraic:
        return False
    if any(item.reason == Reason.NO_FREE_RUN for item in discovery.ranking):
        return False
    code, runs = discovery.status.code, telling_runs(discovery)
    is_small = runs is None or bool(np.all(runs.nrmse < _RULES.small))
    if code == "nothing_missing":
        if runs is None or is_small:
            return False
        # What is read as noise off a few samples may be motion.
        lost = bool(np.any(runs.nrmse > _RULES.useless))
        lost |= bool(np.any(is_undecided(runs)))
        return lost or bool(beyond_noise(runs, plant=discovery.plant))
    # What holds over time alone tells no held-out record to its noise.
    in_time = _in_time(discovery.added) and _misses_by_more_than_noise(discovery)
    doubted = in_time or _bends(discovery.added) or _vanishes(discovery.added)
    doubted |= may_be_store(discovery.added) and not is_small
    doubted |= bends_factor(discovery) or may_be_motion(discovery)
    return code in ("unexplained", "no_data") or (code == "complete" and doubted)


def unless_inputs_are_noisy(discovery: Discovery) -> Discovery:
    """An answer without effects, which lacks nothing where noise in the log of inputs explains it.

    Short runs are asked: long ones may drift, or stick at other times.
    """
    if discovery.status.code != "unexplained" or discovery.added or discovery.in_sample:
        return discovery
    if not explained_by_inputs(telling_runs(discovery), discovery.plant):
        return discovery
    return replace(
        discovery, status=Status("nothing_missing", _NOISY_INPUTS), lead=None, diagnosis=None
    )


def noisy_log_notes(discovery: Discovery) -> list[str]:
    """A note where noise in the log of inputs is all that an answer leaves in short free runs."""
    if discovery.status.code not in ("complete", "nothing_missing"):
        return []
    return explained_by_inputs(discovery.windows_after, discovery.plant)


def telling_runs(discovery: Discovery) -> Validation | None:
    """Free runs of the answer in windows; whole ones where these score far more samples.

    Of samples that become rarer along a record, few windows have enough for their start.
    """
    windows, whole = discovery.windows_after, discovery.after
    if windows is None or whole is None:
        return windows or whole
    return whole if windows.scored < _RULES.scored * whole.scored else windows


def log_error_ratio(trial: Discovery, rival: Discovery) -> float:
    """Logarithm of the errors of the free runs of an answer over those of another one.

    Both on held-out records of their own, as whole runs and in windows; infinite without runs.
    """
    if trial.after is None or rival.after is None:
        return np.inf
    errors = mean_error((trial.after, trial.windows_after))
    return errors - mean_error((rival.after, rival.windows_after))


def stands_in(added: Sequence[Added]) -> bool:
    """Whether effects stand in for others: a disturbance in time, a loss with a kink.

    An overflow beside an offset or a leak is one, in place of a loss that bends, and dry friction
    that is gone at speed in place of dry friction and drag.
    """
    return _in_time(added) or _bends(added) or _vanishes(added)


def is_doubtful(added: Sequence[Added]) -> bool:
    """Whether effects that explain the injection may stand in for others."""
    return stands_in(added) or may_be_store(added)


def _in_time(added: Sequence[Added]) -> bool:
    """Whether one of some effects is a disturbance in time."""
    return any(isinstance(item.effect, Drift | SinusoidalDisturbance) for item in added)


def may_be_motion(discovery: Discovery) -> bool:
    """Whether a change with time, or a kink, of a loss leaves much of the motion in free runs.

    Where records begin alike, as those of a decay, what depends on a state that is not measured,
    or on a power of one that is, is a function of time there, too; and of two stores the loss is
    fast at first and slow below a level.
    """
    runs = telling_runs(discovery)
    if runs is None or np.all(runs.nrmse < _RULES.wide):
        return False
    return any(
        isinstance(item.effect, Overflow)
        or (isinstance(item.effect, ParameterDependence) and not item.effect.signals)
        for item in discovery.added
    )


def _bends(added: Sequence[Added]) -> bool:
    """Whether an overflow stands beside an offset or a leak: in place of a loss that bends."""
    return _share_output(added, Overflow, ConstantOffset | Leak)


def _vanishes(added: Sequence[Added]) -> bool:
    """Whether dry friction falls with the velocity to less than half, or to none for all is told.

    Of lubricated bearings it falls by less (B. Armstrong-Hélouvry, P. Dupont, C. Canudas de Wit,
    Automatica 30 (1994) 1083); damping that is too large at low speed makes up for drag.
    """
    for item in added:
        if isinstance(item.effect, StribeckFriction):
            level, rise, _ = item.parameters.values()
            error = next(iter(item.standard_errors.values()))
            if not level > max(rise, RULES.judge.min_deviations * np.nan_to_num(error)):
                return True
    return False


def _misses_by_more_than_noise(discovery: Discovery) -> bool:
    """Whether free runs of an answer on held-out records do, whole or in windows."""
    runs = [run for run in (discovery.after, discovery.windows_after) if run is not None]
    return any(bool(np.any(run.rmse > _RULES.silent * sensor_noise(run))) for run in runs)


def may_be_store(added: Sequence[Added]) -> bool:
    """Whether a leak stands beside an offset: a store that warms slowly is lost to as a level."""
    return _share_output(added, Leak, ConstantOffset)


def bends_factor(discovery: Discovery) -> bool:
    """Whether the characteristic of an input is bent that stands in products with others alone.

    A term in proportion to the input is missing there as likely: the voltage that a diode takes, in
    a converter whose duty is the input. The bent factor changes all other products with it.
    """
    plant = discovery.declared.nominal
    multiplied = dict(zip(plant.inputs, np.any(product_inputs(plant), axis=0), strict=True))
    bent = [item for item in discovery.added if isinstance(item.effect, InputQuadratic)]
    return any(bool(multiplied.get(item.output, False)) for item in bent)


def may_be_rate(discovery: Discovery) -> bool:
    """Whether a delay or a lag of an input leaves more than noise in free runs of each length.

    A response to the rate of the input is the same to first order: the level of a drum that swells
    before it falls. Of it the injection, which does not try it, leaves little. The score test of
    free runs knows no outputs that are functions of the states.
    """
    if discovery.in_sample or discovery.declared.nominal.has_algebraic:
        return False
    if discovery.status.code != "complete":
        return False
    runs = [run for run in (discovery.after, discovery.windows_after) if run is not None]
    exceeds = (np.any((run.rmse > _RULES.silent * sensor_noise(run)) & (run.nrmse > _RULES.small))
               for run in runs)  # fmt: skip
    is_late = any(isinstance(item.effect, ActuatorLag | InputDelay) for item in discovery.added)
    return is_late and all(map(bool, exceeds))


def _share_output(added: Sequence[Added], *kinds: type | UnionType) -> bool:
    """Whether effects of two kinds act on one output."""
    outputs = [{item.output for item in added if isinstance(item.effect, kind)} for kind in kinds]
    return bool(set.intersection(*outputs))


def leaves_more(discovery: Discovery) -> bool:
    """Whether an answer that explains the injection misses held-out records by more than noise."""
    if discovery.in_sample or not discovery.added or discovery.plant.has_algebraic:
        return False
    runs = telling_runs(discovery)
    if discovery.status.code != "complete" or runs is None:
        return False
    if np.all(runs.nrmse < _RULES.negligible):
        return False
    # What an effect does to an internal state no other one of a measured signal does.
    final = Curve | InputCurve | AbstractInternalEffect
    if any(isinstance(addition.effect, final) for addition in discovery.added):
        return False
    # An error below what was taken for noise: that was fast motion, and tells nothing.
    noise = sensor_noise(runs)
    motion = np.any((runs.rmse < _RULES.motion * noise) & (runs.nrmse > _RULES.small))
    return bool(motion) or bool(beyond_noise(runs, plant=discovery.plant))


def misses_widely(discovery: Discovery) -> bool:
    """Whether an answer that explains the injection leaves much of held-out records.

    Effects that explain the injection of a biased base may stand in for what free runs show.
    """
    runs = telling_runs(discovery)
    return leaves_more(discovery) and runs is not None and bool(np.any(runs.nrmse > _RULES.wide))


_NOISY_INPUTS = (
    "free runs miss the held-out records by no more than noise in the log of the inputs explains"
)
