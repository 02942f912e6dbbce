"""What names the data and the versions behind a result, and results as values of JSON."""

import platform
from dataclasses import is_dataclass
from importlib.metadata import version as version_of
from typing import Any

import equinox as eqx
import jax
import numpy as np

from eoi_jax.data.record import Record


def versions() -> dict[str, str]:
    """Versions of this package and of those that it computes with."""
    return {
        "eoi_jax": version_of("eoi_jax"),
        "jax": jax.__version__,
        "numpy": np.__version__,
        "python": platform.python_version(),
    }


def describe_record(record: Record) -> dict[str, Any]:
    """Name, size, hold and hash of the data of a record, and what was changed in it.

    Args:
        record: any.
    """
    return {
        "name": record.name,
        "samples": len(record.time),
        "sample_period": record.sample_period,
        "hold": record.logged_hold,
        "hash": record.data_hash,
        "notes": record.notes,
    }


def json_values(value: Any) -> Any:
    """A value in the types of JSON; NaN and infinity become null.

    Args:
        value: number, text, array, module, data class, or dicts and lists of these.
    """
    if isinstance(value, dict):
        return {str(key): json_values(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [json_values(item) for item in value]
    if isinstance(value, eqx.Module):
        return {"kind": type(value).__name__, **json_values(vars(value))}
    if is_dataclass(value):
        return json_values(vars(value))
    if isinstance(value, np.ndarray | np.generic | jax.Array):
        return json_values(np.asarray(value).tolist())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
