"""Starts that the model states, and that do not hold: no effect stands for them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from eoi_jax.data.holds import made_alike
from eoi_jax.data.record import Record
from eoi_jax.discovery.result import Discovery
from eoi_jax.discovery.rules import RULES
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.refine import refine_once
from eoi_jax.refinement.result import Refinement
from eoi_jax.refinement.start_check import stated_starts, with_start_check


@dataclass(frozen=True)
class StatedStartSettings:
    """When a start takes the place of an explanation."""

    share: float = 0.5  # of the error that is left with free starts: any model gains a little


_SETTINGS = StatedStartSettings()


def with_stated_starts(discovery: Discovery, records: Sequence[Record]) -> Discovery:
    """An open answer, with a note where the declared model describes the records from other starts.

    Args:
        discovery: the answer.
        records: of the fit, as given.
    """
    plant, used = discovery.declared.nominal, discovery.declared.records
    if discovery.status.code not in ("unexplained", "partial") or not stated_starts(plant):
        return discovery
    stated = refine_once(plant, made_alike(records, records, used), None)
    if not stated.status.fits:
        return discovery
    freed: list[Refinement] = []

    def refit(model: Plant, parts: tuple[Record, ...]) -> Refinement:
        freed.append(refine_once(model, parts, None))
        return freed[-1]

    notes = with_start_check(stated, refit).notes[len(stated.notes) :]
    if not notes:
        return discovery
    if not any(_describes(fit, stated) for fit in freed if fit.status.fits):
        return discovery
    return replace(discovery, notes=(*discovery.notes, *notes))


def _describes(freed: Refinement, stated: Refinement) -> bool:
    """Whether free starts leave noise, or far less than stated ones.

    A start that dies out is little of the error of a long record, also where nothing else is
    missing.
    """
    noise = np.max([record.noise for record in freed.records], axis=0)
    if np.all(freed.rmse <= RULES.questions.silent * noise):
        return True
    return bool(np.all(freed.rmse < _SETTINGS.share * stated.rmse))
