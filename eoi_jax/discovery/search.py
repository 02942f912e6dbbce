r"""The effects that the residual justifies: a search over sets of atoms.

A set is fitted with all declared parameters free, by weighted least squares over the modes. Its
score is twice the gain in log-likelihood minus a penalty,

    score = Σ (|R_0|² - |R|²)/S - (p - m) log n - m q - Σ rarity ,

p added parameters (including shapes), n modes, m effects, q the value that χ² with one degree of
freedom exceeds with probability α/M, M candidates, α the level of false alarms. One parameter must
pass a test whose level accounts for the number of candidates (Bonferroni), each further parameter
costs the penalty of BIC; `rarity` decides between equivalent effects. S(ω) is the power of the
residual of the best set (`noise_spectrum`), so the search is repeated until S and the set agree.

Three measures avoid wrong answers. Sets of two are searched exhaustively on the grid, because an
effect may gain nothing until another is in the set. Shapes are refined locally before sets are
compared (Gauss–Newton, all of them together). Every subset competes with the set: an effect must
gain more than its penalty beside all others.
"""

import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float

from eoi_jax.discovery.candidates import CandidateColumns
from eoi_jax.discovery.noise_spectrum import fitted_power
from eoi_jax.discovery.regression import Base, Fit, Make, Span, Spans, fitted, refined, system
from eoi_jax.discovery.rules import RULES
from eoi_jax.discovery.screening import Changes, Projection, Terms, changes
from eoi_jax.models.augmented import Placed

_RULES = RULES.search

Rows = Float[np.ndarray, " rows"]
Atoms = tuple[CandidateColumns, ...]
Effects = frozenset[Placed]


@dataclass(frozen=True)
class SearchProblem:
    """What is searched.

    Attributes:
        base: the declared model.
        grid: all atoms of the shape grids.
        alpha: level of false alarms.
        max_effects: largest number of effects in a set.
        names: number of candidates, for the Bonferroni correction.
        lacking: power of the residual of the declared model, the reference of material effects.
    """

    base: Base
    grid: Atoms
    alpha: float
    max_effects: int
    names: int
    lacking: float

    @cached_property
    def terms(self) -> list[CandidateColumns]:
        """Atoms that add columns to the model."""
        return [atom for atom in self.grid if atom.target is None]

    @cached_property
    def spans(self) -> Spans:
        """Spacings and ends of each effect's grid."""
        shapes: dict[Placed, list[tuple[float, ...]]] = {}
        for atom in self.grid:
            shapes.setdefault(atom.placed, []).append(atom.shape)
        return {placed: _span(placed, np.asarray(values)) for placed, values in shapes.items()}

    @cached_property
    def level(self) -> float:
        """q of the score."""
        from scipy.special import chdtri  # only discovery needs it

        return float(chdtri(1.0, self.alpha / self.names))

    def scores(self, residual: Rows) -> "Scores":
        """The scores of sets under the power of a residual."""
        base = self.base
        return Scores(self, fitted_power(residual, base.noise, base.local, base.output))


@dataclass(frozen=True)
class Scores:
    """Fits and scores of sets of effects under one power of the residual.

    Attributes:
        problem: what is searched.
        power: S of each mode.
    """

    problem: SearchProblem
    power: Rows
    # Of sets, with the atoms whose identities are the keys.
    _signal_powers: dict[frozenset[int], tuple[Sequence[CandidateColumns], float]] = field(
        init=False, repr=False, default_factory=dict
    )

    @property
    def base(self) -> Base:
        """The declared model."""
        return self.problem.base

    @cached_property
    def _columns(self) -> Terms:
        return Terms(self.problem.terms, self.power)

    @cached_property
    def _declared_projection(self) -> Projection:
        return self._columns.project(self.base.columns, self.base.target)

    @cached_property
    def _changes(self) -> list[Changes]:
        changing = [atom for atom in self.problem.grid if atom.target is not None]
        return changes(changing, self.base, self.power)

    # -- evaluation of a set ------------------------------------------------------------------

    def fit(self, atoms: Sequence[CandidateColumns]) -> Fit:
        """The fit of a set."""
        return fitted(self.base, atoms, self.power)

    def penalty(self, atoms: Sequence[CandidateColumns]) -> float:
        """The penalty for the parameters and the choice of a set."""
        size = sum(len(atom.placed.effect.parameters) for atom in atoms)
        prior = sum(atom.placed.effect.rarity for atom in atoms)
        extra = (size - len(atoms)) * np.log(len(self.base.target))
        return float(extra + len(atoms) * self.problem.level + prior)

    def value(self, fit: Fit) -> float:
        """Penalised cost, to be minimised; infinite if a gain is not physical."""
        return fit.cost + self.penalty(fit.atoms) if fit.physical else np.inf

    def material(self, fit: Fit) -> bool:
        """Whether each effect explains, beside the others, a material share of the residual.

        No model of a rig is exact, and with enough samples any term is significant. A small effect
        beside a large one is material if it explains nearly all that the other leaves. An effect
        that contains a simpler one must also explain something beside the simpler one.
        """
        base, set_power = self.base, self.base.signal_power(fit.residual)
        for atom in fit.atoms:
            remaining = [neighbor for neighbor in fit.atoms if neighbor is not atom]
            power_without = self._signal_power(remaining)
            share_of_remainder = max(
                _RULES.remainder * (power_without - base.noise_power), _RULES.half * power_without
            )
            threshold = min(_RULES.material * self.problem.lacking, share_of_remainder)
            if power_without - set_power < max(threshold, _RULES.trace * base.output_power):
                return False
            present = {neighbor.placed.effect.name for neighbor in remaining}
            for simple in self._contained(atom):
                if simple.placed.effect.name not in present:
                    simple_power = self._signal_power([*remaining, simple])
                    if simple_power - set_power < _RULES.nested * self.problem.lacking:
                        return False
        return True

    def _signal_power(self, atoms: Sequence[CandidateColumns]) -> float:
        """Power above the noise that a set leaves; many sets differ in a single effect."""
        key = frozenset(map(id, atoms))
        if key not in self._signal_powers:
            power = self.base.signal_power(self.fit(atoms).residual)
            self._signal_powers[key] = atoms, power
        return self._signal_powers[key][1]

    def _contained(self, wide: CandidateColumns) -> list[CandidateColumns]:
        """Simpler effects at the same channel that this one can imitate."""
        names, site = wide.placed.effect.contains, wide.placed.site[1:]
        return [
            term
            for term in self.problem.terms
            if term.placed.effect.name in names and term.placed.site[1:] == site
        ]

    def known(self, placed: Placed) -> bool:
        """Whether an effect is already in the span of the declared model."""
        indices = [i for i, term in enumerate(self.problem.terms) if term.placed == placed]
        independent = self._declared_projection.independent
        return bool(indices) and not any(independent[self._columns.part(i)].any() for i in indices)

    # -- generation of sets ---------------------------------------------------------------------

    def extended(self, fit: Fit) -> list[Fit]:
        """The set with each further effect, at the best point of its grid; best first."""
        keys = {atom.key for atom in fit.atoms}
        target, matrix = system(self.base, fit.atoms)
        projection = self._columns.project(matrix, target) if keys else self._declared_projection
        by_atom = self._columns.by_atom(projection)
        best: dict[Placed, CandidateColumns] = {}
        for i in np.argsort(by_atom)[::-1]:
            atom = self.problem.terms[i]
            if atom.key not in keys and by_atom[i] > 0:
                best.setdefault(atom.placed, atom)
        extensions = list(best.values())[: _RULES.exact if keys else None]
        if not any(atom.target is not None for atom in fit.atoms):
            added = matrix[:, len(self.base.free) :]
            for change in self._changes:
                if change.atoms[0].key not in keys:
                    extensions.append(change.atoms[int(np.argmin(change.costs(added)))])
        return sorted((self.fit([*fit.atoms, atom]) for atom in extensions), key=self.value)

    def pairs(self) -> list[Fit]:
        """The sets of two with the largest gain, from an exhaustive search on the grid."""
        terms, owner = self.problem.terms, self._columns.owner
        ranked = [
            (gain, (terms[owner[i]], terms[owner[k]]))
            for gain, i, k in self._columns.pairs(self._declared_projection, _RULES.pairs)
        ]
        declared = float(self.fit([]).cost)
        for change in self._changes:
            costs, projection = change.project_terms(self._columns)
            gains = declared - costs[:, None] + self._columns.by_atom(projection)
            for atom, gain in zip(change.atoms, gains, strict=True):
                ranked += [
                    (gain[i], (atom, terms[i])) for i in np.argsort(gain)[::-1][: _RULES.exact]
                ]
        ranked.sort(key=lambda pair: -pair[0])
        fits: dict[frozenset, Fit] = {}
        tries: Counter[frozenset] = Counter()
        for _, pair in ranked:
            placed = frozenset(atom.placed for atom in pair)
            compatible = len({atom.key for atom in pair}) == 2
            if compatible and placed not in fits and tries[placed] < _RULES.pair_tries:
                tries[placed] += 1
                fit = self.fit(pair)
                if fit.physical:
                    fits[placed] = fit
            if len(fits) >= _RULES.beam:
                break
        return sorted(fits.values(), key=self.value)


@dataclass(frozen=True)
class RankedSets:
    """What a search came to.

    Attributes:
        scores: under the power that the best set leaves.
        sets: the best one of each evaluated combination of effects, best first.
    """

    scores: Scores
    sets: tuple[Fit, ...]


def search_sets(problem: SearchProblem, make: Make) -> RankedSets:
    """Search until the power S and the best set agree.

    Args:
        problem: what is searched.
        make: makes the atoms of an effect at shapes (grid, shapes), for local refinement.
    """
    scores = problem.scores(fitted(problem.base, [], problem.base.output_level).residual)
    chosen, fits, shaped = scores.fit([]), [], {}
    for _ in range(_RULES.rounds):
        fits, shaped = _evaluated(scores, chosen, shaped, make)
        best = next(fit for fit in fits if scores.material(fit))
        unchanged = best.keys == chosen.keys
        scores = problem.scores(best.residual)
        chosen = scores.fit(best.atoms)  # its cost under the new power
        if unchanged:
            break
    sets = sorted((scores.fit(fit.atoms) for fit in fits), key=scores.value)
    leading = [
        fit
        for fit in sets[: _RULES.last]
        if scores.value(fit) < scores.value(sets[0]) + _RULES.last_margin
    ]
    sets[: len(leading)] = [_refined(scores, fit, make) for fit in leading]
    ordered = sorted(sets, key=lambda fit: (not scores.material(fit), scores.value(fit)))
    return RankedSets(scores, tuple(ordered))


def _evaluated(
    scores: Scores, chosen: Fit, shaped: Mapping[Effects, Atoms], make: Make
) -> tuple[list[Fit], dict[Effects, Atoms]]:
    """Sets of up to the largest size, best first; of promising ones the atoms at refined shapes.

    Args:
        scores: under the power that the chosen set leaves.
        chosen: the best set so far.
        shaped: atoms of sets whose shapes were refined before.
        make: makes the atoms of an effect at shapes.
    """
    visited: dict[Effects, Fit] = {frozenset(): scores.fit([])}
    atoms = dict(shaped)

    def visit(fit: Fit) -> None:
        if fit.keys in visited or not np.isfinite(fit.cost):
            return
        refined_atoms = atoms.get(fit.keys)
        if refined_atoms is not None:
            fit = min(fit, scores.fit(refined_atoms), key=scores.value)
        better = sum(scores.value(rival) < scores.value(fit) for rival in visited.values())
        if better < (_RULES.beam if refined_atoms is None else 2):
            fit = _refined(scores, fit, make)
            atoms[fit.keys] = fit.atoms
        visited[fit.keys] = fit

    empty = visited[frozenset()]
    for fit in [chosen, *scores.extended(empty)[: _RULES.beam], *scores.pairs()]:
        visit(fit)
    for size in range(1, scores.problem.max_effects):
        front = [fit for fit in visited.values() if len(fit.atoms) == size and fit.physical]
        for fit in sorted(front, key=scores.value)[:2]:
            for new in scores.extended(fit)[:3]:
                visit(new)
    for fit in list(visited.values()):
        for count in range(1, len(fit.atoms)):
            for part in itertools.combinations(fit.atoms, count):
                visit(scores.fit(part))
    return sorted(visited.values(), key=scores.value), atoms


def _refined(scores: Scores, fit: Fit, make: Make) -> Fit:
    return refined(scores.base, fit, scores.power, scores.problem.spans, make)


def _span(placed: Placed, table: Float[np.ndarray, "grid shapes"]) -> Span:
    steps, low, high, grids = [], [], [], []
    for values, parameter in zip(table.T, placed.effect.shapes, strict=True):
        levels = np.unique(values)
        grids.append(levels)
        gaps = np.diff(levels) if len(levels) > 1 else 0.5 * np.abs(levels)
        steps.append(float(np.median(gaps)))
        low.append(max(levels[0] - 0.5 * gaps[0], parameter.lower))
        high.append(min(levels[-1] + 0.5 * gaps[-1], parameter.upper))
        if parameter.lower == 0.0:  # a scale, which stays positive
            low[-1] = max(low[-1], 0.2 * levels[0])
    return Span(np.asarray(steps), np.asarray(low), np.asarray(high), tuple(grids))
