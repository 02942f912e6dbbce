"""PySINDy, set up by an expert, for naming the effect that a model lacks: the rival to beat.

Sparse regression on a library has no notion of a declared model, of a physical effect or of dry
friction at rest; whoever sets it up brings all of that. Here it is brought, as well as we can:

- weak form: the equation is multiplied by smooth bumps and integrated by parts, so that the noisy
  output is never differentiated (Messenger, Bortz 2021; PySINDy's own weak library integrates by
  parts once and wants the velocity as a signal, so the rows are made here, the two derivatives
  both on the bump, and handed to PySINDy's optimiser);
- a library made by hand, with the terms of all effects on grids of their shapes;
- the declared terms projected out of it before anything is selected;
- forward selection by error reduction ratio (`pysindy.FROLS`);
- the number of terms by the error on the last part of the record;
- terms of impossible sign taken out and the selection repeated, terms that hardly matter for the
  held-out error pruned, and the remaining ones mapped to the name of an effect.

Two weaker and more usual set-ups are options: sequential thresholding (`pysindy.STLSQ`), and
differentiation of the smoothed output. Nothing is shared with the library, nor with the simulator
of the cases.
"""

import time as clock
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from benchmarks.truth import sindy_library as lib

Optimiser = Literal["frols", "stlsq"]
Form = Literal["weak", "derivative"]

GAIN = ("b", "d", "beta")  # the input's gain goes by one of these names: mass, pendulum, tank
HELD_OUT = 0.3  # share of the rows, the last ones, on which the number of terms is chosen
LONGEST = 8  # terms at most
PRUNE = 1.15  # an effect stays if the held-out error grows by more than this without it
ALARM = 0.9  # held-out error with the terms over the error without: above, nothing is named
EXPLAINED = 0.05  # held-out error over that without terms: below, no further effect is looked for
NEGLIGIBLE = 2e-3  # a residual below this share of the rows' size is no effect


class CaseLike(Protocol):
    """What is read of a case (see `effect_cases.Case`); the truth is not."""

    @property
    def declared(self) -> str: ...
    @property
    def time(self) -> np.ndarray: ...
    @property
    def inputs(self) -> np.ndarray: ...
    @property
    def outputs(self) -> np.ndarray: ...
    @property
    def start(self) -> dict[str, float]: ...


@dataclass(frozen=True)
class Found:
    """The answer: y^(r) = Σ coefficient · term; declared terms come first.

    `effects` are the names, none if nothing is missing; `seconds` is the time that it took;
    `held_out` are the errors on the last part of the record of the declared model alone and of
    the one found [unit of y^(r), weighted by the bumps].
    """

    effects: tuple[str, ...]
    terms: tuple[lib.Term, ...]
    coefficients: np.ndarray
    order: int
    held_out: tuple[float, float]
    seconds: float
    declared: np.ndarray

    def bare(self) -> "Found":
        """The declared model alone, fitted the same way: what "before" means."""
        terms = self.terms[: len(self.declared)]
        return replace(self, effects=(), terms=terms, coefficients=self.declared)


# -- selection -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Problem:
    """Rows and columns of one case: declared terms D, candidates X, left-hand side y^(r)."""

    terms: list[lib.Term]
    D: np.ndarray
    X: np.ndarray
    left: np.ndarray
    train: np.ndarray

    def error(self, chosen: Sequence[int]) -> float:
        """Held-out error of the declared terms and the chosen ones, fitted to the other rows."""
        A = np.hstack([self.D, self.X[:, chosen]])
        fit = _solve(A[self.train], self.left[self.train])
        return _rms((self.left - A @ fit)[~self.train])

    def coefficients(self, chosen: Sequence[int]) -> np.ndarray:
        """All rows fitted: declared terms first, then the chosen ones."""
        return _solve(np.hstack([self.D, self.X[:, chosen]]), self.left)


def _solve(A: np.ndarray, b: np.ndarray) -> np.ndarray:
    scale = np.linalg.norm(A, axis=0)
    scale[scale == 0] = 1.0
    return np.linalg.lstsq(A / scale, b, rcond=1e-10)[0] / scale


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x**2)))


def _projected(problem: Problem) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Candidates, left-hand side without the declared terms' part; which candidates are left.

    Columns are scaled to norm one; those that the declared terms (nearly) span are left out.
    """
    D, X = problem.D[problem.train], problem.X[problem.train]
    Q = np.linalg.qr(D / np.linalg.norm(D, axis=0))[0]
    X = X / np.maximum(np.linalg.norm(X, axis=0), 1e-300)
    b = problem.left[problem.train]
    rest, b = X - Q @ (Q.T @ X), b - Q @ (Q.T @ b)
    size = np.linalg.norm(rest, axis=0)
    rest /= np.maximum(size, 1e-300)
    twin = np.triu(abs(rest.T @ rest) > 1.0 - 1e-10, k=1).any(axis=0)  # of an earlier column
    kept = np.flatnonzero((size > 1e-5) & ~twin)
    return rest[:, kept], b, kept


def _frols(X: np.ndarray, b: np.ndarray) -> list[list[int]]:
    """Supports of growing size, greedy by error reduction ratio."""
    import pysindy  # pyright: ignore[reportMissingImports]  (an extra: benchmarks)

    optimiser = pysindy.FROLS(max_iter=LONGEST, alpha=1e-9, unbias=False)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # ill-conditioned coefficients: only the order is used
        optimiser.fit(X, b / np.linalg.norm(b))
    return [np.flatnonzero(coefficients[0]).tolist() for coefficients in optimiser.history_]


def _stlsq(X: np.ndarray, b: np.ndarray) -> list[list[int]]:
    """Supports of growing size, by thresholds from high to low."""
    import pysindy  # pyright: ignore[reportMissingImports]  (an extra: benchmarks)

    supports: list[list[int]] = [[]]
    for threshold in np.geomspace(1.0, 0.03, 8):
        optimiser = pysindy.STLSQ(threshold=threshold, alpha=1e-3, max_iter=10)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # "eliminated all coefficients", "did not converge"
            optimiser.fit(X, b / np.linalg.norm(b))
        support = np.flatnonzero(optimiser.coef_[0]).tolist()
        if len(support) <= 3 * LONGEST and support not in supports:
            supports.append(support)
    return supports


def _shortest(problem: Problem, supports: list[list[int]], names: Callable) -> list[int]:
    """The support with the fewest effects among those with nearly the smallest held-out error."""
    errors = [problem.error(support) for support in supports]
    best = min(errors)
    if best > ALARM * errors[0] or errors[0] < NEGLIGIBLE * _rms(problem.left):
        return []
    enough = max(PRUNE * best, EXPLAINED * errors[0])
    fair = [s for s, e in zip(supports, errors, strict=True) if e <= enough]
    chosen = min(fair, key=lambda support: (len(names(support)), len(support)))
    return _pruned(problem, chosen, EXPLAINED * errors[0])


def _pruned(problem: Problem, chosen: list[int], enough: float) -> list[int]:
    """Take out, one effect at a time, what the held-out error hardly misses."""
    while len(effects := {problem.terms[j].effect for j in chosen}) > 1:
        without = {e: [j for j in chosen if problem.terms[j].effect != e] for e in effects}
        least = min(without.values(), key=problem.error)
        if problem.error(least) > max(enough, PRUNE * problem.error(chosen)):
            break
        chosen = least
    return chosen


def _wrong(problem: Problem, chosen: Sequence[int], gain: float) -> list[int]:
    """Chosen columns whose effect, all its columns together, pushes the wrong way."""
    coefficients = problem.coefficients(chosen)[problem.D.shape[1] :]
    push: dict[str, float] = {}
    for j, value in zip(chosen, coefficients, strict=True):
        driven = problem.terms[j].effect in lib.DRIVEN
        value *= float(np.linalg.norm(problem.X[:, j])) * (gain if driven else 1.0)
        push[problem.terms[j].effect] = push.get(problem.terms[j].effect, 0.0) + value
    return [j for j in chosen if push[problem.terms[j].effect] * problem.terms[j].sign < 0]


def _names(problem: Problem, chosen: Sequence[int], gain: float) -> tuple[str, ...]:
    """Canonical names of what was chosen."""
    coefficients = problem.coefficients(chosen)[problem.D.shape[1] :]
    total: dict[str, float] = {}
    for j, value in zip(chosen, coefficients, strict=True):
        total[problem.terms[j].effect] = total.get(problem.terms[j].effect, 0.0) + value
    if "input_clip" in total:
        # u - clip(u) is a dead zone, clip(u) itself a saturation; u is among the declared terms.
        slack = total.pop("input_clip") * gain < 0
        total["input_dead_zone" if slack else "input_saturation"] = 1.0
    if "stribeck_friction" in total:
        total.pop("coulomb_friction", None)
    level, offset = total.get("coulomb_friction"), total.get("constant_offset")
    if level is not None and offset is not None and abs(offset) < abs(level):
        del total["coulomb_friction"], total["constant_offset"]
        total["asymmetric_friction"] = 1.0
    return tuple(sorted(total))


def _rows(
    s: lib.Signals, declared: tuple[lib.Term, ...], order: int, form: str
) -> tuple[lib.Rows, np.ndarray]:
    """Rows with the narrowest bump that still sees the residual above the noise, and D."""
    make = lib.weak_rows if form == "weak" else lib.derivative_rows
    best: tuple[float, lib.Rows, np.ndarray] | None = None
    for half in (len(s.raw) // 30_000 or 1) * np.array([50, 80, 130, 200, 320]):
        rows = make(s, order, int(half))
        if order == 2:
            rows = rows.take(_moving(s, rows))
        D = lib.columns(declared, s, rows)
        share = (rows.noise / _rms(rows.left - D @ _solve(D, rows.left))) ** 2
        if best is None or share < best[0]:
            best = share, rows, D
        if share < 0.02:
            break
    assert best is not None
    return best[1:]


def _moving(s: lib.Signals, rows: lib.Rows) -> np.ndarray:
    """Rows that hold little rest: while a plant sticks its friction is a reaction, not a law."""
    slow = abs(s.v[:: s.thin]) < 0.02 * np.std(s.v)
    share = (rows.thinned @ slow) / (rows.thinned @ np.ones(len(slow)))
    limit = max(0.2, float(np.quantile(share, 0.4)))
    return np.flatnonzero(share <= limit)


def _problem(declared: str, s: lib.Signals, rows: lib.Rows, D: np.ndarray) -> Problem:
    """The library in rows; frequencies are those that stand out with, and without, another term."""
    train = np.arange(len(rows.left)) < (1.0 - HELD_OUT) * len(rows.left)
    terms = lib.library(declared, s)
    problem = Problem(terms, D, lib.columns(terms, s, rows), rows.left, train)
    X, b, kept = _projected(problem)
    first = int(kept[np.argmax(abs(b @ X))])
    part, left = rows.take(np.flatnonzero(train)), rows.left[train]
    both = np.hstack([D, problem.X[:, [first]]])
    waves = [lib.sinusoids(left, known[train], s, part) for known in (D, both)]
    waves = list(dict.fromkeys(waves[0] + waves[1]))
    X = np.hstack([problem.X, lib.columns(waves, s, rows)])
    return Problem(terms + waves, D, X, rows.left, train)


def discover(
    case: CaseLike,
    optimiser: Optimiser = "frols",
    form: Form = "weak",
) -> Found:
    """Name what the declared model lacks.

    Args:
        case: one record and the name of its declared model; only what `CaseLike` lists is read.
        optimiser: forward selection, or sequential thresholding.
        form: integrate by parts, or differentiate the smoothed output.

    Returns:
        Names, terms and coefficients, and the time that it took.
    """
    began = clock.perf_counter()
    order = 1 if case.declared == "tank" else 2
    s = lib.signals(case.time, case.inputs, case.outputs)
    declared = lib.declared_terms(case.declared)
    rows, D = _rows(s, declared, order, form)
    problem = _problem(case.declared, s, rows, D)
    gain = next(float(np.sign(case.start[name])) for name in GAIN if name in case.start)
    chosen = _select(problem, _frols if optimiser == "frols" else _stlsq, gain)
    return Found(
        effects=_names(problem, chosen, gain),
        terms=declared + tuple(problem.terms[j] for j in chosen),
        coefficients=problem.coefficients(chosen),
        order=order,
        held_out=(problem.error([]), problem.error(chosen)),
        seconds=clock.perf_counter() - began,
        declared=problem.coefficients([]),
    )


def _select(problem: Problem, supports: Callable, gain: float) -> list[int]:
    """Select, ban terms of the wrong sign, select again."""
    X, b, kept = _projected(problem)
    chosen: list[int] = []
    for _ in range(6):
        offered = [[int(kept[i]) for i in support] for support in supports(X, b)]
        chosen = _shortest(problem, offered, lambda c: _names(problem, c, gain))
        wrong = {problem.terms[j].effect for j in _wrong(problem, chosen, gain)}
        if not wrong:
            return chosen
        keep = np.array([problem.terms[j].effect not in wrong for j in kept])
        X, kept = X[:, keep], kept[keep]
    return []


def name(case: CaseLike, optimiser: Optimiser = "frols", form: Form = "weak") -> tuple[str, ...]:
    """Names of the effects that the declared model of `case` lacks; () for none."""
    return discover(case, optimiser, form).effects


# -- free run --------------------------------------------------------------------------------------


def start_of(time: np.ndarray, outputs: np.ndarray, samples: int = 60) -> tuple[float, float]:
    """Output and its rate at the first sample, from a cubic through the first `samples`."""
    t = (time[:samples] - time[0]) / (time[samples - 1] - time[0])
    fit = np.polynomial.polynomial.polyfit(t, np.ravel(outputs)[:samples], 3)
    return float(fit[0]), float(fit[1] / (time[samples - 1] - time[0]))


def free_run(
    found: Found, time: np.ndarray, inputs: np.ndarray, start: tuple[float, float]
) -> np.ndarray:
    """Simulate what was found from `start` (output, rate), (N,); infinite from where it diverges.

    Runge-Kutta over each sample for all that is smooth; dry friction then takes its share of the
    velocity, and stops it where it would turn it round.
    """
    h, u, middle = float(time[1] - time[0]), np.ravel(inputs), time + 0.5 * (time[1] - time[0])
    pairs = [(t, float(c)) for t, c in zip(found.terms, found.coefficients, strict=True)]
    push = sum(
        c * lib.DRIVEN[t.effect](middle, u, *t.shape) for t, c in pairs if t.effect in lib.DRIVEN
    )
    motion = [(c, lib.MOTION[t.effect], t.shape) for t, c in pairs if t.effect in lib.MOTION]
    dry = [(-c, lib.DRY[t.effect], t.shape) for t, c in pairs if t.effect in lib.DRY]
    memory = [[c, *t.shape, 0.0] for t, c in pairs if t.effect == "hysteresis"]

    def rate(y: float, v: float, total: float) -> float:
        for c, term, shape in motion:
            total += c * term(y, v, *shape)
        return total

    y, v = start
    out = np.full(len(time), np.inf)
    limit = 1e6 * (1.0 + abs(y))
    for k, driven in enumerate(np.broadcast_to(push, len(time)).tolist()):
        out[k] = y
        total = driven + sum(c * z for c, _, _, z in memory)
        before = y
        if found.order == 1:
            y = _runge_kutta_1(rate, y, total, h)
        else:
            y, v = _runge_kutta_2(rate, y, v, total, h)
            if dry:
                level = sum(c * term(v, *shape) for c, term, shape in dry)
                loss = max(-h * level, min(h * level, v)) if level > 0 else 0.0
                y, v = y - 0.5 * h * loss, v - loss
        if not abs(y) < limit:
            break
        for state in memory:
            state[3] = float(lib.bouc_wen(state[3], y - before, state[1], state[2]))
    return out


def _runge_kutta_1(rate: Callable, y: float, total: float, h: float) -> float:
    a = rate(y, 0.0, total)
    b = rate(y + 0.5 * h * a, 0.0, total)
    c = rate(y + 0.5 * h * b, 0.0, total)
    d = rate(y + h * c, 0.0, total)
    return y + h / 6.0 * (a + 2.0 * (b + c) + d)


def _runge_kutta_2(
    rate: Callable, y: float, v: float, total: float, h: float
) -> tuple[float, float]:
    a = rate(y, v, total)
    v2 = v + 0.5 * h * a
    b = rate(y + 0.5 * h * v, v2, total)
    v3 = v + 0.5 * h * b
    c = rate(y + 0.5 * h * v2, v3, total)
    v4 = v + h * c
    d = rate(y + h * v3, v4, total)
    return y + h / 6.0 * (v + 2.0 * (v2 + v3) + v4), v + h / 6.0 * (a + 2.0 * (b + c) + d)
