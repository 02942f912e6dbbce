"""Results survive a file, without pickle and without running anything on the way back."""

import json
import pickle

import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi


def spring(t, x, u, p):
    y, rate = x.y
    return -p.alpha * y - p.beta * rate + p.rho * u


@pytest.fixture(scope="module")
def record():
    time = np.arange(4001) * 1e-3
    drive = eoi.excitation.square(time, 1.0, 0.5)
    return eoi.simulate(eoi.plants.mass_spring_damper(true=True), time, drive)


@pytest.fixture(scope="module")
def result(record):
    return eoi.identify(eoi.plants.mass_spring_damper(), record, passes=3)


def test_a_loaded_result_has_the_same_numbers_and_prints_the_same(result, tmp_path):
    result.save(tmp_path / "run.npz")
    back = eoi.load(tmp_path / "run.npz")
    assert back.parameters == result.parameters
    assert str(back) == str(result)
    np.testing.assert_array_equal(back.index, result.index)
    np.testing.assert_array_equal(back.residual[0], result.residual[0])
    np.testing.assert_array_equal(back.records[0].outputs, result.records[0].outputs)


def test_a_loaded_result_of_a_known_plant_can_be_used_on(result, record, tmp_path):
    result.save(tmp_path / "run.npz")
    back = eoi.load(tmp_path / "run.npz")
    again = eoi.identify(back.plant, back.records, back.observer, back.lowpass, passes=1)
    assert again.index[0] == pytest.approx(result.index[result.best_pass], rel=1e-6)


def test_a_model_of_the_users_own_is_given_again_on_loading(record, tmp_path):
    own = eoi.Plant(spring, {"alpha": 150.0, "beta": 8.0, "rho": 2.0}, relative_degree=2)
    result = eoi.identify(own, record, passes=2)
    result.save(tmp_path / "own.npz")
    alone = eoi.load(tmp_path / "own.npz")
    assert alone.parameters == result.parameters
    with pytest.raises(ValueError, match=r"`plant` must be given to `load`.*spring"):
        eoi.validate(alone.plant, record)
    whole = eoi.load(tmp_path / "own.npz", plant=own)
    assert eoi.validate(whole.plant, record).fit[0] > 99.0


def test_what_is_no_result_is_refused(tmp_path):
    with pytest.raises(ValueError, match="`path` must be a file"):
        eoi.load(tmp_path / "absent.npz")
    text = tmp_path / "text.npz"
    text.write_text("no archive")
    with pytest.raises(ValueError, match="`path` must be a result that `save` wrote"):
        eoi.load(text)
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(ValueError, match="`path` must be a result that `save` wrote"):
        eoi.load(tmp_path / "other.npz")


def test_a_pickle_in_the_file_is_not_opened(tmp_path):
    hostile = np.empty(1, dtype=object)
    hostile[0] = pickle.dumps(print)
    np.savez(tmp_path / "hostile.npz", eoi_jax=hostile)
    with pytest.raises(ValueError, match="`path` must be a result that `save` wrote"):
        eoi.load(tmp_path / "hostile.npz")


@pytest.mark.parametrize("name", ["os:system", "eoi_jax.cli:main", "eoi_jax.store:os"])
def test_a_class_that_is_no_result_is_refused(tmp_path, name):
    tree = {"format": 1, "version": "0", "result": {"class": name, "fields": {}}}
    np.savez(tmp_path / "forged.npz", eoi_jax=np.asarray(json.dumps(tree)))
    with pytest.raises(ValueError, match="must hold results of eoi_jax only"):
        eoi.load(tmp_path / "forged.npz")


def test_a_file_of_a_newer_version_says_so(tmp_path):
    tree = {"format": 99, "version": "9.9", "result": None}
    np.savez(tmp_path / "new.npz", eoi_jax=np.asarray(json.dumps(tree)))
    with pytest.raises(ValueError, match=r"format 99, written by eoi_jax 9\.9.*Update"):
        eoi.load(tmp_path / "new.npz")


def test_an_unwritable_place_leaves_nothing(result, tmp_path):
    with pytest.raises(ValueError, match="`path` must be writable"):
        result.save(tmp_path / "no_folder" / "run.npz")
    assert list(tmp_path.iterdir()) == []


def test_jax_arrays_are_stored_as_arrays(tmp_path):
    from eoi_jax.store import save

    save({"a": jnp.arange(3.0), "b": (1, [2.5, None])}, tmp_path / "x.npz")
    back = eoi.load(tmp_path / "x.npz")
    np.testing.assert_array_equal(back["a"], [0.0, 1.0, 2.0])
    assert back["b"] == (1, [2.5, None])
