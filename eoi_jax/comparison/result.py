"""The result of a comparison of methods."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eoi_jax._checks import check_choice
from eoi_jax._display import Result
from eoi_jax._status import Status
from eoi_jax.models.plant import Plant


@dataclass(frozen=True)
class Entry:
    """Result and scores of one method.

    Attributes:
        method: name.
        description: one sentence.
        parameters: estimate by name; None without an answer.
        standard_errors: by name; None if the method gives none.
        status: how it ended.
        rmse: of free runs over the hold-out records, shape (ny,); NaN without an answer, infinite
            where a run diverges.
        windows: rmse of free runs in windows, each with its initial state estimated again, (ny,).
        index: P of the estimate under the common observer and filter, shape (ny,).
        errors: by name, (estimate - truth) over |truth| (or over 1 where the truth is zero);
            None without truth.
        seconds: time of a second call, with everything compiled.
        first_seconds: time of the first call.
    """

    method: str
    description: str
    parameters: dict[str, float] | None
    standard_errors: dict[str, float] | None
    status: Status
    rmse: Float[np.ndarray, " ny"]
    windows: Float[np.ndarray, " ny"]
    index: Float[np.ndarray, " ny"]
    errors: dict[str, float] | None
    seconds: float
    first_seconds: float


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Result):
    """Result of `compare`; prints itself as a table.

    `plot` shows parameter error, hold-out error and time of each method.

    Attributes:
        entries: one for each method, in the order of the call.
        plant: with its nominal parameters.
        truth: true parameters by name, or None.
        held_out: whether free runs are on other records than those of the fit.
        window: length of the re-initialised runs [s]; None where records are too short.
        reasons: why the common observer and filter were chosen.
        notes: limits of the scores.
    """

    entries: tuple[Entry, ...]
    plant: Plant
    truth: dict[str, float] | None
    held_out: bool
    window: float | None
    reasons: tuple[str, ...]
    notes: tuple[str, ...]

    def __getitem__(self, method: str) -> Entry:
        """The entry of a method by name.

        Raises:
            ValueError: a name that is not among them.
        """
        names = [entry.method for entry in self.entries]
        check_choice("method", method, names)
        return self.entries[names.index(method)]
