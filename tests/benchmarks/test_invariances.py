"""A slice of `benchmarks/robustness/invariances.py`, and what it brought to light."""

import numpy as np
import pytest
from scipy import integrate, stats

import eoi_jax as eoi
from benchmarks.robustness import invariances
from eoi_jax.discovery.lags import Peak, strongest


@pytest.mark.slow
def test_order_units_and_the_order_of_parameters_change_nothing():
    """A pendulum with dry friction."""
    said = []
    counts = invariances.compared([3], ("order", "units", "parameters"), said.append)
    assert said == []
    assert sum(one.compared for one in counts.values()) == 6


def test_a_benchmark_that_sees_nothing_would_see_this():
    base = invariances.identified(invariances.experiment(3))[0]
    moved = invariances.replace(base, theta=base.theta + 0.01 * base.errors)
    truth = np.asarray(list(invariances.experiment(3).truth.values()))
    (words,) = invariances.violations(base, moved, "order", truth)
    assert words == "estimate 0.01 of its error"
    moved = invariances.replace(base, errors=1.06 * base.errors, status="stalled")
    assert len(invariances.violations(base, moved, "order", truth)) == 2


def test_a_split_may_move_an_estimate_by_what_its_degrees_of_freedom_allow():
    """Of ten the quantile is 6.567, that a normal variable has at 4."""
    base = invariances.identified(invariances.experiment(3))[0]
    lost, truth = np.sqrt(0.05 / 0.95), base.theta  # as if there were no bias
    for freedom, quantile in ((10.0, 6.567), (np.inf, 4.0), (np.nan, 4.0)):
        few = invariances.replace(base, freedom=np.full_like(base.freedom, freedom))
        for share, wrong in ((0.98, False), (1.02, True)):
            theta = base.theta + share * quantile * lost * base.errors
            other = invariances.replace(few, theta=theta)
            said = invariances.violations(few, other, "split", truth)
            assert (said != []) == wrong
    assert np.isclose(integrate.quad(stats.t.pdf, 6.567, np.inf, (10,))[0], 3.167e-5, 1e-3)


def test_initial_states_of_outputs_in_other_units_are_the_same():
    """Squared errors of metres and radians do not add up."""
    one = invariances.experiment(5)  # two masses
    free_runs = []
    for units in (one.units, invariances.Units((1e3, 1e-3))):
        records = tuple((t, u, y * units.outputs) for t, u, y in one.records)
        scaled = invariances.replace(one, records=records, units=units)
        result = eoi.validate(scaled.model, scaled.made())
        free_runs.append(result.rmse / units.outputs)
    np.testing.assert_allclose(free_runs[1], free_runs[0], rtol=1e-6)


def test_the_strongest_peaks_of_several_records_are_taken_once_in_whatever_order():
    peaks = [Peak(1.0, 9.0, 0.2), Peak(1.1, 7.0, 0.1), Peak(4.0, 8.0, 0.1), Peak(1.3, 2.0, 0.1)]
    assert list(strongest(peaks)) == list(strongest(peaks[::-1])) == [1.0, 4.0, 1.3]
