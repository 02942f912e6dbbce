"""The constants of a discovery, and what follows from them alone."""

import os
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from eoi_jax.data.record import Record
from eoi_jax.discovery.cosine_modes import informative_band
from eoi_jax.discovery.rules import RULES
from eoi_jax.discovery.side_by_side import waits
from eoi_jax.estimation.identify import Identification
from eoi_jax.estimation.preparation import PreparedRecords
from eoi_jax.models.effects.effect import AbstractEffect
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.validate import growth_that_rules, judged_runs
from eoi_jax.simulation.validation import Validation


@dataclass(frozen=True)
class Task:
    """The constants of a discovery: the declared model, its records and the options."""

    plant: Plant
    prepared: PreparedRecords  # for the estimator
    records: tuple[Record, ...]
    held_out: tuple[Record, ...]
    effects: tuple[AbstractEffect, ...]
    declared: Identification
    alpha: float
    max_effects: int
    window: float | None
    pairs: int = 0  # of a parameter and a signal, whose dependences are tried

    @cached_property
    def threads(self) -> int:
        """Number of threads that evaluate models; 0 if they would deadlock (`side_by_side`)."""
        return 0 if waits(self.plant) else os.cpu_count() or 1

    @cached_property
    def whole_runs(self) -> Validation:
        """Free runs of the declared model through whole records."""
        return judged_runs(self.declared.plant, self.held_out or self.records)

    @cached_property
    def longest(self) -> float | None:
        """Length of long free runs [s] where whole ones say nothing; None: whole records."""
        limit = RULES.judge.misled
        growth = growth_that_rules(self.declared.plant, self.whole_runs, limit=limit)
        return None if growth is None else growth.window

    @cached_property
    def band(self) -> float:
        """Highest frequency of the modes [rad/s]."""
        cutoff = self.declared.lowpass.cutoff
        telling = informative_band(self.plant, self.records)
        return RULES.modes.band * float(np.clip(telling, cutoff, RULES.modes.widest * cutoff))
