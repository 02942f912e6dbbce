r"""Which effects does the residual justify: a search over sets of atoms.

A set is fitted with all declared parameters free, by weighted least squares over the modes, and
scored by twice the log-likelihood gained less a penalty,

    score = Σ (|R_0|² - |R|²)/S - (p - m) log n - m q - Σ rarity ,

p parameters added (shapes count), n modes, m effects, q the value that χ² with one degree of
freedom exceeds with probability α/M, M candidates, α the level of false alarms: one parameter must
pass a test at a level that knows how many names were tried (Bonferroni), each further one costs
what BIC asks for; `rarity` settles ties between twins. S(ω) is the power of what the best set
leaves (`noise_model`), so the search is repeated until S and the set agree.

Three things keep it honest: sets of two are searched exhaustively on the grid (an effect may gain
nothing before another is in), shapes are refined locally before sets are compared (Gauss–Newton,
all of them together), and every part of a set competes with it: an effect must be worth its penalty
beside all others.
"""

import itertools
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float

from eoi_jax.discovery.candidates import CandidateColumns
from eoi_jax.discovery.noise_spectrum import fitted_power
from eoi_jax.discovery.regression import Base, Fit, Make, Span, Spans, fitted, refined, system
from eoi_jax.discovery.screening import Projection, Terms, changes
from eoi_jax.models.augmented import Placed

_BEAM = 5  # sets of one size that are refined
# Sets that are refined once more under the power that the answer leaves: so many at most, none
# further behind the best one than this.
_LAST, _CLOSE = 3, 50.0
_PAIRS = 400  # pairs of columns that are looked at
_TRIES = 3  # points of the grid at which a pair may turn out unphysical
_TRIED = 8  # effects that are fitted exactly after the quick ranking
_ROUNDS = 4  # of power and set
# Shares, power: what an effect must take of the declared model's residual, or else of what is left
# without it, above the noise and with it; and what it must take of y^(r) in any case.
_MATERIAL, _MOSTLY, _HALF, _TRACE = 0.015, 0.9, 0.5, 1e-8
_NESTED = 0.0005  # like the first, of an effect beside a simpler one that it contains

Rows = Float[np.ndarray, " rows"]


@dataclass
class Search:
    """The search.

    Attributes:
        base: the declared model.
        grid: all atoms to start from.
        make: atoms of an effect at given shapes (grid, shapes), for local refinement.
        alpha: level of false alarms.
        most: effects in a set at most.
        names: number of candidates, for the correction.
        lacking: power of the residual of the model that was declared, the measure of what matters.
    """

    base: Base
    grid: list[CandidateColumns]
    make: Make
    alpha: float
    most: int
    names: int
    lacking: float
    power: Rows = field(init=False)
    _columns: Terms = field(init=False)
    _alone: Projection = field(init=False)
    _refined: dict[frozenset, tuple[CandidateColumns, ...]] = field(
        init=False, default_factory=dict
    )
    spans: Spans = field(init=False, default_factory=dict)

    def run(self) -> list[Fit]:
        """The best set of each composition that was looked at, best first."""
        self.spans = _spacings(self.grid)
        self._terms = [one for one in self.grid if one.target is None]
        self._changing = [one for one in self.grid if one.target is not None]
        self.power = np.ones_like(self.base.target)
        self._weigh(fitted(self.base, [], self.power).residual)
        chosen, shown = self.fit([]), []
        for _ in range(_ROUNDS):
            shown = self._once(chosen)
            best = next(one for one in shown if self.material(one))
            same = best.keys == chosen.keys
            self._weigh(best.residual)
            chosen = self.fit(best.atoms)  # its cost under the new power
            if same:
                break
        sets = sorted((self.fit(one.atoms) for one in shown), key=self.value)
        near = [one for one in sets[:_LAST] if self.value(one) < self.value(sets[0]) + _CLOSE]
        sets[: len(near)] = [self._refine(one) for one in near]
        return sorted(sets, key=lambda one: (not self.material(one), self.value(one)))

    # -- one set ------------------------------------------------------------------------------

    def fit(self, atoms: Sequence[CandidateColumns]) -> Fit:
        """A set at the present power."""
        return fitted(self.base, atoms, self.power)

    def penalty(self, atoms: Sequence[CandidateColumns]) -> float:
        """What the parameters and the choice of a set cost."""
        size = sum(len(one.placed.effect.parameters) for one in atoms)
        prior = sum(one.placed.effect.rarity for one in atoms)
        extra = (size - len(atoms)) * np.log(len(self.base.target))
        return float(extra + len(atoms) * self._level + prior)

    @cached_property
    def _level(self) -> float:
        """q of the score."""
        from scipy.special import chdtri  # only discovery needs it

        return float(chdtri(1.0, self.alpha / self.names))

    def value(self, fit: Fit) -> float:
        """Penalised cost: the smaller the better; infinite where a gain is not physical."""
        return fit.cost + self.penalty(fit.atoms) if fit.physical else np.inf

    def material(self, fit: Fit) -> bool:
        """Whether each effect takes, beside the others, a share of the residual that matters.

        No model of a rig is exact, and enough samples make any term significant. A small effect
        beside a large one matters where it takes nearly all that the other leaves. An effect that
        contains a simpler one must be worth something beside that too.
        """
        base, own = self.base, self.base.signal_power(fit.residual)
        for one in fit.atoms:
            others = [other for other in fit.atoms if other is not one]
            without = base.signal_power(self.fit(others).residual)
            rest = max(_MOSTLY * (without - base.noise_power), _HALF * without)
            least = min(_MATERIAL * self.lacking, rest)
            if without - own < max(least, _TRACE * base.output_power):
                return False
            present = {other.placed.effect.name for other in others}
            for simple in self._contained(one):
                if simple.placed.effect.name not in present:
                    left = base.signal_power(self.fit([*others, simple]).residual)
                    if left - own < _NESTED * self.lacking:
                        return False
        return True

    def _contained(self, one: CandidateColumns) -> list[CandidateColumns]:
        """Simpler effects at the same channel that this one can imitate."""
        names, site = one.placed.effect.contains, one.placed.site[1:]
        return [
            other
            for other in self._terms
            if other.placed.effect.name in names and other.placed.site[1:] == site
        ]

    def known(self, placed: Placed) -> bool:
        """Whether an effect is in the span of the declared model already."""
        own = [i for i, one in enumerate(self._terms) if one.placed == placed]
        kept = self._alone.independent
        return bool(own) and not any(kept[self._columns.part(i)].any() for i in own)

    def _weigh(self, residual: Rows) -> None:
        base = self.base
        self.power = fitted_power(residual, base.noise, base.local, base.output)
        self._columns = Terms(self._terms, self.power)
        self._alone = self._columns.project(base.columns, base.target)
        self._changes = changes(self._changing, base, self.power)

    # -- sets that are worth a look -------------------------------------------------------------

    def _once(self, chosen: Fit) -> list[Fit]:
        visited: dict[frozenset, Fit] = {frozenset(): self.fit([])}

        def visit(fit: Fit) -> None:
            if fit.keys not in visited and np.isfinite(fit.cost):
                visited[fit.keys] = self._polished(fit, visited.values())

        for fit in [chosen, *self.extended(visited[frozenset()])[:_BEAM], *self._pairs()]:
            visit(fit)
        for size in range(1, self.most):
            front = [fit for fit in visited.values() if len(fit.atoms) == size and fit.physical]
            for fit in sorted(front, key=self.value)[:2]:
                for new in self.extended(fit)[:3]:
                    visit(new)
        for fit in list(visited.values()):
            for count in range(1, len(fit.atoms)):
                for part in itertools.combinations(fit.atoms, count):
                    visit(self.fit(part))
        return sorted(visited.values(), key=self.value)

    def _polished(self, fit: Fit, others: Iterable[Fit]) -> Fit:
        """Refined, where that may matter: not done before, or among the best."""
        known = self._refined.get(fit.keys)
        if known is not None:
            fit = min(fit, self.fit(known), key=self.value)
        better = sum(self.value(other) < self.value(fit) for other in others)
        if better < (_BEAM if known is None else 2):
            fit = self._refine(fit)
            self._refined[fit.keys] = fit.atoms
        return fit

    def _refine(self, fit: Fit) -> Fit:
        return refined(self.base, fit, self.power, self.spans, self.make)

    def extended(self, fit: Fit) -> list[Fit]:
        """The set with one more effect, at its best point of the grid; best first."""
        keys = {one.key for one in fit.atoms}
        target, matrix = system(self.base, fit.atoms)
        beside = self._columns.project(matrix, target) if keys else self._alone
        by_atom = self._columns.by_atom(beside)
        best: dict[Placed, CandidateColumns] = {}
        for i in np.argsort(by_atom)[::-1]:
            one = self._terms[i]
            if one.key not in keys and by_atom[i] > 0:
                best.setdefault(one.placed, one)
        tried = list(best.values())[: _TRIED if keys else None]
        if not any(one.target is not None for one in fit.atoms):
            added = matrix[:, len(self.base.free) :]
            for several in self._changes:
                if several.atoms[0].key not in keys:
                    tried.append(several.atoms[int(np.argmin(several.costs(added)))])
        return sorted((self.fit([*fit.atoms, one]) for one in tried), key=self.value)

    def _pairs(self) -> list[Fit]:
        """Sets of two that gain most on the grid, all of them tried."""
        terms, owner = self._terms, self._columns.owner
        found = [
            (gain, (terms[owner[i]], terms[owner[k]]))
            for gain, i, k in self._columns.pairs(self._alone, _PAIRS)
        ]
        declared = float(self.fit([]).cost)
        for several in self._changes:
            left, beside = several.project_terms(self._columns)
            gains = declared - left[:, None] + self._columns.by_atom(beside)
            for one, gain in zip(several.atoms, gains, strict=True):
                found += [(gain[i], (one, terms[i])) for i in np.argsort(gain)[::-1][:_TRIED]]
        found.sort(key=lambda pair: -pair[0])
        fits: dict[frozenset, Fit] = {}
        tries: Counter[frozenset] = Counter()
        for _, pair in found:
            placed = frozenset(one.placed for one in pair)
            apart = len({one.key for one in pair}) == 2
            if apart and placed not in fits and tries[placed] < _TRIES:
                tries[placed] += 1
                fit = self.fit(pair)
                if fit.physical:
                    fits[placed] = fit
            if len(fits) >= _BEAM:
                break
        return sorted(fits.values(), key=self.value)


def _spacings(grid: Sequence[CandidateColumns]) -> Spans:
    """Steps and ends of each effect's grid."""
    shapes: dict[Placed, list[tuple[float, ...]]] = {}
    for one in grid:
        shapes.setdefault(one.placed, []).append(one.shape)
    return {placed: _span(placed, np.asarray(values)) for placed, values in shapes.items()}


def _span(placed: Placed, table: Float[np.ndarray, "grid shapes"]) -> Span:
    steps, low, high, grids = [], [], [], []
    for values, parameter in zip(table.T, placed.effect.shapes, strict=True):
        levels = np.unique(values)
        grids.append(levels)
        gaps = np.diff(levels) if len(levels) > 1 else 0.5 * np.abs(levels)
        steps.append(float(np.median(gaps)))
        low.append(max(levels[0] - 0.5 * gaps[0], parameter.lower))
        high.append(min(levels[-1] + 0.5 * gaps[-1], parameter.upper))
        if parameter.lower == 0.0:  # a scale: never down to nothing
            low[-1] = max(low[-1], 0.2 * levels[0])
    return Span(np.asarray(steps), np.asarray(low), np.asarray(high), tuple(grids))
