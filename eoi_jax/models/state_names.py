"""Names of internal states that the model does not name: z, or z1, z2, ….

Where a channel or a parameter has such a name they are internal_z, internal_z1, …, so that a name
stands for one thing in equations, exported files and units.
"""

import re
from collections.abc import Collection


def numbered_states(names: Collection[str], first: int, count: int) -> tuple[str, ...]:
    """Names of some internal states: numbered, unless there is but one.

    Args:
        names: of channels and parameters.
        first: number of internal states before these.
        count: of these.
    """
    stem = _stem(names)
    if first + count == 1:
        return (stem,) * count
    return tuple(f"{stem}{first + i + 1}" for i in range(count))


def names_state(key: str, names: Collection[str]) -> bool:
    """Whether a key is the name of an internal state, however many there are.

    Args:
        key: any text.
        names: of channels and parameters.
    """
    return re.fullmatch(rf"{_stem(names)}\d*", key) is not None


def _stem(names: Collection[str]) -> str:
    """Whether it is free does not depend on the number of states, which effects add to."""
    stem = "z"
    while any(re.fullmatch(rf"{stem}\d*", name) for name in names):
        stem = f"internal_{stem}"
    return stem
