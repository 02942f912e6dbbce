r"""Several methods on the same records, scored in the same way.

Each method gets the plant at its nominal parameters and the same records. The scores do not depend
on the method: free runs on hold-out records, the error of the parameters where the truth is known,
and the index P of eq. (14) under *one* observer and *one* filter, chosen from the records. (A
method's own index depends on its filter, and cannot be compared with that of another.)
"""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eoi_jax._checks import check, check_choice, check_kind
from eoi_jax._status import Status
from eoi_jax.comparison.methods import AbstractComparator, Estimate, on_request, standard
from eoi_jax.comparison.result import Comparison, Entry
from eoi_jax.data.holds import made_alike
from eoi_jax.data.record import Record
from eoi_jax.data.windows import window_length
from eoi_jax.estimation.defaults import default_observer
from eoi_jax.estimation.hold import decided
from eoi_jax.estimation.holdout import INITIAL, held_out_records
from eoi_jax.estimation.identify import estimate, trial_fit
from eoi_jax.estimation.preparation import prepare_records
from eoi_jax.models.check_records import check_records
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.validate import judged_runs


def compare(
    plant: Plant,
    records: Record | Sequence[Record],
    validation: Record | Sequence[Record] | None = None,
    truth: Mapping[str, float] | None = None,
    methods: Sequence[AbstractComparator | str] | None = None,
) -> Comparison:
    """Estimate a plant's parameters by several methods, and compare the results.

    Args:
        plant: the model with its nominal parameters, from which every method starts.
        records: one or several; every method fits all of them.
        validation: hold-out records, on which free runs are scored; default: the records of the
            fit.
        truth: true parameters of the records by name, if known.
        methods: comparators, and names of those in `comparators.standard()` and
            `comparators.on_request()`; default: all of the former.

    Returns:
        One entry for each method. A method that fails has a status that says how, and does not
        affect the others.

    Raises:
        ValueError: records that do not match the plant, an unknown parameter in `truth`, no method,
            a method that is not a comparator, two methods of the same name.
    """
    checked = check_records(plant, records)
    validation_records = held_out_records(plant, checked, validation)
    check(
        validation is None or len(validation_records) > 0,
        "validation",
        "must hold at least one record",
        "none",
    )
    read = checked
    checked, evidence = decided(plant, read, trial_fit)
    scored = made_alike(validation_records, read, checked) or checked
    check_kind("truth", {} if truth is None else truth, Mapping, "a dict of values by name")
    for name in truth or {}:
        check_choice("truth", name, plant.names)
    chosen = _methods(methods)
    names = [comparator.name for comparator in chosen]
    check(len(set(names)) == len(names), "methods", "must have different names", ", ".join(names))
    scorer = _Scorer(plant, scored, dict(truth) if truth else None, common_index(plant, checked))
    entries = tuple(scorer.entry(comparator, checked) for comparator in chosen)
    return Comparison(
        entries,
        plant,
        scorer.truth,
        bool(validation_records),
        scorer.window,
        (*evidence, *scorer.index.reasons),
        scorer.notes,
    )


def _methods(
    methods: Sequence[AbstractComparator | str] | None,
) -> tuple[AbstractComparator, ...]:
    library = {method.name: method for method in (*standard(), *on_request())}
    requested = [methods] if isinstance(methods, str) else methods
    requested = standard() if requested is None else requested
    check_kind("methods", requested, Iterable, "comparators or their names")
    chosen = []
    for method in requested:
        if isinstance(method, str):
            check_choice("methods", method, library)
        check_kind("methods", method, (AbstractComparator, str), "comparators or their names")
        chosen.append(library[method] if isinstance(method, str) else method)
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
    """Index under the observer and the filter that `identify` chooses for the nominal parameters.

    Args:
        plant: at its nominal parameters, for which the relay is chosen.
        records: of the index.

    Returns:
        The score function, and the reasons for observer and filter.
    """
    prepared = prepare_records(plant, check_records(plant, records))
    observer, chosen = default_observer(
        plant, prepared.fine, prepared.inputs, prepared.lowpass.cutoff, prepared.substeps
    )

    def score(values: Mapping[str, float]) -> Float[np.ndarray, " ny"]:
        candidate = plant.with_parameters(values)
        return np.asarray(estimate(candidate, prepared, observer, passes=1).index[0])

    return CommonIndex(score, prepared.reasons + chosen)


# -- one method ---------------------------------------------------------------------------------


class _Scorer:
    """Scores every method on the same records, in windows of `min_samples` or more."""

    def __init__(
        self,
        plant: Plant,
        scored: Sequence[Record],
        truth: dict[str, float] | None,
        index: CommonIndex,
        min_samples: int = 20,
    ):
        self.plant, self.scored, self.truth, self.index = plant, scored, truth, index
        self.window = window_length(scored, min_samples)
        self.notes: tuple[str, ...] = ()
        if self.window is None:
            self._note(f"held-out records are too short for windows of {min_samples} samples")

    def entry(self, method: AbstractComparator, records: tuple[Record, ...]) -> Entry:
        """Run a method, again for its time once compiled, and score its answer."""
        answer, first = _timed(lambda: _attempt(method, self.plant, records))
        seconds = np.nan
        if answer.status.ok:
            answer, seconds = _timed(lambda: _attempt(method, self.plant, records))
        values = answer.parameters
        no_value = np.full(len(self.plant.outputs), np.nan)
        free_run, windows, index = no_value, no_value, no_value
        if values is not None:
            free_run, index = self._free_run(values, None), self.index.score(values)
            windows = no_value if self.window is None else self._free_run(values, self.window)
        return Entry(
            method.name,
            method.description,
            values,
            answer.standard_errors,
            answer.status,
            free_run,
            windows,
            index,
            self._errors(values),
            seconds,
            first,
        )

    def _free_run(self, values: dict[str, float], window: float | None) -> np.ndarray:
        """Hold-out error; NaN with a note if a record cannot be scored."""
        samples = min(len(record) for record in self.scored)
        if window is not None:
            samples = min(round(window / record.sample_period) for record in self.scored)
        initial = min(INITIAL, max(samples // 2, 1))
        try:
            candidate = self.plant.with_parameters(values)
            return judged_runs(candidate, self.scored, initial, window).rmse
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
    """A method's answer; exceptions and invalid answers become a status."""
    try:
        answer = method.estimate(plant, records)
        if answer.parameters is None:
            return answer
        check(
            set(answer.parameters) == set(plant.names),
            "parameters",
            f"must name all of {', '.join(plant.names)}",
            ", ".join(answer.parameters),
        )
        if not np.all(np.isfinite(list(answer.parameters.values()))):
            return Estimate(None, None, Status("diverged", "the estimate is not finite"))
    except Exception as error:
        text = f"{method.name} raised {type(error).__name__}: {error}"
        return Estimate(None, None, Status("failed", text))
    return answer
