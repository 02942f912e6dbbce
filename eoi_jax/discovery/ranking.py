"""The evidence for every candidate, in the order in which a user should read it."""

from collections.abc import Sequence

import numpy as np

from eoi_jax.discovery.result import Evidence
from eoi_jax.discovery.round import Round, values_of
from eoi_jax.models.augmented import Placed
from eoi_jax.models.plant import Plant


def ranking(plant: Plant, rounds: Sequence[Round], kept: Sequence[Placed]) -> tuple[Evidence, ...]:
    """What was added, then every other candidate alone, by score."""
    first = rounds[0]
    search, empty = first.found, first.found.fit([])
    power = float(np.sum(empty.residual**2))
    rows: dict[Placed, Evidence] = {}
    alone = {fit.atoms[0].placed: fit for fit in search.extended(empty)}
    refined = {next(iter(fit.keys)): fit for fit in first.sets if len(fit.atoms) == 1}
    worth = {
        one.placed: search.value(search.fit([other for other in fit.atoms if other is not one]))
        - search.value(fit)
        for fit in [first.chosen]
        for one in fit.atoms
    }
    for placed in first.candidates:
        fit = refined.get(placed, alone.get(placed))
        channels = placed.effect.channels(plant)
        remark, parameters, score, taken = "", {}, -np.inf, 0.0
        known = search.known(placed)
        if fit is None or known:
            remark = "already in the model" if known else "not to be evaluated"
        else:
            parameters = dict(zip(placed.names, values_of(fit)[placed], strict=True))
            score = worth.get(placed, empty.cost - fit.cost - search.penalty(fit.atoms))
            taken = 1.0 - float(np.sum(fit.residual**2)) / power
            remark = "" if fit.physical else "wrong sign"
            remark = first.refused.get(placed, remark)
        name, channel = placed.effect.name, channels[placed.channel]
        rows[placed] = Evidence(
            name, channel, parameters, max(taken, 0.0), float(score), remark,
            *ends(plant, placed),
        )  # fmt: skip
    chosen = set(kept) | set(worth)
    # What held-out records alone refuse is read first: the records of the fit ask for it.
    denied = {one.placed for one in first.denied.atoms} if first.denied and not chosen else set()
    order = sorted(rows, key=lambda one: (one not in chosen, one not in denied,
                                          rows[one].remark != "", -rows[one].score))  # fmt: skip
    return tuple(rows[one] for one in order)


def ends(plant: Plant, one: Placed) -> tuple[str, str]:
    """The output that it is counted from, and the input beside which it acts."""
    return (
        "" if one.against is None else plant.outputs[one.against],
        "" if one.through is None else plant.inputs[one.through],
    )
