"""Records from and to the objects of other packages: pandas, xarray, nonlinear_benchmarks.

Objects are read by their attributes, so none of the packages is imported for reading.
"""

import difflib
from collections.abc import Sequence
from typing import Any

import numpy as np

from eoi_jax._checks import check
from eoi_jax.data.input_holds import HoldArgument
from eoi_jax.data.record import Record
from eoi_jax.data.resampling import Real

Columns = str | Sequence[str]


def record_from_pandas(
    frame: Any,
    inputs: Columns = (),
    outputs: Columns = (),
    time: str | None = None,
    *,
    sample_period: Real | None = None,
    name: str = "record",
    hold: HoldArgument = "auto",
    burn_in: Real = 0.0,
) -> Record:
    """A record from columns of a data frame.

    Args:
        frame: a `pandas.DataFrame`, or any other with columns by name.
        inputs: columns of the inputs; none for a free system.
        outputs: columns of the outputs.
        time: column of the stamps [s], or of dates; default: the index, unless it only counts
            rows and `sample_period` is given.
        sample_period: time between rows [s], where there are no stamps.
        name: of the record.
        hold: of the inputs, as in `Record`.
        burn_in: not scored at the start [s].

    Returns:
        The record; its units are `frame.attrs["units"]`, if present.

    Raises:
        ValueError: an unknown column, no outputs, stamps and a sample period or neither; and
            the errors of `Record`.

    Source: pandas.DataFrame, https://pandas.pydata.org/docs/reference/frame.html
    """
    u_names, y_names = _names(inputs), _names(outputs)
    check(len(y_names) > 0, "outputs", "must name at least one column", "none",
          f"Columns present: {', '.join(map(str, list(frame.columns)[:30]))}.")  # fmt: skip
    for field, names in (("inputs", u_names), ("outputs", y_names), ("time", _names(time or ()))):
        for key in names:
            _check_present(field, key, [str(column) for column in frame.columns])
    counting = type(frame.index).__name__ == "RangeIndex"
    stamped = time is not None or not counting
    check(
        stamped != (sample_period is not None),
        "time, sample_period",
        "must not be both given or both omitted, where the index counts rows",
        f"time={time}, sample_period={sample_period}, an index of {type(frame.index).__name__}",
    )
    values = frame[time] if time is not None else frame.index
    stamps = np.asarray(values) if stamped else float(sample_period or 0.0) * np.arange(len(frame))
    units = dict(getattr(frame, "attrs", {}).get("units", {}))
    used_units = {key: unit for key, unit in units.items() if key in (*u_names, *y_names, "time")}
    return Record(
        stamps,
        _matrix(frame, u_names),
        _matrix(frame, y_names),
        name,
        input_names=u_names,
        output_names=y_names,
        units=used_units,
        hold=hold,
        burn_in=burn_in,
    )


def record_to_pandas(record: Record) -> Any:
    """A data frame of a record: inputs and outputs by name over time [s]; NaN where not measured.

    Args:
        record: any.

    Returns:
        A `pandas.DataFrame`, indexed by ``time``; units, name and hold in its `attrs`.

    Source: pandas.DataFrame, https://pandas.pydata.org/docs/reference/frame.html
    """
    import pandas as pd

    inputs = np.where(record.input_valid[:, None], record.inputs, np.nan)
    values = np.hstack([inputs, record.known_outputs])
    columns = [*record.input_names, *record.output_names]
    frame = pd.DataFrame(values, index=pd.Index(record.time, name="time"), columns=columns)
    frame.attrs = {"units": dict(record.units), "name": record.name, "hold": record.hold}
    return frame


def record_from_xarray(
    dataset: Any,
    inputs: Columns = (),
    outputs: Columns = (),
    time: str = "time",
    *,
    name: str = "record",
    hold: HoldArgument = "auto",
    burn_in: Real = 0.0,
) -> Record:
    """A record from variables of an xarray dataset.

    A variable with a second dimension gives a channel for each label of that dimension.

    Args:
        dataset: an `xarray.Dataset`.
        inputs: variables of the inputs; none for a free system.
        outputs: variables of the outputs.
        time: the coordinate of the stamps [s], or of dates.
        name: of the record.
        hold: of the inputs, as in `Record`.
        burn_in: not scored at the start [s].

    Returns:
        The record; `attrs["units"]` of each variable is its unit.

    Raises:
        ValueError: an unknown variable or coordinate, a variable that is not over `time`; and
            the errors of `Record`.

    Source: xarray.Dataset, https://docs.xarray.dev/en/stable/generated/xarray.Dataset.html
    """
    _check_present("time", time, [str(label) for label in dataset.coords])
    check(len(_names(outputs)) > 0, "outputs", "must name at least one variable", "none",
          f"Variables present: {', '.join(map(str, dataset.data_vars))}.")  # fmt: skip
    channels: dict[str, list[tuple[str, np.ndarray]]] = {"inputs": [], "outputs": []}
    units = {}
    for field, names in (("inputs", _names(inputs)), ("outputs", _names(outputs))):
        for key in names:
            _check_present(field, key, [str(label) for label in dataset.data_vars])
            variable = dataset[key]
            check(time in variable.dims and variable.ndim <= 2, field,
                  f"must be a variable over `{time}` and at most one other dimension",
                  f"`{key}` over {', '.join(map(str, variable.dims))}")  # fmt: skip
            parts = _channels(key, variable, time)
            channels[field] += parts
            unit = variable.attrs.get("units")
            units |= {label: str(unit) for label, _ in parts} if unit else {}
    u_parts, y_parts = channels["inputs"], channels["outputs"]
    stamps = np.asarray(dataset[time].values)
    count = len(stamps)
    return Record(
        stamps,
        _stacked([values for _, values in u_parts], count),
        _stacked([values for _, values in y_parts], count),
        name,
        input_names=[label for label, _ in u_parts],
        output_names=[label for label, _ in y_parts],
        units=units,
        hold=hold,
        burn_in=burn_in,
    )


def record_to_xarray(record: Record) -> Any:
    """A dataset of a record: a variable for each channel over ``time`` [s], NaN where not measured.

    Args:
        record: any.

    Returns:
        An `xarray.Dataset`; the role of each variable is in its `attrs["role"]`, its unit in its
        `attrs["units"]`; name, hold (a list where inputs differ) and sample period [s] are in the
        attributes of the dataset.

    Source: xarray.Dataset, https://docs.xarray.dev/en/stable/generated/xarray.Dataset.html
    """
    import xarray as xr

    variables = {}
    for role, names, values in (
        ("input", record.input_names, np.where(record.input_valid[:, None], record.inputs, np.nan)),
        ("output", record.output_names, record.known_outputs),
    ):
        for key, column in zip(names, values.T, strict=True):
            attributes = {"role": role, "units": record.units.get(key, "")}
            variables[key] = ("time", column, attributes)
    hold = record.hold if isinstance(record.hold, str) else list(record.hold)
    attributes = {"name": record.name, "hold": hold, "sample_period": record.sample_period}
    time = ("time", record.time, {"units": "s"})
    return xr.Dataset(variables, coords={"time": time}, attrs=attributes)


def record_from_benchmark(
    data: Any,
    *,
    input_names: Columns | None = None,
    output_names: Columns | None = None,
    hold: HoldArgument = "auto",
) -> Record:
    """A record from an object of the package nonlinear_benchmarks, its `Input_output_data`.

    Its `state_initialization_window_length`, the number of samples that a benchmark does not
    score, becomes the record's burn-in.

    Args:
        data: has `u`, `y`, `sampling_time` and `name`.
        input_names: of the channels; default ``u`` or ``u1, u2, …``.
        output_names: the same with ``y``.
        hold: of the inputs, as in `Record`.

    Returns:
        The record, from time 0.

    Raises:
        ValueError: an object without these, or without a sample period in seconds; and the errors
            of `Record`.

    Source: M. Schoukens and others, https://github.com/GerbenBeintema/nonlinear_benchmarks
    """
    complete = all(hasattr(data, key) for key in ("u", "y", "sampling_time"))
    advice = "A benchmark's loader gives (train, test): pass one of them, or one of their parts."
    check(complete, "data", "must have u, y and sampling_time", f"a {type(data).__name__}", advice)
    period = np.ravel(np.asarray(data.sampling_time))
    real = period.dtype.kind in "iuf" and period.size == 1
    check(real, "data.sampling_time", "must be a number of seconds", data.sampling_time,
          "Use Record.from_period.")  # fmt: skip
    unscored = getattr(data, "state_initialization_window_length", None) or 0
    return Record.from_period(
        float(period[0]),
        np.asarray(data.u),
        np.asarray(data.y),
        str(getattr(data, "name", "") or "benchmark"),
        input_names=input_names,
        output_names=output_names,
        hold=hold,
        burn_in=float(unscored) * float(period[0]),
    )


def _names(columns: Columns) -> list[str]:
    return [columns] if isinstance(columns, str) else list(columns)


def _check_present(field: str, key: str, present: list[str]) -> None:
    close = difflib.get_close_matches(key, present, n=1, cutoff=0.4)
    hint = f"Did you mean `{close[0]}`?" if close else ""
    listed = ", ".join(present[:30]) or "none"
    check(key in present, field, f"must be one of those present ({listed})", f"`{key}`", hint)


def _matrix(frame: Any, names: list[str]) -> np.ndarray:
    return _stacked([np.asarray(frame[key]) for key in names], len(frame))


def _stacked(columns: list[np.ndarray], count: int) -> np.ndarray:
    return np.stack(columns, axis=1) if columns else np.zeros((count, 0))


def _channels(key: str, variable: Any, time: str) -> list[tuple[str, np.ndarray]]:
    """The channels of a variable, by name."""
    if variable.ndim == 1:
        return [(key, np.asarray(variable.values))]
    (dim,) = [label for label in variable.dims if label != time]
    values = np.asarray(variable.transpose(time, dim).values)
    labels = [str(label) for label in np.asarray(variable[dim].values).tolist()]
    return [(f"{key}_{label}", column) for label, column in zip(labels, values.T, strict=True)]
