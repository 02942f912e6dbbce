"""Results survive a file, without pickle and without running anything on the way back."""

import collections.abc
import dataclasses
import importlib
import inspect
import json
import pickle
import pkgutil
import subprocess
import sys
import typing
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.models.augmented import augmented, place
from eoi_jax.models.storage import _Arrays, _encode
from eoi_jax.models.stored_classes import CLASSES, FUNCTIONS, class_named, function_named, tag_of

FORMER = Path(__file__).parent / "stored" / "format_3"


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


def test_a_result_is_no_json_file(result, tmp_path):
    rule = r"`path` must not end in \.json, where `load` expects a model, got .*Take \.npz for a"
    with pytest.raises(ValueError, match=rule):
        result.save(tmp_path / "run.json")
    assert not list(tmp_path.iterdir())


def test_a_result_is_equal_to_itself_only_and_shows_its_table(result, record):
    again = eoi.identify(eoi.plants.mass_spring_damper(), record, passes=3)
    assert result == result
    assert result != again
    assert len({result, again}) == 2
    assert repr(result) == str(result)
    judged = eoi.validate(result, record)
    assert repr(judged) == str(judged)
    assert judged == judged
    assert "array(" not in repr((result, judged))


def test_a_loaded_result_has_the_same_numbers_and_prints_the_same(result, tmp_path):
    result.save(tmp_path / "run.npz")
    back = eoi.load(tmp_path / "run.npz")
    assert back.parameters == result.parameters
    assert str(back) == str(result)
    np.testing.assert_array_equal(back.index, result.index)
    np.testing.assert_array_equal(back.residual[0], result.residual[0])
    np.testing.assert_array_equal(back.records[0].outputs, result.records[0].outputs)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """One of every kind, by class."""
    time = np.arange(1500) * 4e-3
    true = eoi.plants.mass_spring_damper(true=True)
    drives = (eoi.excitation.square(time, 1.0, hertz) for hertz in (0.5, 0.8))
    record, held_out = (eoi.simulate(true, time, drive) for drive in drives)
    table = np.column_stack([time, record.inputs, record.outputs])
    file = tmp_path_factory.mktemp("data") / "run.csv"
    np.savetxt(file, table, delimiter=",", header="time,voltage,angle", comments="")
    plant, name = eoi.plants.mass_spring_damper(), "alpha"
    noise = 1e-4 * np.random.default_rng(0).standard_normal(record.outputs.shape)
    noisy = record.with_outputs(record.outputs + noise, "noisy")
    one, fitted = eoi.identify(plant, record, passes=3), eoi.refine(plant, noisy)
    every = (
        record.smooth(200.0).resample(2),
        one,
        fitted,
        eoi.validate(plant, [record, held_out]),
        eoi.diagnose(one),
        eoi.uncertainty(one),
        eoi.profile(fitted, noisy, name),
        eoi.remaining(fitted, validation=held_out),
        eoi.discover(plant, record, held_out, effects=["coulomb_friction"]),
        eoi.compare(plant, record, methods=[eoi.comparators.StateVariableFilter()]),
        eoi.inspect(file),
    )
    return {type(one): one for one in every}


EXPORTED = [
    item
    for item in (getattr(eoi, name) for name in dir(eoi))
    if isinstance(item, type) and hasattr(item, "plot")
]


def test_the_status_of_an_earlier_version_has_its_name_of_today():
    """A discovery that is complete was called explained."""
    assert eoi.load(FORMER / "discovery.npz").status.code == "complete"


@pytest.mark.parametrize("kind", EXPORTED, ids=lambda kind: kind.__name__)
def test_every_result_survives_a_file(results, kind, tmp_path):
    result = results[kind]
    result.save(tmp_path / "result.npz")
    back = eoi.load(tmp_path / "result.npz")
    assert type(back) is kind
    assert str(back) == str(result)
    (tree, arrays), (own_tree, own_arrays) = stored(back), stored(result)
    assert tree == own_tree
    for key, array in own_arrays.items():
        np.testing.assert_array_equal(arrays[key], array)


def stored(result):
    """All that a file holds of a result, as text: NaN is equal to NaN."""
    arrays = _Arrays()
    return json.dumps(_encode(result, arrays)), arrays.by_key


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


@dataclasses.dataclass(frozen=True)
class Rate:
    """A model may be an object; this one is a dataclass of the user's own."""

    factor: float

    def __call__(self, t, x, u, p):
        return self.factor * (u - x.z)


# Every function is a lambda of this module: one name for all.
WHOLE = eoi.Plant(
    lambda t, x, u, p: p.gain * x.z[0] - p.rate * x.y[0],
    {"gain": 1.5, "rate": 2.0},
    internal=lambda t, x, u, p: 5.0 * (u - x.z),
    internal_initial=lambda p: jnp.zeros(1),
    actuator=lambda t, u, p: 0.5 * u,
)


@pytest.fixture(scope="module")
def drawn():
    time = np.arange(2000) * 1e-2
    return eoi.simulate(WHOLE, time, eoi.excitation.square(time, 1.0, 0.5))


def test_every_function_of_the_given_plant_is_restored_in_its_place(drawn, tmp_path):
    plant = WHOLE.with_parameters({"gain": 1.0})
    result = eoi.identify(plant, drawn, passes=2)
    result.save(tmp_path / "own.npz")
    back = eoi.load(tmp_path / "own.npz", plant=plant)
    for key in ("dynamics", "internal", "internal_initial", "actuator"):
        assert getattr(back.plant, key) is getattr(plant, key)
        assert getattr(back.nominal, key) is getattr(plant, key)
    before, after = (eoi.validate(one.plant, drawn).rmse for one in (result, back))
    np.testing.assert_array_equal(before, after)


@pytest.mark.slow
def test_functions_inside_an_augmented_plant_are_restored_too(drawn, tmp_path):
    placed = (
        place(WHOLE, eoi.effects.CoulombFriction(), 0),
        place(WHOLE, eoi.effects.InputDelay(), 0),
    )
    values = {name: 0.1 for one in placed for name in one.names}
    plant = augmented(WHOLE, placed, values)
    result = eoi.identify(plant, drawn, passes=1, transient=1.0)
    result.save(tmp_path / "more.npz")
    for given in (WHOLE, plant):
        assert eoi.load(tmp_path / "more.npz", plant=given).nominal == plant
    with pytest.raises(ValueError, match="`plant` must be given to `load`"):
        eoi.validate(eoi.load(tmp_path / "more.npz").plant, drawn)


def test_a_model_that_is_an_object_is_given_again_on_loading(drawn, tmp_path):
    plant = eoi.Plant(WHOLE.dynamics, WHOLE.parameters, internal=Rate(5.0), internal_initial=[0.0])
    eoi.identify(plant, drawn, passes=1).save(tmp_path / "object.npz")
    assert eoi.load(tmp_path / "object.npz", plant=plant).plant.internal.function == Rate(5.0)


@pytest.mark.parametrize(
    ("field", "changes", "shown"),
    [
        ("parameters", {"parameters": {"gain": 1.0, "speed": 1.0}}, "gain, rate, got gain, speed"),
        ("degrees", {"relative_degree": 2}, "1, got 2"),
        ("inputs", {"inputs": ("voltage",)}, "u, got voltage"),
        ("outputs", {"outputs": ("angle",)}, "y, got angle"),
        ("internal", {"internal": None, "internal_initial": None}, "a function, got none"),
        ("internal_initial", {"internal_initial": [0.0]}, "a function, got 1 value"),
        ("actuator", {"actuator": None}, "a function, got none"),
    ],
)
def test_another_plant_is_refused_and_what_differs_is_named(drawn, tmp_path, field, changes, shown):
    eoi.identify(WHOLE, drawn, passes=1).save(tmp_path / "own.npz")
    whole = {
        "dynamics": lambda t, x, u, p: p.gain * u - x.y[0],
        "parameters": WHOLE.parameters,
        "internal": WHOLE.internal,
        "internal_initial": WHOLE.internal_initial,
        "actuator": WHOLE.actuator,
    }
    with pytest.raises(ValueError, match=rf"`plant\.{field}` must be as in the file, {shown}"):
        eoi.load(tmp_path / "own.npz", plant=eoi.Plant(**{**whole, **changes}))


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
    tree = {"format": 3, "version": "0", "result": {"class": name, "fields": {}}}
    np.savez(tmp_path / "forged.npz", eoi_jax=np.asarray(json.dumps(tree)))
    with pytest.raises(ValueError, match="must hold results of eoi_jax only"):
        eoi.load(tmp_path / "forged.npz")


@pytest.mark.parametrize(("number", "advice"), [(99, "Update"), (1, "Compute the result again")])
def test_a_file_of_another_format_says_so(tmp_path, number, advice):
    tree = {"format": number, "version": "9.9", "result": None}
    np.savez(tmp_path / "other.npz", eoi_jax=np.asarray(json.dumps(tree)))
    with pytest.raises(ValueError, match=rf"format {number}, written by eoi_jax 9\.9.*{advice}"):
        eoi.load(tmp_path / "other.npz")


def test_an_unwritable_place_leaves_nothing(result, tmp_path):
    with pytest.raises(ValueError, match="`path` must be writable"):
        result.save(tmp_path / "no_folder" / "run.npz")
    assert list(tmp_path.iterdir()) == []


def test_jax_arrays_are_stored_as_arrays(tmp_path):
    from eoi_jax.models.storage import save

    save({"a": jnp.arange(3.0), "b": (1, [2.5, None])}, tmp_path / "x.npz")
    back = eoi.load(tmp_path / "x.npz")
    np.testing.assert_array_equal(back["a"], [0.0, 1.0, 2.0])
    assert back["b"] == (1, [2.5, None])


# -- files of other versions ------------------------------------------------------------------


# Fields that these files do not have, with the defaults that they are read with.
LATER_FIELDS = {
    "kind_items": {"tuple": []},
    "start_items": {"tuple": []},
    "hold_declared": True,
    "output": {"tuple": []},
    "common_factors": {"tuple": []},
    "at_input": {"tuple": []},
    "window": None,
    "lower": None,
    "upper": None,
    "history": None,
    "probability": None,
    "repeats": None,
    "denied": {"tuple": []},
    "reason": "",
    "rivals": {"tuple": []},
    "test_before": None,
    "test_after": None,
    "test_windows_before": None,
    "test_windows_after": None,
    "wraps": None,
    "further_shapes": {"tuple": []},
    "codes": {"tuple": []},
    "scattered": False,
}
# Words that have changed since.
LATER_WORDS = {("code", "explained"): "complete"}


def tags(tree):
    """Names of classes, effects and functions in a stored tree."""
    if isinstance(tree, dict):
        for key in ("class", "effect", "function"):
            if isinstance(tree.get(key), str):
                yield tree[key]
        tree = list(tree.values())
    for part in tree if isinstance(tree, list) else ():
        yield from tags(part)


def content(tree):
    """A stored tree without the names that were given to classes and functions."""
    if isinstance(tree, list):
        return [content(part) for part in tree]
    if not isinstance(tree, dict):
        return tree
    names = {"class", "function"} if "name" not in tree else {"class", "function", "effect"}
    return {
        key: "a name" if key in names else _word(key, content(part))
        for key, part in tree.items()
        if LATER_FIELDS.get(key) != part or key not in LATER_FIELDS
    }


def _word(key, part):
    return LATER_WORDS.get((key, part), part) if isinstance(part, str) else part


@pytest.mark.parametrize("path", sorted(FORMER.iterdir()), ids=lambda path: path.stem)
def test_files_of_the_version_that_named_classes_by_their_modules_are_read(path, tmp_path):
    with np.load(path) as file:
        before = json.loads(str(file["eoi_jax"]))
    assert before["format"] == 3
    assert any(":" in name for name in tags(before["result"]))
    back = eoi.load(path)
    tree, _ = stored(back)
    assert content(json.loads(tree)) == content(before["result"])
    assert not any(":" in name for name in tags(json.loads(tree)))


def test_plants_of_a_former_file_are_those_of_the_library():
    for name, plant in eoi.load(FORMER / "library.npz").items():
        assert plant == getattr(eoi.plants, name)()


def package():
    for found in pkgutil.walk_packages(eoi.__path__, "eoi_jax."):
        yield importlib.import_module(found.name)


def mentioned(annotation, kinds):
    """Classes of the package in an annotation."""
    if isinstance(annotation, str):
        return {kind for kind in kinds if kind.__name__ in annotation}
    if isinstance(annotation, type):
        return {annotation} & kinds
    if typing.get_origin(annotation) is collections.abc.Callable:
        return set()
    return {one for part in typing.get_args(annotation) for one in mentioned(part, kinds)}


def test_every_class_that_a_result_may_hold_has_a_tag():
    kinds = {
        item
        for module in package()
        for item in vars(module).values()
        if inspect.isclass(item) and item.__module__.startswith("eoi_jax.")
    }
    waiting, seen = {*EXPORTED, eoi.effects.AbstractEffect}, set()
    while waiting:
        kind = waiting.pop()
        seen.add(kind)
        inside = {one for one in kinds if issubclass(one, kind)}
        for field in dataclasses.fields(kind) if dataclasses.is_dataclass(kind) else ():
            inside |= mentioned(field.type, kinds)
        waiting |= inside - seen
    assert len(seen) > 60
    # A file holds the computed Certainty in place of a deferred one.
    for kind in seen - {importlib.import_module("eoi_jax.estimation.covariance").DeferredCertainty}:
        if not inspect.isabstract(kind):
            assert class_named(tag_of(kind)) is kind


def test_every_tag_names_what_it_is_the_tag_of():
    for tag in CLASSES:
        assert tag_of(class_named(tag)) == tag
    for tag in FUNCTIONS:
        assert tag_of(function_named(tag)) == tag
    with pytest.raises(TypeError, match="Unfinished has no tag: give it one"):
        tag_of(type("Unfinished", (), {"__module__": "eoi_jax.data"}))


# -- results of others ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def parts(result, tmp_path_factory):
    """The tree and the arrays of a stored identification."""
    path = tmp_path_factory.mktemp("whole") / "run.npz"
    result.save(path)
    with np.load(path) as file:
        arrays = dict(file)
    return json.loads(str(arrays.pop("eoi_jax"))), arrays


def forged(folder, tree, arrays):
    path = folder / "forged.npz"
    np.savez(
        path, eoi_jax=np.asarray(tree if isinstance(tree, str) else json.dumps(tree)), **arrays
    )
    return path


def whole(result):
    return {"format": 3, "version": "0", "result": result}


STATUS = {"code": "converged", "message": "all is well"}
DEEP = '{"list": [' * 4000 + "1" + "]}" * 4000


@pytest.mark.parametrize(
    ("tree", "said"),
    [
        (whole({"list": 3}), "its structure is not that of a result: Expected `array`, got `int`"),
        (whole({"list": [], "dict": {}}), "its structure is not that of a result: an object of"),
        (whole({}), "its structure is not that of a result: an object of no key"),
        (whole({"more": 1}), "Object contains unknown field `more`"),
        (whole({"class": "eoi_jax.results:Status"}), "an object of class"),
        (whole({"array": "a0"}), "it has no array a0"),
        (whole({"list": [{"array": "a0"}]}), "it has no array a0"),
        (f'{{"format": 3, "version": "0", "result": {DEEP}}}', "nested too deeply"),
        ("{", "must be a result that `save` wrote"),
        ("[]", "must be a result that `save` wrote"),
        ({"format": "3", "version": "0", "result": 1}, "must be a result that `save` wrote"),
        ({"format": True, "version": "0", "result": 1}, "must be a result that `save` wrote"),
        ({"format": 3, "version": 0, "result": 1}, "must be a result that `save` wrote"),
        (
            whole({"class": "eoi_jax.results:Status", "fields": {**STATUS, "more": 1}}),
            r"must hold a Status of this version, got a field ['more']",
        ),
        (
            whole({"class": "eoi_jax.results:Status", "fields": {"code": "converged"}}),
            "must hold Status.message, got nothing",
        ),
        (
            whole({"class": "eoi_jax.results:Status", "fields": {**STATUS, "code": 1}}),
            "must hold Status.code as it is declared, got int",
        ),
    ],
)
def test_a_structure_that_is_none_of_a_result_is_refused(tree, said, tmp_path):
    with pytest.raises(ValueError, match="`path` must") as caught:
        eoi.load(forged(tmp_path, tree, {}))
    assert said in str(caught.value)


def test_a_whole_status_is_one(tmp_path):
    tree = whole({"class": "eoi_jax.results:Status", "fields": STATUS})
    assert eoi.load(forged(tmp_path, tree, {})) == eoi.Status(**STATUS)


def test_an_array_of_another_kind_or_size_is_refused(parts, tmp_path):
    tree, arrays = parts
    record = tree["result"]["fields"]["records"]["tuple"][0]["fields"]
    key = record["outputs"]["array"]
    assert eoi.load(forged(tmp_path, tree, arrays)).index.ndim == 2
    for wrong in (arrays[key][..., None], arrays[key] + 1j, arrays[key][:-1], np.asarray("text")):
        with pytest.raises(
            ValueError, match=r"must hold Record\.\w+ as it is declared, got an array"
        ):
            eoi.load(forged(tmp_path, tree, {**arrays, key: wrong}))


def test_a_damaged_archive_is_refused_wherever_it_is_cut(result, tmp_path):
    result.save(tmp_path / "run.npz")
    data = (tmp_path / "run.npz").read_bytes()
    for size in np.linspace(0, len(data) - 1, 12).astype(int):
        (tmp_path / "cut.npz").write_bytes(data[:size])
        with pytest.raises(ValueError, match="`path` must be a result that `save` wrote"):
            eoi.load(tmp_path / "cut.npz")


def test_no_module_is_imported_because_a_file_says_so(tmp_path):
    code = (
        "import sys, eoi_jax; before = set(sys.modules)\n"
        "from eoi_jax.models.stored_classes import class_named, function_named\n"
        "assert class_named('eoi_jax.cli.terminal:Outcome') is None\n"
        "assert class_named('eoi_jax.results:EngineUsed') is not None\n"
        "assert function_named('eoi_jax.plants.pendulum:jnp') is None\n"
        "assert 'eoi_jax.cli' not in sys.modules"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_a_result_that_unpacks_to_more_than_is_allowed_is_refused(result, tmp_path):
    result.save(tmp_path / "run.npz")
    with pytest.raises(ValueError, match=r"unpacks to more than 1e-05 GB.*`max_gigabytes`"):
        eoi.load(tmp_path / "run.npz", max_gigabytes=1e-5)
    assert eoi.load(tmp_path / "run.npz", max_gigabytes=np.inf).parameters == result.parameters


def test_what_cannot_be_read_back_is_not_stored():
    with pytest.raises(TypeError, match="cannot store slice"):
        _encode(slice(3), _Arrays())
