"""A lag of a sensor in place of lags and delays of the inputs.

What a sensor shows late is late behind each input, and behind the plant's own motion; what an
actuator does late is late behind its input alone. The injection, which needs the outputs as they
are, explains the lag of a sensor by an effect on each input that moves.
"""

from collections.abc import Sequence

import numpy as np

from eoi_jax.data.holds import moving_inputs, with_hold, with_word
from eoi_jax.data.input_holds import HOLDS
from eoi_jax.data.record import Record
from eoi_jax.discovery.exchanged_lags import commutes
from eoi_jax.discovery.free_run_search import FreeRunAnswer
from eoi_jax.discovery.free_run_trials import Search, refined
from eoi_jax.discovery.in_free_runs import answered, begun_search, placed_effects
from eoi_jax.discovery.judge import Judge, Judged
from eoi_jax.discovery.probability import Contest
from eoi_jax.discovery.result import Discovery
from eoi_jax.estimation.lowpass import LowPass
from eoi_jax.models.augmented import Placed, augmented
from eoi_jax.models.effects import ActuatorLag, InputDelay, SensorLag
from eoi_jax.models.placements import placements
from eoi_jax.models.plant import Plant


def may_be_sensor(discovery: Discovery) -> bool:
    """Whether an answer of the injection has a lag of an input, or several inputs that are late.

    Only free runs on held-out records can tell it from a lag of the sensor. Behind a linear plant
    of first order with one input they cannot, either.
    """
    if discovery.status.code != "complete" or discovery.in_sample or not discovery.added:
        return False
    plant, late = discovery.declared.nominal, _late(placed_effects(discovery))
    if plant.has_algebraic or not placements(plant, [SensorLag()]):
        return False
    is_lag = any(isinstance(at.effect, ActuatorLag) for at in late)
    return len(late) > 1 or (is_lag and not commutes(plant, late[0]))


def with_sensor_in_place(
    discovery: Discovery,
    records: tuple[Record, ...],
    held_out: tuple[Record, ...],
    lowpass: LowPass | None,
) -> Discovery:
    """The discovery, with a lag of the sensor where it predicts better or is plainer.

    Args:
        discovery: the answer so far, which explains the injection.
        records: to fit, as given.
        held_out: that judge, as given.
        lowpass: F of the fits; None: chosen from the records.
    """
    search = begun_search(discovery, records)
    if search is None:
        return discovery
    placed = placed_effects(discovery)
    named = refined(discovery.plant, placed, search.searched, search.judge)
    models = [refined(*model, search.searched, search.judge) for model in _with_sensors(discovery)]
    trials = [trial for trial in models if trial is not None]
    if named is None or not trials:
        return discovery
    search, best = _made_best(search, min(trials, key=lambda trial: trial.error), records, held_out)
    if not _takes_place(search.judge, best, named):
        return discovery
    contest = Contest(search.base, best, (named, *trials))
    answer = FreeRunAnswer.of(search, best, discovery.declared.plant, (contest,))
    outcome = answered(discovery, answer, [at.effect for at in best.placed], lowpass)
    return outcome if outcome.effects != discovery.effects and outcome.added else discovery


def _made_best(
    search: Search, best: Judged, records: tuple[Record, ...], held_out: tuple[Record, ...]
) -> tuple[Search, Judged]:
    """A model on records made in the way that fits it best, input by input, with their search.

    The hold was chosen with delays and lags of the inputs in the model, which look like another.

    Args:
        search: with the hold of the answer.
        best: the model, refined on its records.
        records: to fit, as given.
        held_out: that judge, as given.
    """
    count, skew = records[0].inputs.shape[1], search.records[0].skew
    for j in moving_inputs(records):
        first = search.records[0].hold
        for word in HOLDS:
            hold = with_word(first, j, word, count)
            if hold == search.records[0].hold:
                continue
            variant = search.made_with(
                with_hold(records, hold, skew), with_hold(held_out, hold, skew)
            )
            trial = variant.refitted(best)
            if trial is not None and variant.is_better_made(trial, best):
                search, best = variant, trial
    return search, best


def _takes_place(judge: Judge, trial: Judged, named: Judged) -> bool:
    """Whether a model with a lag of a sensor takes the place of that which the injection named."""
    if len(trial.placed) < len(named.placed) and judge.is_as_good(trial.runs, named.runs):
        return True
    return judge.prefers(trial.runs, named.runs)


def _with_sensors(discovery: Discovery) -> list[tuple[Plant, tuple[Placed, ...]]]:
    """The answer with a lag of one of the sensors in place of all that is late at inputs."""
    placed, values = placed_effects(discovery), discovery.plant.parameters
    late = _late(placed)
    time = float(np.median([values[name] for at in late for name in at.names]))
    stay = tuple(at for at in placed if at not in late)
    declared = discovery.declared.nominal
    plant = declared.with_parameters({name: values[name] for name in declared.names})
    models = []
    for sensor in placements(plant, [SensorLag()]):
        names = {**values, sensor.names[0]: time}
        models.append((augmented(plant, (*stay, sensor), names), (*stay, sensor)))
    return models


def _late(placed: Sequence[Placed]) -> list[Placed]:
    """Lags and delays of inputs."""
    return [at for at in placed if isinstance(at.effect, ActuatorLag | InputDelay)]
