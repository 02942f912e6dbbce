"""Resampling: from stamps to a uniform grid, and between the samples of a uniform record.

Splines are built over positions in samples, not in seconds, so that they are equally well
conditioned for records in microseconds and in hours.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from eoi_jax._checks import check, check_choice
from eoi_jax._types import Mask, Signals, TimeAxis
from eoi_jax.data.input_holds import HOLDS, Columns, Hold, by_hold, columns_by_hold, hold_of_each
from eoi_jax.data.recursion import substituted
from eoi_jax.data.uniform_spline import within_steps

# A number as a caller may write it.
Real: TypeAlias = float | int | np.number
Segments: TypeAlias = Sequence[tuple[int, int]]


@dataclass(frozen=True)
class GridSettings:
    """When stamps lie on a uniform grid; all in periods of that grid but for a ratio."""

    tolerance: float = 1e-3  # distance from its grid point within which a stamp is on it
    rounding: float = 1e-9  # of sums and quotients of stamps
    gap: float = 2.5  # spacing above which samples are missing; below, a sample is late
    max_growth: float = 10.0  # points of the grid for each stamp; with more, the pauses dominate
    long_share: float = 0.1  # of the spacings; so many that are long are how samples come, no gaps
    scatter: float = 4.0  # long over short spacings in whole numbers, which are no milliseconds
    most_points: int = 20_000  # of a grid that has every stamp though they have no usual spacing
    neighbors: int = 5  # spacings on each side, beside which one of such a grid may be a gap
    hole: float = 4.0  # spacing over the longest of these, from which on it is one
    moved: float = 0.02  # of the smallest spacing, by which a stamp of such a grid may be rounded
    most_moved: float = 0.25  # the same where the grid would have too many points
    # Hours in days, minutes in hours (seconds in minutes), minutes in days, seconds in both.
    parts: tuple[float, ...] = (24.0, 60.0, 1440.0, 3600.0, 86400.0)
    day: float = 86400.0  # s: the last digit of dates of months and years
    written: float = 0.15  # of such a part, by which the digits of a stamp may be off it


_SETTINGS = GridSettings()


@dataclass(frozen=True)
class Grid:
    """The uniform grid that fits a set of stamps.

    Attributes:
        time: the grid [s], shape (M,).
        sample_period: its step [s].
        index: the grid point on which each stamp lies; None if stamps lie between grid points,
            so that values must be interpolated.
        deviation: largest distance of a stamp from the straight line through them [periods].
        resolution: step of the clock's last digit [s], where rounding to it explains a
            `deviation` above the tolerance; otherwise 0.
        scattered: the stamps have no usual spacing, as those of samples taken by hand; the grid is
            so fine that each lies on it.
    """

    time: TimeAxis
    sample_period: float
    index: Int[np.ndarray, " stamps"] | None
    deviation: float
    resolution: float
    scattered: bool = False

    @property
    def notes(self) -> tuple[str, ...]:
        """A sentence where stamps are taken to be rounded."""
        if not self.resolution:
            return ()
        note = f"Time is written in steps of {self.resolution:g} s; the deviation from a uniform "
        return (note + "clock is no more than that rounding.",)


def uniform_grid(stamps: TimeAxis) -> Grid:
    """The uniform grid of strictly increasing stamps; missing samples leave holes in it.

    The period is the slope of the least-squares line through (sample number, stamp), so a nominal
    step with rounded digits, such as 1/610.35 s, gives neither drift nor jitter. Stamps within
    1e-3 of a period of that line, or within the rounding to the clock's last digit, which may be as
    coarse as the period, are on the grid. If they scatter around the line by up to half a period,
    the grid still follows the line. Otherwise the period is the median spacing, and the grid starts
    at the first stamp. Stamps without a usual spacing (samples taken by hand, more often at first)
    have no such period: where they are multiples of a step that is not too small, they are the
    points of that grid.

    Args:
        stamps: strictly increasing time [s], at least two.

    Raises:
        ValueError: the grid would be more than ten times longer than the stamps.
    """
    spacing = np.diff(stamps)
    period = float(np.median(spacing))
    scattered = _scattered_grid(stamps)
    if scattered is not None:
        return scattered
    _check_regular(stamps, period)
    steps = np.maximum(np.rint(spacing / period), 1).astype(np.int64)
    index = np.concatenate([[0], np.cumsum(steps)])
    line = _line(index, stamps)
    # A coarse clock counts one or two digits a period.
    if np.mean(steps > 1) > _SETTINGS.long_share:
        complete = np.arange(len(stamps))
        line_of_all = _line(complete, stamps)
        if _is_rounded(stamps, *line_of_all[1:]):
            index, line = complete, line_of_all
    start, slope, deviation = line
    on_line = deviation <= _SETTINGS.tolerance
    rounded = not on_line and _is_rounded(stamps, slope, deviation)
    if on_line or rounded:
        count = int(index[-1]) + 1
        slope = _snap(slope, count)
        start = float(stamps[0]) if on_line else start
        time = start + slope * np.arange(count)
        return Grid(time, slope, index, deviation, _digit(stamps, slope) if rounded else 0.0)
    if _are_days(stamps, slope):
        return _grid_of_all(stamps, _SETTINGS.day)
    first = float(stamps[0])
    if deviation < 0.5:  # from the first point of the line that lies between stamps
        period, first = slope, start + slope * np.ceil((first - start) / slope - _SETTINGS.rounding)
    count = int(np.floor((stamps[-1] - first) / period + _SETTINGS.rounding)) + 1
    period = _snap(period, count)
    time = first + period * np.arange(count)
    return Grid(time, period, None, deviation, 0.0)


def sample_segments(stamps: TimeAxis, good: Mask, sample_period: float) -> list[tuple[int, int]]:
    """Runs (start, stop) of good samples without a gap.

    A gap is a spacing above 2.5 periods. A smaller one is a late sample, as the clock of an
    operating system produces it, and is bridged by a spline.
    """
    joined = np.diff(stamps) <= _SETTINGS.gap * sample_period
    return runs(good, joined)


def runs(good: Mask, joined: Bool[np.ndarray, " steps"] | None = None) -> list[tuple[int, int]]:
    """Runs (start, stop) of consecutive True; `joined` (N-1,) may break them further."""
    links = good[1:] & good[:-1]
    if joined is not None:
        links = links & joined
    starts = np.flatnonzero(good & ~np.concatenate([[False], links]))
    stops = np.flatnonzero(good & ~np.concatenate([links, [False]])) + 1
    return list(zip(starts.tolist(), stops.tolist(), strict=True))


def holes(spacing: Float[np.ndarray, " steps"]) -> Bool[np.ndarray, " steps"]:
    """Which spacings of stamps without a usual one are far longer than all of those around them."""
    reach = _SETTINGS.neighbors
    around = np.lib.stride_tricks.sliding_window_view(np.pad(spacing, reach), 2 * reach + 1)
    longest = np.max(np.delete(around, reach, axis=1), axis=1)
    return spacing > _SETTINGS.hole * longest


def own_period(position: Float[np.ndarray, " samples"]) -> float:
    """Mean distance between the samples of one channel, without the holes in it [grid steps].

    Args:
        position: where the channel was sampled, increasing [grid steps].
    """
    spacing = _usual_spacing(position)
    return float(np.mean(spacing)) if spacing.size else 1.0


def own_segments(position: Float[np.ndarray, " samples"]) -> list[tuple[int, int]]:
    """Runs (start, stop) of samples of one channel without a hole.

    A hole is a spacing of more than 2.5 periods. Where samples are missing at random, a few
    spacings are longer than that without any event: the longest of n that are distributed
    exponentially is about their mean plus ln n of their standard deviations. So much is no hole, up
    to five periods.

    Args:
        position: where the channel was sampled, increasing [grid steps].
    """
    usual = _usual_spacing(position)
    good = np.ones(len(position), dtype=bool)
    if not usual.size:
        return runs(good)
    period, gap = np.mean(usual), _SETTINGS.gap
    longest = period + np.std(usual) * np.log(usual.size)
    return runs(good, np.diff(position) <= np.clip(longest, gap * period, 2.0 * gap * period))


def _usual_spacing(position: Float[np.ndarray, " samples"]) -> Float[np.ndarray, " spacings"]:
    """Spacings of samples up to five times their median."""
    spacing = np.diff(position)
    return spacing[spacing <= 2.0 * _SETTINGS.gap * np.median(spacing)] if spacing.size else spacing


def covered(position: Float[np.ndarray, " stamps"], segments: Segments, query: TimeAxis) -> Mask:
    """Whether each query lies within a segment, between its first and its last sample."""
    mask = np.zeros(query.shape, dtype=bool)
    for start, stop in segments:
        mask[_queries_within(position, start, stop, query)] = True
    return mask


def fill(
    position: Float[np.ndarray, " stamps"],
    values: Float[np.ndarray, "stamps channel"],
    query: TimeAxis,
) -> Signals:
    """Linear interpolation of each channel over its finite values, constant at the ends."""
    filled = np.zeros((query.size, values.shape[1]))
    for j, channel in enumerate(values.T):
        finite = np.isfinite(channel)
        filled[:, j] = np.interp(query, position[finite], channel[finite]) if finite.any() else 0.0
    return filled


def spline(
    position: Float[np.ndarray, " stamps"],
    values: Float[np.ndarray, "stamps channel"],
    segments: Segments,
    query: TimeAxis,
    degree: int,
) -> Signals:
    """Interpolating spline of each segment, linear interpolation between the segments.

    Not-a-knot ends: polynomials up to `degree` are reproduced. A segment too short for the
    degree gets the next lower odd one.

    Args:
        position: where the samples lie, increasing [samples].
        values: at the samples.
        segments: runs (start, stop) to be interpolated separately.
        query: positions of the interpolated values, sorted [samples].
        degree: 1, 3 or 5.

    Source: de Boor, A Practical Guide to Splines, 1978.
    """
    from scipy.interpolate import make_interp_spline  # 0.2 s of import that few calls need

    result = fill(position, values, query)
    for start, stop in segments:
        wanted_points = _queries_within(position, start, stop, query)
        order = next((k for k in (5, 3, 1) if k <= degree and k < stop - start), 0)
        if order and wanted_points.stop > wanted_points.start and values.shape[1]:
            segment_spline = make_interp_spline(position[start:stop], values[start:stop], k=order)
            result[wanted_points] = segment_spline(query[wanted_points])
    return result


def sub_stepped(
    values: Float[np.ndarray, "time channel"], segments: Segments, count: int
) -> Float[np.ndarray, "points channel"]:
    """`spline` of degree five on a uniform record, with `count` steps in place of each step."""
    if list(segments) == [(0, len(values))]:
        result = np.empty(((len(values) - 1) * count + 1, values.shape[1]))
    else:
        query = np.arange((len(values) - 1) * count + 1) / count
        result = fill(np.arange(len(values), dtype=float), values, query)
    fractions = np.arange(count) / count
    for start, stop in segments:
        if stop - start > 1 and values.shape[1]:
            values_within = within_steps(values[start:stop], fractions, degree=5)
            result[count * start : count * (stop - 1)] = values_within.reshape(-1, values.shape[1])
        result[count * (stop - 1)] = values[stop - 1]
    return result


def hold_inputs(
    position: Float[np.ndarray, " stamps"],
    inputs: Float[np.ndarray, "stamps nu"],
    segments: Segments,
    query: TimeAxis,
    hold: str,
) -> Signals:
    """The inputs between their samples: held (`zero`), straight lines, or a quintic spline."""
    check_choice("hold", hold, HOLDS)
    if hold == "smooth":
        return spline(position, inputs, segments, query, degree=5)
    if hold == "linear":
        return fill(position, inputs, query)
    last = np.searchsorted(position, query + _SETTINGS.tolerance, side="right") - 1
    return inputs[np.clip(last, 0, len(inputs) - 1)]


def inputs_on_grid(
    position: Float[np.ndarray, " stamps"],
    inputs: Float[np.ndarray, "stamps nu"],
    segments: Segments,
    query: Float[np.ndarray, " points"],
    hold: Hold,
    averaged: bool = False,
) -> Float[np.ndarray, "points nu"]:
    """Inputs at grid points, each by its hold between its stamps.

    Args:
        position: of the stamps, increasing [grid steps].
        inputs: at the stamps; missing values are filled in linearly.
        segments: runs (start, stop) of stamps without a gap.
        query: the grid points [grid steps].
        hold: of the inputs.
        averaged: whether held inputs are their means over each step, for stamps off the grid.
    """
    finite = fill(position, inputs, position)

    def values(word: str, columns: Columns) -> np.ndarray:
        if averaged and word == "zero":
            return held_means(position, finite[:, columns], query.size)
        return hold_inputs(position, finite[:, columns], segments, query, word)

    return by_hold(hold, finite, values)


def sub_stepped_inputs(
    inputs: Float[np.ndarray, "time nu"], segments: Segments, count: int, hold: Hold
) -> Float[np.ndarray, "points nu"]:
    """`hold_inputs` on a uniform record, with `count` steps in place of each step."""

    def values(word: str, columns: Columns) -> np.ndarray:
        if word == "smooth":
            return sub_stepped(inputs[:, columns], segments, count)
        position, query = np.arange(len(inputs)), np.arange((len(inputs) - 1) * count + 1)
        position = position.astype(float)
        return hold_inputs(position, inputs[:, columns], segments, query / count, word)

    return by_hold(hold, inputs, values)


def acting_inputs(
    inputs: Float[np.ndarray, "time nu"],
    segments: Segments,
    delays: Float[np.ndarray, " nu"] | None,
    count: int,
    hold: Hold,
) -> tuple[Float[np.ndarray, "points nu"], Float[np.ndarray, "steps nu"]]:
    """Inputs at the points of a grid of `count` steps a sample, and in the middle of its steps.

    Args:
        inputs: on a uniform grid.
        segments: runs (start, stop) with known inputs.
        delays: by which each input acts later than it was logged [samples]; None: by none.
        count: fine steps in place of each step.
        hold: of the inputs. A held one that is delayed has its means over the steps at both places.
    """
    if delays is None:
        fine = sub_stepped_inputs(inputs, segments, 2 * count, hold)
        return fine[::2], fine[1::2]
    points = np.empty(((len(inputs) - 1) * count + 1, inputs.shape[1]))
    middles = np.empty((len(points) - 1, inputs.shape[1]))
    for word, columns in columns_by_hold(hold):
        group = inputs[:, columns], segments, delays[columns]
        if word == "zero":
            points[:, columns] = delayed_inputs(*group, count, word)
            middles[:, columns] = points[:-1, columns]
        else:
            fine = delayed_inputs(*group, 2 * count, word)
            points[:, columns], middles[:, columns] = fine[::2], fine[1::2]
    return points, middles


def delayed_inputs(
    inputs: Float[np.ndarray, "time nu"],
    segments: Segments,
    delays: Float[np.ndarray, " nu"],
    count: int,
    hold: str,
) -> Float[np.ndarray, "points nu"]:
    """`sub_stepped_inputs` of inputs that act later: at the points, or means behind them.

    A held input that changes within a fine step has no level there; its mean over the step has the
    same effect. Other inputs are interpolated. At the ends of a segment, where the neighbour is not
    known, the values stay.

    Args:
        inputs: on a uniform grid.
        segments: runs (start, stop) with known inputs.
        delays: of each input, negative for earlier [samples].
        count: fine steps in place of each step.
        hold: of the inputs.
    """
    result = sub_stepped_inputs(inputs, segments, count, hold)
    position = np.arange(len(inputs), dtype=float)
    for start, stop in segments:
        places = np.arange(start * count, (stop - 1) * count + 1)
        for j, delay in enumerate(delays):
            if hold == "zero":
                whole = int(np.floor(delay * count))
                share = delay * count - whole
                levels = inputs[start:stop, j]
                late, later = (
                    levels[np.clip((places - shift) // count, start, stop - 1) - start]
                    for shift in (whole, whole + 1)
                )
                result[places, j] = late + share * (later - late)
            else:
                query = np.clip(places / count - delay, start, stop - 1)
                column = inputs[:, j : j + 1]
                moved = hold_inputs(position, column, [(start, stop)], query, hold)
                result[places, j] = moved[:, 0]
    return result


def inputs_within_steps(
    inputs: Float[np.ndarray | Array, "time nu"],
    fractions: Float[np.ndarray, " places"],
    hold: Hold,
) -> Any:
    """Inputs at the same fractions of every step, (steps, places, nu); its end (1) is part of it.

    Those of JAX, also traced, are held or linear: they have no spline.
    """
    words = hold_of_each(hold, inputs.shape[1])
    for word in (hold,) if isinstance(hold, str) else hold:
        check_choice("hold", word, HOLDS)

    def straight(group: Any, words: Sequence[str]) -> Any:
        rise = (group[1:] - group[:-1]) * np.array([word == "linear" for word in words], float)
        return group[:-1, None] + fractions[:, None] * rise[:, None]

    def values(word: str, columns: Columns) -> Any:
        group = inputs[:, columns]
        if word == "smooth":
            return within_steps(np.asarray(group), fractions, degree=5)
        return straight(group, (word,))

    return by_hold(hold, inputs, values) if "smooth" in words else straight(inputs, words)


def held_means(
    position: Float[np.ndarray, " stamps"], inputs: Float[np.ndarray, "stamps nu"], count: int
) -> Signals:
    """Means over the steps of a grid of inputs that are held from each stamp to the next.

    An input that changes within a step has no single level there; its mean has the same effect.

    Args:
        position: of the stamps, increasing [steps]; the grid begins at zero.
        inputs: values from each stamp on.
        count: number of steps.
    """
    # The step in which each input changes.
    step = np.ceil(position[1:] - _SETTINGS.tolerance).astype(int) - 1
    within_grid = (step >= 0) & (step < count)
    share = np.clip(step + 1 - position[1:], 0.0, 1.0)  # of the step after the change
    means = hold_inputs(position, inputs, (), np.arange(count, dtype=float), "zero")
    np.add.at(means, step[within_grid], (share[:, None] * np.diff(inputs, axis=0))[within_grid])
    return means


def staircase_to_smooth(levels: Signals) -> Signals:
    r"""Samples of the low-frequency part of a staircase, at the instants of its levels.

    Level k is held from k to k + 1. With the levels as samples of a smooth signal v, the part of
    the staircase below the Nyquist frequency is the mean of v over a step,
    $u(t) = \int_{t-h}^{t} v\,dt' / h$, of response $e^{-j\theta/2}\,\sin(\theta/2)/(\theta/2)$
    at θ = ωh. The levels themselves, taken as samples of u, would lack the delay of half a sample.
    Here v is a quintic spline through the levels, constant before the first one.

    For slow signals this is (−v[k−2] + 13 v[k−1] + 13 v[k] − v[k+1]) / 24, the fourth-order
    refinement of the mean of two neighbours.

    Args:
        levels: values held over each step.
    """
    if not levels.shape[1]:
        return levels
    nodes, weights = np.polynomial.legendre.leggauss(3)  # exact up to degree five
    extended = np.concatenate([levels[:1], levels])
    return 0.5 * np.einsum("p,spc->sc", weights, within_steps(extended, 0.5 + 0.5 * nodes, 5))


def low_pass(values: Signals, cutoff: float) -> Signals:
    """Butterworth filter of order four, forward and backward: no phase, |F|² = 1/4 at cut-off.

    Args:
        values: a segment.
        cutoff: fraction of the Nyquist frequency, in (0, 1).

    Source: as `scipy.signal.sosfiltfilt` (odd extension at the ends) of `scipy.signal.butter`.
    """
    if not values.shape[1] or len(values) < 2:
        return values
    # The extension must be longer than the filter's memory, or its transient enters the record.
    memory = int(np.ceil(4 / cutoff)) + 15
    count = min(memory, len(values) - 1)
    first, last = 2.0 * values[:1], 2.0 * values[-1:]
    ends = first - values[count:0:-1], last - values[-2 : -count - 2 : -1]
    extended = np.concatenate([ends[0], values, ends[1]])
    for _ in range(2):
        extended = _filtered(cutoff, extended)[::-1]
    return extended[count : len(extended) - count]


def _filtered(cutoff: float, values: Signals) -> Signals:
    """Forward, from a state that has settled at the first sample."""
    for numerator, denominator in _sections(cutoff):
        # Both recursions count from the first sample, which they pass unchanged.
        change = values - values[:1]
        padded = np.concatenate([np.zeros((2, values.shape[1])), change])
        right = numerator[0] * padded[2:] + numerator[1] * padded[1:-1]
        right += numerator[2] * padded[:-2]
        values = substituted(denominator[:, None], right) + values[:1]
    return values


def _sections(cutoff: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Numerator and denominator in 1/z of each half of the filter, bilinear and prewarped."""
    k = np.tan(0.5 * np.pi * cutoff)
    sections = []
    for angle in (np.pi / 8.0, 3.0 * np.pi / 8.0):
        damping = 2.0 * k * np.cos(angle)
        a = np.array([1.0 + damping + k**2, 2.0 * (k**2 - 1.0), 1.0 - damping + k**2])
        sections.append((k**2 * np.array([1.0, 2.0, 1.0]) / a[0], a / a[0]))
    return sections


def low_pass_noise(*cutoffs: float) -> float:
    """Standard deviation of unit white noise after `low_pass` at each of the cut-offs in turn."""
    power = np.ones(4096)
    delay = np.exp(-1j * np.pi * np.arange(len(power)) / len(power))  # 1/z
    for cutoff in cutoffs:
        for numerator, denominator in _sections(cutoff):
            power *= np.abs(np.polyval(numerator[::-1], delay)) ** 4
            power /= np.abs(np.polyval(denominator[::-1], delay)) ** 4
    return float(np.sqrt(np.mean(power)))


def _queries_within(
    position: Float[np.ndarray, " stamps"], start: int, stop: int, query: TimeAxis
) -> slice:
    first = np.searchsorted(query, position[start] - _SETTINGS.tolerance, side="left")
    last = np.searchsorted(query, position[stop - 1] + _SETTINGS.tolerance, side="right")
    return slice(int(first), int(last))


def _line(index: Int[np.ndarray, " time"], stamps: TimeAxis) -> tuple[float, float, float]:
    """Least-squares line: value at index 0, slope, and the largest distance from it [slopes]."""
    middle = index.mean()
    offset = index - middle
    slope = float(offset @ (stamps - stamps.mean()) / (offset @ offset))
    start = float(stamps.mean() - slope * middle)
    return start, slope, float(np.max(np.abs(stamps - (start + slope * index)))) / slope


def _is_rounded(stamps: TimeAxis, period: float, deviation: float) -> bool:
    """Whether rounding to the last digit explains the deviation from a line [periods].

    It is at most half a digit, and a tenth for the error of the line.
    """
    return deviation <= 0.6 * _digit(stamps, period) / period + _SETTINGS.tolerance


def _digit(stamps: TimeAxis, period: float) -> float:
    """Step of the last digit of stamps [s]; 0 where they have none."""
    return _SETTINGS.day if _are_days(stamps, period) else _resolution(stamps, period)


def _resolution(stamps: TimeAxis, period: float) -> float:
    """The largest power of ten, at most the period, that divides every stamp."""
    top = int(np.floor(np.log10(period)))
    for power in range(top, top - 4, -1):
        digits = stamps / 10.0**power
        slack = 1e-6 + 4 * np.finfo(float).eps * np.max(np.abs(digits))
        if np.max(np.abs(digits - np.rint(digits))) <= slack:
            return 10.0**power
    return 0.0


def _are_days(stamps: TimeAxis, period: float) -> bool:
    """Whether the stamps are whole days apart, ten or more, as those of months and years are."""
    days = (stamps - stamps[0]) / _SETTINGS.day
    return 10.0 * _SETTINGS.day <= period and bool(np.all(np.abs(days - np.rint(days)) < 1e-6))


def _are_sparse(stamps: TimeAxis) -> bool:
    """Whether a tenth of the spacings and more are gaps of a grid of the median spacing."""
    median, long = np.quantile(np.diff(stamps), [0.5, 1.0 - _SETTINGS.long_share])
    return bool(long >= _SETTINGS.gap * median)


def lost_between(grid: Grid, stamps: TimeAxis) -> str:
    """What resampling loses of sparse samples, and what to do; empty where it loses none.

    Args:
        grid: of the stamps.
        stamps: of the samples.
    """
    if grid.index is not None or not _are_sparse(stamps):
        return ""
    text = "No spacing of the stamps is usual, and samples far from others are lost by resampling: "
    text += "round the stamps to a step of which the record has at most "
    return f"{text}{_SETTINGS.most_points}, or split it."


def _scattered_grid(stamps: TimeAxis) -> Grid | None:
    """The grid that has every stamp, where spacings differ so much that none of them is usual.

    Then as many as a tenth of them would be gaps, had the record the period of another tenth.
    """
    short, long = np.quantile(np.diff(stamps), [_SETTINGS.long_share, 1.0 - _SETTINGS.long_share])
    if long < _SETTINGS.gap * short:
        return None
    for unit in _common_steps(stamps - stamps[0]):
        grid = _grid_of_all(stamps, unit)
        if grid.time.size <= _SETTINGS.most_points:
            return grid
    return None


def _common_steps(elapsed: TimeAxis) -> Iterator[float]:
    """Steps of which all stamps are multiples, to rounding; that to which they may be rounded.

    Args:
        elapsed: stamps from the first.
    """
    smallest = float(np.diff(elapsed).min())
    digit = _resolution(elapsed, smallest)
    if digit:
        yield digit
    for parts in _SETTINGS.parts:
        ticks = parts * elapsed
        is_written = np.max(np.abs(ticks - np.rint(ticks))) <= _SETTINGS.written
        if is_written and parts * smallest > 1.0 - 2.0 * _SETTINGS.written:
            yield 1.0 / parts
    fine, coarse = (
        2.0 * _SETTINGS.moved * smallest,
        float(elapsed[-1]) / (_SETTINGS.most_points - 1),
    )
    yield fine
    if _are_sparse(elapsed) and fine < coarse <= 2.0 * _SETTINGS.most_moved * smallest:
        yield coarse


def _grid_of_all(stamps: TimeAxis, unit: float) -> Grid:
    """The grid that begins at the first stamp and has each stamp, rounded to `unit`."""
    ticks = np.rint((stamps - stamps[0]) / unit).astype(np.int64)
    divisor = int(np.gcd.reduce(ticks))
    index, step = ticks // divisor, divisor * unit
    count = int(index[-1]) + 1
    time = float(stamps[0]) + step * np.arange(count)
    deviation = float(np.max(np.abs(stamps - time[index]))) / step
    return Grid(time, step, index, deviation, 0.0, scattered=True)


def _snap(period: float, count: int) -> float:
    """The period in twelve digits if no sample moves: 0.001, not 0.0009999999999999996."""
    short = float(f"{period:.12g}")
    return short if abs(short - period) * count < 1e-6 * period else period


def _check_regular(stamps: TimeAxis, period: float) -> None:
    span = float(stamps[-1] - stamps[0])
    check(
        span <= _SETTINGS.max_growth * period * len(stamps),
        "time",
        f"must be sampled regularly: {len(stamps)} samples span {span / period:.3g} times "
        "their median spacing",
        f"median {period:g} s, span {span:g} s",
        "Split the record at its long pauses, or round its stamps to a coarser step.",
    )
