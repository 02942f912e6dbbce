r"""Every method on the same records, with the same report.

Each method gets the plant at its nominal parameters and the same records. Its estimate is judged by
what does not depend on the method: free runs on held-out records, the truth where it is known, and
the index P of eq. (14) under *one* observer and *one* filter, chosen once from the records (a
method's own index depends on its own filter, and no two of them may be compared).
"""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eoi_jax._checks import check, check_choice, check_kind
from eoi_jax._display import Result
from eoi_jax._status import Status
from eoi_jax.comparison.methods import AbstractComparator, Estimate, standard
from eoi_jax.data.record import Record
from eoi_jax.data.windows import window_length
from eoi_jax.estimation.defaults import default_observer
from eoi_jax.estimation.holdout import INITIAL, held_out_records
from eoi_jax.estimation.identify import estimate
from eoi_jax.estimation.preparation import prepare_records
from eoi_jax.models.check_records import check_records
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.validate import validate

_FEWEST = 20  # samples of a re-initialised run, at least


@dataclass(frozen=True)
class Entry:
    """One method's row.

    Attributes:
        method: its name. description: one sentence on it.
        parameters: estimate by name; None where it has no answer.
        standard_errors: by name; None where it has none.
        status: how it ended.
        rmse: of free runs through whole held-out records, shape (ny,). windows: of free runs whose
            state is estimated anew in every window. NaN without an answer, infinite where a run
            diverges.
        index: P of the estimate under the common observer and filter, shape (ny,).
        errors: by name, (estimate - truth) over |truth| (or over 1 where the truth is zero);
            None where no truth is given.
        seconds: of a second call, with everything compiled. first_seconds: of the first call.
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


@dataclass(frozen=True)
class Comparison(Result):
    """What `compare` found: prints itself as a table.

    `plot` shows parameter error, held-out error and time of each method.

    Attributes:
        entries: one for each method, in the order given.
        plant: with its nominal parameters.
        truth: by name, where given.
        held_out: whether free runs are on other records than those of the fit.
        window: length of the re-initialised runs [s]; None where records are too short.
        reasons: the common observer and filter, and why.
        notes: what limits the numbers.
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
        names = [one.method for one in self.entries]
        check_choice("method", method, names)
        return self.entries[names.index(method)]


def compare(
    plant: Plant,
    records: Record | Sequence[Record],
    validation: Record | Sequence[Record] | None = None,
    truth: Mapping[str, float] | None = None,
    methods: Sequence[AbstractComparator | str] | None = None,
) -> Comparison:
    """Estimate a plant's parameters by several methods, and put them side by side.

    Args:
        plant: the model with its nominal parameters, from which every method starts.
        records: one or several; every method fits all of them.
        validation: held-out records, on which free runs are scored, none of them seen by a fit; if
            left out, those of the fit.
        truth: parameters that made the records, by name, where they are known.
        methods: comparators, one's own among them, and names of those in `comparators.standard()`;
            by default all of these.

    Returns:
        One entry for each method. A method that fails has a status that says how, and the others
        are not touched by it.

    Raises:
        ValueError: records that do not fit the plant, an unknown parameter in `truth`, no method,
            one that is no comparator, two of one name.
    """
    several = check_records(plant, records)
    apart = held_out_records(plant, several, validation)
    check(
        validation is None or len(apart) > 0, "validation", "must hold at least one record", "none"
    )
    held = apart or several
    check_kind("truth", {} if truth is None else truth, Mapping, "a dict of values by name")
    for name in truth or {}:
        check_choice("truth", name, plant.names)
    chosen = _methods(methods)
    names = [one.name for one in chosen]
    check(len(set(names)) == len(names), "methods", "must have different names", ", ".join(names))
    judge = _Judge(plant, held, dict(truth) if truth else None, common_index(plant, several))
    entries = tuple(judge.entry(one, several) for one in chosen)
    return Comparison(
        entries,
        plant,
        judge.truth,
        bool(apart),
        judge.window,
        judge.index.reasons,
        judge.notes,
    )


def _methods(
    methods: Sequence[AbstractComparator | str] | None,
) -> tuple[AbstractComparator, ...]:
    known = {one.name: one for one in standard()}
    several = [methods] if isinstance(methods, str) else list(known) if methods is None else methods
    check_kind("methods", several, Iterable, "comparators or their names")
    chosen = []
    for one in several:
        if isinstance(one, str):
            check_choice("methods", one, known)
        check_kind("methods", one, (AbstractComparator, str), "comparators or their names")
        chosen.append(known[one] if isinstance(one, str) else one)
    check(len(chosen) > 0, "methods", "must hold at least one comparator", "none")
    return tuple(chosen)


# -- the common index ---------------------------------------------------------------------------


@dataclass(frozen=True)
class CommonIndex:
    """P of eq. (14) at any parameters, always under the same observer and filter.

    Attributes:
        score: θ by name → P, shape (ny,).
        reasons: for the observer and the filter.
    """

    score: Callable[[Mapping[str, float]], Float[np.ndarray, " ny"]]
    reasons: tuple[str, ...]


def common_index(plant: Plant, records: Record | Sequence[Record]) -> CommonIndex:
    """The observer and the filter that `identify` would choose, kept for every set of parameters.

    Args:
        plant: at its nominal parameters, for which the relay is chosen.
        records: on which P is taken.

    Returns:
        A score, and the reasons for what was chosen.
    """
    prepared = prepare_records(plant, check_records(plant, records))
    observer, chosen = default_observer(
        plant, prepared.fine, prepared.inputs, prepared.lowpass.cutoff, prepared.substeps
    )

    def score(values: Mapping[str, float]) -> Float[np.ndarray, " ny"]:
        at = plant.with_parameters(values)
        return np.asarray(estimate(at, prepared, observer, passes=1).index[0])

    return CommonIndex(score, prepared.reasons + chosen)


# -- one method ---------------------------------------------------------------------------------


class _Judge:
    """What every method is judged by."""

    def __init__(
        self,
        plant: Plant,
        held: Sequence[Record],
        truth: dict[str, float] | None,
        index: CommonIndex,
    ):
        self.plant, self.held, self.truth, self.index = plant, held, truth, index
        self.window = window_length(held, _FEWEST)
        self.notes: tuple[str, ...] = ()
        if self.window is None:
            self._note(f"held-out records are too short for windows of {_FEWEST} samples")

    def entry(self, method: AbstractComparator, records: tuple[Record, ...]) -> Entry:
        """Run a method twice, for its time once compiled, and score its answer."""
        found, first = _timed(lambda: _attempt(method, self.plant, records))
        seconds = np.nan
        if found.status.ok:
            found, seconds = _timed(lambda: _attempt(method, self.plant, records))
        values = found.parameters
        none = np.full(len(self.plant.outputs), np.nan)
        whole, windows, index = none, none, none
        if values is not None:
            whole, index = self._free_run(values, None), self.index.score(values)
            windows = none if self.window is None else self._free_run(values, self.window)
        return Entry(
            method.name,
            method.description,
            values,
            found.standard_errors,
            found.status,
            whole,
            windows,
            index,
            self._errors(values),
            seconds,
            first,
        )

    def _free_run(self, values: dict[str, float], window: float | None) -> np.ndarray:
        """Held-out error; a record that cannot be scored costs the number, not the comparison."""
        samples = min(len(one) for one in self.held)
        if window is not None:
            samples = min(round(window / one.sample_period) for one in self.held)
        initial = min(INITIAL, max(samples // 2, 1))
        try:
            at = self.plant.with_parameters(values)
            return validate(at, self.held, initial_samples=initial, window=window).rmse
        except ValueError as error:
            self._note(f"no free runs on held-out records: {error}")
            return np.full(len(self.plant.outputs), np.nan)

    def _errors(self, values: dict[str, float] | None) -> dict[str, float] | None:
        if self.truth is None or values is None:
            return None
        return {
            name: (values[name] - true) / (abs(true) if true else 1.0)
            for name, true in self.truth.items()
        }

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes += (text,)


def _timed(run: Callable[[], Estimate]) -> tuple[Estimate, float]:
    start = time.perf_counter()
    value = run()
    return value, time.perf_counter() - start


def _attempt(method: AbstractComparator, plant: Plant, records: tuple[Record, ...]) -> Estimate:
    """A method's answer; whatever it raises, or gets wrong, is a status."""
    try:
        found = method.estimate(plant, records)
        if found.parameters is None:
            return found
        check(
            set(found.parameters) == set(plant.names),
            "parameters",
            f"must name all of {', '.join(plant.names)}",
            ", ".join(found.parameters),
        )
        if not np.all(np.isfinite(list(found.parameters.values()))):
            return Estimate(None, None, Status("diverged", "the estimate is not finite"))
    except Exception as error:
        text = f"{method.name} raised {type(error).__name__}: {error}"
        return Estimate(None, None, Status("failed", text))
    return found
