"""The tests that a set of effects must pass to be the answer of a round.

Each of its effects is material and physical, no product of signals explains what the set leaves,
and each lowers the error on the held-out records. Of sets that are hardly told apart, the held-out
records decide.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from eoi_jax.discovery.candidates import CandidateColumns
from eoi_jax.discovery.cosine_modes import model_rows
from eoi_jax.discovery.noise_spectrum import fitted_power
from eoi_jax.discovery.regression import Fit, Make, system
from eoi_jax.discovery.remarks import (
    HELD_OUT,
    PRODUCT_ALONE,
    PRODUCT_OF_REST,
    Refusal,
    less_probable,
)
from eoi_jax.discovery.round_start import RoundStart
from eoi_jax.discovery.rules import RULES
from eoi_jax.discovery.search import Effects, RankedSets
from eoi_jax.models.augmented import Placed, own_states
from eoi_jax.models.effects import SinusoidalDisturbance
from eoi_jax.models.effects.effect import AbstractTerm
from eoi_jax.models.effects.products import ModulatedSinusoid, Product
from eoi_jax.models.plant import Plant

_RULES = RULES.round


@dataclass(frozen=True)
class Decision:
    """The set that passed, and why others did not.

    Attributes:
        chosen: the set; empty where none passed.
        refused: why effects of better sets are not in it.
        rejected: sets that did not pass.
        denied: the best set that only the held-out records refuse.
    """

    chosen: Fit
    refused: Mapping[Placed, Refusal]
    rejected: frozenset[Effects]
    denied: Fit | None


def decided(start: RoundStart, ranked: RankedSets, make: Make) -> Decision:
    """The best set that passes all tests.

    Args:
        start: what the round starts from.
        ranked: the sets, best first.
        make: makes the atoms of an effect at shapes (grid, shapes).
    """
    tests = _Tests(start, ranked, make)
    chosen = tests.first_accepted()
    return Decision(chosen, tests.refused, frozenset(tests.rejected), tests.denied)


def held_out_costs(
    start: RoundStart, ranked: RankedSets, sets: Sequence[Fit]
) -> dict[Effects, float]:
    """Costs on the held-out records, under the residual power that the first set leaves there.

    Args:
        start: what the round starts from.
        ranked: what its search came to.
        sets: fits to the records of the fit.
    """
    base = start.held_out_base
    residuals = [_held_out_residual(start, ranked, fit) for fit in sets]
    power = fitted_power(residuals[0], base.noise, base.local, base.output)
    pairs = zip(sets, residuals, strict=True)
    return {fit.keys: float(np.sum(residual**2 / power)) for fit, residual in pairs}


@dataclass
class _Tests:
    """The tests one after another: what they refuse, and the products that they have tried."""

    start: RoundStart
    ranked: RankedSets
    make: Make
    refused: dict[Placed, Refusal] = field(default_factory=dict)
    rejected: set[Effects] = field(default_factory=set)
    denied: Fit | None = None
    _least_with_product: float = np.inf  # least residual power of a set with a product

    def first_accepted(self) -> Fit:
        """The best set that passes; the empty one where none does."""
        sets = self.ranked.sets
        for i, fit in enumerate(sets):
            if not fit.atoms:
                return fit
            if self._accepts(fit):
                return self._preferred(fit, sets[i + 1 :])
        return self.ranked.scores.fit([])

    def _accepts(self, fit: Fit) -> bool:
        accepted = (
            fit.physical
            and self.ranked.scores.material(fit)
            and self._passes_product_test(fit)
            and self._lowers_held_out_error(fit)
        )
        if not accepted:
            self.rejected.add(fit.keys)
        return accepted

    def _preferred(self, fit: Fit, remaining: Sequence[Fit]) -> Fit:
        """The most probable set, held-out records included, of those that are hardly told apart.

        A dead zone that is never entered equals an offset, unless a held-out record enters it.
        """
        scores = self.ranked.scores
        alternatives = [
            alternative
            for alternative in remaining
            if 0 < len(alternative.atoms) <= len(fit.atoms)
            and scores.value(alternative) - scores.value(fit) < _RULES.told_apart
        ]
        if not alternatives or not self.start.task.held_out:
            return fit
        costs = held_out_costs(self.start, self.ranked, [fit, *alternatives])
        ordered = sorted(
            [fit, *alternatives], key=lambda item: scores.value(item) + costs[item.keys]
        )
        best = next(item for item in ordered if item is fit or self._accepts(item))
        for placed in fit.keys - best.keys:
            self.refused[placed] = less_probable(_effect_names(best.keys - fit.keys))
        return best

    def _passes_product_test(self, fit: Fit) -> bool:
        """Whether no product of signals explains most of the residual of a set and its extensions.

        Regression specification error test (Ramsey 1969): the residual of a correct set does not
        correlate with products of signals. A gain that varies with position or time resembles an
        offset or a disturbance if signals vary little about their mean; the residual reveals it.
        """
        power, scores = self.start.base.signal_power, self.ranked.scores
        # A residual that a further effect of the library explains does not count against the set.
        remainder = min(
            power(extended.residual)
            for extended in [fit, *scores.extended(fit)[: _RULES.extensions]]
        )
        products = {
            product: atom.placed
            for atom in reversed(fit.atoms)
            for product in _products(self.start.model, atom)
        }
        for (product, shape), placed in products.items():
            product_atoms = self.make(product, np.reshape(shape, (1, -1)))
            # Also compare with products beside better sets: an equivalent set fails like them.
            with_product = power(scores.fit([*fit.atoms, *product_atoms]).residual)
            self._least_with_product = min(with_product, self._least_with_product)
            if remainder - self._least_with_product > max(
                _RULES.product * remainder, _RULES.notable * scores.problem.lacking
            ):
                self.refused[placed] = PRODUCT_OF_REST
                return False
            # A product that alone explains more than the set: the set imitates it.
            if (
                power(fit.residual) - power(scores.fit(product_atoms).residual)
                > _RULES.notable * scores.problem.lacking
            ):
                self.refused[placed] = PRODUCT_ALONE
                return False
        return True

    def _lowers_held_out_error(self, fit: Fit) -> bool:
        """Each effect must lower the held-out error beside the others."""
        if not self.start.task.held_out:
            return True
        base, scores = self.start.held_out_base, self.ranked.scores
        residual = _held_out_residual(self.start, self.ranked, fit)
        power = fitted_power(residual, base.noise, base.local, base.output)
        for atom in fit.atoms:
            fit_without = scores.fit([neighbor for neighbor in fit.atoms if neighbor is not atom])
            residual_without = _held_out_residual(self.start, self.ranked, fit_without)
            if float(np.sum(residual_without**2 / power)) <= float(np.sum(residual**2 / power)):
                self.refused[atom.placed] = HELD_OUT
                self.denied = fit if self.denied is None else self.denied
                return False
        return True


def _held_out_residual(
    start: RoundStart, ranked: RankedSets, fit: Fit
) -> Float[np.ndarray, " rows"]:
    """The residual of a set on the held-out records, at the parameters of the fit."""
    if own_states(start.model) > 0:
        plant = start.with_effects(ranked.scores, fit, fit.values)
        return model_rows(plant, start.held_out_modes)[0][0]
    candidates = [start.held_out_columns(atom) for atom in fit.atoms]
    target, columns = system(start.held_out_base, candidates)
    return target - columns @ fit.theta


def _effect_names(effects: Iterable[Placed]) -> str:
    return " and ".join(sorted({placed.effect.label for placed in effects}))


def _products(model: Plant, atom: CandidateColumns) -> list[tuple[Placed, tuple[float, ...]]]:
    """The products of signals that can refute an effect, with their shape parameters."""
    degree = min(model.degrees[atom.placed.output], 2)
    pairs = ((), (("u", "y"), ("y", "y")), (("u", "y"), ("u", "v"), ("y", "v")))[degree]
    terms: list[tuple[AbstractTerm, tuple[float, ...]]] = [(Product(*pair), ()) for pair in pairs]
    if isinstance(atom.placed.effect, SinusoidalDisturbance):
        factors = (("u",), ("y", "u"), ("y", "v", "u"))[degree]
        terms += [(ModulatedSinusoid(signal), atom.shape) for signal in factors]
    location = atom.placed.output, atom.placed.through
    return [(Placed(term, location[0], (), through=location[1]), shape) for term, shape in terms]
