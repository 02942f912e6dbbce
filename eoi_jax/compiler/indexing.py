"""Slices, gathers, scatters and pads of arrays by NumPy, as JAX defines them.

To ask JAX itself would compile each of them. The arrays hold a few components each.

Source:
    https://openxla.org/xla/operation_semantics (gather, scatter, dynamic slices, pad).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jax.lax import GatherScatterMode

Axes = Sequence[Any]  # whole numbers, some of them NumPy's


def gather(params: dict, array: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """`lax.gather`; −1 where it reads beyond the array and fills."""
    numbers, sizes = params["dimension_numbers"], params["slice_sizes"]
    squeezed = {*numbers.collapsed_slice_dims, *numbers.operand_batching_dims}
    window = tuple(size for i, size in enumerate(sizes) if i not in squeezed)
    batch = starts.shape[:-1]
    result = np.full((*batch, *window), -1, array.dtype)
    for at in np.ndindex(batch):
        first = _start(
            array, starts[at], at, numbers.start_index_map, numbers.operand_batching_dims,
            numbers.start_indices_batching_dims,
        )  # fmt: skip
        first = _window_start(array, first, sizes, params["mode"])
        if first is not None:
            result[at] = array[_box(first, sizes)].reshape(window)
    offsets = numbers.offset_dims
    return np.moveaxis(result, range(len(batch), result.ndim), offsets) if offsets else result


def scatter(params: dict, array: np.ndarray, starts: np.ndarray, new: np.ndarray) -> np.ndarray:
    """`lax.scatter`; of several values for one component the last one stays."""
    numbers = params["dimension_numbers"]
    dims = numbers.update_window_dims
    batch = starts.shape[:-1]
    parts = np.moveaxis(new, dims, range(len(batch), new.ndim)) if dims else new
    inserted = {*numbers.inserted_window_dims, *numbers.operand_batching_dims}
    window = iter(parts.shape[len(batch) :])
    sizes = tuple(1 if i in inserted else next(window) for i in range(array.ndim))
    result = array.copy()
    for at in np.ndindex(batch):
        first = _start(
            array, starts[at], at, numbers.scatter_dims_to_operand_dims,
            numbers.operand_batching_dims, numbers.scatter_indices_batching_dims,
        )  # fmt: skip
        first = _window_start(array, first, sizes, params["mode"])
        if first is not None:
            result[_box(first, sizes)] = parts[at].reshape(sizes)
    return result


def dynamic_slice(params: dict, array: np.ndarray, *starts: np.ndarray) -> np.ndarray:
    """`lax.dynamic_slice`."""
    sizes = params["slice_sizes"]
    return array[_box(_clipped(array, [int(start) for start in starts], sizes), sizes)]


def dynamic_update_slice(
    params: dict, array: np.ndarray, new: np.ndarray, *starts: np.ndarray
) -> np.ndarray:
    """`lax.dynamic_update_slice`."""
    del params
    result = array.copy()
    result[_box(_clipped(array, [int(start) for start in starts], new.shape), new.shape)] = new
    return result


def pad(params: dict, array: np.ndarray, value: np.ndarray) -> np.ndarray:
    """`lax.pad`, with gaps inside and with negative amounts, which cut off."""
    for axis, (low, high, interior) in enumerate(params["padding_config"]):
        count = array.shape[axis]
        size = count + max(count - 1, 0) * interior
        spread = np.full((*array.shape[:axis], size, *array.shape[axis + 1 :]), value)
        np.moveaxis(spread, axis, 0)[:: interior + 1] = np.moveaxis(array, axis, 0)
        amounts = [(0, 0)] * array.ndim
        amounts[axis] = max(low, 0), max(high, 0)
        padded = np.pad(spread, amounts, constant_values=value)
        ends = slice(max(-low, 0), padded.shape[axis] - max(-high, 0))
        array = np.moveaxis(np.moveaxis(padded, axis, 0)[ends], 0, axis)
    return array


def _start(
    array: np.ndarray, values: np.ndarray, at: Axes, dims: Axes, batched: Axes, index_axes: Axes
) -> list[int]:
    """Where a window begins: as the indices say, and along axes of a batch where that stands."""
    first = [0] * array.ndim
    for dim, value in zip(dims, values, strict=True):
        first[dim] = int(value)
    for dim, axis in zip(batched, index_axes, strict=True):
        first[dim] = at[axis]
    return first


def _window_start(array: np.ndarray, first: list[int], sizes: Any, mode: Any) -> list[int] | None:
    """The start of a window inside the array; None where one beyond it is dropped."""
    clipped = _clipped(array, first, sizes)
    drops = GatherScatterMode.from_any(mode) == GatherScatterMode.FILL_OR_DROP
    return None if drops and clipped != first else clipped


def _clipped(array: np.ndarray, first: list[int], sizes: Any) -> list[int]:
    room = zip(first, array.shape, sizes, strict=True)
    return [min(max(start, 0), length - size) for start, length, size in room]


def _box(first: list[int], sizes: Any) -> tuple[slice, ...]:
    return tuple(slice(start, start + size) for start, size in zip(first, sizes, strict=True))
