"""Translations to machine code: done once, kept, and never a reason for an error.

The scan (`scan.py`) runs every model. So whatever goes wrong on the way to machine code, an
operation that is no arithmetic, a part of JAX that has another name in this version, an error of
LLVM, is the reason why the scan runs; it is never an error of the caller's.
"""

import functools
from collections.abc import Callable, Hashable
from typing import Any

from eoi_jax.compiler.graph import Untranslatable

_MOST = 64  # of machine code


def kept_translation(function: Callable, most: int = _MOST) -> Callable:
    """A translation that is done once for the same arguments; so is one that fails.

    Args:
        function: of hashable arguments.
        most: translations that are kept, the least recently used go first.

    Returns:
        The same function; it raises `Untranslatable`, whatever the failure was.
    """

    @functools.lru_cache(maxsize=most)
    def attempt(*arguments: Hashable) -> Any:
        try:
            return function(*arguments)
        except Untranslatable as reason:
            return _Failure(str(reason))
        except Warning:  # of a caller whose warnings are errors
            raise
        except Exception as error:
            text = str(error).strip().split("\n")[0]
            return _Failure(f"translation failed, {type(error).__name__}: {text}")

    @functools.wraps(function)
    def kept(*arguments: Hashable) -> Any:
        result = attempt(*arguments)
        if isinstance(result, _Failure):
            raise Untranslatable(result.reason)
        return result

    kept.__dict__["cache_clear"] = attempt.cache_clear
    return kept


class _Failure:
    """Why a translation failed."""

    def __init__(self, reason: str):
        self.reason = reason
