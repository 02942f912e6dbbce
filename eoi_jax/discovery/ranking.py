"""The evidence for every candidate, in the order in which a user should read it."""

from collections.abc import Mapping, Sequence

import numpy as np

from eoi_jax.discovery.remarks import IN_MODEL, NOT_EVALUATED, WRONG_SIGN, Refusal
from eoi_jax.discovery.result import Evidence
from eoi_jax.discovery.round import RoundResult
from eoi_jax.models.augmented import Placed
from eoi_jax.models.placements import ends
from eoi_jax.models.plant import Plant


def ranking(
    plant: Plant,
    rounds: Sequence[RoundResult],
    added: Sequence[Placed],
    refused: Mapping[Placed, Refusal],
) -> tuple[Evidence, ...]:
    """The added effects first, then every other candidate on its own, by descending score.

    Args:
        plant: the declared model.
        rounds: of the search.
        added: effects of the answer.
        refused: why other effects are not.
    """
    first = rounds[0]
    scores, empty = first.ranked.scores, first.ranked.scores.fit([])
    weight = scores.base.output_weight
    power = float(np.sum(weight * empty.residual**2))
    rows: dict[Placed, Evidence] = {}
    single_fits = {fit.atoms[0].placed: fit for fit in scores.extended(empty)}
    refined = {next(iter(fit.keys)): fit for fit in first.ranked.sets if len(fit.atoms) == 1}
    gains = {
        atom.placed: scores.value(
            scores.fit([neighbor for neighbor in fit.atoms if neighbor is not atom])
        )
        - scores.value(fit)
        for fit in [first.chosen]
        for atom in fit.atoms
    }
    for placed in first.candidates:
        fit = refined.get(placed, single_fits.get(placed))
        channels = placed.effect.channels(plant)
        refusal, parameters, score, share = refused.get(placed), {}, -np.inf, 0.0
        in_model = scores.known(placed)
        if fit is None or in_model:
            refusal = IN_MODEL if in_model else NOT_EVALUATED
        else:
            parameters = dict(zip(placed.names, fit.values[placed], strict=True))
            score = gains.get(placed, empty.cost - fit.cost - scores.penalty(fit.atoms))
            share = 1.0 - float(np.sum(weight * fit.residual**2)) / power
            refusal = refusal or (None if fit.physical else WRONG_SIGN)
        name, channel = placed.effect.name, channels[placed.channel]
        rows[placed] = Evidence(
            name, channel, parameters, max(share, 0.0), float(score),
            refusal.text if refusal else "", *ends(plant, placed), placed.effect.form,
            refusal.reason if refusal else "",
        )  # fmt: skip
    chosen = set(added) | set(gains)
    # A set that only the held-out records refuse comes first: the records of the fit support it.
    denied = set()
    if first.decision.denied and not chosen:
        denied = {atom.placed for atom in first.decision.denied.atoms}

    def priority(placed: Placed) -> tuple[bool, bool, bool, float]:
        row = rows[placed]
        return placed not in chosen, placed not in denied, row.remark != "", -row.score

    return tuple(rows[placed] for placed in sorted(rows, key=priority))
