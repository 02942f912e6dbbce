r"""Outputs between the samples where a held input makes them kink: those of first order.

A spline through the samples is as smooth as a signal of limited band. An output of first order is
not where its input is held: its rate jumps with the input. A spline smears that
jump over the steps around, while the input that the model reads jumps at once: of the residual at
the cut-off of F two per cent are then an error of the interpolation, in step with the input.

Within a sample $y$ obeys $\dot y = f$. With $f$ linearised in the middle of the sample, along the
chord from $y_k$ to $y_{k+1}$, and with what the inputs do within the sample,

$$ y(t) = y_k + \int_0^t (g - \bar g) \, dt' + \Delta y \, t / h, \qquad
g = \frac{\partial f}{\partial y} y(t) + \frac{\partial f}{\partial u} u(t) $$

with $\bar g$ the mean of $g$ over the sample, and $y$ in $g$ by Picard iteration from the chord.
The mean of the rate is measured, only its course within the sample is the model's. An error of
$\partial f/\partial y$ enters with a twelfth of the square of $h$ over the time constant, one of
$\partial f/\partial u$ of a held input not at all. $h\,\partial f/\partial y$ is taken as one at
most: a faster mode is not resolved by the samples. What hidden states do within a sample is left
out. An output on which no held input acts at once does not kink: it keeps its spline.
"""

from functools import partial

import numpy as np
from jaxtyping import Float

from eoi_jax.data.record import Record
from eoi_jax.models.jacobians import driven, slopes_behind
from eoi_jax.models.plant import Plant


def resampled(plant: Plant, record: Record, substeps: int) -> Record:
    """A record with each sample divided into steps, its outputs as the plant moves between samples.

    Outputs are interpolated by splines (`Record.resample`) unless `follows_model`.

    Args:
        plant: with its nominal parameters.
        record: as measured.
        substeps: steps per sample.
    """
    bends = substeps > 1 and follows_model(plant, record)
    return record.resample(substeps, partial(_bent, plant, record.bridged) if bends else None)


def follows_model(plant: Plant, record: Record) -> bool:
    """Whether an output may kink where an input is held: one of first order."""
    return 1 in plant.degrees and "zero" in record.holds


def _bent(
    plant: Plant, record: Record, fine: Record, iterations: int = 3
) -> Float[np.ndarray, "points ny"]:
    """Outputs of a finer grid; each iteration is sharper by h over the time constant."""
    y, h, samples = record.outputs, record.sample_period, len(record) - 1
    substeps = (len(fine) - 1) // samples
    state = _states(plant, fine).reshape(samples, substeps, plant.rows, -1)
    u = driven(plant, fine.time[:-1] + 0.5 * fine.sample_period, fine.midpoint_inputs())
    inputs, middle = np.reshape(u, (samples, substeps, -1)), np.mean(state, axis=1)
    slopes = slopes_behind(plant, record.time[:-1] + 0.5 * h, middle, np.mean(inputs, axis=1))
    by_state, by_input = (np.where(np.isfinite(slope), slope, 0.0) for slope in slopes)
    fastest = h * np.max(np.sum(np.abs(by_state[:, :, 0]), axis=2), axis=1)
    by_state = by_state / np.maximum(fastest, 1.0)[:, None, None, None]
    driving = np.einsum("kij,ksj->ksi", by_input, inputs)
    kinks = np.any(by_input[:, :, np.asarray(record.holds) == "zero"], axis=(0, 2))
    kinks &= np.asarray(plant.degrees) == 1
    rise, places = np.diff(y, axis=0)[:, None], np.linspace(0.0, 1.0, substeps + 1)[:, None]
    course = chord = y[:-1, None] + rise * places
    for _ in range(iterations):
        level = 0.5 * (course[:, 1:] + course[:, :-1])
        state[:, :, 0] = np.where(kinks, level, state[:, :, 0])
        rate = np.einsum("kirj,ksrj->ksi", by_state, state - middle[:, None]) + driving
        bend = np.cumsum(rate - np.mean(rate, axis=1, keepdims=True), axis=1) * (h / substeps)
        course = chord + np.pad(bend, ((0, 0), (1, 0), (0, 0)))
    bent = np.append(course[:, :-1].reshape(samples * substeps, -1), y[-1:], axis=0)
    return np.where(kinks, bent, fine.outputs)


def _states(plant: Plant, fine: Record) -> Float[np.ndarray, "steps r ny"]:
    """Outputs and their derivatives in the middle of each step, by differences."""
    y, h = fine.outputs, fine.sample_period
    rows = [0.5 * (y[1:] + y[:-1]), np.diff(y, axis=0) / h]
    while len(rows) < plant.rows:
        rows.append(np.gradient(rows[-1], h, axis=0))
    return np.stack(rows[: plant.rows], axis=1)
