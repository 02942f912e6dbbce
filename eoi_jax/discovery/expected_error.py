r"""The error that a right model is expected to make in free runs, and whether one makes more.

The start of a run is known from its first samples, and the parameters from the records of the fit.
With $J_x$ and $J_\theta$ the derivatives of an output over its noise $\sigma$ with both, $P$ the
covariance that the samples of the head leave the start and $C$ that of the parameters, a right
model errs by

$$ \sigma^2 \bigl(1 + J_x P J_x^\top + J_\theta C J_\theta^\top\bigr),\quad
   P = \Bigl(\sum_{head} J_x^\top J_x\Bigr)^{-1}. $$

In a culture that grows a start that is told by three samples is most of it. The noise itself is
read off differences of few samples; the ratio of both squares is then that of an F distribution.

Derivation: variance of a prediction by linear least squares, L. Ljung, *System Identification*,
2nd ed., appendix II.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from eoi_jax.data.record import Record
from eoi_jax.discovery.confirm import excesses, unsure_noise
from eoi_jax.discovery.input_noise import error_of_input_noise
from eoi_jax.discovery.judge import Judged
from eoi_jax.discovery.rules import RULES
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.first_runs import first_runs
from eoi_jax.refinement.result import Refinement
from eoi_jax.refinement.spans import Span, spans_of
from eoi_jax.simulation.error_growth import returns
from eoi_jax.simulation.sensor_noise import sensor_noise
from eoi_jax.simulation.validation import Validation


def misses(model: Judged) -> list[str]:
    """A sentence for each output that misses held-out records by more than a right model may.

    None where long runs miss by no more: in windows the start is known less well. None where short
    runs alone do not, either, and long ones may drift, as those of an oscillator or an integrator;
    those of a plant that returns to rest show what is missing.
    """
    plant = model.refinement.plant
    long_runs, short_runs = model.runs
    of_long = _excess(model, long_runs)
    if not of_long or short_runs is None:
        return of_long
    return _excess(model, short_runs) or (of_long if returns(plant, long_runs.records) else [])


def error_over_noise(model: Judged) -> str:
    """By how much a model misses held-out records where `misses` says nothing, in words.

    Of long runs and windows by the larger, those apart that miss by more than noise, as they drift;
    of the output that misses by most. Where few samples tell the noise, to within what factor.
    """
    runs = [run for run in model.runs if run is not None]
    silent = [run for run in runs if not excesses(run, sensor_noise(run))]
    run = max(silent or runs, key=_most_times)
    if _most_times(run) <= RULES.questions.silent:
        return "no more than noise"
    if np.any(error_of_input_noise(model.refinement.plant, run)):
        return "no more than noise in the log of the inputs explains"
    times = f"{_most_times(run):.2g} times the noise{'' if run.window is None else ' in windows'}"
    # Runs that exceed it are told apart: they drift. Others may by the error of their starts.
    if silent:
        return times + unsure_noise(run, sensor_noise(run))
    return f"{times}, as a right model may from starts that are told no better"


def _most_times(run: Validation) -> float:
    """Error over the noise, of the output where that is largest; 0 of outputs without noise."""
    noise = sensor_noise(run)
    times = np.divide(run.rmse, noise, out=np.zeros_like(noise), where=noise > 0.0)
    return float(np.max(times, initial=0.0, where=~np.isnan(times)))


def _excess(model: Judged, run: Validation) -> list[str]:
    """Of runs of one length; what a right model may err by is asked where the noise is exceeded."""
    if not excesses(run, sensor_noise(run)):
        return []
    expected = expected_error(model.refinement, run)
    if excesses(run, expected):
        expected = np.hypot(expected, error_of_input_noise(model.refinement.plant, run))
    return excesses(run, expected)


def expected_error(refinement: Refinement, run: Validation) -> Float[np.ndarray, " ny"]:
    """Root mean square of the error of each output, were the model right [unit of y].

    Args:
        refinement: of the model, whose records tell the parameters.
        run: its free runs, whole or in windows.
    """
    noise, plant, records = sensor_noise(run), refinement.plant, run.records
    covariance = _covariance(refinement, noise)
    share, count = np.zeros(len(noise)), np.zeros(len(noise))
    spans = spans_of(records, run.window)
    of_runs = _slopes(plant, records, spans, run.substeps, noise)
    for span, slopes in zip(spans, of_runs, strict=True):
        scored = run.scored_at[span.record]
        head = int(np.argmax(scored)) if np.any(scored) else len(scored)
        seen = slopes.start[:head].reshape(-1, slopes.start.shape[-1])
        start = _inverse(seen.T @ seen)
        part = np.einsum("tjs,sr,tjr->tj", slopes.start, start, slopes.start)
        part += np.einsum("tjp,pq,tjq->tj", slopes.theta, covariance, slopes.theta)
        counted = slopes.use & (np.arange(len(slopes.use)) >= head)[:, None]
        share += np.sum(np.where(counted, part, 0.0), axis=0)
        count += np.sum(counted, axis=0)
    mean = np.nan_to_num(share / np.maximum(count, 1.0), posinf=0.0)
    return noise * np.sqrt(1.0 + np.maximum(mean, 0.0))


class _Slopes(NamedTuple):
    """Of one run: derivatives of the outputs over their noise, and which samples are scored."""

    start: Float[np.ndarray, "time ny own"]
    theta: Float[np.ndarray, "time ny free"]
    use: Bool[np.ndarray, "time ny"]


def _slopes(
    plant: Plant,
    records: Sequence[Record],
    spans: Sequence[Span],
    substeps: int,
    noise: Float[np.ndarray, " ny"],
) -> list[_Slopes]:
    problem, _, weighed = first_runs(plant, records, spans, substeps or None)
    slopes = weighed[..., :-1] / (np.asarray(problem.scale) * noise)[:, None]
    parts = np.split(slopes, [slopes.shape[-1] - len(problem.free)], axis=-1)
    return [_Slopes(*run) for run in zip(*parts, problem.use, strict=True)]


def _covariance(refinement: Refinement, noise: Float[np.ndarray, " ny"]) -> np.ndarray:
    """That of the free parameters, were the residual of the fit the noise.

    The starts of its runs are estimated as well: what they explain of the slopes tells nothing.
    """
    records, plant = refinement.records, refinement.plant
    spans = spans_of(records, refinement.window)
    information = 0.0
    for slopes in _slopes(plant, records, spans, refinement.substeps, noise):
        start, theta = (part.reshape(-1, part.shape[-1]) for part in slopes[:2])
        crossed = start.T @ theta
        information += theta.T @ theta - crossed.T @ _inverse(start.T @ start) @ crossed
    return _inverse(np.asarray(information))


def _inverse(information: Float[np.ndarray, "size size"]) -> Float[np.ndarray, "size size"]:
    """Pseudoinverse, whatever the units: zero for what leaves no trace."""
    lengths = np.sqrt(np.diagonal(information))
    lengths = np.where(lengths > 0.0, lengths, np.inf)
    scaled = information / np.outer(lengths, lengths)
    return np.linalg.pinv(scaled, rcond=1e-10, hermitian=True) / np.outer(lengths, lengths)
