"""Effects in a fitted model: what a discovery says of each, and of their certainty."""

from collections.abc import Sequence
from dataclasses import replace

from eoi_jax.discovery.ranking import ends
from eoi_jax.discovery.result import Added
from eoi_jax.estimation.covariance import Certainty
from eoi_jax.estimation.identify import Identification, estimate
from eoi_jax.estimation.preparation import PreparedRecords
from eoi_jax.models.augmented import Placed
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.result import Refinement

UNCERTAIN = "the records hardly tell the size of"


def added_effect(plant: Plant, fit: Identification, placed: Placed) -> Added:
    """An effect with its parameters in a fit."""
    channels = placed.effect.channels(plant)
    return Added(
        placed.effect,
        channels[placed.channel],
        {name: fit.parameters[name] for name in placed.names},
        {name: fit.standard_errors[name] for name in placed.names},
        placed.effect.sentence,
        *ends(plant, placed),
    )


def uncertain_effects(added: Sequence[Added]) -> list[str]:
    """Notes on effects of which every standard error exceeds half of its parameter."""

    def vague(addition: Added) -> bool:
        pairs = (
            (abs(addition.parameters[name]), error)
            for name, error in addition.standard_errors.items()
        )
        return all(error > 0.5 * value for value, error in pairs)

    return [
        f"{UNCERTAIN} {addition.effect.name.replace('_', ' ')}: every parameter of it has a "
        "standard error above half of its value"
        for addition in added
        if vague(addition)
    ]


def as_fit(prepared: PreparedRecords, result: Refinement) -> Identification:
    """A refinement as a fit: one pass gives the injection that is left."""
    injection_fit = estimate(result.plant, prepared, passes=1)
    return replace(
        injection_fit, parameters=result.parameters, information=result.information,
        plant=result.plant,
        certainty=Certainty(result.covariance, result.degrees_of_freedom, result.standard_errors),
        status=result.status,
    )  # fmt: skip
