"""The record: measured signals on a uniform time grid, with notes on everything done to them.

A record holds NumPy arrays on the host; kernels take their arrays from it.
"""

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float

from eoi_jax._checks import RecordWarning, check, check_choice, check_positive, counted, warn_caller
from eoi_jax._display import Result
from eoi_jax._types import WHERE_SET, Inputs, Mask, OutputMask, Outputs, TimeAxis
from eoi_jax.data.cleaning import (
    LONGEST_HELD,
    SHORTEST,
    Names,
    between_own_samples,
    channel_groups,
    channel_names,
    check_labels,
    check_lengths,
    check_untraced,
    interpolate,
    interpolated_noise,
    is_slow,
    known_inputs,
    own_noise,
    place,
    rate_notes,
    read_signals,
    read_stamps,
    replaced_outputs,
    scored_samples,
)
from eoi_jax.data.digest import digest
from eoi_jax.data.equal_stamps import distinct_stamps
from eoi_jax.data.input_holds import (
    HOLD_TAKEN,
    HOLDS,
    NO_LONGER_HELD,
    Hold,
    HoldArgument,
    by_hold,
    declared_or_suggested,
    hold_of_each,
    hold_text,
    read_hold,
    shared,
)
from eoi_jax.data.noise import quanta
from eoi_jax.data.overflow import without_codes
from eoi_jax.data.repeats import repeat_notes
from eoi_jax.data.resampling import (
    Real,
    acting_inputs,
    covered,
    lost_between,
    low_pass_noise,
    own_period,
    runs,
    sub_stepped,
    uniform_grid,
)
from eoi_jax.data.smoothing import smoothed_inputs, smoothed_outputs, smoothing_note
from eoi_jax.data.sparse_inputs import between_entries
from eoi_jax.data.unwrapping import checked_periods, unwrapped_channels
from eoi_jax.data.wrapping import wrap_notes


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Record(Result):
    """One measured or simulated run (t, u, y) on a uniform time grid.

    `plot` shows outputs and inputs over time, without masked samples.

    The arguments are checked and brought onto the grid. Samples with stamps within 1e-3 of a
    period of a uniform clock, or within the rounding of their printed digits, are used unchanged;
    otherwise outputs are resampled by a cubic spline, and inputs by their hold (held inputs by
    their mean over each step). Missing samples, gaps, NaN and infinities are masked, each channel
    by itself, and the values are interpolated linearly there to keep arithmetic finite. Rows of one
    stamp are merged where no channel has two values. Each of these changes gives a `RecordWarning`
    and a sentence in `notes`.

    Where an output is missing it is not scored, and simulations run on. Where an input is missing
    it is unknown, and simulations start again behind it. A missing sample of an input leaves no
    doubt, and counts as known, in a gap of one or two samples of a held input (``"zero"``) with the
    same value on both sides, and as a single sample of another input between two measured ones. An
    input that has values in some rows only, as in a log of changes or one with a row for each
    channel, follows its hold in between if that is declared. An output that is measured at two of
    three samples or less often has a rate of its own: free runs are scored at its samples, and
    passes interpolate it (`bridged`).

    Args:
        time: stamps (N,) [s], increasing; datetimes count in seconds from the first.
        inputs: (N,) or (N, nu); ``np.zeros((N, 0))`` for a system without input.
        outputs: (N,) or (N, ny).
        name: name of the record.
        input_names: default: the column names of a pandas object, else ``u`` or ``u1, u2, …``.
        output_names: the same with ``y``.
        units: ``{name: unit}``, for tables and figures.
        hold: the input between two samples: ``"zero"`` (a converter held it), ``"linear"``,
            ``"smooth"`` (band-limited, a quintic spline through the samples) or ``"auto"``:
            zero for an input that at most 20 % of the steps change, else linear. Where inputs
            differ, one word for each: ``{"heating": "zero", "outdoor": "linear"}``, or in order.
        burn_in: time at the start that is not scored [s].
        mask_faults: whether samples of an output that leave its course alone are masked, as faults
            of the sensor: not where such a sample can be true, as in an impact.

    Attributes:
        time: (N,) [s]. inputs: (N, nu). outputs: (N, ny). All read-only.
        hold: one word where all inputs share it, else a word for each; `holds`: a word for each.
        valid: (N,), False where a sample was missing or not finite in any channel.
        input_valid: (N,), True where all inputs are known; everywhere without inputs.
        output_valid: (N, ny), True where each output was measured.
        skew: (nu,), time by which each input acts later than it was logged [s].
        output_periods: (ny,), mean time between two samples of each output, without gaps [s].
        sample_period: step of `time` [s].
        hold_declared: whether the caller named the hold; else the samples decided it, and an
            estimate decides again by its fit.
        notes: sentences on the changes made to the record, in order.
        file_units: units in its file, by channel, where the caller neither gave a unit nor scaled
            the column; also that in which its time counts, by `time`. None: none.
        smoothed: cut-off frequencies of the zero-phase low-passes applied so far [rad/s].

    Raises:
        ValueError: wrong shapes, unequal lengths, values that are no numbers, a channel without a
            finite value, fewer than 8 (valid) samples of one, time that is not finite, decreases or
            repeats a stamp with different values, an unknown hold, a negative burn-in.
    """

    time: TimeAxis
    inputs: Inputs
    outputs: Outputs
    valid: Mask
    sample_period: float
    name: str
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    units: dict[str, str]
    hold: Hold
    burn_in: float
    notes: tuple[str, ...]
    smoothed: tuple[float, ...]
    # Taken over from the record that this one was made from; None: estimated from this record.
    _noise: Float[np.ndarray, " ny"] | None
    _quantum: Float[np.ndarray, " ny"] | None
    _middle: Float[np.ndarray, "between nu"] | None  # inputs halfway between the samples
    hold_declared: bool = True
    _periods: Float[np.ndarray, " ny"] | None = field(default=None, metadata=WHERE_SET)
    # None: as `valid` says.
    _input_valid: Mask | None = field(default=None, metadata=WHERE_SET)
    _output_valid: OutputMask | None = field(default=None, metadata=WHERE_SET)
    # By which the inputs act later than they were logged [s]; None: they do not.
    _skew: Float[np.ndarray, " nu"] | None = field(default=None, metadata=WHERE_SET)
    # Whether it is the later part of another record; None: it is not.
    _continues: bool | None = field(default=None, metadata=WHERE_SET)
    _logged_hold: Hold | None = field(default=None, metadata=WHERE_SET)  # None: `hold`
    file_units: dict[str, str] | None = field(default=None, metadata=WHERE_SET)
    # Inputs on the grid by each hold of `HOLDS`; None: declared, or the samples are on the grid.
    _by_hold: Float[np.ndarray, "holds time nu"] | None = field(default=None, metadata=WHERE_SET)

    @np.errstate(over="ignore", invalid="ignore")  # of samples that are masked
    def __init__(
        self,
        time: Any,
        inputs: Any,
        outputs: Any = None,
        name: str = "record",
        *,
        input_names: Names = None,
        output_names: Names = None,
        units: Mapping[str, str] | None = None,
        hold: HoldArgument = "auto",
        burn_in: Real = 0.0,
        mask_faults: bool = True,
    ):
        check(bool(0 <= burn_in < np.inf), "burn_in", "must be a time ≥ 0 in seconds", burn_in)
        check_untraced(time, inputs, outputs)
        stamps = read_stamps(time)
        u, y = read_signals("inputs", inputs), read_signals("outputs", outputs)
        check_lengths(stamps, u, y)
        u_names = channel_names("input_names", input_names, inputs, u.shape[1], "u")
        y_names = channel_names("output_names", output_names, outputs, y.shape[1], "y")
        check_labels(u_names, y_names, dict(units or {}))
        notes: list[str] = []  # these also give warnings; the choice of a hold does not
        stamps, u, y = distinct_stamps(stamps, u, y, notes)
        u, y = without_codes(u, u_names, notes), without_codes(y, y_names, notes)
        u, reach = between_entries(stamps, u, u_names, hold, notes)
        good = scored_samples(u_names, y_names, u, y, mask_faults, notes)
        input_hold, hold_notes = declared_or_suggested(hold, u[good[0]], u_names)
        grid = uniform_grid(stamps)
        noise = quantum = None
        if grid.index is None:
            arrays = interpolate(grid, stamps, u, y, good, notes, reach)
            quantum = quanta(y, good[1])  # interpolation hides the steps and the noise
            notes += wrap_notes(y_names, y, good[1])  # of jumps that an interpolation divides
            noise = interpolated_noise(grid, stamps, y, arrays[1], good[1], arrays[3], quantum)
        else:
            arrays = place(grid, grid.index, u, y, good, notes, reach)
        inputs_of, outputs, u_valid, measured = arrays
        inputs = inputs_of(input_hold)
        count = int(np.min(measured.sum(axis=0)))
        rule, advice = f"must have at least {SHORTEST} valid samples", lost_between(grid, stamps)
        check(count >= SHORTEST, "outputs", rule, count, advice)
        certain = known_inputs(u_names, inputs, u_valid, input_hold, grid.sample_period, notes)
        rate_notes(y_names, measured, grid.sample_period, notes)
        for note in notes:
            warn_caller(f"Record `{name}`: {note}", RecordWarning)
        masks = u_valid & measured.all(axis=1), certain, measured
        self._set(inputs, outputs, masks, grid.time, grid.sample_period)
        labels = {
            "name": name, "input_names": u_names, "output_names": y_names,
            "units": dict(units or {}), "hold": input_hold, "hold_declared": hold != "auto",
            "burn_in": float(burn_in), "smoothed": (), "_noise": noise, "_quantum": quantum,
            "notes": (*notes, *hold_notes, *grid.notes, *repeat_notes(y_names, y, good[1])),
        }  # fmt: skip
        self._assign(labels)
        tried = np.stack([inputs_of(word) for word in HOLDS]) if hold == "auto" else inputs[None]
        self._assign({"_by_hold": tried if np.any(tried != tried[0]) else None})

    @classmethod
    def from_period(
        cls,
        sample_period: Real,
        inputs: Any,
        outputs: Any,
        name: str = "record",
        *,
        input_names: Names = None,
        output_names: Names = None,
        units: Mapping[str, str] | None = None,
        hold: HoldArgument = "auto",
        burn_in: Real = 0.0,
        mask_faults: bool = True,
    ) -> "Record":
        """A record whose samples are `sample_period` [s] apart, the first one at time 0.

        Other arguments and errors as for `Record`.
        """
        check_positive("sample_period", sample_period, "It is the time between samples in seconds.")
        time = float(sample_period) * np.arange(read_signals("outputs", outputs).shape[0])
        return cls(time, inputs, outputs, name, input_names=input_names, units=units, hold=hold,
                   output_names=output_names, burn_in=burn_in, mask_faults=mask_faults)  # fmt: skip

    # -- parts ----------------------------------------------------------------------------

    def __len__(self) -> int:
        return self.time.size

    def __getitem__(self, index: Any) -> "Record":
        """``record[1000:5000]``: those samples, with the same names, units, hold and time.

        The burn-in is reduced by the time before the slice.

        Raises:
            ValueError: an index that is no slice, a step, fewer than 8 (valid) samples.
        """
        advice = "Write record[1000:5000]."
        check(isinstance(index, slice), "record[…]", "must be sliced", repr(index), advice)
        rule, advice = "must be sliced without a step", "Filter with `smooth` before that."
        check(index.step in (None, 1), "record[…]", rule, index.step, advice)
        start, stop, _ = index.indices(len(self))
        part = slice(start, stop)
        measured = self.output_valid[part]
        count = int(min(np.min(measured.sum(axis=0)), self.input_valid[part].sum()))
        rule = f"must keep at least {SHORTEST} valid samples"
        value = f"{count} in [{index.start}:{index.stop}] of {len(self)}"
        check(count >= SHORTEST, "record[…]", rule, value)
        return self.part(start, stop)

    def part(self, start: int, stop: int) -> "Record":
        """Samples `start` to `stop`, however few or masked; otherwise as a slice."""
        part = slice(start, stop)
        new = self._changed(None)
        masks = self.valid[part], self.input_valid[part], self.output_valid[part]
        signals = self.inputs[part], self.outputs[part]
        new._set(*signals, masks, self.time[part], self.sample_period)
        gridded = None if self._by_hold is None else self._by_hold[:, part]
        burn_in = max(self.burn_in - start * self.sample_period, 0.0)
        return new._assign({"burn_in": burn_in, "_by_hold": gridded})

    def split(self, fraction: Real) -> tuple["Record", "Record"]:
        """The first `fraction` of the samples, and the remaining ones.

        The second part begins in the middle: known starts of a plant are not its own. A slice
        counts as a record with a beginning.

        Raises:
            ValueError: a fraction outside (0, 1), or a part of fewer than 8 samples.
        """
        check(bool(0 < fraction < 1), "fraction", "must lie in (0, 1)", fraction)
        cut = round(float(fraction) * len(self))
        return self[:cut], self[cut:].continuing()

    def continuing(self) -> "Record":
        """The same samples as those of a record that begins in the middle of a run."""
        return self._changed(None)._assign({"_continues": True})

    def with_outputs(self, outputs: Outputs, name: str, simulated: Mask | None = None) -> "Record":
        """The same instants and inputs with other outputs, as of a simulation.

        Samples that are not finite are masked, with a note and a `RecordWarning`, as in `Record`.

        Args:
            outputs: (N, ny).
            name: of the record.
            simulated: where there are any; None: everywhere.

        Raises:
            ValueError: an output with fewer than 8 finite samples.
        """
        replaced = replaced_outputs(name, self.output_names, outputs, simulated, self.sample_period)
        outputs, measured, notes = replaced
        new = self._changed(None)
        masks = np.asarray(measured.all(axis=1)), self.input_valid, measured
        new._set(self.inputs, outputs, masks, self.time, self.sample_period)
        unmeasured = {"_noise": None, "_quantum": None, "_middle": self._middle, "_periods": None}
        return new._assign({"name": name, "notes": tuple(notes), "smoothed": (), **unmeasured})

    def with_hold(self, hold: HoldArgument) -> "Record":
        """The same samples with a declared hold of the inputs: zero, linear or smooth.

        Args:
            hold: of all inputs, or of each, as in `Record`.

        Raises:
            ValueError: an unknown hold or input, or an input without one.
        """
        hold = read_hold(hold, self.input_names, automatic=False)
        if hold == self.hold and self.hold_declared:
            return self
        new = self._changed(None)
        middle = self._middle if hold == self.hold else None
        notes = tuple(note for note in self.notes if not note.startswith(HOLD_TAKEN))
        made = {"_middle": middle, "_logged_hold": None, "notes": notes}
        if self._by_hold is not None and hold != self.hold:
            gridded: dict[str, Inputs] = dict(zip(HOLDS, self._by_hold, strict=True))
            made["inputs"] = by_hold(hold, self.inputs, lambda word, j: gridded[word][:, j])
        return new._assign({"hold": hold, "hold_declared": True, **made})

    def with_delayed_inputs(self, delays: Any) -> "Record":
        """The same samples with inputs that act later than they were logged.

        Channels of a logger may be a part of a sample period apart. `inputs` stay as they are; what
        acts between the samples is shifted. Where a neighbour is not known the values stay.

        Args:
            delays: of each input, (nu,), negative for earlier [s].

        Raises:
            ValueError: not a finite time for each input.
        """
        steps = np.asarray(delays, dtype=float) / self.sample_period
        rule = f"must hold a time for each of {counted(self.inputs.shape[1], 'input')}"
        check(steps.shape == (self.inputs.shape[1],), "delays", rule, f"shape {steps.shape}")
        check(bool(np.all(np.isfinite(steps))), "delays", "must hold finite times", delays)
        if not np.any(steps):
            return self
        new = self._changed(None)
        return new._assign({"_skew": np.asarray(delays, dtype=float), "_middle": None})

    def unwrapped(self, periods: Mapping[str, Real]) -> "Record":
        """The record with counters and angles that no longer start again at the end of their range.

        Each sample is moved by whole periods to within half a period of the one before. A note says
        so, and whether gaps are so long that the number of turns in them is not known.

        Args:
            periods: ``{channel: period}`` in the channel's unit: 4096 counts, 360 °, 2π rad.

        Raises:
            ValueError: an unknown channel, a period that is not positive or is smaller than the
                channel's range, a record that was interpolated or smoothed.
        """
        read = checked_periods(periods, self.input_names + self.output_names, self._noise)
        masks = self.valid, self.input_valid, self.output_valid
        u, notes = unwrapped_channels(self.inputs, masks[1], self.input_names, read)
        y, more = unwrapped_channels(self.outputs, masks[2], self.output_names, read)
        new = self._changed(" ".join(notes + more))
        new._set(u, y, masks, self.time, self.sample_period)
        return new

    def without_inputs(self, *names: str) -> "Record":
        """The record without some of its inputs.

        Args:
            names: of inputs that no model reads, for example the reference of a controller; none:
                the record with its outputs only.

        Raises:
            ValueError: a name that is none of the record's inputs.
        """
        for name in names:
            check_choice("names", name, self.input_names)
        chosen = np.asarray([bool(names) and name not in names for name in self.input_names], bool)
        labels = tuple(np.asarray(self.input_names)[chosen].tolist())
        words = np.asarray(hold_of_each(self.hold, len(self.input_names)))[chosen].tolist()
        hold = shared(words) if words else None
        new = self.with_inputs(self.inputs[:, chosen], labels, self.skew[chosen], hold)
        gridded = None if self._by_hold is None else self._by_hold[:, :, chosen]
        return new._assign({"_by_hold": gridded})

    def with_inputs(
        self, inputs: Inputs, names: tuple[str, ...], skew: Any = None, hold: Hold | None = None
    ) -> "Record":
        """The same instants and outputs with other inputs, known where the present ones are.

        Args:
            inputs: (N, nu).
            names: of each.
            skew: time by which each acts later than it was logged, (nu,) [s]; None: by none.
            hold: None: that of the record, zero where its inputs have different ones.
        """
        new = self._changed(None)
        u_valid = self.input_valid if len(names) else np.ones(len(self), bool)
        masks = self.valid, u_valid, self.output_valid
        new._set(inputs, self.outputs, masks, self.time, self.sample_period)
        hold = hold or (self.hold if isinstance(self.hold, str) else "zero")
        skew = skew if np.any(skew) else None
        return new._assign({"input_names": names, "_skew": skew, "hold": hold})

    def segments(self) -> list[tuple[int, int]]:
        """Runs (start, stop) of consecutive valid samples."""
        return runs(self.valid)

    def input_segments(self) -> list[tuple[int, int]]:
        """Runs (start, stop) of consecutive samples with known inputs."""
        return runs(self.input_valid)

    @property
    def continues(self) -> bool:
        """Whether it is the second part of a `split`, which begins in the middle of a run."""
        return bool(self._continues)

    @property
    def bridged(self) -> "Record":
        """The record with each output interpolated between its own samples, at its own rate.

        By a cubic spline, where two samples are at most 2.5 of the output's periods apart: late and
        single missing samples, and all samples between those of an output with a rate of its own.
        `output_valid` is True there. Noise, quantum and `output_periods` are those of the samples.
        """
        gaps = (np.diff(np.flatnonzero(column)) for column in self.output_valid.T)
        return self._bridged if any(np.any(gap > 1) for gap in gaps) else self

    @cached_property
    def _bridged(self) -> "Record":
        outputs, valid = between_own_samples(self.outputs, self.output_valid)
        new = self._changed(None)
        masks = self.input_valid & valid.all(axis=1), self.input_valid, valid
        new._set(self.inputs, outputs, masks, self.time, self.sample_period)
        return new._assign({**self._of_the_samples, "_middle": self._middle})

    @property
    def _of_the_samples(self) -> dict[str, Any]:
        """What a record that is interpolated from this one takes over."""
        return {"_noise": self.noise, "_quantum": self.quantum, "_periods": self.output_periods}

    @property
    def _is_slow(self) -> bool:
        """Whether an output has a rate of its own, and lies as measured."""
        return any(is_slow(column) for column in self.output_valid.T)

    # -- between the samples --------------------------------------------------------------

    def resample(self, substeps: int, course: Callable | None = None) -> "Record":
        """The record with each step divided into `substeps` steps.

        Outputs are interpolated by a quintic spline through each valid segment, inputs by their
        hold. A new sample is valid if the samples around it are. The original samples keep their
        values. Outputs with a rate of their own are bridged before.

        Args:
            substeps: in place of each step.
            course: function of the new record that gives its outputs, (S, ny), in place of splines.

        Raises:
            ValueError: `substeps` is no integer ≥ 1.
        """
        is_count = isinstance(substeps, int | np.integer) and substeps >= 1
        check(bool(is_count), "substeps", "must be an integer ≥ 1", substeps)
        if substeps == 1 and self._skew is None:
            return self
        if self._is_slow:
            return self.bridged.resample(substeps, course)
        count = (len(self) - 1) * substeps + 1
        position, query = np.arange(len(self), dtype=float), np.arange(count) / substeps
        outputs, valid = np.empty((count, self.outputs.shape[1])), []
        for columns, mask in channel_groups(self.output_valid):
            segments = runs(mask)
            outputs[:, columns] = sub_stepped(self.outputs[:, columns], segments, substeps)
            valid += [covered(position, segments, query)] * outputs[:, columns].shape[1]
        # A single spline for sub-steps and midpoints: a second one would only take longer.
        inputs, middle = self._between(substeps)
        u_valid = covered(position, self.input_segments(), query)
        sample_period = self.sample_period / substeps
        new = self._changed(
            f"Sub-stepped by {substeps}: outputs by a quintic spline, inputs by "
            f"their hold ({hold_text(self.hold, self.input_names)})."
        )
        time = self.time[0] + sample_period * np.arange(count)
        masks = covered(position, self.segments(), query), u_valid, np.stack(valid, axis=1)
        new._set(inputs, outputs, masks, time, sample_period)
        new._assign({**self._of_the_samples, "_middle": middle, "_skew": None})
        return new if course is None else new._assign({"outputs": course(new)})

    def _between(
        self, substeps: int
    ) -> tuple[Float[np.ndarray, "points nu"], Float[np.ndarray, "steps nu"]]:
        """Inputs at the points of a finer grid, and in the middle of its steps."""
        delays = None if self._skew is None else self._skew / self.sample_period
        return acting_inputs(self.inputs, self.input_segments(), delays, substeps, self.hold)

    def smooth(self, cutoff: Real, inputs: Sequence[str] | None = None) -> "Record":
        """The record filtered by a zero-phase low-pass, the same for inputs and outputs.

        A filter composed of shifts by whole samples commutes with any linear plant, so the filtered
        signals are related as the raw ones are, if the filtered input is interpreted as the raw
        one is. A held input is a staircase and lags its samples by half a step on average:
        its filtered levels are converted to samples of the signal that acts on the plant
        (`staircase_to_smooth`). The result's hold is ``"smooth"``, and there is no half-sample
        shift between u and y.

        The filter is a Butterworth filter of order four, run forward and backward through each
        valid segment of each channel; within about 2/cutoff of the ends of a segment it uses an
        extrapolation of the data. Outputs with a rate of their own are bridged before.

        Args:
            cutoff: cut-off frequency, at which the amplitude is one half [rad/s].
            inputs: names of those that are filtered; None: all. Leave out those in which the plant
                is not affine: the square of a filtered input is not the filtered square.

        Raises:
            ValueError: `cutoff` is not between 0 and the Nyquist frequency π / sample_period, or a
                name that is none of the record's inputs.
        """
        nyquist = np.pi / self.sample_period
        rule = f"must lie in (0, {nyquist:g}) rad/s, below the Nyquist frequency"
        check(bool(0 < cutoff < nyquist), "cutoff", rule, cutoff)
        if self._is_slow:
            return self.bridged.smooth(cutoff, inputs)
        for name in () if inputs is None else inputs:
            check_choice("inputs", name, self.input_names)
        filtered = [inputs is None or name in inputs for name in self.input_names]
        share, measured = float(cutoff) / nyquist, self.output_valid
        is_held = np.array(self.holds) == "zero"
        smooth_inputs = smoothed_inputs(self.inputs, self.input_valid, filtered, is_held, share)
        outputs = smoothed_outputs(self.outputs, measured, share)
        holds = [
            "smooth" if smooth else hold for smooth, hold in zip(filtered, self.holds, strict=True)
        ]
        note = smoothing_note(None if all(filtered) else inputs, float(cutoff))
        note += NO_LONGER_HELD * (holds.count("zero") < self.holds.count("zero"))
        new = self._changed(f"{note}.")
        masks = self.valid, self.input_valid, measured
        new._set(smooth_inputs, outputs, masks, self.time, self.sample_period)
        cutoffs, logged = (*self.smoothed, float(cutoff)), self.logged_hold
        made = {"hold": shared(holds), "_logged_hold": logged, "smoothed": cutoffs}
        new._assign({**self._of_the_samples, **made})
        noise = self.noise / self.noise_left * new.noise_left
        return new._assign({"_noise": noise, "_quantum": np.zeros_like(noise)})

    def midpoint_inputs(self) -> Float[np.ndarray, "steps nu"]:
        """The inputs in the middle of each of the N − 1 steps, by their hold."""
        return self._between(1)[1] if self._middle is None else self._middle

    # -- properties -----------------------------------------------------------------------

    @property
    def input_valid(self) -> Mask:
        """Where all inputs are known, (N,); everywhere without inputs."""
        if self._input_valid is None:
            return self.valid if self.inputs.shape[1] else np.ones(len(self), dtype=bool)
        return self._input_valid

    @property
    def logged_hold(self) -> Hold:
        """The hold of the inputs as they were logged: what `smooth` makes is smooth."""
        return self.hold if self._logged_hold is None else self._logged_hold

    @property
    def holds(self) -> tuple[str, ...]:
        """The hold of each input, (nu,): zero, linear or smooth."""
        return hold_of_each(self.hold, self.inputs.shape[1])

    @property
    def skew(self) -> Float[np.ndarray, " nu"]:
        """Time by which each input acts later than it was logged, (nu,) [s]."""
        return np.zeros(self.inputs.shape[1]) if self._skew is None else self._skew

    @property
    def output_valid(self) -> OutputMask:
        """Where each output was measured, (N, ny)."""
        if self._output_valid is None:
            return np.repeat(self.valid[:, None], self.outputs.shape[1], axis=1)
        return self._output_valid

    @property
    def known_outputs(self) -> Outputs:
        """Outputs, NaN where they were not measured (of a free run, not simulated), (N, ny)."""
        return np.where(self.output_valid, self.outputs, np.nan)

    @property
    def output_periods(self) -> Float[np.ndarray, " ny"]:
        """Mean time between two samples of each output, without the gaps in it [s].

        For a bridged, sub-stepped or smoothed record it is that of the measured samples.
        """
        if self._periods is not None:
            return self._periods
        positions = (np.flatnonzero(column).astype(float) for column in self.output_valid.T)
        return self.sample_period * np.asarray([own_period(position) for position in positions])

    @property
    def noise(self) -> Float[np.ndarray, " ny"]:
        """Standard deviation of the white measurement noise of each output, from its differences.

        Where the motion is fast beside the sampling it is an upper bound: free runs of a model show
        a smaller one (`simulation/sensor_noise.py`), which is what `discover` judges by.

        It includes quantisation. The differences do not show the quantisation of a signal that is
        constant between coarse steps, so the noise is at least quantum/√12. For an interpolated or
        sub-stepped record it is the noise of the measured samples; for a smoothed record, the part
        of it that the filter passes.

        Source: `data/noise.py`.
        """
        return self._estimated_noise if self._noise is None else self._noise

    @property
    def noise_left(self) -> Float[np.ndarray, " ny"]:
        """Share of the standard deviation of white noise that smoothing passes; 1 without any.

        Of an output with a rate of its own: samples that are further apart have as much noise in a
        narrower band.
        """
        nyquist = np.pi / self.sample_period
        share = low_pass_noise(*(cutoff / nyquist for cutoff in self.smoothed))
        return np.minimum(share * np.sqrt(self.output_periods / self.sample_period), 1.0)

    @property
    def quantum(self) -> Float[np.ndarray, " ny"]:
        """Step of the values of each output; 0 if they are not multiples of one step.

        For a sub-stepped record it is that of the measured samples; after smoothing it is 0.
        """
        return self._estimated_quantum if self._quantum is None else self._quantum

    @cached_property
    def _estimated_noise(self) -> Float[np.ndarray, " ny"]:
        steps = self.quantum / np.sqrt(12.0)
        noise = np.zeros(self.outputs.shape[1])
        for columns, mask in channel_groups(self.output_valid):
            noise[columns] = own_noise(self.outputs[:, columns], mask)
        return np.maximum(noise, steps)

    @cached_property
    def _estimated_quantum(self) -> Float[np.ndarray, " ny"]:
        return quanta(self.outputs, self.output_valid)

    @property
    def data_hash(self) -> str:
        """Sixteen hexadecimal digits that change with any value of time, inputs, outputs, masks."""
        arrays = [self.time, self.inputs, self.outputs, self.valid]
        # Masks of single channels only where they say more: hashes of one mask for all stay.
        known_alone = runs(self.input_valid & ~self.valid)
        said = any(stop - start > LONGEST_HELD for start, stop in known_alone)
        if self._output_valid is not None or (said and self.inputs.shape[1]):
            arrays += [self.input_valid, self.output_valid]
        return digest("", arrays)

    @property
    def content_hash(self) -> str:
        """Sixteen hexadecimal digits that change with anything that an estimate depends on.

        That is the data of `data_hash`, the hold, the burn-in, and the noise, the quantum and the
        midpoint inputs that are taken from an earlier record.
        """
        settings = f"{self.data_hash} {self.sample_period!r} {self.hold} {self.burn_in!r}"
        arrays = [self._noise, self._quantum, self._middle]
        arrays += [] if self._skew is None else [self._skew]
        if self._is_slow or np.any(self.output_periods > self.sample_period):
            arrays.append(self.output_periods)
        return digest(settings, arrays)

    # -- construction ---------------------------------------------------------------------

    def _changed(self, note: str | None) -> "Record":
        """A shallow copy with an additional note."""
        new = copy.copy(self)
        new.__dict__.pop("_bridged", None)
        return new._assign({"notes": (*self.notes, note) if note else self.notes})

    def _set(
        self,
        inputs: Inputs,
        outputs: Outputs,
        masks: tuple[Mask, Mask, OutputMask],
        time: TimeAxis,
        sample_period: float,
    ) -> None:
        """Set signals and masks: `valid`, `input_valid`, `output_valid`."""
        valid, u_valid, measured = masks
        shared = bool(np.all(measured == valid[:, None]))
        arrays = {
            "inputs": inputs,
            "outputs": outputs,
            "valid": valid,
            "time": time,
            "_by_hold": self._by_hold if inputs is self.__dict__.get("inputs") else None,
            "_input_valid": u_valid if inputs.shape[1] and np.any(u_valid != valid) else None,
            "_output_valid": None if shared else measured,
        }
        for array in arrays.values():
            if array is not None:
                array.setflags(write=False)  # kernels and results share them
        self._assign({**arrays, "sample_period": float(sample_period), "_middle": None})
        for name in ("_estimated_noise", "_estimated_quantum"):  # of the samples of the original
            self.__dict__.pop(name, None)

    def _assign(self, values: dict[str, Any]) -> "Record":
        """The record, with fields set while it is constructed: it is frozen."""
        for key, value in values.items():
            object.__setattr__(self, key, value)
        return self
