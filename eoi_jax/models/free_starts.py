"""Internal states whose start a plant leaves open, where a value is needed."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from eoi_jax._checks import check
from eoi_jax.models.effects.effect import internal_names
from eoi_jax.models.known_starts import listed
from eoi_jax.models.plant import Plant


def free_start_names(plant: Plant) -> tuple[str, ...]:
    """Names of the internal states that are declared as free at the start of a record."""
    names = internal_names(plant)
    return tuple(names[i] for i in np.flatnonzero(plant.free_internal))


def starts_text(
    plant: Plant, records: Sequence[str], starts: Sequence[Float[np.ndarray, " nz"]]
) -> str:
    """Free starts by record: ``run1 soc 0.9; run2 soc 0.6``.

    Args:
        plant: that declares them.
        records: names.
        starts: all internal states at the start of each record.
    """
    names, (places,) = free_start_names(plant), np.nonzero(plant.free_internal)
    parts = []
    for record, start in zip(records, starts, strict=True):
        values = zip(names, start[places].tolist(), strict=True)
        parts.append(f"{record} {', '.join(f'{name} {value:.4g}' for name, value in values)}")
    return listed(parts)


def internal_starts(
    plant: Plant, values: Mapping[str, float], name: str, advice: str
) -> Float[np.ndarray, " nz"]:
    """Internal states at the start of a run, free ones as given by name.

    Args:
        plant: the plant.
        values: of free ones by name, others are not read.
        name: of the argument that gives them.
        advice: how to give one, ``{}`` in place of its name.

    Raises:
        ValueError: a free one that is not given.
    """
    start = plant.initial_internal.copy()
    for place, state in zip(
        np.flatnonzero(plant.free_internal), free_start_names(plant), strict=True
    ):
        rule = f"must give {state}, an internal state whose start is free"
        check(state in values, name, rule, ", ".join(values) or "nothing", advice.format(state))
        start[place] = values[state]
    return start


def check_known_starts(plant: Plant) -> None:
    """Check that a plant says where all its internal states start: a pass along data needs it.

    Args:
        plant: to be observed as it is.

    Raises:
        ValueError: some are free.
    """
    advice = "Declare a value; `identify`, `refine`, `validate` and `discover` estimate free ones."
    check_no_free_start(plant, "plant", advice)


def check_no_free_start(plant: Plant, name: str, advice: str) -> None:
    """Check that a plant says where all its internal states start.

    Args:
        plant: to be simulated without an estimate of its start.
        name: of the argument that would say it.
        advice: how to give it.

    Raises:
        ValueError: some are free.
    """
    free = free_start_names(plant)
    rule = "must give the start of internal states that the plant declares as free"
    check(not free, name, rule, f"nothing for {', '.join(free)}", advice)
