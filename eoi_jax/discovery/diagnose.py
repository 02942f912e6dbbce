r"""Tests whether the residual is more than noise, and what it depends on.

The residual due to noise alone is known (`residual`), and it is not white. So the residual is
thinned to the filter's bandwidth and whitened by the linear predictor that follows from its
spectrum under the null hypothesis. The result is white if the model is right, whatever its size.
Standard errors of means account for the colour in two ways, by that of the noise and by an estimate
(Newey and West); a finding must be significant under both.

**Sources.** Newey and West, Econometrica 55 (1987) 703; Ljung, *System Identification*, ch. 16
(residual tests, feedback); those of `regression.noise_autocorrelation`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

from eoi_jax._checks import check, check_kind, real
from eoi_jax._display import findings
from eoi_jax._process import one_thread
from eoi_jax.data.clipping import saturations
from eoi_jax.data.record import Record
from eoi_jax.data.spectrum import foreign_lines
from eoi_jax.discovery.diagnosis import Confounded, Cross, Diagnosis, Line, Map, PerOutput, Window
from eoi_jax.discovery.residual import View, raw_noise, variable_names, views_of
from eoi_jax.estimation.identify import Identification
from eoi_jax.estimation.regression.least_squares import Solution, least_squares, untraced
from eoi_jax.estimation.regression.noise_autocorrelation import (
    FEWEST,
    LAGS,
    coloured_means,
    correlations,
    largest,
    ljung_box,
    max_lag,
    prediction_from,
    wald,
    whitened,
    whitened_inputs,
)
from eoi_jax.models.check_records import check_records
from eoi_jax.models.plant import Plant

_LEVEL = 0.01
_MARGIN = 1.05  # ratio of residual to floor (rms) within the uncertainty of the noise estimate
_CLEAR = 3.0  # ratio of noise to discretisation error above which noise determines the colour
_FEEDBACK = 0.3  # correlation with future inputs above which feedback is suspected
_MOVES, _MOVED = 0.3, 0.02  # share of steps that change it, and by what share of the largest
_MIN_EXPLAINED = 0.01  # share of the residual's power that a map must explain to be reported
_BINS = 20
_WINDOWS = 20
_CONFOUNDED = 0.95  # correlation of two estimates above which they are confounded
_POOR = 0.01  # share of the regressors' mean power below which a window has no excitation
_UNEVEN = 100.0  # ratio of the standard errors of the worst and the best combination
_LINE_SHARE = 0.1  # share of the residual's power above which a line is reported


@one_thread()
def diagnose(
    identification: Identification,
    records: Record | Sequence[Record] | None = None,
    *,
    level: float = _LEVEL,
) -> Diagnosis:
    """Test the residual of an estimate against noise, and look for what may be wrong.

    Args:
        identification: result of `identify`.
        records: as they were measured, to look for saturation and quantisation; by default those
            of the identification, in which smoothing hides both.
        level: of significance, the chance of a false alarm of each test.

    Returns:
        The evidence; `findings` puts it in sentences.

    Raises:
        ValueError: no identification, a level outside (0, 0.5), records that do not fit the plant.

    Source:
        Ljung and Box, Biometrika 65 (1978) 297; Newey and West, Econometrica 55 (1987) 703; Ljung,
        *System Identification*, chapter 16.
    """
    check(0.0 < real(level) < 0.5, "level", "must lie in (0, 0.5)", level)
    check_kind("identification", identification, Identification, "what `identify` returned")
    plant = identification.plant
    measured = identification.records if records is None else check_records(plant, records)
    views, method_floor = views_of(identification)
    excitation, windows, solution = _excitation(identification, views)
    draft = Diagnosis(
        findings=(),
        outputs=plant.outputs,
        inputs=plant.inputs,
        units=plant.units,
        degrees=plant.degrees,
        level=float(level),
        **_residual_tests(plant, views, method_floor, level),
        excitation=excitation,
        windows=windows,
        confounded=_confounded(identification, solution),
        worst_combination=_worst_combination(plant, solution),
        sliding_fraction=identification.sliding_fraction,
        saturation=tuple(event for record in measured for event in saturations(record)),
        noise=np.max([raw_noise(plant, record) for record in measured], axis=0),
        quantum=np.max([record.quantum for record in measured], axis=0),
        lines=tuple(_foreign_lines(plant, views)),
    )
    return replace(draft, findings=findings(draft, identification.status))


# -- tests -----------------------------------------------------------------------------------


def _foreign_lines(plant: Plant, views: Sequence[View]) -> Iterator[Line]:
    """Spectral lines of external origin with a large share of the residual (fit of a sinusoid)."""
    for view in views:
        for j, output in enumerate(plant.outputs):
            scored = np.isfinite(view.residual[:, j])
            residual, time = view.residual[scored, j], view.record.time[scored]
            for frequency, rms in foreign_lines(view.record, j):
                waves = np.stack([np.cos(frequency * time), np.sin(frequency * time)], axis=1)
                fit = waves @ np.linalg.lstsq(waves, residual)[0]
                share = float(np.sum(fit**2) / max(np.sum(residual**2), np.finfo(float).tiny))
                if share > _LINE_SHARE:
                    yield Line(output, view.record.name, frequency, rms, share)


def _residual_tests(
    plant: Plant, views: Sequence[View], method_floor: PerOutput, level: float
) -> dict[str, Any]:
    """All fields of `Diagnosis` that are computed from the residual."""
    ny = len(plant.outputs)
    rms, floor, excess = np.stack([_size(views, j) for j in range(ny)], axis=1)
    exceeds_noise = (excess > _upper(level)) & (rms > _MARGIN * np.hypot(floor, method_floor))
    # The discretisation error is small but not white: where it matters, whiteness tests nothing.
    testable = exceeds_noise | (floor > _CLEAR * method_floor)
    whites = [[_white(view, j) for view in views] for j in range(ny)]
    rho, whiteness = zip(*(ljung_box(parts) for parts in whites), strict=True)
    whiteness = np.where(testable, whiteness, np.nan)
    offsets = [_offset(views, j) for j in range(ny)]
    maps = [_maps(plant, views, j) for j in range(ny)]
    strongest = [_strongest(maps[j], level, rms[j], method_floor[j]) for j in range(ny)]
    cross = []
    for j in range(ny):
        for k in range(len(plant.inputs)):
            delay_test = _delay(views, j, k, level) if exceeds_noise[j] else (np.nan, 0.0)
            unexplained = 1.0 - (floor[j] / rms[j]) ** 2 if exceeds_noise[j] else np.inf
            delay = delay_test[0] if delay_test[1] > 0.5 * unexplained else np.nan
            white = whites[j] if testable[j] else [np.full_like(part, np.nan) for part in whites[j]]
            cross.append(_cross(plant, views, white, (j, k), delay, level))
    return {
        "residual_rms": rms,
        "noise_floor": floor,
        "method_floor": method_floor,
        "more_than_noise": exceeds_noise,
        "whiteness": whiteness,
        "white": ~(whiteness < level),
        "autocorrelation": np.stack(rho),
        "thinning": tuple(view.thin for view in views),
        "offset": np.asarray([mean for mean, _ in offsets]),
        "offset_error": np.asarray([error for _, error in offsets]),
        "cross": tuple(cross),
        "maps": tuple(entry for output_maps in maps for entry in output_maps),
        "strongest": tuple(strongest),
    }


def _upper(level: float) -> float:
    """Quantile of the standard normal distribution exceeded with probability `level`."""
    from scipy.special import ndtri

    return float(-ndtri(level))


def _size(views: Sequence[View], j: int) -> tuple[float, float, float]:
    """Rms of the residual, its floor, and its excess over the floor in standard deviations."""
    square = floor = spread = count = 0.0

    def noise_variance(view: View) -> float:
        """Relative variance of the noise power; eighth differences of n samples count as n / 3.6.

        C(32, 16) / C(16, 8)² = 3.63, Σ ρ² of the eighth difference of white noise.
        """
        record = view.record
        return 3.63 * float(record.output_periods[j]) / (record.sample_period * len(record))

    for view in views:
        e = view.residual[:, j]
        scored = np.isfinite(e)
        square += float(np.sum(e[scored] ** 2))
        floor += float(np.sum(scored) * view.null[j, 0])
        part = float(np.sum(scored) * view.null[j, 0])
        dependence = view.samples_per_independent[j] / max(np.sum(scored), 1)
        spread += 2.0 * part**2 * (dependence + noise_variance(view))
        count += float(np.sum(scored))
    if not count:
        return np.nan, np.nan, np.nan
    excess = (square - floor) / np.sqrt(max(spread, np.finfo(float).tiny))
    return np.sqrt(square / count), np.sqrt(floor / count), excess


def _white(view: View, j: int) -> Float[np.ndarray, " n"]:
    """The thinned residual, whitened and divided by its deviation under the null hypothesis."""
    prediction = prediction_from(view.null[j])
    variance = view.null[j, 0] - prediction @ view.null[j, 1:]
    return whitened(view.thinned(j), prediction) / np.sqrt(max(variance, np.finfo(float).tiny))


def _cross(
    plant: Plant,
    views: Sequence[View],
    whites: Sequence[np.ndarray],
    pair: tuple[int, int],
    delay: float,
    level: float,
) -> Cross:
    """The whitened residual of one output against one whitened input (`pair`)."""
    j, k = pair
    pairs = list(zip(whites, whitened_inputs([view.inputs[:, k] for view in views]), strict=True))
    lags = np.arange(-LAGS, LAGS + 1)
    rho, counts = correlations(pairs, lags.tolist())
    step = max(view.thin * view.record.sample_period for view in views)
    past = largest(rho, counts, lags >= 0)
    future = largest(rho, counts, lags < 0)
    # A model error follows the input; where the input is periodic, it also precedes it a little.
    feedback = future[1] < level and abs(future[0]) > _FEEDBACK and _moves(views, k)
    return Cross(
        plant.outputs[j],
        plant.inputs[k],
        lags * step,
        rho,
        past[1],
        float(lags[past[2]] * step),
        future[1],
        float(delay),
        bool(feedback),
    )


def _moves(views: Sequence[View], k: int) -> bool:
    """Whether an input changes most of the time; a mostly constant one cannot be feedback."""
    steps = [np.abs(np.diff(view.record.inputs[:, k])) for view in views]
    return any(np.mean(step > _MOVED * np.max(step)) > _MOVES for step in steps)


def _delay(views: Sequence[View], j: int, k: int, level: float) -> tuple[float, float]:
    """The delay of input k that explains most of residual j [s], and the share it explains.

    F[φ] is projected out of F[f(delayed u) - f(u)], because other parameters would have absorbed a
    part. The residual is regressed on the result: the right delay has the coefficient one. NaN if
    no delay fits.
    """
    from scipy.special import ndtr

    target, columns, Phi = [], [], []
    for view in views:
        e = view.thinned(j)
        scored = np.isfinite(e)
        target.append(e[scored])
        columns.append(view.late[scored, j, k])
        Phi.append(view.Phi[:: view.thin, j][scored])
    e, late, phi = np.concatenate(target), np.concatenate(columns), np.concatenate(Phi)
    if len(e) < FEWEST or not np.any(late):
        return np.nan, 0.0
    phi = phi / np.maximum(np.linalg.norm(phi, axis=0), np.finfo(float).tiny)
    columns_and_residual = np.column_stack([late, e])
    columns_and_residual = (
        columns_and_residual - phi @ np.linalg.lstsq(phi, columns_and_residual, rcond=1e-10)[0]
    )
    late, e = columns_and_residual[:, :-1], columns_and_residual[:, -1]
    power = np.maximum(np.sum(late**2, axis=0), np.finfo(float).tiny)
    gain = late.T @ e / power
    explained = gain**2 * power / max(e @ e, np.finfo(float).tiny)
    fits = (gain > 0.5) & (gain < 2.0)
    if not np.any(fits):
        return np.nan, 0.0
    best = int(np.argmax(np.where(fits, explained, 0.0)))
    # Half the thinned samples count: neighbours are still correlated.
    strength = np.sqrt(0.5 * len(e) * explained[best] / max(1.0 - explained[best], 1e-12))
    if 2.0 * ndtr(-strength) * len(gain) > level:
        return np.nan, 0.0
    delays = views[0].delays * views[0].record.sample_period
    if best == 0:  # far below the time constant of the filter only the size shows a delay
        return float(delays[0] * gain[0]), float(explained[0])
    return _peak(delays, explained, best), float(explained[best])


def _peak(x: np.ndarray, values: np.ndarray, best: int) -> float:
    """Maximum of the parabola through the largest value and its neighbours."""
    if best == len(x) - 1 or len(np.unique(x[best - 1 : best + 2])) < 3:
        return float(x[best])
    a, b, _ = np.polyfit(x[best - 1 : best + 2] - x[best], values[best - 1 : best + 2], 2)
    return float(x[best] - b / (2.0 * a)) if a < 0 else float(x[best])


def _null(views: Sequence[View], j: int) -> list[np.ndarray]:
    return [view.null[j] for view in views]


def _offset(views: Sequence[View], j: int) -> tuple[float, float]:
    """Mean of the residual and its standard error."""
    labels = [np.where(np.isfinite(view.thinned(j)), 0, -1) for view in views]
    means = coloured_means([view.thinned(j) for view in views], labels, 1, _null(views, j))
    if not means.counts[0]:
        return np.nan, np.nan
    return float(means.mean[0]), float(np.sqrt(max(means.coloured[0, 0], means.null[0, 0])))


def _maps(plant: Plant, views: Sequence[View], j: int) -> list[Map]:
    total = sum(int(np.sum(np.isfinite(view.thinned(j)))) for view in views)
    if total < FEWEST:
        return []
    freedom = 1.5 * total / max_lag(total)  # of a Bartlett window
    bins = int(np.clip(freedom / 8.0, 3, _BINS))
    maps = []
    for c, name in enumerate(variable_names(plant)):
        values = [view.variables[:, c] for view in views]
        entry = _map((plant.outputs[j], name), views, values, j, bins, freedom)
        maps += [entry] if entry else []
    return maps


def _map(
    names: tuple[str, str],
    views: Sequence[View],
    values: Sequence[np.ndarray],
    j: int,
    bins: int,
    freedom: float,
) -> Map | None:
    """Binned means, and a Wald test that all are equal; None for a constant variable."""
    masks = [np.isfinite(view.thinned(j)) for view in views]
    scored = np.concatenate([v[mask] for mask, v in zip(masks, values, strict=True)])
    if np.ptp(scored) <= 1e-12 * np.max(np.abs(scored)):
        return None
    edges = np.unique(np.quantile(scored, np.linspace(0, 1, bins + 1)[1:-1]))
    used, place = np.unique(np.searchsorted(edges, scored, side="right"), return_inverse=True)
    if len(used) < 2:
        return None
    labels = [np.full(len(mask), -1) for mask in masks]
    starts = np.cumsum([np.sum(mask) for mask in masks])[:-1]
    for label, mask, part in zip(labels, masks, np.split(place, starts), strict=True):
        label[mask] = part
    thinned = [view.thinned(j) for view in views]
    means = coloured_means(thinned, labels, len(used), _null(views, j))
    error = np.maximum(np.diagonal(means.coloured), np.diagonal(means.null))
    e = np.concatenate([view.thinned(j)[mask] for view, mask in zip(views, masks, strict=True)])
    deviation = means.mean - np.mean(e)
    power = float(np.sum(e**2))
    explained = float(np.sum(means.counts * (deviation**2 - error))) / power if power > 0 else 0.0
    # Hotelling's correction for the first: its covariance is an estimate.
    tests = (wald(means.mean, means.coloured, freedom), wald(means.mean, means.null, np.inf))
    statistic, p_value = max(tests, key=lambda test: test[1])
    return Map(
        *names,
        np.bincount(place, scored) / means.counts,
        means.mean,
        1.96 * np.sqrt(error),
        statistic,
        p_value,
        max(explained, 0.0),
    )


def _strongest(maps: Sequence[Map], level: float, rms: float, method_floor: float) -> Map | None:
    """The map that explains most among those beyond chance and discretisation error."""
    good = [
        entry
        for entry in maps
        if entry.p_value < level / len(maps)
        and entry.explained > max(_MIN_EXPLAINED, (method_floor / rms) ** 2)
    ]
    return max(good, key=lambda entry: entry.explained) if good else None


# -- parameters ------------------------------------------------------------------------------


def _excitation(
    identification: Identification, views: Sequence[View]
) -> tuple[float, tuple[Window, ...], Solution]:
    """Excitation of all records together and of each window, and the least-squares solution."""
    index = identification.index[identification.best_pass]
    weights = np.where(np.isfinite(index) & (index > 0), 1.0 / np.where(index > 0, index, 1.0), 1.0)
    free = identification.plant.free
    stretches = [stretch for view in views for stretch in _stretches(view, weights, views)]
    total = np.sum([stretch[3] for stretch in stretches], axis=0)
    count = max(sum(stretch[4] for stretch in stretches), 1)
    solution = least_squares(total, np.zeros(len(free)), free)
    estimated = free > 0
    scale = np.sqrt(np.maximum(np.diagonal(total)[estimated], np.finfo(float).tiny) / count)

    def smallest_and_mean(information: np.ndarray, samples: int) -> tuple[float, float]:
        scaled = (
            information[np.ix_(estimated, estimated)] / max(samples, 1) / np.outer(scale, scale)
        )
        values = np.linalg.eigvalsh(scaled)
        return max(float(values[0]), 0.0), float(np.mean(values))

    windows = []
    for name, start, stop, information, samples in stretches:
        smallest, mean = smallest_and_mean(information, samples)
        windows.append(Window(name, start, stop, smallest, mean < _POOR))
    return smallest_and_mean(total, count)[0], tuple(windows), solution


def _stretches(
    view: View, weights: PerOutput, views: Sequence[View]
) -> list[tuple[str, float, float, np.ndarray, int]]:
    """Information and scored samples of each window of a record, some twenty over all records."""
    record = view.record
    length = sum(len(item.record) * item.record.sample_period for item in views)
    shortest = 10 * view.thin  # a few independent samples
    all_scored = np.any(np.isfinite(view.residual), axis=1)
    first = int(np.argmax(all_scored))  # the transient is not scored
    size = max(round(length / _WINDOWS / record.sample_period), shortest)
    count = max(round((len(record) - first) / size), 1)
    windows = []
    for part in np.array_split(np.arange(first, len(record)), count):
        scored = np.isfinite(view.residual[part])
        phi = np.where(scored[:, :, None], view.Phi[part], 0.0)
        information = np.einsum("j,tja,tjb->ab", weights, phi, phi, optimize=True)
        bounds = float(record.time[part[0]]), float(record.time[part[-1]])
        windows.append((record.name, *bounds, information, int(np.sum(np.any(scored, axis=1)))))
    return windows


def _confounded(identification: Identification, solution: Solution) -> tuple[Confounded, ...]:
    """Pairs of strongly correlated estimates, the most correlated first.

    The smaller of two correlations counts: that of the estimates, which includes model errors, and
    that of the experiment alone, for white residuals.
    """
    correlation = _correlation(np.asarray(solution.inverse))
    if np.all(np.isfinite(identification.covariance)):
        estimated = _correlation(identification.covariance)
        correlation = np.where(np.abs(estimated) < np.abs(correlation), estimated, correlation)
    names = identification.plant.names
    pairs = [
        Confounded(names[a], names[b], float(correlation[a, b]))
        for a in range(len(names))
        for b in range(a + 1, len(names))
        if abs(correlation[a, b]) > _CONFOUNDED
    ]
    return tuple(sorted(pairs, key=lambda pair: -abs(pair.correlation)))


def _correlation(covariance: Float[np.ndarray, "np np"]) -> Float[np.ndarray, "np np"]:
    error = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    scale = np.where(error > 0, error, np.inf)
    return covariance / np.outer(scale, scale)


def _worst_combination(plant: Plant, solution: Solution) -> str:
    """The parameter combination that is least certain, if far less certain than the others."""
    eigenvalues = np.asarray(solution.eigenvalues)
    if eigenvalues[0] * _UNEVEN**2 > eigenvalues[-1] or not np.any(solution.scale):
        return ""
    first = np.arange(len(eigenvalues)) > 0
    return untraced(
        eqx.tree_at(lambda fit: fit.identified, solution, first), plant.names, plant.free
    )[0]
