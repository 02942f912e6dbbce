"""`compare`: the same report for every method, whatever one of them does."""

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax import comparators
from eoi_jax._status import Status
from eoi_jax.comparison.compare import common_index

TIME = np.arange(0.0, 12.0, 2e-3)


@pytest.fixture(scope="module")
def plant() -> eoi.Plant:
    return eoi.plants.mass_spring_damper()


@pytest.fixture(scope="module")
def truth() -> dict[str, float]:
    return eoi.plants.mass_spring_damper(true=True).parameters


@pytest.fixture(scope="module")
def record(plant: eoi.Plant, truth: dict[str, float]) -> eoi.Record:
    u = eoi.excitation.square(TIME, amplitude=1.0, frequency=0.5)
    return eoi.simulate(plant.with_parameters(truth), TIME, u)


@pytest.fixture(scope="module")
def held(plant: eoi.Plant, truth: dict[str, float]) -> eoi.Record:
    u = eoi.excitation.prbs(TIME, amplitude=1.0, switching_period=0.2, seed=2)
    return eoi.simulate(plant.with_parameters(truth), TIME, u)


class Given(comparators.AbstractComparator):
    """Answers with what it was given."""

    description = "parameters by hand"

    def __init__(self, name: str, values: dict[str, float] | None, status: str = "converged"):
        self.name = name  # type: ignore[misc]
        self.values, self.status = values, status

    def estimate(self, plant, records) -> comparators.Estimate:
        return comparators.Estimate(self.values, None, Status(self.status, "by hand"))


class Raises(comparators.AbstractComparator):
    """Raises what it was given."""

    name = "raises"
    description = "fails"

    def __init__(self, error: BaseException):
        self.error = error

    def estimate(self, plant, records) -> comparators.Estimate:
        raise self.error


@pytest.fixture(scope="module")
def result(plant, record, held, truth) -> eoi.Comparison:
    return eoi.compare(plant, record, held, truth)


# -- the report -----------------------------------------------------------------------------------


def test_every_method_is_a_row_with_the_same_scores(result: eoi.Comparison):
    assert [one.method for one in result.entries] == [one.name for one in comparators.standard()]
    for one in result.entries:
        assert one.status.ok, one.status
        assert np.all(np.isfinite(one.rmse))
        assert np.all(np.isfinite(one.windows))
        assert np.all(np.isfinite(one.index))
        assert one.seconds > 0.0
        assert one.first_seconds > 0.0


def test_clean_record_ranks_the_methods_as_their_theory_says(result: eoi.Comparison):
    def worst(method: str) -> float:
        found = result[method].errors
        assert found is not None
        return max(abs(value) for value in found.values())

    # Output error is exact, a pass errs by its step, a lag or a chattering relay by much more.
    assert worst("refined") < 1e-8
    assert worst("output_error") < 1e-8
    assert worst("plain_implicit") < 1e-4
    assert worst("svf") < 1e-3
    assert worst("svf_iv") < 1e-3
    assert 1e-3 < worst("plain_explicit") < 0.3
    assert 1e-2 < worst("vss_direct") < 1.0


def test_instruments_are_as_good_as_output_error_for_a_linear_plant(plant, record):
    rng = np.random.default_rng(5)
    sigma = 1e-2 * np.sqrt(np.mean(record.outputs**2))
    y = record.outputs + sigma * rng.standard_normal(record.outputs.shape)
    methods = [comparators.StateVariableInstruments(), comparators.OutputError()]
    own, best = eoi.compare(plant, record.with_outputs(y, "noisy"), methods=methods).entries
    assert own.parameters is not None
    assert best.parameters is not None
    assert best.standard_errors is not None
    # The ends of the record, which W costs, and what lies beyond its band.
    for key, error in best.standard_errors.items():
        assert abs(own.parameters[key] - best.parameters[key]) < error


def test_the_table_names_every_method_and_how_it_ended(result: eoi.Comparison):
    text = str(result)
    for one in result.entries:
        assert f"- {one.method}: {one.status}" in text
    assert "held-out" in text
    assert "worst error" in text
    assert max(len(line) for line in text.splitlines()) < 200


def test_the_figure_has_a_panel_for_each_score(result: eoi.Comparison):
    figure = result.plot()
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert len(titles) == 3
    assert titles[1].startswith("free-run rmse, held out")
    labels = [tick.get_text() for tick in figure.axes[0].get_yticklabels()]
    assert labels == [one.method for one in result.entries]


def test_a_comparison_comes_back_from_its_file(result: eoi.Comparison, tmp_path):
    result.save(tmp_path / "comparison.npz")
    again = eoi.load(tmp_path / "comparison.npz")
    assert str(again) == str(result)


def test_an_unknown_method_lists_the_known_ones(result: eoi.Comparison):
    with pytest.raises(ValueError, match=r"plain_implicit.*Did you mean `svf_iv`"):
        result["svf_vi"]


# -- the common index -----------------------------------------------------------------------------


def test_common_index_is_that_of_identify_at_fixed_parameters(plant, record, truth):
    index = common_index(plant, record)
    own = eoi.identify(plant, record)
    near = plant.with_parameters(truth)
    other = eoi.identify(near, record, own.observer, own.lowpass, passes=1)
    np.testing.assert_allclose(index.score(truth), other.index[0], rtol=1e-9)
    np.testing.assert_allclose(index.score(plant.parameters), own.index[0], rtol=1e-9)


def test_common_index_does_not_know_the_method(plant, record, truth):
    methods = [Given("one", truth), Given("two", truth), comparators.PlainExplicit()]
    found = eoi.compare(plant, record, methods=methods)
    np.testing.assert_array_equal(found["one"].index, found["two"].index)
    assert found["one"].index < found["plain_explicit"].index


def test_scores_of_an_answer_are_those_of_validate_and_of_its_distance_to_the_truth(
    plant, record, held
):
    """Relative to the truth's size, whatever its sign; to one where it is zero."""
    values = {"alpha": 150.0, "beta": 12.0, "rho": 1.5}
    truth = {"alpha": -200.0, "beta": 0.0, "rho": 2.0}
    found = eoi.compare(plant, record, held, truth, [Given("given", values)])
    assert found["given"].errors == {"alpha": 1.75, "beta": 12.0, "rho": -0.25}
    at = plant.with_parameters(values)
    np.testing.assert_allclose(found["given"].rmse, eoi.validate(at, held).rmse, rtol=1e-9)
    assert found.window is not None
    windows = eoi.validate(at, held, window=found.window).rmse
    np.testing.assert_allclose(found["given"].windows, windows, rtol=1e-9)


# -- whatever a method does -----------------------------------------------------------------------


def test_one_method_that_raises_costs_its_own_row_only(plant, record, truth):
    methods = [Raises(RuntimeError("no licence")), Given("given", truth)]
    found = eoi.compare(plant, record, truth=truth, methods=methods)
    assert found["raises"].status.code == "failed"
    assert "RuntimeError: no licence" in found["raises"].status.message
    assert found["raises"].parameters is None
    assert np.all(np.isnan(found["raises"].rmse))
    assert found["given"].errors == dict.fromkeys(truth, 0.0)
    assert "no licence" in str(found)
    assert found.plot() is not None


def test_an_interrupt_passes(plant, record):
    with pytest.raises(KeyboardInterrupt):
        eoi.compare(plant, record, methods=[Raises(KeyboardInterrupt())])


def test_an_answer_without_all_parameters_is_a_failure(plant, record):
    found = eoi.compare(plant, record, methods=[Given("part", {"alpha": 1.0})])
    assert found["part"].status.code == "failed"
    assert "must name all of alpha, beta, rho" in found["part"].status.message


def test_an_estimate_that_is_not_finite_is_no_answer(plant, record, truth):
    found = eoi.compare(plant, record, methods=[Given("nan", {**truth, "rho": np.nan})])
    assert found["nan"].status.code == "diverged"
    assert found["nan"].parameters is None


def test_a_start_whose_free_run_diverges_stops_output_error_alone(plant, record):
    wild = plant.with_parameters({"alpha": -1e5, "beta": -1e3})
    methods = [comparators.OutputError(), comparators.Refined()]
    found = eoi.compare(wild, record, methods=methods)
    assert found["output_error"].status.code == "diverged"
    assert found["refined"].status.ok


def test_an_estimate_that_diverges_scores_infinity(plant, record, held, truth):
    found = eoi.compare(plant, record, held, methods=[Given("wild", {**truth, "beta": -1e3})])
    assert np.isinf(found["wild"].rmse[0])


def test_a_held_out_record_shorter_than_the_initial_window_is_scored_from_its_middle(
    plant, record, held, truth
):
    found = eoi.compare(plant, record, held[:30], methods=[Given("given", truth)])
    assert np.isfinite(found["given"].rmse[0])
    assert np.isnan(found["given"].windows[0])
    assert found.window is None
    assert any("too short for windows" in note for note in found.notes)


def test_held_out_records_may_have_different_sample_periods(plant, record, held, truth):
    time = np.arange(0.0, 12.0, 2e-2)
    slow = eoi.simulate(
        plant.with_parameters(truth), time, np.sin(2.0 * time), hold="linear", substeps=4
    )
    for several in ([held, slow], [slow, held]):
        found = eoi.compare(plant, record, several, methods=[Given("given", truth)])
        assert found.window == pytest.approx(1.2)
        assert found["given"].windows[0] < 1e-6
        assert not found.notes


def test_a_held_out_record_that_cannot_be_scored_is_a_note(plant, record, held, truth):
    never = eoi.Record(held.time, held.inputs, held.outputs, burn_in=1e3)
    found = eoi.compare(plant, record, never, methods=[Given("given", truth)])
    assert np.isnan(found["given"].rmse[0])
    assert np.isfinite(found["given"].index[0])
    assert any("valid samples after the first" in note for note in found.notes)


def test_a_record_of_the_fit_cannot_judge(plant, record):
    with pytest.raises(ValueError, match=r"must not be one of the records of the fit.*split"):
        eoi.compare(plant, record, record, methods=["svf"])
    with pytest.raises(ValueError, match=r"must not hold samples that the fit sees"):
        eoi.compare(plant, record, record[100:], methods=["svf"])


def test_without_held_out_records_it_says_so(plant, record, truth):
    found = eoi.compare(plant, record, methods=[Given("given", truth)])
    assert not found.held_out
    assert "free runs on the records of the fit" in str(found)
    assert found["given"].errors is None


# -- wrong calls ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"methods": []}, "`methods` must hold at least one comparator"),
        ({"methods": [Given("a", None), Given("a", None)]}, "`methods` must have different names"),
        ({"truth": {"alfa": 1.0}}, r"`truth` must be one of alpha, beta, rho.*`alpha`"),
        ({"validation": []}, "`validation` must hold at least one record"),
    ],
)
def test_wrong_calls_say_what_to_do(plant, record, arguments, message):
    with pytest.raises(ValueError, match=message):
        eoi.compare(plant, record, **arguments)
