"""A sweep as one table: a row for each lane, for spreadsheets and data frames."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from eoi_jax._checks import check

_LANE = ("record", "lowpass", "observer", "start", "resample")
_NEEDED = ("status", "parameters", "standard_error")


def sweep_to_pandas(sweep: Any) -> Any:
    """A data frame of a sweep: a row for each lane, which is one gain set on one record.

    Args:
        sweep: of `sweep`, `open_sweep` or `best`.

    Returns:
        A `pandas.DataFrame`. Columns: record, filter, kind and gains of the observer, starting
        point and resample; ``parameters[name]`` and ``standard_error[name]`` of each parameter,
        ``common_index[name]`` and ``sliding_fraction[name]`` of each output; the status by its
        name, and ``ok``. The index of every pass is not in it. `attrs` are those of the sweep.

    Raises:
        ValueError: not a sweep.

    Source: pandas.DataFrame, https://pandas.pydata.org/docs/reference/frame.html
    """
    import pandas as pd

    complete = all(name in getattr(sweep, "variables", ()) for name in _NEEDED)
    check(complete, "sweep", "must be what `sweep` returned", type(sweep).__name__)
    lanes = sweep.expand_dims([name for name in _LANE if name not in sweep.dims])
    template = lanes["status"].transpose(*_LANE)
    columns: dict[str, np.ndarray] = {"record": np.empty(0)}  # the first column
    for name, values in (*lanes.coords.items(), *lanes.data_vars.items()):
        for label, part in _parts(str(name), values):
            columns[label] = part.broadcast_like(template).transpose(*_LANE).values.ravel()
    names = sweep["status"].attrs["flag_meanings"].split()
    columns["status"] = np.asarray(names)[columns["status"]]
    frame = pd.DataFrame(columns).rename_axis("lane")
    frame.attrs = dict(sweep.attrs)
    return frame


def _parts(name: str, values: Any) -> Iterator[tuple[str, Any]]:
    """The columns of a variable: one for each output or parameter; none along the passes."""
    further = [dimension for dimension in values.dims if dimension not in _LANE]
    if not further:
        yield name, values
    elif name not in further and name != "theta_0" and further in (["parameter"], ["output"]):
        for label in values[further[0]].values:
            part = values.sel({further[0]: label}, drop=True)
            yield f"{name}[{label}]", part
