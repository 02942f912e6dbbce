"""A sweep is a loop over `identify`, whatever it is cut into and wherever its chunks run."""

import json
import warnings
from concurrent.futures import Executor, Future, ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import Motion, grid, moved_mass_spring

import eoi_jax as eoi
from eoi_jax.estimation.engines import AbstractEngine, Automatic, Scan
from eoi_jax.estimation.observers import FirstOrder, HighOrder, SecondOrder, SuperTwisting, gains
from eoi_jax.estimation.sweep.sweep import sweep

TRUE = {"alpha": 40.0, "beta": 1.2, "rho": 3.0}
H = 2e-3


def spring(t, x, u, p):
    y, rate = x.y
    return -p.alpha * y - p.beta * rate + p.rho * u


PLANT = eoi.Plant(spring, {"alpha": 30.0, "beta": 1.0, "rho": 2.0}, relative_degree=2)


def run(samples, motion=None, name="run"):
    t = grid(samples, H)
    u, y = moved_mass_spring(t, TRUE, *([motion] if motion else []))
    return eoi.Record(t, u, y, name, hold="smooth")


OTHER = Motion((0.04, 0.03, 0.01), (2.0, 5.0, 11.0), (1.3, 0.1, 2.5))
RECORDS = [run(2500, name="first"), run(1800, OTHER, name="second")]
FILTERS = [eoi.LowPass(20.0), eoi.LowPass(12.0)]
OBSERVERS = [
    SecondOrder(60.0, 2e3, 300.0),
    SecondOrder(60.0, 2e3, 2.0),  # too weak to slide: another estimate, yet the same as identify's
    SuperTwisting(600.0),
]
SETTINGS = {"substeps": 1, "smoothing": False, "transient": 0.8, "passes": 4}


def quick(**changes):
    """Two gain sets on one short record."""
    observers = gains(SecondOrder, {"c1": 60.0, "c2": 2e3, "c3": [300.0, 200.0]})
    given = {"plant": PLANT, "records": RECORDS[1], "observers": observers, "lowpass": FILTERS[0]}
    return sweep(**{**given, "passes": 2, "substeps": 1, "smoothing": False, **changes})


def agrees(lane, one):
    """One lane of a sweep against one identification, but for errors: a lane's are of blocks."""
    taken = len(one.index)
    np.testing.assert_allclose(lane.parameters, list(one.parameters.values()), rtol=1e-9)
    np.testing.assert_allclose(lane["index"][:taken], one.index, rtol=1e-6, atol=1e-20)
    assert np.all(np.isnan(lane["index"][taken:]))
    np.testing.assert_allclose(lane.sliding_fraction, one.sliding_fraction, rtol=1e-12)
    assert int(lane.passes) == taken
    assert int(lane.best_pass) == one.best_pass
    meanings = lane.status.attrs["flag_meanings"].split()
    assert meanings[int(lane.status)] == one.status.code


def same(a, b):
    """Two sweeps, number by number."""
    for name in a.data_vars:
        np.testing.assert_array_equal(a[name], b[name], err_msg=name)


@pytest.fixture(scope="module")
def whole():
    starts = [{}, {"alpha": 55.0, "rho": 4.0}]
    return sweep(PLANT, RECORDS, OBSERVERS, FILTERS, starts=starts, **SETTINGS), starts


@pytest.mark.parametrize("record", range(2))
@pytest.mark.parametrize("lowpass", range(2))
@pytest.mark.parametrize("observer", range(3))
def test_every_lane_is_what_identify_gives(whole, record, lowpass, observer):
    result, starts = whole
    for i, start in enumerate(starts):
        one = eoi.identify(
            PLANT.with_parameters(start),
            RECORDS[record],
            OBSERVERS[observer],
            FILTERS[lowpass],
            **SETTINGS,
        )
        place = {"record": record, "lowpass": lowpass, "observer": observer, "start": i}
        agrees(result.isel(place).sel(resample=0), one)


def test_lanes_on_a_bound_are_what_identify_gives_and_others_do_not_notice():
    truth = TRUE["beta"]
    plant = PLANT.declared_anew({"beta": 1.2 * truth}, bounds={"beta": (1.05 * truth, np.inf)})
    lanes = sweep(plant, RECORDS[0], OBSERVERS[::2], FILTERS[0], **SETTINGS)
    for i, observer in enumerate(OBSERVERS[::2]):
        lane = lanes.isel(record=0, lowpass=0, observer=i, start=0).sel(resample=0)
        agrees(lane, eoi.identify(plant, RECORDS[0], observer, FILTERS[0], **SETTINGS))
        errors = lane.standard_error.values
        np.testing.assert_array_equal(np.isnan(errors), [False, True, False])
    wide = PLANT.declared_anew(bounds={"beta": (0.0, np.inf)})
    starts = [{}, {"beta": 0.0}]  # a start on a bound that does not hold it
    free, kept = (sweep(one, RECORDS[0], OBSERVERS[0], FILTERS[0], starts=starts, **SETTINGS)
                  for one in (PLANT, wide))  # fmt: skip
    same(free, kept)


def test_the_scan_gives_the_same_numbers(whole):
    result, starts = whole
    scanned = sweep(PLANT, RECORDS[1], OBSERVERS[0], FILTERS[0], starts=starts, engine=Scan(),
                    **SETTINGS)  # fmt: skip
    own = result.isel(record=[1], lowpass=[0], observer=[0])
    for name in ("parameters", "index", "common_index"):
        np.testing.assert_allclose(scanned[name], own[name], rtol=1e-7, atol=1e-18)
    assert (scanned.attrs["engine"], scanned.attrs["engine_reason"]) == ("scan", "")


def test_labels_say_which_lane_is_which(whole):
    result, _ = whole
    assert result.sizes["record"] == 2
    assert list(result.record.values) == ["first", "second"]
    assert list(result.cutoff.values) == [20.0, 12.0]
    assert list(result.order.values) == [2, 2]
    assert list(result.kind.values) == ["SecondOrder"] * 2 + ["SuperTwisting"]
    assert result.c3.values[0] == 300.0
    assert np.isnan(result.c3.values[2])
    assert list(result.parameter.values) == ["alpha", "beta", "rho"]
    assert result.theta_0.sel(start=1, parameter="alpha") == 55.0
    assert [name for name in result.coords if name in ("c1", "c2", "c3")] == ["c1", "c2", "c3"]
    assert result.attrs["plant"] == "spring"


def test_chosen_filter_and_observer_are_those_of_identify():
    result = sweep(PLANT, RECORDS[0], passes=3)
    agrees(result.isel(record=0, lowpass=0, observer=0, start=0, resample=0),
           eoi.identify(PLANT, RECORDS[0], passes=3))  # fmt: skip


def test_records_in_one_list_are_estimated_from_together():
    observer, lowpass = OBSERVERS[0], FILTERS[0]
    records = {"both": RECORDS, "second": RECORDS[1]}
    result = sweep(PLANT, records, observer, lowpass, **SETTINGS)
    assert list(result.record.values) == ["both", "second"]
    both = eoi.identify(PLANT, RECORDS, observer, lowpass, **SETTINGS)
    agrees(result.sel(record="both", resample=0).isel(lowpass=0, observer=0, start=0), both)


def test_records_of_the_same_values_are_told_apart_by_how_they_are_read():
    """Steps are kept from one sweep to the next; hold and burn-in are part of them."""
    for changes in ({"hold": "zero"}, {"hold": "linear"}, {"hold": "linear", "burn_in": 2.0}):
        record = replaced(**changes)
        result = sweep(PLANT, record, OBSERVERS[0], FILTERS[0], **SETTINGS)
        one = eoi.identify(PLANT, record, OBSERVERS[0], FILTERS[0], instruments=False, **SETTINGS)
        agrees(result.isel(record=0, lowpass=0, observer=0, start=0, resample=0), one)


def bent(t, x, u, p):
    """Not affine: the stiffness as a power, so that Gauss–Newton overshoots."""
    y, rate = x.y
    return -jnp.exp(p.power) * y - p.beta * rate + p.rho * u


def test_damped_steps_of_a_model_that_is_not_affine_are_each_lanes_own():
    plant = eoi.Plant(bent, {"power": 1.0, "beta": 1.0, "rho": 2.0}, relative_degree=2)
    starts = [{}, {"power": 8.0}, {"power": 3.0}]
    result = sweep(plant, RECORDS[0], OBSERVERS[0], FILTERS[0], starts=starts,
                   passes=8, substeps=1, smoothing=False)  # fmt: skip
    for i, start in enumerate(starts):
        one = eoi.identify(plant.with_parameters(start), RECORDS[0], OBSERVERS[0], FILTERS[0],
                           passes=8, substeps=1, smoothing=False)  # fmt: skip
        agrees(result.isel(record=0, lowpass=0, observer=0, start=i, resample=0), one)


def test_two_outputs_with_gains_of_their_own():
    def pair(t, x, u, p):
        y, rate = x.y
        own = jnp.array([p.k, p.k2])
        return -own * y - jnp.array([0.5, 0.9]) * rate + u

    plant = eoi.Plant(pair, {"k": 30.0, "k2": 50.0}, 2, inputs=("u", "v"), outputs=("y", "w"))
    t = grid(2000, H)
    u1, y1 = moved_mass_spring(t, {"alpha": 40.0, "beta": 0.5, "rho": 1.0})
    u2, y2 = moved_mass_spring(t, {"alpha": 60.0, "beta": 0.9, "rho": 1.0}, OTHER)
    record = eoi.Record(
        t,
        np.stack([u1, u2], 1),
        np.stack([y1, y2], 1),
        input_names=["u", "v"],
        output_names=["y", "w"],
        hold="smooth",
    )
    sets = gains(SecondOrder, {"c1": 60.0, "c2": 2e3, "c3": [[300.0, 200.0], [250.0, 400.0]]})
    result = sweep(plant, record, sets, FILTERS[0], **SETTINGS)
    assert result.c3.dims == ("observer", "output")
    for i, c3 in enumerate(([300.0, 200.0], [250.0, 400.0])):
        one = eoi.identify(plant, record, SecondOrder(60.0, 2e3, c3), FILTERS[0], **SETTINGS)
        agrees(result.isel(record=0, lowpass=0, observer=i, start=0, resample=0), one)


# -- bootstrap ----------------------------------------------------------------------------------


def noisy(samples=20_000, size=1e-3, seed=0):
    """Mass and spring with a load that is not declared: coloured residuals."""
    rng = np.random.default_rng(seed)
    t = grid(samples, H)
    load = np.convolve(rng.normal(size=samples), np.ones(50) / 50, "same")
    u, y = moved_mass_spring(t, TRUE)
    return eoi.Record(t, u + size * load, y, "noisy", hold="smooth")


def test_resamples_scatter_as_the_standard_error_says():
    result = sweep(PLANT, noisy(size=0.5), OBSERVERS[0], FILTERS[0], resamples=200, seed=4,
                   passes=3, substeps=1, smoothing=False)  # fmt: skip
    lane = result.isel(record=0, lowpass=0, observer=0, start=0)
    scatter = lane.parameters.sel(resample=slice(1, None)).std("resample")
    error = lane.standard_error.sel(resample=0)
    # Both are estimates from some tens of blocks: a third of error in each is chance.
    assert np.all(np.abs(np.log(scatter / error)) < np.log(2.0))
    assert len(np.unique(lane.parameters.sel(parameter="alpha"))) == 201


def test_resamples_do_not_depend_on_how_the_sweep_is_cut():
    a = quick(resamples=5, seed=3, chunk=100)
    b = quick(resamples=5, seed=3, chunk=2)
    np.testing.assert_allclose(a.parameters, b.parameters, rtol=1e-12)
    c = quick(resamples=5, seed=4, chunk=2)
    drawn = {"resample": slice(1, None)}
    assert not np.any(np.isclose(a.sel(drawn).parameters, c.sel(drawn).parameters, rtol=1e-12))
    np.testing.assert_array_equal(b.sel(resample=0).parameters, c.sel(resample=0).parameters)


# -- lanes that go wrong ------------------------------------------------------------------------


def test_a_bad_gain_ends_its_own_lane_only():
    sets = gains(SecondOrder, {"c1": 60.0, "c2": 2e3, "c3": [300.0, np.nan, -1.0, 200.0]})
    result = quick(observers=sets).isel(record=0, lowpass=0, start=0, resample=0)
    meanings = result.status.attrs["flag_meanings"].split()
    codes = [meanings[i] for i in result.status.values]
    assert codes[1:3] == ["invalid_gains"] * 2
    assert list(result.ok.values) == [True, False, False, True]
    assert np.all(np.isnan(result.parameters[1:3]))
    assert np.all(np.isnan(result["index"][1:3]))
    same(result.isel(observer=[0, 3]).drop_vars("observer"),
         quick().isel(record=0, lowpass=0, start=0, resample=0))  # fmt: skip


def test_a_start_that_diverges_ends_its_own_lane_only():
    def steep(t, x, u, p):
        y, rate = x.y
        return -p.alpha * y - p.beta * rate + p.rho * u + 1e-9 * jnp.log(p.safe) * y

    plant = eoi.Plant(steep, {"alpha": 30.0, "beta": 1.0, "rho": 2.0, "safe": 1.0}, 2,
                      fixed=("safe",))  # fmt: skip
    result = quick(plant=plant, starts=[{}, {"safe": -1.0}])
    lanes = result.isel(record=0, lowpass=0, observer=0, resample=0)
    meanings = lanes.status.attrs["flag_meanings"].split()
    assert lanes.ok.values[0]
    assert meanings[lanes.status.values[1]] == "diverged"


# -- single precision ---------------------------------------------------------------------------


def test_single_precision_says_what_it_costs():
    double, single = quick(), quick(precision="float32")
    for name, key in (("parameters", "parameters"), ("common_index", "common_index")):
        said = single.attrs[f"float32_error_of_{key}"]
        own = float(np.max(np.abs(single[name] - double[name]) / np.abs(double[name]).max()))
        assert said > 0
        assert own <= 1.001 * said
    assert "float32_error_of_parameters" not in double.attrs


# -- stores -------------------------------------------------------------------------------------


class Failing(AbstractEngine):
    """The usual engine, until it is interrupted."""

    def __init__(self, runs, error: type[BaseException] = KeyboardInterrupt):
        self.left, self.error = runs, error

    def run(self, *args):
        self.left -= 1
        if self.left < 0:
            raise self.error
        return Automatic().run(*args)


def many(**changes):
    sets = gains(SecondOrder, {"c1": 60.0, "c2": 2e3, "c3": np.linspace(150.0, 300.0, 6)})
    return quick(observers=sets, chunk=2, **changes)


def test_an_interrupted_sweep_keeps_what_is_done_and_goes_on_from_there(tmp_path):
    path = tmp_path / "sweep.zarr"
    part = many(store=path, engine=Failing(9))  # a chunk takes four passes
    done = part.ok.values.ravel()
    assert part.attrs["finished"] == 0
    assert 0 < done.sum() < 6
    meanings = part.status.attrs["flag_meanings"].split()
    assert {meanings[i] for i in part.status.values.ravel()[~done]} == {"not_run"}
    counted = Failing(100)
    rest = many(store=path, engine=counted)
    assert rest.attrs["finished"] == 1
    assert 100 - counted.left == 4 * 1 or 100 - counted.left == 4 * 2  # nothing landed runs again
    whole = many()
    same(rest.drop_attrs(), whole.drop_attrs())
    same(eoi.open_sweep(path), whole)
    assert "of 3 chunks came from the store" in rest.attrs["engine_reason"]
    again = many(store=path)
    assert again.attrs["engine"] == "none"
    assert again.attrs["engine_reason"].startswith("3 of 3 chunks came from the store")


def test_without_a_store_an_interrupt_keeps_what_is_done_too():
    part = many(engine=Failing(5))
    assert part.ok.values.sum() == 2


def test_parts_of_one_store_make_the_whole(tmp_path):
    for i in range(3):
        assert many(store=tmp_path / "s", part=(i, 3)).attrs["engine"] == "native"
    assert many(store=tmp_path / "s", part=(7, 8)).attrs["engine"] == "none"  # has no chunk
    same(eoi.open_sweep(tmp_path / "s"), many())


def replaced(**changes):
    """The values of the short record, read in another way."""
    one = RECORDS[1]
    return eoi.Record(one.time, one.inputs, one.outputs, one.name, **{"hold": "smooth", **changes})


def test_a_store_of_another_sweep_is_refused(tmp_path):
    quick(store=tmp_path / "s")
    for changes in (
        {"passes": 3},
        {"records": RECORDS[0]},
        {"records": replaced(hold="zero")},
        {"records": replaced(burn_in=1.0)},
        {"lowpass": FILTERS[1]},
        {"starts": [{"alpha": 31.0}]},
        {"observers": gains(SecondOrder, {"c1": 60.0, "c2": 2e3, "c3": [300.0, 201.0]})},
        {"plant": eoi.Plant(bent, {"power": 1.0, "beta": 1.0, "rho": 2.0}, 2)},
    ):
        with pytest.raises(ValueError, match=r"this very sweep.*Give another folder"):
            quick(store=tmp_path / "s", **changes)


def softening(table, gain):
    """Models that differ only in an array that they hold, or in what their actuator does."""

    def f(t, x, u, p):
        y, rate = x.y
        force = jnp.interp(y[0], jnp.array([-1.0, 0.0, 1.0]), table)
        return -p.alpha * force - p.beta * rate + p.rho * u

    return eoi.Plant(f, {"alpha": 30.0, "beta": 1.0, "rho": 2.0}, 2,
                     actuator=lambda t, u, p: gain * u)  # fmt: skip


@pytest.mark.parametrize("wrap", [jnp.asarray, np.asarray])
def test_a_store_of_a_model_with_other_numbers_in_it_is_refused(tmp_path, wrap):
    table, other = wrap([-1.0, 0.0, 1.0]), wrap([-1.0, 0.0, 1.5])
    first = quick(store=tmp_path / "s", plant=softening(table, 1.0))
    for plant in (softening(other, 1.0), softening(table, 5.0)):
        with pytest.raises(ValueError, match="this very sweep"):
            quick(store=tmp_path / "s", plant=plant)
    same(quick(store=tmp_path / "s", plant=softening(table, 1.0), engine=Failing(0)), first)


def test_arrays_inside_a_compiled_model_tell_two_models_apart(tmp_path):
    def compiled(table):
        inner = jax.jit(lambda y: jnp.interp(y, jnp.array([-1.0, 0.0, 1.0]), table))
        return eoi.Plant(lambda t, x, u, p: -p.alpha * inner(x.y[0, 0]) + p.rho * u,
                         {"alpha": 30.0, "rho": 2.0}, 2)  # fmt: skip

    quick(store=tmp_path / "s", plant=compiled(np.array([-1.0, 0.0, 1.0])))
    with pytest.raises(ValueError, match="this very sweep"):
        quick(store=tmp_path / "s", plant=compiled(np.array([-1.0, 0.0, 1.5])))


def test_a_store_of_another_version_is_refused(tmp_path):
    import zarr

    quick(store=tmp_path / "s")
    root = zarr.open_group(str(tmp_path / "s"), mode="r+")
    for key, value, message in (
        ("version", "0.0.7", "written by this version"),
        ("format", 99, "format 4"),
    ):
        labels = json.loads(str(root.attrs["eoi_jax"]))
        root.attrs["eoi_jax"] = json.dumps({**labels, key: value})
        with pytest.raises(ValueError, match=message):
            quick(store=tmp_path / "s")


def test_a_folder_that_is_no_store_is_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(ValueError, match="must be the store of a sweep"):
        quick(store=tmp_path)
    assert [one.name for one in tmp_path.iterdir()] == ["thesis.tex"]
    with pytest.raises(ValueError, match="`store` must exist"):
        eoi.open_sweep(tmp_path / "nowhere")


def test_a_store_that_cannot_be_written_is_known_before_work_starts(tmp_path):
    (tmp_path / "file").write_text("")
    engine = Failing(0)
    with pytest.raises(OSError, match="file"):
        quick(store=tmp_path / "file" / "sweep", engine=engine)


def test_a_full_disk_stops_the_sweep_and_keeps_what_landed(tmp_path, monkeypatch):
    from eoi_jax.estimation.sweep.store import Store

    write, count = Store.write, iter(range(100))

    def full(self, place, arrays):
        if next(count) == 1:
            raise OSError(28, "No space left on device")
        write(self, place, arrays)

    monkeypatch.setattr(Store, "write", full)
    with pytest.raises(OSError, match="No space"):
        many(store=tmp_path / "s")
    assert eoi.open_sweep(tmp_path / "s").ok.values.sum() == 2


# -- executors ----------------------------------------------------------------------------------


def test_threads_give_the_same_numbers():
    with ThreadPoolExecutor(2) as executor:
        same(many(executor=executor).drop_attrs(), many().drop_attrs())


class Flaky(Executor):
    """Loses a chunk now and then, as a worker that is killed does."""

    def __init__(self, lose):
        self.lose, self.calls = lose, 0

    def submit(self, fn, /, *args, **kwargs):
        future: Future = Future()
        self.calls += 1
        if self.calls in self.lose:
            future.set_exception(RuntimeError("worker died"))
        else:
            future.set_result(fn(*args, **kwargs))
        return future


def test_a_lost_worker_costs_its_chunk_and_nothing_else():
    executor = Flaky(lose={2})
    with pytest.warns(UserWarning, match="worker died"):
        result = many(executor=executor)
    assert executor.calls == 4
    same(result.drop_attrs(), many().drop_attrs())


def test_a_chunk_that_fails_again_and_again_is_marked_and_tried_by_the_next_run(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        result = many(executor=Flaky(lose={1, 4, 5}), store=tmp_path / "s")
    meanings = result.status.attrs["flag_meanings"].split()
    lost = [meanings[i] == "lost" for i in result.status.values.ravel()]
    assert sum(lost) == 2
    same(many(store=tmp_path / "s").drop_attrs(), many().drop_attrs())


# -- long records -------------------------------------------------------------------------------


def test_a_long_record_in_pieces_is_the_record(tmp_path):
    record = noisy(30_000, size=0.05)
    for name, values in (("u", record.inputs), ("y", record.outputs)):
        np.save(tmp_path / f"{name}.npy", values)
    u, y = (np.load(tmp_path / f"{name}.npy", mmap_mode="r") for name in "uy")
    long = eoi.LongRecord(H, u, y, piece=7000, overlap=2000, name="long", hold="smooth")
    settings = {"transient": 3.0, "passes": 3, "substeps": 1, "smoothing": False}
    result = sweep(PLANT, [long, record], OBSERVERS[0], FILTERS[0], **settings)
    pieces, one = (
        result.isel(record=i, lowpass=0, observer=0, start=0, resample=0) for i in (0, 1)
    )
    # What the observer and the filter remember has decayed by exp(-20/√2) where pieces begin.
    np.testing.assert_allclose(pieces.parameters, one.parameters, rtol=1e-5)
    np.testing.assert_allclose(pieces["index"][:2], one["index"][:2], rtol=1e-4)
    np.testing.assert_allclose(pieces.standard_error, one.standard_error, rtol=0.35)


# -- best ---------------------------------------------------------------------------------------


def test_best_does_not_fall_for_a_low_cut_off():
    sets = gains(
        SecondOrder, {"c1": 60.0, "c2": 2e3, "c3": [0.05, 300.0]}
    )  # the first is too weak to slide
    filters = [eoi.LowPass(1.5), eoi.LowPass(15.0)]
    result = sweep(PLANT, noisy(8000, size=0.3), sets, filters, passes=3,
                   substeps=1, smoothing=False)  # fmt: skip
    last = result["index"].isel(record=0, start=0, resample=0, output=0).min("pass")
    assert float(last.isel(lowpass=0, observer=1)) < float(last.isel(lowpass=1, observer=1))
    chosen = eoi.best(result)
    assert float(chosen.cutoff) == 15.0
    assert float(chosen.c3) == 300.0
    assert "common index" in chosen.attrs["criterion"]
    judged = eoi.best(result, PLANT, noisy(6000, size=0.3, seed=9))
    assert float(judged.c3) == 300.0
    assert "NRMSE" in judged.attrs["criterion"]


def test_the_only_lane_with_an_answer_is_the_best():
    result = quick(observers=gains(SecondOrder, {"c1": 60.0, "c2": 2e3, "c3": [np.nan, 300.0]}))
    assert float(eoi.best(result).c3) == 300.0


def test_best_of_nothing_says_so():
    result = quick(observers=gains(SecondOrder, {"c1": 60.0, "c2": 2e3, "c3": [np.nan]}))
    with pytest.raises(ValueError, match=r"lane with an answer.*status"):
        eoi.best(result)
    with pytest.raises(ValueError, match="`plant` must be given"):
        eoi.best(result, validation=RECORDS[0])
    with pytest.raises(ValueError, match="`shortlist` must be"):
        eoi.best(result, shortlist=0)


def test_a_lane_in_sliding_mode_comes_before_one_that_is_as_good():
    sets = gains(SecondOrder, {"c1": 60.0, "c2": 2e3, "c3": [0.05, 300.0]})
    result = quick(observers=sets)
    index = result["common_index"]
    slides = index.isel(observer=1).values
    first = np.arange(2)[None, None, :, None, None, None] == 0
    for better, chosen in ((0.999, 300.0), (0.9, 0.05)):
        values = np.broadcast_to(slides[:, :, None] * np.ones_like(index.values), index.shape)
        score = index.copy(data=np.where(first, better, 1.0) * values)
        changed = result.assign(common_index=score)
        if chosen == 300.0:
            assert float(eoi.best(changed).c3) == chosen
        else:
            with pytest.warns(RuntimeWarning, match=r"sliding mode in only .*Raise the gains"):
                assert float(eoi.best(changed).c3) == chosen


# -- what is refused ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"observers": []}, "`observers` must hold at least one.*no lane"),
        ({"observers": ["SecondOrder"]}, "`observers` must be observers"),
        ({"observers": FirstOrder(3.0)}, "relative degree of the plant"),
        ({"observers": HighOrder(3.0, degree=3)}, "relative degree of the plant"),
        ({"observers": SecondOrder(1.0, 1.0, [1.0, 2.0])}, "`observer.c3` must be one number"),
        ({"records": []}, "`records` must hold at least one.*no lane"),
        ({"records": [3]}, "`records` must be a Record|parameter records"),
        ({"lowpass": []}, "`lowpass` must hold at least one.*no lane"),
        ({"lowpass": [20.0]}, "`lowpass` must be filters"),
        ({"starts": []}, "`starts` must hold at least one.*no lane"),
        ({"starts": [[1.0, 2.0]]}, r"`starts\[0\]` must give finite values of alpha, beta, rho"),
        ({"starts": [[1.0, 2.0, np.nan]]}, r"`starts\[0\]` must give finite"),
        ({"starts": [{"gamma": 1.0}]}, "gamma"),
        ({"passes": 0}, "`passes` must be an integer ≥ 1"),
        ({"resamples": -1}, "`resamples` must be an integer ≥ 0"),
        ({"chunk": 0}, "`chunk` must be an integer ≥ 1"),
        ({"transient": -3.0}, "`transient` must be a time ≥ 0 in seconds, got -3.0"),
        ({"transient": np.nan}, "`transient` must be a time ≥ 0 in seconds, got nan"),
        ({"substeps": 0}, "`substeps` must be an integer ≥ 1, got 0"),
        ({"smoothing": True}, "`smoothing` must be a cut-off > 0 in rad/s, or False, got True"),
        ({"smoothing": -1.0}, "`smoothing` must be a cut-off > 0 in rad/s, or False, got -1.0"),
        ({"precision": "half"}, "`precision` must be one of float64, float32"),
        ({"part": (3, 3)}, r"`part` must be \(i, n\)"),
    ],
)
def test_what_does_not_fit_is_refused_before_any_work(changes, message):
    with pytest.raises((ValueError, TypeError), match=message):
        quick(engine=Failing(0, AssertionError), **changes)


# -- progress -----------------------------------------------------------------------------------


def test_progress_counts_lanes_and_leaves_standard_output_alone(capfd, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")  # as on a terminal
    monkeypatch.setenv("TERM", "xterm")
    same(many(progress=True), many())
    printed = capfd.readouterr()
    assert printed.out == ""
    assert "sweep" in printed.err
    assert "/6" in printed.err
