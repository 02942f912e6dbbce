"""The record: what was measured, on a uniform time grid, with everything done to it written down.

A record is plain NumPy on the host; kernels take their arrays from it.
"""

import copy
import hashlib
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float

from eoi_jax._checks import RecordWarning, check, check_choice, check_positive
from eoi_jax._display import Result
from eoi_jax._types import Mask, TimeAxis
from eoi_jax.data.cleaning import (
    SHORTEST,
    Inputs,
    Names,
    Outputs,
    channel_names,
    check_labels,
    check_lengths,
    choose_hold,
    drop_repeats,
    finite_rows,
    interpolate,
    interpolated_noise,
    place,
    read_signals,
    read_stamps,
)
from eoi_jax.data.noise import white_noise
from eoi_jax.data.resampling import (
    HOLDS,
    Real,
    covered,
    fill,
    low_pass,
    low_pass_noise,
    runs,
    staircase_to_smooth,
    sub_stepped,
    sub_stepped_inputs,
    uniform_grid,
)


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Record(Result):
    """One measured or simulated run (t, u, y) on a uniform time grid.

    `plot` shows outputs and inputs over time, masked samples left out.

    What comes in is checked and brought onto the grid. Stamps within 1e-3 of a period of a
    uniform clock, or as near to it as their printed digits tell, are taken as they are; otherwise
    outputs are resampled by a cubic spline, inputs by their hold (held ones enter each step by
    their mean over it). Missing samples, gaps, NaN and infinities are masked: `valid` is False
    there, and the values are linear interpolations that keep arithmetic finite. Repeated stamps
    with equal values are dropped. Each of these is said by a `RecordWarning` and kept in `notes`.

    Args:
        time: stamps (N,) [s], increasing; datetimes count in seconds from the first.
        inputs: (N,) or (N, nu); ``np.zeros((N, 0))`` for a system without input.
        outputs: (N,) or (N, ny).
        name: what to call it.
        input_names: default: the column names of a pandas object, else ``u`` or ``u1, u2, …``.
        output_names: the same with ``y``.
        units: ``{name: unit}``, for tables and figures.
        hold: the input between two samples: ``"zero"`` (a converter held it), ``"linear"``,
            ``"smooth"`` (band-limited, a quintic spline through the samples) or ``"auto"``:
            zero if at most 20 % of the steps change each input, else linear.
        burn_in: time at the start that is not to be scored [s].

    Attributes:
        time: (N,) [s]. inputs: (N, nu). outputs: (N, ny). All read-only.
        valid: (N,), False where a sample is missing or not finite in any channel.
        sample_period: step of `time` [s].
        notes: sentences on what was done to the record, in order.
        smoothed: cut-offs of the zero-phase low-passes that it went through [rad/s].

    Raises:
        ValueError: wrong shapes, unequal lengths, values that are no numbers, a channel without a
            finite value, fewer than 8 (valid) samples, time that is not finite, decreases or
            repeats a stamp with other values, an unknown hold, a negative burn-in.
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
    hold: str
    burn_in: float
    notes: tuple[str, ...]
    smoothed: tuple[float, ...]
    _noise: Float[np.ndarray, " ny"] | None  # known from the samples this one was made from
    _quantum: Float[np.ndarray, " ny"] | None
    _middle: (
        Float[np.ndarray, "between nu"] | None
    )  # halfway between the samples, if it is known from a coarser record

    @np.errstate(over="ignore", invalid="ignore")  # of samples that are masked
    def __init__(
        self,
        time: Any,
        inputs: Any,
        outputs: Any,
        name: str = "record",
        *,
        input_names: Names = None,
        output_names: Names = None,
        units: Mapping[str, str] | None = None,
        hold: str = "auto",
        burn_in: Real = 0.0,
    ):
        check_choice("hold", hold, ("auto", *HOLDS))
        check(bool(0 <= burn_in < np.inf), "burn_in", "must be a time ≥ 0 in seconds", burn_in)
        stamps = read_stamps(time)
        u, y = read_signals("inputs", inputs), read_signals("outputs", outputs)
        check_lengths(stamps, u, y)
        u_names = channel_names("input_names", input_names, inputs, u.shape[1], "u")
        y_names = channel_names("output_names", output_names, outputs, y.shape[1], "y")
        check_labels(u_names, y_names, dict(units or {}))
        notes: list[str] = []  # what is warned about; the choice of a hold is only noted
        stamps, u, y = drop_repeats(stamps, u, y, notes)
        good = finite_rows((*u_names, *y_names), np.hstack([u, y]), notes)
        hold, why = choose_hold(u[good], hold)
        grid = uniform_grid(stamps)
        noise = quanta = None
        if grid.index is None:
            arrays = interpolate(grid, stamps, u, y, good, hold, notes)
            # Interpolation hides both the noise and the steps of the raw values.
            quanta = _quanta(y[good])
            noise = interpolated_noise(grid, stamps, arrays[1], good, arrays[2], quanta)
        else:
            arrays = place(grid, grid.index, u, y, good, notes)
        count = int(arrays[2].sum())
        check(count >= SHORTEST, "outputs", f"must have at least {SHORTEST} valid samples", count)
        for note in notes:
            warnings.warn(f"Record `{name}`: {note}", RecordWarning, stacklevel=2)
        if grid.resolution:
            why.append(
                f"Time is written in steps of {grid.resolution:g} s; the deviation from a "
                "uniform clock is no more than that rounding."
            )
        self._set(*arrays, grid.time, grid.sample_period)
        labels = {
            "name": name,
            "input_names": u_names,
            "output_names": y_names,
            "units": dict(units or {}),
            "hold": hold,
            "burn_in": float(burn_in),
            "notes": (*notes, *why),
            "smoothed": (),
            "_noise": noise,
            "_quantum": quanta,
        }
        self._assign(labels)

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
        hold: str = "auto",
        burn_in: Real = 0.0,
    ) -> "Record":
        """A record whose samples are `sample_period` [s] apart, the first one at time 0.

        Other arguments and errors as for `Record`.
        """
        check_positive("sample_period", sample_period, "It is the time between samples in seconds.")
        time = float(sample_period) * np.arange(read_signals("outputs", outputs).shape[0])
        return cls(
            time,
            inputs,
            outputs,
            name,
            input_names=input_names,
            units=units,
            hold=hold,
            output_names=output_names,
            burn_in=burn_in,
        )

    # -- parts of it ----------------------------------------------------------------------

    def __len__(self) -> int:
        return self.time.size

    def __getitem__(self, index: Any) -> "Record":
        """``record[1000:5000]``: those samples; names, units, hold and absolute time stay.

        What is left of the burn-in stays too.

        Raises:
            ValueError: an index that is no slice, a step, fewer than 8 (valid) samples.
        """
        check(
            isinstance(index, slice),
            "record[…]",
            "must be sliced",
            repr(index),
            "Write record[1000:5000].",
        )
        check(
            index.step in (None, 1),
            "record[…]",
            "must be sliced without a step",
            index.step,
            "Filter with `smooth` before leaving samples out.",
        )
        start, stop, _ = index.indices(len(self))
        part = slice(start, stop)
        shown = f"{int(self.valid[part].sum())} in [{index.start}:{index.stop}] of {len(self)}"
        enough = int(self.valid[part].sum()) >= SHORTEST
        check(enough, "record[…]", f"must keep at least {SHORTEST} valid samples", shown)
        new = self._changed(None)
        new._set(
            self.inputs[part],
            self.outputs[part],
            self.valid[part],
            self.time[part],
            self.sample_period,
        )
        left = max(self.burn_in - start * self.sample_period, 0.0)
        new._assign({"burn_in": left})
        return new

    def split(self, fraction: Real) -> tuple["Record", "Record"]:
        """The first `fraction` of the samples, and the rest.

        Raises:
            ValueError: a fraction outside (0, 1), or a part of fewer than 8 samples.
        """
        check(bool(0 < fraction < 1), "fraction", "must lie in (0, 1)", fraction)
        cut = round(float(fraction) * len(self))
        return self[:cut], self[cut:]

    def with_outputs(self, outputs: Outputs, name: str) -> "Record":
        """The same instants and inputs with other outputs, all valid: those of a simulation."""
        new = self._changed(None)
        new._set(self.inputs, outputs, np.ones(len(self), bool), self.time, self.sample_period)
        known = {"_noise": None, "_quantum": None, "_middle": self._middle}
        new._assign({"name": name, "notes": (), "smoothed": (), **known})
        return new

    def without_inputs(self) -> "Record":
        """The outputs alone."""
        new = self._changed(None)
        none = np.zeros((len(self), 0))
        new._set(none, self.outputs, self.valid, self.time, self.sample_period)
        new._assign({"input_names": ()})
        return new

    def segments(self) -> list[tuple[int, int]]:
        """Runs (start, stop) of consecutive valid samples."""
        return runs(self.valid)

    # -- between the samples --------------------------------------------------------------

    def resample(self, substeps: int) -> "Record":
        """The record with `substeps` steps in place of each one.

        Outputs by a quintic spline through each valid segment, inputs by their hold. A new sample
        is valid if the samples around it are. The original samples keep their values.

        Raises:
            ValueError: `substeps` is no integer ≥ 1.
        """
        whole = isinstance(substeps, int | np.integer) and substeps >= 1
        check(bool(whole), "substeps", "must be an integer ≥ 1", substeps)
        if substeps == 1:
            return self
        count = (len(self) - 1) * int(substeps) + 1
        position, segments = np.arange(len(self), dtype=float), self.segments()
        query = np.arange(count) / int(substeps)
        outputs = sub_stepped(self.outputs, segments, int(substeps))
        # One spline for both: a second one, through the sub-steps, would only cost more.
        inputs = sub_stepped_inputs(self.inputs, segments, 2 * int(substeps), self.hold)
        valid = covered(position, segments, query)
        sample_period = self.sample_period / int(substeps)
        new = self._changed(
            f"Sub-stepped by {substeps}: outputs by a quintic spline, inputs by "
            f"their hold ({self.hold})."
        )
        time = self.time[0] + sample_period * np.arange(count)
        new._set(inputs[::2], outputs, valid, time, sample_period)
        known = {"_noise": self.noise, "_quantum": self.quantum, "_middle": inputs[1::2]}
        new._assign(known)
        return new

    def smooth(self, cutoff: Real) -> "Record":
        """The record through one zero-phase low-pass, the same for inputs and outputs.

        A filter made of shifts by whole samples commutes with any linear plant, so the relation
        between the filtered signals is that between the raw ones, if the filtered input is read as
        the raw one was. A held input is a staircase and lags its samples by half a step on
        average: its filtered levels are turned into samples of the signal that the plant sees
        (`staircase_to_smooth`). The result's hold is ``"smooth"``, and no half-sample shift enters
        between u and y.

        The filter is Butterworth of order four, run forward and backward through each valid
        segment; within about 2/cutoff of a segment's ends it sees an extension, not data.

        Args:
            cutoff: [rad/s]; there the amplitude falls to one half.

        Raises:
            ValueError: `cutoff` is not between 0 and the Nyquist frequency π / sample_period.
        """
        nyquist = np.pi / self.sample_period
        check(
            bool(0 < cutoff < nyquist),
            "cutoff",
            f"must lie in (0, {nyquist:g}) rad/s, below the Nyquist frequency",
            cutoff,
        )
        inputs, outputs = np.array(self.inputs), np.array(self.outputs)
        share = float(cutoff) / nyquist
        for start, stop in self.segments():
            u = low_pass(inputs[start:stop], share)
            inputs[start:stop] = staircase_to_smooth(u) if self.hold == "zero" else u
            outputs[start:stop] = low_pass(outputs[start:stop], share)
        position = np.arange(len(self), dtype=float)
        known = self.valid[:, None]
        inputs = fill(position, np.where(known, inputs, np.nan), position)
        outputs = fill(position, np.where(known, outputs, np.nan), position)
        new = self._changed(
            f"Inputs and outputs smoothed by the same zero-phase low-pass, {float(cutoff):g} rad/s."
        )
        new._set(inputs, outputs, self.valid, self.time, self.sample_period)
        new._assign({"hold": "smooth", "smoothed": (*self.smoothed, float(cutoff))})
        left = self.noise / self.noise_left * new.noise_left
        new._assign({"_noise": left, "_quantum": np.zeros_like(left)})
        return new

    def midpoint_inputs(self) -> Float[np.ndarray, "steps nu"]:
        """The inputs in the middle of each of the N − 1 steps, by their hold."""
        if self._middle is not None:
            return self._middle
        return sub_stepped_inputs(self.inputs, self.segments(), 2, self.hold)[1::2]

    # -- what it shows --------------------------------------------------------------------

    @property
    def noise(self) -> Float[np.ndarray, " ny"]:
        """Standard deviation of the white measurement noise of each output, from its differences.

        Quantisation finer than the noise is part of it; a signal that stands still between coarse
        steps hides it from the differences, so the noise is at least that of its steps,
        quantum/√12. Of an interpolated or sub-stepped record it is the noise of the samples that
        were measured, of a smoothed one what the filter leaves of that.

        Source: `data/noise.py`.
        """
        return self._own_noise if self._noise is None else self._noise

    @property
    def noise_left(self) -> float:
        """Share of the standard deviation of white noise that smoothing left, 1 without any."""
        nyquist = np.pi / self.sample_period
        return low_pass_noise(*(cutoff / nyquist for cutoff in self.smoothed))

    @property
    def quantum(self) -> Float[np.ndarray, " ny"]:
        """Step of the values of each output; 0 if they are not multiples of one step.

        Of a sub-stepped record it is that of its samples; smoothing removes it.
        """
        return self._own_quantum if self._quantum is None else self._quantum

    @cached_property
    def _own_noise(self) -> Float[np.ndarray, " ny"]:
        steps = self.quantum / np.sqrt(12.0)
        return np.maximum(white_noise(self.outputs, self.segments()), steps)

    @cached_property
    def _own_quantum(self) -> Float[np.ndarray, " ny"]:
        return _quanta(self.outputs[self.valid])

    @property
    def data_hash(self) -> str:
        """Sixteen hexadecimal digits that change with any value of time, inputs, outputs, valid."""
        return _digest("", (self.time, self.inputs, self.outputs, self.valid))

    @property
    def content_hash(self) -> str:
        """The same of all that an estimate reads: the values, and what is to be made of them.

        That is the hold, the burn-in, and what is known from the samples that this record was made
        from: their noise and step, and the inputs between them.
        """
        about = f"{self.data_hash} {self.sample_period!r} {self.hold} {self.burn_in!r}"
        return _digest(about, (self._noise, self._quantum, self._middle))

    def __repr__(self) -> str:
        return _table(self)

    # -- construction ---------------------------------------------------------------------

    def _changed(self, note: str | None) -> "Record":
        """A shallow copy with one more note."""
        new = copy.copy(self)
        new._assign({"notes": (*self.notes, note) if note else self.notes})
        return new

    def _set(
        self, inputs: Inputs, outputs: Outputs, valid: Mask, time: TimeAxis, sample_period: float
    ) -> None:
        arrays = {"inputs": inputs, "outputs": outputs, "valid": valid, "time": time}
        for array in arrays.values():
            array.setflags(write=False)  # kernels and results share them
        self._assign({**arrays, "sample_period": float(sample_period), "_middle": None})
        for name in ("_own_noise", "_own_quantum"):  # of other samples, if this is a copy
            self.__dict__.pop(name, None)

    def _assign(self, values: dict[str, Any]) -> None:
        """The one way around `frozen`, for records that are still being made."""
        for key, value in values.items():
            object.__setattr__(self, key, value)


def _digest(about: str, arrays: Iterable[np.ndarray | None]) -> str:
    digest = hashlib.sha256(about.encode())
    for array in arrays:
        digest.update(str(np.shape(array)).encode() if array is not None else b"none")
        digest.update(b"" if array is None else np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:16]


def _quanta(y: Outputs) -> Float[np.ndarray, " ny"]:
    return np.asarray([_quantum(channel) for channel in y.T])


def _quantum(values: TimeAxis) -> float:
    levels = np.unique(values)
    steps = np.diff(levels)
    # Rounding makes twins of one level: they are no step.
    steps = steps[steps > 1e-9 * np.max(np.abs(levels), initial=0.0)]
    if not steps.size:
        return 0.0
    ratio = steps / steps.min()
    return float(steps.min()) if np.all(np.abs(ratio - np.rint(ratio)) < 0.05) else 0.0


def _label(record: Record, key: str) -> str:
    unit = record.units.get(key)
    return f"{key} [{unit}]" if unit else key


def _table(record: Record) -> str:
    h = record.sample_period
    size = f"{len(record)} samples, {len(record) * h:.4g} s, every {h:.6g} s ({1 / h:.5g} Hz)"
    lines = [f"Record `{record.name}`: {size}"]
    rows = [("", "channel", "min", "max", "rms", "noise", "quantum")]
    known = record.valid
    for key, channel in zip(record.input_names, record.inputs[known].T, strict=True):
        rows.append(("input", _label(record, key), *_spread(channel), "", ""))
    for i, (noise, quantum) in enumerate(zip(record.noise, record.quantum, strict=True)):
        key, channel = record.output_names[i], record.outputs[known, i]
        shown = (f"{noise:.2g}", f"{quantum:.3g}" if quantum else "–")
        rows.append(("output", _label(record, key), *_spread(channel), *shown))
    widths = [max(len(row[j]) for row in rows) for j in range(len(rows[0]))]
    for row in rows:
        left = f"  {row[0]:{widths[0]}}  {row[1]:{widths[1]}}"
        right = "".join(f"  {cell:>{w}}" for cell, w in zip(row[2:], widths[2:], strict=True))
        lines.append((left + right).rstrip())
    facts = [f"hold {record.hold}", f"{100 * known.mean():.4g} % valid"]
    if record.burn_in:
        facts.append(f"burn-in {record.burn_in:g} s")
    lines.append("  " + ", ".join(facts))
    return "\n".join([*lines, *(f"  - {note}" for note in record.notes)])


def _spread(channel: TimeAxis) -> tuple[str, str, str]:
    rms = float(np.sqrt(np.mean(channel**2)))
    return f"{channel.min():.4g}", f"{channel.max():.4g}", f"{rms:.4g}"
