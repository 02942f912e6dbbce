"""Profile likelihood and block bootstrap, against what is known of simple experiments."""

from dataclasses import replace

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax._status import Status
from eoi_jax.refinement.result import Refinement
from eoi_jax.report.estimate_figures import profile_figure
from eoi_jax.uncertainty.profile_likelihood import Profile

PERIOD, COUNT, NOISE = 0.02, 1000, 1e-3
TIME = np.arange(COUNT) * PERIOD
PLANT = eoi.Plant(
    lambda t, x, u, p: p.gain * u - p.rate * x.y[0],
    {"gain": 2.0, "rate": 1.5},
    units={"rate": "1/s"},
    bounds={"rate": (0.0, 10.0)},
    name="tank",
)
CLEAN = eoi.simulate(PLANT, TIME, np.sin(0.2 * TIME**1.5), hold="linear", substeps=1)


def record(noise: np.ndarray) -> eoi.Record:
    return CLEAN.with_outputs(CLEAN.outputs + NOISE * noise[:, None], "noisy")


def white(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(COUNT)


@pytest.fixture(scope="module")
def refined() -> tuple[eoi.Record, Refinement]:
    measured = record(white(0))
    return measured, eoi.refine(PLANT, measured, substeps=1)


@pytest.fixture(scope="module")
def profiled(refined) -> Profile:
    measured, result = refined
    return eoi.profile(result, measured, "rate", substeps=1)


def test_profile_of_a_well_determined_parameter_is_its_standard_error(refined, profiled: Profile):
    _, result = refined
    low, high = eoi.uncertainty(result).intervals()["rate"]
    # The parabola is exact for a linear model; here its bend is worth an error squared, 1e-3.
    assert profiled.interval == pytest.approx((low, high), abs=0.02 * (high - low))
    assert np.all(profiled.statistic[[0, -1]] >= profiled.threshold)
    assert np.min(profiled.statistic) == profiled.statistic[profiled.values == profiled.estimate]
    assert "effective samples" in str(profiled)


def test_other_parameters_follow_along_the_profile(refined, profiled: Profile):
    """Gain and rate are correlated: with the rate held too high the best gain is too high."""
    _, result = refined
    correlation = eoi.uncertainty(result).correlation[0, 1]
    slope = np.polyfit(profiled.values, profiled.parameters[:, 0], 1)[0]
    errors = result.standard_errors
    # Of white residuals the slope is ρ s_gain/s_rate; 20 blocks know each of these to some 1/√20.
    assert slope == pytest.approx(correlation * errors["gain"] / errors["rate"], rel=0.5)
    np.testing.assert_allclose(profiled.parameters[:, 1], profiled.values, rtol=1e-12)


def test_coloured_residuals_are_worth_fewer_samples(profiled: Profile):
    """AR(1) with a = 0.9 has 19 times the power of white noise at low frequency."""
    from scipy.signal import lfilter

    noise = lfilter([np.sqrt(1 - 0.81)], [1.0, -0.9], white(1))
    measured = record(np.asarray(noise))
    result = eoi.refine(PLANT, measured, substeps=1)
    coloured = eoi.profile(result, measured, "rate", substeps=1)
    # Each within a factor of two: the sandwich has 20 blocks.
    assert 0.5 < profiled.samples / COUNT < 2.0
    assert coloured.samples < 0.25 * COUNT


def test_a_profile_goes_as_far_as_its_threshold_and_no_further(profiled: Profile):
    """One point beyond it on each side; the ends lie between the last two, by the root of D."""
    below = profiled.values < profiled.estimate
    beyond = profiled.statistic >= profiled.threshold
    assert np.count_nonzero(below & beyond) == np.count_nonzero(~below & beyond) == 1
    root = np.sqrt(profiled.statistic) * np.where(below, -1.0, 1.0)
    ends = np.interp(np.sqrt(profiled.threshold) * np.array([-1.0, 1.0]), root, profiled.values)
    np.testing.assert_allclose(profiled.interval, ends, rtol=1e-12)
    error = profiled.standard_error
    steps = np.diff(profiled.values) / (np.sqrt(profiled.threshold) * error)
    np.testing.assert_allclose(steps, 0.5, rtol=1e-9)  # of the half width by the parabola


def test_an_interval_ends_at_a_bound_inside_it(refined):
    measured, result = refined
    error = result.standard_errors["rate"]
    for side, end in ((-1, "below"), (1, "above")):
        bound = result.parameters["rate"] + side * 0.7 * error
        limits = (bound, 10.0) if side < 0 else (0.0, bound)
        plant = eoi.Plant(PLANT.dynamics, result.parameters, bounds={"rate": limits}, name="tank")
        found = eoi.profile(replace(result, plant=plant), measured, "rate", substeps=1)
        (note,) = found.notes
        assert note == f"open {end}: the bound {bound:g} lies inside the interval"
        assert found.interval[(side + 1) // 2] == bound
        assert np.isfinite(found.interval[(1 - side) // 2])
        assert bound == (found.values[0] if side < 0 else found.values[-1])


def test_wrong_calls_of_profile_are_named(refined):
    measured, result = refined
    with pytest.raises(ValueError, match="Did you mean `rate`"):
        eoi.profile(result, measured, "rat")
    with pytest.raises(ValueError, match="`level` must lie in"):
        eoi.profile(result, measured, "rate", level=95.0)
    lost = replace(result, status=Status("diverged", "it does not stay finite"))
    with pytest.raises(ValueError, match="`refinement` must have an answer"):
        eoi.profile(lost, measured, "rate")
    unknown = replace(result, covariance=np.full((2, 2), np.nan))
    with pytest.raises(ValueError, match="`name` must have a finite standard error"):
        eoi.profile(unknown, measured, "rate")
    one = eoi.Plant(PLANT.dynamics, result.parameters, fixed=("gain",))
    with pytest.raises(ValueError, match="another free parameter"):
        eoi.profile(replace(result, plant=one), measured, "rate")


def test_figure_of_a_profile_shows_both_and_the_threshold(profiled: Profile):
    (axes,) = profile_figure(profiled).axes
    assert [line.get_label() for line in axes.get_lines()[:3]] == [
        "from the standard error", "profile", "95 %",
    ]  # fmt: skip
    assert axes.get_xlabel() == "rate [1/s]"
    assert profiled.plot() is not None


# -- bootstrap --------------------------------------------------------------------------------


def loaded(seed: int) -> eoi.Record:
    """A run under a load that is not measured: noise that instruments are not asked to cure."""
    long = np.arange(6 * COUNT) * PERIOD
    drive = np.sin(0.2 * long**1.3)
    load = np.random.default_rng(seed).standard_normal(len(long))
    load = 0.1 * np.convolve(load, np.ones(10) / 10, "same")
    moved = eoi.simulate(PLANT, long, drive + load, hold="linear", substeps=1)
    return eoi.Record(long, drive, moved.outputs, "long", hold="linear")


@pytest.fixture(scope="module")
def identified() -> tuple[eoi.Record, eoi.Identification]:
    measured = loaded(0)
    return measured, eoi.identify(PLANT, measured)


def test_bootstrap_errors_are_near_the_scatter_of_repeated_experiments(identified):
    measured, result = identified
    drawn = eoi.bootstrap(result, measured, resamples=200)
    again = [eoi.identify(PLANT, loaded(seed)).parameters for seed in range(30)]
    assert drawn.parameters == result.parameters
    for name, error in drawn.standard_errors.items():
        scatter = np.std([one[name] for one in again], ddof=1)
        # Of some 40 blocks and of 30 runs, 1/√80 and 1/√58: 17 % together, three times that.
        assert 0.6 < error / scatter < 1.7
    low, high = drawn.intervals()["rate"]
    assert low < result.parameters["rate"] < high
    assert drawn.draws is not None
    assert drawn.draws.shape == (200, 2)


def test_bootstrap_repeats_by_its_seed_and_carries_over_to_other_quantities(identified):
    measured, result = identified
    one, same, other = (
        eoi.bootstrap(result, measured, resamples=np.int64(30), seed=s) for s in (1, 1, 2)
    )
    np.testing.assert_array_equal(one.draws, same.draws)
    assert np.any(np.asarray(one.draws) != np.asarray(other.draws))
    static = one.physical(lambda p: {"static": p.gain / p.rate})
    assert static.draws is not None
    np.testing.assert_allclose(static.draws[:, 0], one.draws[:, 0] / one.draws[:, 1])  # type: ignore[index]
    low, high = static.intervals()["static"]
    assert low < static.parameters["static"] < high


def test_an_estimate_by_instruments_is_not_resampled():
    """Resamples are of plain passes: their interval would be that of another estimator."""
    measured = record(white(0))
    cured = eoi.identify(PLANT, measured, instruments=True)
    with pytest.raises(ValueError, match=r"plain passes.*got one by instrumental.*`uncertainty`"):
        eoi.bootstrap(cured, measured)


def test_wrong_calls_of_bootstrap_are_named(identified):
    measured, result = identified
    with pytest.raises(ValueError, match="`resamples` must be an integer ≥ 20"):
        eoi.bootstrap(result, measured, resamples=3)
    lost = replace(result, status=Status("no_data", "nothing to score"))
    with pytest.raises(ValueError, match="`estimate` must be one with an answer"):
        eoi.bootstrap(lost, measured)
    still = measured.with_outputs(0.0 * measured.outputs, "still")
    with pytest.raises(ValueError, match="at least half of the resamples"):
        eoi.bootstrap(result, still, resamples=20)
