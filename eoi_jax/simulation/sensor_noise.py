"""The noise of sensors, bounded from above by what free runs leave.

Differences of neighbouring samples show the noise (`data/noise.py`) only where the motion is slow
beside the sampling: an hourly room temperature moves by more than its thermometer errs. A model
that is simulated takes the fast motion out, though slow errors of it may be large, and the same
differences of what is left show less. Both estimates are too large where motion is in them, so that
the smaller one holds. Where sampling is fast they agree, and nothing changes.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from eoi_jax.data.cleaning import own_noise
from eoi_jax.data.noise import white_noise
from eoi_jax.data.record import Record
from eoi_jax.data.resampling import own_segments
from eoi_jax.simulation.step_size import RULES
from eoi_jax.simulation.validation import Validation


@dataclass(frozen=True)
class SensorNoiseSettings:
    """When errors show more of the noise than the samples do."""

    # Differences of errors over those of the samples, from which on both are noise.
    agreement: float = 0.9
    # Degrees of freedom of differences of errors, of an order above the lowest: with so many their
    # root mean square is below half of the noise in one of a hundred cases (χ²).
    degrees: float = 10.0


_SETTINGS = SensorNoiseSettings()


def sensor_noise(*free_runs: Validation | None) -> Float[np.ndarray, " ny"]:
    """Standard deviation of the white noise of each output, at most [unit of y].

    Args:
        free_runs: of models on records, one or more; whole or in windows.

    Returns:
        The largest over the records of `Record.noise`, each reduced to what the differences of
        the errors show: those of the model that leaves least. Not below the rounding of the samples
        and the accuracy of a simulation.
    """
    return np.min([_bound(run) for run in free_runs if run is not None], axis=0)


def shows_noise(run: Validation) -> Bool[np.ndarray, " ny"]:
    """Whether differences of the samples show the noise of each output, and not its motion.

    Args:
        run: free runs of a model, which takes the motion out of them.
    """
    noise = np.max([record.noise for record in run.records], axis=0)
    return sensor_noise(run) >= _SETTINGS.agreement * noise


def is_exact(run: Validation) -> bool:
    """Whether errors of free runs are within the accuracy of a simulation: less is luck."""
    return bool(np.all(run.rmse <= np.max([_accuracy(record) for record in run.records], axis=0)))


def _bound(run: Validation) -> Float[np.ndarray, " ny"]:
    predicted = [prediction.outputs for prediction in run.predictions]
    parts = zip(run.records, predicted, run.scored_masks, strict=True)
    return np.max([_of_record(*part) for part in parts], axis=0)


def _of_record(
    record: Record,
    predicted: Float[np.ndarray, "time ny"],
    scored: Bool[np.ndarray, " time"],
) -> Float[np.ndarray, " ny"]:
    """`Record.noise`, or what the errors show where the samples move by much more than these.

    Runs in windows are apart by their first samples, which are not scored.
    """
    noise = np.array(record.noise)
    for j, level in enumerate(noise):
        (places,) = np.nonzero(record.output_valid[:, j] & scored)
        pair = np.stack([record.outputs[:, j], record.outputs[:, j] - predicted[:, j]], axis=1)
        segments = own_segments(places.astype(float))
        motion, error = white_noise(pair[places], segments, degrees=_SETTINGS.degrees)
        if error < _SETTINGS.agreement * motion:
            # Interpolation and smoothing take noise from the differences, of errors alike.
            unprepared = own_noise(record.outputs[:, [j]], record.output_valid[:, j])[0]
            rounding = min(record.quantum[j] / np.sqrt(12.0), level)
            noise[j] = np.clip(error * level / unprepared, rounding, level)
    return np.maximum(noise, _accuracy(record))


def _accuracy(record: Record) -> Float[np.ndarray, " ny"]:
    """What a free run errs by itself: its steps, ``RULES.resolution`` of y, and their rounding.

    Each step rounds to ε |y| at most.
    """
    counted = record.output_valid
    spread = np.std(record.outputs, axis=0, where=counted)
    largest = np.max(np.abs(record.outputs), axis=0, where=counted, initial=0.0)
    return np.maximum(RULES.resolution * spread, np.finfo(float).eps * largest * len(record))
