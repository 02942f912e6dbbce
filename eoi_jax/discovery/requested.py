"""Effects that the caller of `discover` asked for, and which of them have no place in the plant."""

from collections.abc import Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from eoi_jax._checks import check, check_choice, check_kind
from eoi_jax.data.record import Record
from eoi_jax.discovery.result import Discovery
from eoi_jax.models.augmented import Placed
from eoi_jax.models.effects import (
    Coupling,
    InputAction,
    ParameterDependence,
    couplings,
    input_actions,
    input_products,
    on_request,
    parameter_dependences,
    rare,
    standard,
    wider,
)
from eoi_jax.models.effects.effect import AbstractCascade, AbstractEffect, AbstractTerm, At, Seen
from eoi_jax.models.equations.system import TextDynamics
from eoi_jax.models.function_snapshot import is_of_package
from eoi_jax.models.placements import placements
from eoi_jax.models.plant import Plant
from eoi_jax.models.used_inputs import used_inputs

OPEN = ("partial", "unexplained")  # codes of answers that leave something


def requested(
    plant: Plant, effects: Sequence[AbstractEffect | str] | None, records: Sequence[Record]
) -> tuple[AbstractEffect, ...]:
    """The effects by name or as objects.

    For None the standard ones, and actions of the inputs that no equation of the plant has.
    """
    if effects is None:
        used = np.any(used_inputs(plant), axis=0)
        idle = (action for action in input_actions(plant) if not used[action.signals[0].column])
        return (*standard(), *idle)
    return named_effects(effects, plant, records)


def named_effects(
    effects: Sequence[AbstractEffect | str],
    plant: Plant,
    records: Sequence[Record],
    field: str = "effects",
) -> tuple[AbstractEffect, ...]:
    """The effects of the whole library by name, in all their forms, or as objects.

    Args:
        effects: names or objects.
        plant: the declared model.
        records: to fit; they tell which dependences of parameters there may be.
        field: of the call or config that has the names, for messages.

    Raises:
        ValueError: an unknown name, or none that the plant can have.
    """
    of_plant = input_products(plant) + couplings(plant) + input_actions(plant)
    of_plant += parameter_dependences(plant, records)
    library = (*standard(), *rare(), *wider(), *on_request(), *of_plant)
    check_kind(field, effects, Sequence, "a list of names or effects")
    check(len(effects) > 0, field, "must name at least one effect", "none")
    chosen: list[AbstractEffect] = []
    names = sorted({effect.name for effect in library} | {Coupling.name, InputAction.name}
                   | {ParameterDependence.name})  # fmt: skip
    for effect in effects:
        if isinstance(effect, str):
            check_choice(field, effect, names)
            several = effect != Coupling.name or len(plant.outputs) > 1
            check(several, field, f"{Coupling.name} needs a plant of several outputs", plant.name)
            chosen += [candidate for candidate in library if candidate.name == effect]
        else:
            check_kind(field, effect, AbstractEffect, "names or effects")
            if not is_of_package(type(effect)):
                _check_own(field, effect, plant)
            chosen.append(effect)
    rule = f"must hold one that fits {plant.name} and its records"
    check(len(chosen) > 0, field, rule, ", ".join(map(str, effects)))
    return tuple(chosen)


def _check_own(field: str, effect: AbstractEffect, plant: Plant) -> None:
    """Check what a user's class of effects declares, and the shape of its term."""
    kind = type(effect).__name__
    for attribute in ("name", "sentence"):
        good = isinstance(getattr(effect, attribute, None), str)
        check(good, field, f"must have a `{attribute}`, a text", kind)
    good = not effect.shapes or type(effect).grid is not AbstractEffect.grid
    rule = "must have `grid`, with initial values of its `shapes`"
    check(good, field, rule, kind, "It returns a row for each trial, a column for each shape.")
    if isinstance(effect, AbstractTerm):
        number, state = jnp.zeros(()), jnp.zeros((plant.rows, len(plant.outputs)))
        inputs, z = jnp.zeros(len(plant.inputs)), jnp.zeros(effect.states)
        point = At(number, number, number, number, z, number, state, inputs)
        gains, shapes = ([number] * len(part) for part in (effect.gains, effect.shapes))
        returned = jax.eval_shape(lambda: jnp.asarray(effect.term(point, gains, shapes))).shape
        rule = "must return a number from `term`, that of one instant"
        check(returned == (), field, rule, f"shape {returned} from {kind}", "Write `gain[0]`.")


def names_with_place(plant: Plant, effects: Sequence[AbstractEffect]) -> set[str]:
    """Names of the effects that can act on a plant."""
    names = dict.fromkeys(effect.name for effect in effects)
    fitting = {placed.effect.name for placed in placements(plant, effects)}
    degrees = ", ".join(
        f"{output} of relative degree {degree}"
        for output, degree in zip(plant.outputs, plant.degrees, strict=True)
    )
    check(len(fitting) > 0, "effects", f"must hold one that fits {plant.name}", ", ".join(names),
          f"It has {degrees}. {_needs(effects)}Leave `effects` out to try all.")  # fmt: skip
    return fitting


def notes_without_place(
    effects: Sequence[AbstractEffect], fitting: set[str], discovery: Discovery
) -> list[str]:
    """A note for each requested effect that was not tried, or tried in free runs alone."""
    looked = {evidence.effect for evidence in discovery.ranking} or fitting
    in_free_runs = {effect.name for effect in effects if effect.only_in_free_runs} & fitting
    notes = []
    unmet = _unmet_needs(discovery, [effect for effect in effects if effect.name in in_free_runs])
    for name in dict.fromkeys(effect.name for effect in effects):
        if name in unmet and name not in discovery.effects:
            notes.append(_NOT_OF_KIND.format(name, unmet[name]))
        elif name in in_free_runs and name not in discovery.effects:
            notes.append(_IN_FREE_RUNS.format(name))
        elif name not in looked and name not in in_free_runs:
            reason = _NOTHING_SHOWS if name in fitting else _NO_PLACE
            notes.append(reason.format(name, discovery.declared.nominal.name))
        if name not in fitting:
            needs = _needs([effect for effect in effects if effect.name == name])
            notes += [needs.rstrip(" .")] if needs else []
    return notes


def chain_notes(discovery: Discovery) -> list[str]:
    """Notes on what was not tried on internal states of a motion, where an answer is open.

    What acts on the acceleration of a position whose rate is an internal state in other units acts
    on that state. What depends on an internal position, as a stop does, has no signal there.
    """
    plant = discovery.declared.nominal
    if discovery.status.code not in OPEN or not isinstance(plant.dynamics, TextDynamics):
        return []
    equations = plant.dynamics.equations
    texts = dict(equations.derivatives)
    notes = [
        _NO_CHAIN.format(output, texts[output], state)
        for output, state in equations.internal_rates.items()
        if plant.kinds[output] == "position"
    ]
    for state, rate in equations.internal_integrals.items():
        friction = "" if rate in plant.outputs else f", and friction that depends on {rate}"
        notes.append(_NO_POSITION.format(state, friction))
    return notes


def with_requested(discovery: Discovery, effects: Sequence[AbstractEffect]) -> Discovery:
    """An answer that leaves something open, which says that the caller named what was tried."""
    status = discovery.status
    if status.code not in OPEN:
        return discovery
    names = ", ".join(dict.fromkeys(effect.name for effect in effects))
    text = f"{status.message}. {_REQUESTED.format(names)}"
    return replace(discovery, status=replace(status, message=text))


def _unmet_needs(discovery: Discovery, effects: Sequence[AbstractEffect]) -> dict[str, str]:
    """What effects on measured outputs need that no record of the fit shows, by their names."""
    plant = discovery.declared.nominal
    needs, met = (
        {effect.name: effect.record_needs for effect in effects if effect.record_needs},
        set[str](),
    )
    for placed in placements(plant, effects):
        if placed.on_input or placed.on_state or _has_sense(plant, placed, discovery.records):
            met.add(placed.effect.name)
    return {name: need for name, need in needs.items() if name not in met}


def _has_sense(plant: Plant, placed: Placed, records: Sequence[Record]) -> bool:
    """Whether an effect is meaningful for what is measured of the output that it acts on."""
    j = placed.output
    y = np.concatenate([record.outputs[record.output_valid[:, j], j] for record in records])
    noise = max(float(record.noise[j]) for record in records)
    duration = max(float(record.time[-1] - record.time[0]) for record in records)
    period, peaks = records[0].sample_period, np.zeros(0)
    kind = plant.kinds[plant.outputs[j]]
    measured = placed.row == 0
    return placed.effect.shows(
        Seen(y, y, y, measured, noise, duration, period, 1.0 / duration, peaks, kind=kind)
    )


def _needs(effects: Sequence[AbstractEffect]) -> str:
    """On what some of these effects must act, in sentences."""
    needs = {
        effect.name: effect.needs
        for effect in effects
        if isinstance(effect, AbstractCascade) and effect.needs
    }
    return "".join(f"{name} must act on {rule}. " for name, rule in needs.items())


_REQUESTED = "Only what `effects` names was tried ({}): leave it out to try all"
_IN_FREE_RUNS = (
    "{} is tried in free runs on held-out records alone, where the injection gives no answer"
)
_NOT_OF_KIND = "{} was not tried: it needs {}, and the records of the fit show none"
_NO_CHAIN = (
    "effects on the acceleration of {0}, as a weight out of balance, were not tried: its "
    'derivative "{1}" has the internal state {2}. Write the derivative of {0} as the name of a '
    "state alone, which has the unit of {0} a second, and {2} in terms of that"
)
_NO_POSITION = (
    "effects of the internal state {0} (springs that harden, gaps and stops{1}) were not tried, as "
    "they act on outputs. Measure it, or write one into the equations, wherever the force of the "
    "spring stands: a parameter that is 0 and its term, as k3*{0}**3 (between two masses, of their "
    "distance), which is there if `refine` lowers the errors with it"
)
_NO_PLACE = "{} was not tried: no output, input or internal state of {} is of its kind"
_NOTHING_SHOWS = "{} was not tried: nothing in the records of {} is of its kind"
