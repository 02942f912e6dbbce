"""Inputs of rows without a usual spacing, or off the grid, by the hold that a fit chooses."""

import numpy as np
import pytest

import eoi_jax as eoi

HOUR = 3600.0
# A few rows in which an infusion was changed, more than one step in five: suggested is "linear".
STAMPS = HOUR * np.array([0, 1, 2, 3, 4, 6, 8, 12, 13, 16, 20, 24, 25, 26, 28, 32, 36], float)
RATES = np.array([100, 0, 0, 50, 0, 0, 0, 80, 0, 0, 0, 60, 0, 0, 0, 0, 0], float)


def concentration(stamps: np.ndarray, k: float = 0.25, volume: float = 12.0) -> np.ndarray:
    """dc/dt = rate/volume - k c from 0, k [1/h], exact for rates held from row to row."""
    values = [0.0]
    for step, rate in zip(np.diff(stamps) / HOUR, RATES, strict=False):
        decay = np.exp(-k * step)
        values.append(decay * values[-1] + rate / volume / k * (1.0 - decay))
    return np.array(values)


def dosed(hold: str, stamps: np.ndarray = STAMPS) -> eoi.Record:
    noise = 1.0 + 0.01 * np.random.default_rng(3).standard_normal(len(stamps))
    outputs = concentration(stamps) * noise
    return eoi.Record(stamps, RATES, outputs, "patient", input_names=["rate"], hold=hold)


def jittered(hold: str) -> eoi.Record:
    rng = np.random.default_rng(1)
    time = 0.1 * (np.arange(300) + rng.uniform(-0.2, 0.2, 300))
    inputs = np.stack([np.sign(np.sin(3.0 * time)), rng.standard_normal(300)], axis=1)
    return eoi.Record(time, inputs, np.sin(time), "rig", input_names=["a", "b"], hold=hold)


@pytest.mark.parametrize("word", ["zero", "linear", "smooth"])
@pytest.mark.filterwarnings("ignore::eoi_jax.RecordWarning")
def test_a_hold_that_is_chosen_later_is_one_that_was_declared(word: str) -> None:
    for made in (dosed, jittered):
        chosen, declared = made("auto").with_hold(word), made(word)
        np.testing.assert_array_equal(chosen.inputs, declared.inputs)
        np.testing.assert_array_equal(chosen[5:90].inputs, declared[5:90].inputs)
        part = made("auto")[5:90].with_hold(word)
        np.testing.assert_array_equal(part.inputs, declared[5:90].inputs)
        np.testing.assert_array_equal(chosen.midpoint_inputs(), declared.midpoint_inputs())
    record = jittered("auto")
    mixed = record.with_hold({"a": "zero", "b": word})
    np.testing.assert_array_equal(mixed.inputs[:, 0], jittered("zero").inputs[:, 0])
    np.testing.assert_array_equal(mixed.inputs[:, 1], jittered(word).inputs[:, 1])
    single = record.without_inputs("a").with_hold(word)
    np.testing.assert_array_equal(single.inputs[:, 0], jittered(word).inputs[:, 1])


@pytest.mark.filterwarnings("ignore::eoi_jax.RecordWarning")
def test_a_record_on_its_grid_keeps_its_samples() -> None:
    record = eoi.Record(np.arange(20.0), np.arange(20.0) ** 2, np.arange(20.0), "even")
    for word in ("zero", "linear", "smooth"):
        assert record.with_hold(word).inputs is record.inputs


@pytest.mark.filterwarnings("ignore::eoi_jax.RecordWarning")
def test_infusions_of_a_table_by_hand_are_held_where_that_fits() -> None:
    plant = eoi.plant_from_text(
        {"c": "rate/(V*3600) - k/3600*c"}, {"k": 0.2, "V": 15.0}, outputs=["c"], inputs=["rate"]
    )
    record = dosed("auto")
    assert record.hold == "linear"
    fit = eoi.refine(plant, record)
    assert fit.records[0].hold == "zero"
    assert abs(fit.parameters["V"] - 12.0) < 0.3
    assert abs(fit.parameters["k"] - 0.25) < 0.01
    # Planned doses are read as the records of the fit were.
    runs = eoi.validate(fit, record)
    assert runs.rmse[0] < 0.02 * np.std(record.known_outputs[record.output_valid])
