"""Refinement with the controller in the loop."""

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.models.augmented import augmented, place
from eoi_jax.models.sampled_states import SampledStates
from tests.simulation.closed_loops import TRUTH, WRONG, controller, double, measured


@pytest.fixture(scope="module")
def refined():
    return eoi.refine(double(**WRONG), measured(noise=1e-3), validation=measured(2, noise=1e-3),
                      controller=controller())  # fmt: skip


def test_the_truth_comes_out_of_whole_records(refined):
    assert refined.status.code == "converged"
    assert refined.window is None
    assert refined.in_loop
    for name, value in TRUTH.items():
        assert abs(refined.parameters[name] - value) < 4.0 * refined.standard_errors[name]
        assert refined.standard_errors[name] < 2e-3 * value


def test_the_result_is_one_of_the_plant_alone(refined):
    assert refined.plant.inputs == ("current",)
    assert refined.plant.internal is None
    assert refined.nominal.parameters == WRONG
    assert refined.starts[0].z.shape == (0,)
    assert refined.records[0].input_names == ("current",)
    assert refined.engine.name == "native"
    assert "with the controller in the loop" in str(refined)


def test_without_noise_the_truth_is_exact():
    better = eoi.refine(double(**WRONG), measured(), controller=controller())
    assert better.parameters == pytest.approx(TRUTH, rel=1e-6)


def test_windows_that_are_asked_for_have_the_controller_too():
    better = eoi.refine(double(**WRONG), measured(noise=1e-3), window=5.0, controller=controller())
    assert better.window == pytest.approx(5.0, rel=0.01)
    for name, value in TRUTH.items():
        assert abs(better.parameters[name] - value) < 4.0 * better.standard_errors[name]


@pytest.mark.slow
@pytest.mark.long
def test_standard_errors_know_that_the_errors_are_coloured():
    errors = []
    for seed in range(20):
        record = measured(100 + seed, noise=1e-2)
        fit = eoi.refine(double(), record, controller=controller())
        errors.append([(fit.parameters[name] - value) / fit.standard_errors[name]
                       for name, value in TRUTH.items()])  # fmt: skip
    # 20 records: the rms of a standard normal errs by 16 %; three such are 0.5 to 1.5.
    assert np.all(np.abs(np.sqrt(np.mean(np.square(errors), axis=0)) - 1.0) < 0.5)


def test_a_result_is_saved_and_loaded(refined, tmp_path):
    path = tmp_path / "refined.npz"
    refined.save(path)
    again = eoi.load(path, plant=double())
    assert again.in_loop
    assert again.parameters == refined.parameters


def test_a_profile_has_the_same_controller(refined):
    record = measured(noise=1e-3)
    profile = eoi.profile(refined, record, "b", controller=controller())
    low, high = profile.interval
    assert low < TRUTH["b"] + 0.005
    assert high > TRUTH["b"] - 0.005
    with pytest.raises(ValueError, match="must be the one of the refinement"):
        eoi.profile(refined, record, "b")


def test_effects_are_not_tried_in_the_loop(refined):
    with pytest.raises(ValueError, match="with the controller in the loop"):
        eoi.remaining(refined)


@pytest.mark.slow
@pytest.mark.parametrize("c", [0.5, 1.2])
def test_where_the_loop_is_lost_at_the_start_windows_come_first(c):
    # So little drive that the recorded gains do not hold the plant.
    record = measured(noise=1e-3)
    better = eoi.refine(double(c=c), record, controller=controller())
    assert better.status.code == "converged"
    assert better.window is None
    assert better.nominal.parameters["c"] == c
    assert better.before[0] > 100.0
    assert better.residual_before[0].shape == record.outputs.shape
    assert any(note.startswith("The loop is lost") for note in better.notes)
    for name, value in TRUTH.items():
        assert abs(better.parameters[name] - value) < 4.0 * better.standard_errors[name]


@pytest.mark.slow
def test_several_starts_have_the_controller_too():
    starts = [{"a": 15.0, "b": 0.3, "c": 6.0}, {"a": 30.0, "b": 2.0, "c": 5.0}]
    better = eoi.refine(double(**WRONG), measured(count=500), starts=starts,
                        controller=controller())  # fmt: skip
    assert better.parameters == pytest.approx(TRUTH, rel=1e-6)


def test_results_draw_themselves(refined):
    refined.plot()
    eoi.validate(refined.plant, measured(noise=1e-3), controller=controller()).plot()
    plt.close("all")


def test_passes_and_effects_do_not_follow_sampled_states():
    sampled = SampledStates(lambda t, x, u, p: u, 1, 0.01)
    plant = eoi.Plant(
        lambda t, x, u, p: p.b * x.z[0] - x.y[0], {"b": 1.0},
        internal=lambda t, x, u, p: jnp.array([0.0, -1.0]), internal_initial=[0.0, 0.0],
        sampled=sampled,
    )  # fmt: skip
    record = measured().without_inputs("r")
    with pytest.raises(ValueError, match="must have no states that change at samples: passes"):
        eoi.identify(plant, record)
    effect = place(plant, eoi.effects.CubicDamping(), 0)
    with pytest.raises(ValueError, match="for effects to be added"):
        augmented(plant, [effect], dict.fromkeys(effect.names, 1.0))


def test_a_reference_too_many_is_named_with_what_to_do():
    with pytest.raises(ValueError, match=r'Leave the others out: `record.without_inputs\("r"\)`'):
        eoi.identify(double(), measured())
