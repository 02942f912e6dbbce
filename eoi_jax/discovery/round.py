"""A round of discovery: a search from a model, and the tests of its sets on held-out records."""

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from itertools import chain

import numpy as np
from jaxtyping import Float

from eoi_jax.discovery.candidates import CandidateColumns
from eoi_jax.discovery.noise_spectrum import expected_power
from eoi_jax.discovery.regression import Base, Fit, within_bounds
from eoi_jax.discovery.round_start import RoundStart
from eoi_jax.discovery.rules import RULES
from eoi_jax.discovery.search import Effects, RankedSets, SearchProblem, search_sets
from eoi_jax.discovery.set_tests import Decision, decided, held_out_costs
from eoi_jax.discovery.side_by_side import map_in_threads
from eoi_jax.models.augmented import Placed, place
from eoi_jax.models.effects import (
    AsymmetricFriction,
    ConstantOffset,
    CoulombFriction,
    ParameterDependence,
)
from eoi_jax.models.effects.effect import AbstractTerm
from eoi_jax.models.plant import Plant

_RULES = RULES.round


@dataclass(frozen=True)
class RoundResult:
    """What a round came to.

    Attributes:
        start: the model that was searched from.
        candidates: effects that were searched.
        ranked: their sets, best first.
        decision: the set that passed the tests.
    """

    start: RoundStart
    candidates: tuple[Placed, ...]
    ranked: RankedSets
    decision: Decision

    @property
    def base(self) -> Base:
        """The model that was searched from, as modes."""
        return self.start.base

    @property
    def chosen(self) -> Fit:
        """The set that is added; empty where none passed."""
        return self.decision.chosen

    @property
    def terms(self) -> dict[Placed, list[CandidateColumns]]:
        """The atoms of each searched term."""
        grids: dict[Placed, list[CandidateColumns]] = {}
        for atom in self.ranked.scores.problem.grid:
            if isinstance(atom.placed.effect, AbstractTerm):
                grids.setdefault(atom.placed, []).append(atom)
        return grids

    @property
    def exhausted(self) -> bool:
        """Whether the residual of the chosen set is noise."""
        power = expected_power(self.base.noise, self.base.local, self.base.output)
        return float(np.mean(self.bounded_fit.residual**2 / power)) < _RULES.noise_like

    @property
    def declared(self) -> Fit:
        """The fit of the model without added effects, within its bounds."""
        scores = self.ranked.scores
        return within_bounds(self.base, scores.fit([]), scores.power)

    @cached_property
    def bounded_fit(self) -> Fit:
        """The fit of the chosen set within the bounds of the model, which is added and tested."""
        return within_bounds(self.base, self.chosen, self.ranked.scores.power)

    def augmented(self, added: dict[Placed, tuple[float, ...]]) -> Plant:
        """The model with the chosen set, at its fitted values.

        Args:
            added: the effects with their parameters, as `read_friction` interprets them.
        """
        return self.start.with_effects(self.ranked.scores, self.bounded_fit, added)

    @cached_property
    def plausible(self) -> list[tuple[Effects, float]]:
        """Sets that may be the answer, with twice their negative log-likelihood and penalty.

        The chosen one and those that are not refused, on the records of the fit and on held-out
        ones.
        """
        scores, chosen = self.ranked.scores, self.chosen
        limit = scores.value(chosen) + RULES.probability.implausible
        rivals = [
            fit
            for fit in self.ranked.sets
            if fit.keys != chosen.keys
            and fit.keys not in self.decision.rejected
            and scores.value(fit) < limit
            and scores.material(fit)
        ]
        costs = {fit.keys: 0.0 for fit in (chosen, *rivals)}
        if rivals and self.start.task.held_out:
            costs = held_out_costs(self.start, self.ranked, [chosen, *rivals])
        return [(fit.keys, scores.value(fit) + costs[fit.keys]) for fit in (chosen, *rivals)]

    def removed(self, laws: Collection[Placed]) -> float:
        """Power of the residual that laws of the chosen set take beside the others."""
        scores = self.ranked.scores
        remaining = [atom for atom in self.chosen.atoms if atom.placed not in laws]
        power = self.base.signal_power
        return power(scores.fit(remaining).residual) - power(self.chosen.residual)


def search_round(
    start: RoundStart, lacking: float, earlier: RoundResult | None = None
) -> RoundResult:
    """Find the best set that the held-out records do not refuse.

    Args:
        start: the model to search from.
        lacking: residual power of the declared model, the reference of material effects.
        earlier: a round that lends the columns that it has computed.
    """
    task, columns_of = start.task, {}

    def make(placed: Placed, shapes: Float[np.ndarray, "grid shapes"]) -> list[CandidateColumns]:
        key = (placed, shapes.tobytes())
        if key not in columns_of:  # sets that share an effect ask for the same shapes
            columns_of[key] = start.columns(placed, shapes)
        return columns_of[key]

    signals = start.signals_of_candidates()
    candidates = tuple(placed for placed, seen in signals.items() if placed.effect.shows(seen))
    terms = earlier.terms if earlier and start.has_weights_of(earlier.start) else {}

    def gridded(placed: Placed) -> list[CandidateColumns]:
        shapes, atoms = placed.effect.grid(signals[placed]), terms.get(placed, [])
        unchanged = [atom.shape for atom in atoms] == [tuple(row) for row in shapes.tolist()]
        return atoms if atoms and unchanged else make(placed, shapes)

    # Each effect is a separate kernel: they are compiled in parallel.
    grid = tuple(chain.from_iterable(map_in_threads(task.threads, gridded, candidates)))
    names = {placed.effect.name for placed in candidates}
    # Of dependences each pair of a parameter and a signal is one, whichever are left of them.
    names = max(len(names) + (task.pairs - 1 if ParameterDependence.name in names else 0), 1)
    problem = SearchProblem(start.base, grid, task.alpha, task.max_effects, names, lacking)
    ranked = search_sets(problem, make)
    return RoundResult(start, candidates, ranked, decided(start, ranked, make))


def read_friction(plant: Plant, fit: Fit) -> dict[Placed, tuple[float, ...]]:
    """The set, with asymmetric dry friction of similar levels read as a level and an offset.

    Two levels c₊, c₋ and a level (c₊ + c₋)/2 beside an offset (c₋ - c₊)/2 are the same function.
    Similar levels are called Coulomb friction and an offset, very different ones asymmetric.
    """
    added = {}
    for placed, values in fit.values.items():
        asymmetric = isinstance(placed.effect, AsymmetricFriction)
        if asymmetric and max(values) < _RULES.similar_levels * min(values):
            forward, backward = values
            location = placed.channel, placed.against, placed.through
            level = place(plant, CoulombFriction(), *location)
            offset = place(plant, ConstantOffset(), *location)
            added[level] = (0.5 * (forward + backward),)
            added[offset] = (0.5 * (backward - forward),)
        else:
            added[placed] = values
    return added
