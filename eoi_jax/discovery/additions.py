"""Effects in a fitted model: what a discovery says of each, and of their certainty."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from eoi_jax.discovery.probability import Standing
from eoi_jax.discovery.remarks import FitNote
from eoi_jax.discovery.result import Added
from eoi_jax.discovery.rules import RULES
from eoi_jax.estimation.covariance import Certainty
from eoi_jax.estimation.identify import Identification, estimate
from eoi_jax.estimation.preparation import PreparedRecords
from eoi_jax.models.augmented import Placed
from eoi_jax.models.effects import (
    ActuatorLag,
    ConstantOffset,
    Drift,
    FreePlay,
    InputDelay,
    Leak,
    LinearStiffness,
    SensorLag,
    SinusoidalDisturbance,
)
from eoi_jax.models.jacobians import points_of, state_slopes
from eoi_jax.models.placements import ends
from eoi_jax.models.plant import Plant
from eoi_jax.models.sensor_errors import sensor_errors
from eoi_jax.refinement.result import Refinement

_RULES = RULES.answer
_INSTANTS = 50  # of a record, between which an equation is tested to be linear


def added_effect(
    plant: Plant, fit: Identification, placed: Placed, standing: Standing | None = None
) -> Added:
    """An effect with its parameters in a fit, and its standing among its rivals."""
    channels = placed.effect.channels(plant)
    return Added(
        placed.effect,
        channels[placed.channel],
        {name: fit.parameters[name] for name in placed.names},
        {name: fit.standard_errors[name] for name in placed.names},
        placed.effect.sentence,
        *ends(plant, placed),
        None if standing is None else standing.probability,
        () if standing is None else standing.rivals,
    )


def size_is_known(
    names: Iterable[str], parameters: Mapping[str, float], standard_errors: Mapping[str, float]
) -> bool:
    """Whether one of these parameters of an effect has an error of at most half of its value.

    Args:
        names: of the effect's parameters; one without any has no size that could be unknown.
        parameters: values by name.
        standard_errors: by name.
    """
    sizes = [standard_errors[name] <= _RULES.known * abs(parameters[name]) for name in names]
    return any(sizes) or not sizes


def has_size(placed: Placed, fit: Identification | Refinement) -> bool:
    """`size_is_known` of an effect in a fit, by its parameters that are estimated."""
    names = [name for name in placed.names if name not in fit.plant.fixed]
    return size_is_known(names, fit.parameters, fit.standard_errors)


def smallest_values(placed: Placed) -> dict[str, float]:
    """Zero for each parameter of an effect, or the bound that is nearest to it."""
    parameters = zip(placed.names, placed.effect.parameters, strict=True)
    return {name: min(max(0.0, item.lower), item.upper) for name, item in parameters}


def uncertain_effects(added: Sequence[Added]) -> list[str]:
    """Notes on effects of which every standard error exceeds half of its parameter."""
    labels = [addition.label for addition in added]
    return [
        FitNote(
            f"the records hardly tell the size of {addition.label.replace('_', ' ')}"
            f"{f' at {addition.position}' if labels.count(addition.label) > 1 else ''}: every "
            "parameter of it has a standard error above half of its value"
        )
        for addition in added
        if not size_is_known(addition.parameters, addition.parameters, addition.standard_errors)
    ]


def fit_notes(plant: Plant, added: Sequence[Added], fit: Identification) -> list[str]:
    """All notes below on an answer."""
    return [
        *level_notes(plant, added),
        *gap_notes(plant, added, fit),
        *sensor_notes(plant, added),
        *disturbance_notes(fit, added),
        *sign_notes(plant, fit),
        *untold_notes(plant, fit),
    ]


def level_notes(plant: Plant, added: Sequence[Added]) -> list[str]:
    """Notes on a leak beside an offset of the same output: both are a loss to one level.

    Args:
        plant: as it is declared.
        added: to the model.
    """
    offsets = {item.output: item for item in added if isinstance(item.effect, ConstantOffset)}
    notes = []
    for item in added:
        if isinstance(item.effect, Leak) and item.output in offsets:
            (rate,), (offset,) = (
                effect.parameters.values() for effect in (item, offsets[item.output])
            )
            unit = plant.units.get(item.output, "")
            notes.append(FitNote(_LEVEL.format(item.output, f"{offset / rate:.3g} {unit}".strip())))
    return notes


def gap_notes(plant: Plant, added: Sequence[Added], fit: Identification) -> list[str]:
    """Notes on declared springs that act within the gap of a free play, too.

    The effect takes its stiffness s from that of the declared spring K where the play is. With
    s = K that is a play; with less, a mount between stops at both ends, whose own stiffness is
    K - s, and the declared parameter is that of the mount and the stops together.

    Args:
        plant: as it is declared.
        added: to the model.
        fit: the answer.
    """
    if not fit.status.fits or any(isinstance(item.effect, LinearStiffness) for item in added):
        return []
    model = plant.with_parameters({name: fit.parameters[name] for name in plant.names})
    notes = []
    for item in added:
        if not isinstance(item.effect, FreePlay) or item.against:
            continue
        output, (gain, gap) = plant.outputs.index(item.output), item.parameters.values()
        stiffness, gain_error = _stiffness(model, output), next(iter(item.standard_errors.values()))
        if not stiffness > 0.0:
            continue
        share = 1.0 - gain / stiffness
        for name, _ in _estimated(plant, fit):
            value, error = fit.parameters[name], fit.standard_errors[name]
            of_double = _stiffness(model.with_parameters({name: 2.0 * value}), output)
            share_error = np.hypot(error / value, gain_error / stiffness) if value else np.inf
            is_spring = np.isclose(of_double, 2.0 * stiffness)
            if is_spring and share > RULES.judge.min_deviations * share_error:
                sizes = {name: (value, share * value), item.output: (gap,)}
                texts = [
                    f"{size:.4g} {plant.units.get(key, '')}".rstrip()
                    for key, values in sizes.items()
                    for size in values
                ]
                notes.append(FitNote(_WITHIN_GAP.format(name, *texts, item.label)))
    return notes


def _stiffness(plant: Plant, output: int) -> float:
    """-∂f/∂y of an output, where all is at rest at zero."""
    y = np.zeros((1, plant.rows, len(plant.outputs)))
    slopes = state_slopes(plant, np.zeros(1), y, np.zeros((1, len(plant.inputs))))
    return -float(slopes[0, output, 0, output])


def sensor_notes(plant: Plant, added: Sequence[Added]) -> list[str]:
    """Notes on delays and lags that the sensor may have as well as the actuator, or the other way.

    What is linear and does not change in time commutes: behind such a plant of one input and one
    output the records are the same. Where nothing drives a plant, a lag is one more mode of it.
    """
    if (len(plant.inputs), len(plant.outputs)) == (0, 1):
        return [
            f"a second store does the same as the lag of the sensor of {plant.outputs[0]}, for "
            "nothing drives the plant"
            for addition in added
            if addition.effect.name == SensorLag.name
        ]
    if (len(plant.inputs), len(plant.outputs)) != (1, 1):
        return []
    sensor, actuator = f"the sensor of {plant.outputs[0]}", f"the actuator of {plant.inputs[0]}"
    rivals = {
        InputDelay.name: f"a delay of {sensor} in place of that of {plant.inputs[0]}",
        ActuatorLag.name: f"a lag of {sensor} in place of that of {plant.inputs[0]}",
        SensorLag.name: f"a lag of {actuator} in place of that of {sensor}",
    }
    return [
        f"{rivals[addition.effect.name]} does the same where the plant is linear"
        for addition in added
        if addition.effect.name in rivals
    ]


def disturbance_notes(fit: Identification, added: Sequence[Added]) -> list[str]:
    """Notes on disturbances that an error of the sensor does as well, with the size of that.

    Args:
        fit: the answer.
        added: to the model.
    """
    if not fit.status.fits or not fit.records or len(fit.plant.outputs) != 1:
        return []
    record, (output,) = fit.records[0], fit.plant.outputs
    points = points_of(record, fit.plant.rows, _INSTANTS)
    unit = fit.plant.units.get(output, "")
    return [
        FitNote(_OF_SENSOR[name].format(output, f"{size:.3g} {unit}".rstrip(), name) + _WHICH)
        for name, size in sensor_errors(fit.plant, points).items()
        if any(item.effect.name == name for item in added)
    ]


def sign_notes(plant: Plant, fit: Identification) -> list[str]:
    """Notes on declared parameters that came out with the other sign, by more than their error.

    A rate of a reaction cannot be negative, a gain may be: only the user knows. Effects that stand
    in for others often leave such parameters.

    Args:
        plant: as it is declared.
        fit: the answer.
    """
    return [
        FitNote(_TURNED.format(name, fit.parameters[name], nominal))
        for name, nominal in _estimated(plant, fit)
        if fit.parameters[name] * nominal < 0.0
        and size_is_known([name], fit.parameters, fit.standard_errors)
    ]


def untold_notes(plant: Plant, fit: Identification) -> list[str]:
    """Notes on declared parameters that the records do not tell, not even their magnitude.

    The standard error exceeds the value, and the nominal value too: beside what was found any value
    does as well, and that of the fit has run off or stayed by chance. One near zero whose error is
    below its nominal value is told to be that small.

    Args:
        plant: as it is declared.
        fit: the answer.
    """
    return [
        FitNote(_UNTOLD.format(name, fit.parameters[name], fit.standard_errors[name]))
        for name, nominal in _estimated(plant, fit)
        if fit.standard_errors[name] > max(abs(fit.parameters[name]), abs(nominal))
    ]


def _estimated(plant: Plant, fit: Identification) -> list[tuple[str, float]]:
    """Declared parameters that a fit has estimated, with their nominal values; none without one."""
    held = {*plant.fixed, *fit.plant.fixed}
    return [
        (name, nominal)
        for name, nominal in plant.parameters.items()
        if fit.status.fits and name in fit.parameters and name not in held
    ]


_OF_SENSOR = {
    ConstantOffset.name: "a zero of the sensor of {} that is off by {} does the same as {}",
    Drift.name: "a drift of the sensor of {} by {}/s does the same as {}, but for a constant",
    SinusoidalDisturbance.name: "a sinusoid in the sensor of {} of {} does the same as {}",
}
_WHICH = ": the records do not tell which"
_LEVEL = "leak and constant_offset of {} are together a loss to a level of {} that nothing measures"
_WITHIN_GAP = (
    "{0} = {1} is the stiffness beyond the gap of {4}: within ±{3} it is {2}. Of a mount between "
    "stops at both ends that is the stiffness of the mount, and the difference that of the stops"
)
_TURNED = (
    "{} is {:.3g}, and its nominal value {:.3g} has the other sign: where that is impossible give "
    "it `bounds`, and doubt what was found beside it"
)
_UNTOLD = (
    "the records do not tell {}: it is {:.3g} with a standard error of {:.2g}; fix it at a value "
    "that is known, or leave its term out"
)


def as_fit(prepared: PreparedRecords, result: Refinement) -> Identification:
    """A refinement as a fit: one pass gives the injection that is left."""
    injection_fit = estimate(result.plant, prepared, passes=1)
    return replace(
        injection_fit, parameters=result.parameters, information=result.information,
        plant=result.plant,
        certainty=Certainty(result.covariance, result.degrees_of_freedom, result.standard_errors),
        status=result.status,
    )  # fmt: skip
