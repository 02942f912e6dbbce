"""Cells in series and a lag of the sensor, beside SciPy's solution of the same equations."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.discovery.additions import sensor_notes, size_is_known
from eoi_jax.discovery.result import Added
from eoi_jax.models.augmented import added_effects, augmented, place
from eoi_jax.models.equations.display import equation_text
from eoi_jax.models.placements import placements
from eoi_jax.models.streams import stream_inputs
from eoi_jax.refinement.refine import refine_once
from eoi_jax.refinement.remaining import remaining

VALUES = {"a": 0.3, "inlet": 20.0, "b": 0.15, "steam": 100.0, "c": 0.4}
TIME = np.arange(0.0, 40.0, 0.25)
LAG = effects.SensorLag()


def exchanger(t, x, u, p):
    flow, power = u
    return p.a * flow * (p.inlet - x.y[0]) + p.b * (p.steam - x.y[0]) + p.c * power


EXCHANGER = eoi.Plant(exchanger, VALUES, 1, ("flow", "power"), ("temperature",))


def mass(t, x, u, p):
    position, rate = x.y
    return u - p.k * position - p.d * rate


MASS = eoi.Plant(mass, {"k": 4.0, "d": 0.6}, 2, ("force",), ("position",))


def plates(t, x, u, p):
    first, second = x.y[0]
    flow = p.couple * (first - second)
    return jnp.stack([p.heat * u[0] - p.loss * first - flow, flow - p.loss * second])


PLATES = eoi.Plant(
    plates, {"heat": 1.0, "loss": 0.1, "couple": 0.3}, 1, ("heater",), ("first", "second")
)


def inputs(seed, low=0.2, high=1.0):
    draw = np.random.default_rng(seed)
    return np.repeat(draw.uniform(low, high, (len(TIME) // 20, 2)), 20, axis=0)


def solved(rate, start, u):
    """By SciPy, from each step of the held inputs to the next."""
    states = [np.asarray(start, float)]
    for k in range(len(TIME) - 1):
        run = solve_ivp(rate, TIME[k : k + 2], states[-1], args=(u[k],), rtol=1e-10, atol=1e-12)
        states.append(run.y[:, -1])
    return np.asarray(states)


def simulated(plant, u, initial, internal=None):
    record = eoi.simulate(
        plant, TIME, u, initial, hold="zero", internal=internal, substeps=16
    )  # fmt: skip
    return record.outputs


def with_lag(plant, lag, output=0):
    placed = place(plant, LAG, output)
    return augmented(plant, [placed], {placed.names[0]: lag})


# -- the physics ------------------------------------------------------------------------------


@pytest.mark.parametrize("cells", [2, 3, 6])
def test_cells_are_a_chain_that_the_stream_passes_while_each_is_heated_alike(cells):
    u, p = inputs(0), SimpleNamespace(**VALUES)

    def rate(t, x, u):
        before = np.concatenate([[p.inlet], x[:-1]])
        return cells * p.a * u[0] * (before - x) + p.b * (p.steam - x) + p.c * u[1]

    start = np.linspace(30.0, 60.0, cells)
    plant = augmented(EXCHANGER, [place(EXCHANGER, effects.CellsInSeries(cells), 0)], {})
    assert plant.parameters == EXCHANGER.parameters
    got = simulated(plant, u, [60.0], start[:-1] - start[-1])[:, 0]
    np.testing.assert_allclose(got, solved(rate, start, u)[:, -1], rtol=1e-6)


def test_a_lag_of_the_sensor_follows_an_output_of_degree_one():
    u, tau = inputs(1), 0.8

    def rate(t, x, u):
        true, shown = x
        flow = VALUES["a"] * u[0] * (VALUES["inlet"] - true)
        heat = VALUES["b"] * (VALUES["steam"] - true) + VALUES["c"] * u[1]
        return [flow + heat, (true - shown) / tau]

    got = simulated(with_lag(EXCHANGER, tau), u, [45.0], [5.0])[:, 0]
    np.testing.assert_allclose(got, solved(rate, [50.0, 45.0], u)[:, 1], rtol=1e-6)


def test_a_lag_of_the_sensor_follows_a_position():
    u, tau = inputs(2, -1.0, 1.0), 0.3
    position, rate, shown = 0.2, -0.1, 0.05

    def slope(t, x, u):
        return [x[1], u[0] - 4.0 * x[0] - 0.6 * x[1], (x[0] - x[2]) / tau]

    shown_rate = (position - shown) / tau
    plant, initial = with_lag(MASS, tau), [shown, shown_rate]
    got = simulated(plant, u[:, 0], initial, [rate - shown_rate])[:, 0]
    wanted = solved(slope, [position, rate, shown], u)[:, 2]
    np.testing.assert_allclose(got, wanted, atol=1e-6)


def test_what_reads_an_output_behind_a_lag_reads_what_the_sensor_follows():
    """The second plate is warmed by the first one, not by its thermometer."""
    u, tau = inputs(3), 2.0

    def rate(t, x, u):
        first, second, shown = x
        flow = 0.3 * (first - second)
        return [u[0] - 0.1 * first - flow, flow - 0.1 * second, (first - shown) / tau]

    got = simulated(with_lag(PLATES, tau), u[:, :1], [[1.0, 0.5]], [0.7])
    np.testing.assert_allclose(got, solved(rate, [1.7, 0.5, 1.0], u)[:, [2, 1]], rtol=1e-6)


# -- with other effects -----------------------------------------------------------------------


def rates_of(plant, seed=0):
    draw = np.random.default_rng(seed)
    theta, count = jnp.asarray(plant.theta), len(plant.initial_internal)
    x = eoi.State(jnp.asarray([[50.0]]), jnp.asarray(draw.uniform(-5.0, 5.0, count)))
    u, t = jnp.asarray([0.6, 0.8]), jnp.asarray(0.0)
    return plant.derivative(t, x, u, theta), plant.internal_rate(t, x, u, theta)


@pytest.mark.parametrize("effect", [effects.CellsInSeries(3), LAG], ids=["cells", "sensor"])
def test_effects_that_are_added_later_are_within(effect):
    offset, placed = effects.ConstantOffset(), place(EXCHANGER, effect, 0)
    values = {**dict.fromkeys(placed.names, 0.5), "constant_offset": 2.0}
    first = augmented(EXCHANGER, [placed], values)
    later = augmented(first, [place(first, offset, 0)], values)
    at_once = augmented(EXCHANGER, [place(EXCHANGER, offset, 0), placed], values)
    for got, wanted in zip(rates_of(later), rates_of(at_once), strict=True):
        np.testing.assert_allclose(got, wanted, rtol=1e-13)
    assert [item.effect.name for item in added_effects(later)] == [effect.name, offset.name]


def test_a_sensor_is_behind_the_cells_whichever_comes_first():
    chosen = [place(EXCHANGER, effect, 0) for effect in (effects.CellsInSeries(2), LAG)]
    first, other = (
        augmented(EXCHANGER, placed, {"sensor_lag": 0.5}) for placed in (chosen, chosen[::-1])
    )
    z, theta = jnp.asarray([2.0, -3.0]), jnp.asarray(first.theta)
    t, y, u = jnp.asarray(0.0), jnp.asarray([[50.0]]), jnp.asarray([0.6, 0.8])
    wanted = first.internal_rate(t, eoi.State(y, z), u, theta)
    got = other.internal_rate(t, eoi.State(y, z[::-1]), u, theta)
    np.testing.assert_allclose(got[::-1], wanted, rtol=1e-13)


def test_a_second_store_follows_the_slope_that_later_effects_change():
    store = place(EXCHANGER, effects.SecondNode(), 0)
    values = {"second_node_exchange": 0.2, "second_node_rate": 0.1, "constant_offset": 2.0}
    first = augmented(EXCHANGER, [store], values)
    later = augmented(first, [place(first, effects.ConstantOffset(), 0)], values)
    slope, (rate,) = rates_of(later)
    state = np.random.default_rng(0).uniform(-5.0, 5.0)
    assert float(rate) == pytest.approx(-0.1 * state - float(slope[0]))


# -- derivatives, files, texts ----------------------------------------------------------------


@pytest.fixture(scope="module")
def connected():
    placed = [place(EXCHANGER, effect, 0) for effect in (effects.CellsInSeries(3), LAG)]
    return augmented(EXCHANGER, placed, {"sensor_lag": 0.7})


def test_derivatives_are_those_by_differences(connected):
    def outputs(theta):
        x = eoi.State(jnp.asarray([[50.0]]), jnp.asarray([3.0, -4.0, 2.0]))
        run = eoi.rollout(connected, theta, x, jnp.asarray(inputs(4)[:40]), 0.25)
        return run.y if hasattr(run, "y") else run

    theta = jnp.asarray(connected.theta)
    slopes = np.asarray(jax.jacfwd(outputs)(theta))
    for i, value in enumerate(connected.theta):
        step = 1e-5 * max(abs(value), 1.0)
        moved = [np.asarray(outputs(theta.at[i].add(sign * step))) for sign in (1.0, -1.0)]
        difference = (moved[0] - moved[1]) / (2.0 * step)
        size = np.max(np.abs(difference))
        np.testing.assert_allclose(slopes[..., i] / size, difference / size, atol=1e-7)


def noisy(plant, seed, sigma, u=None):
    u = inputs(seed) if u is None else u
    clean = eoi.simulate(plant, TIME, u, [55.0], hold="zero", substeps=16)
    noise = sigma * np.random.default_rng(seed).standard_normal(clean.outputs.shape)
    return clean.with_outputs(clean.outputs + noise, f"run {seed}")


def test_a_fit_finds_the_lag_and_any_start_and_survives_a_file(connected, tmp_path):
    u = inputs(5)
    p = SimpleNamespace(**VALUES)

    def rate(t, x, u):
        cells, shown = x[:3], x[3]
        before = np.concatenate([[p.inlet], cells[:-1]])
        rates = 3 * p.a * u[0] * (before - cells) + p.b * (p.steam - cells) + p.c * u[1]
        return [*rates, (cells[-1] - shown) / 0.7]

    y = solved(rate, [40.0, 50.0, 60.0, 55.0], u)[:, 3]
    record = eoi.Record(
        TIME, u, y, hold="zero", input_names=("flow", "power"), output_names=("temperature",)
    )
    start = connected.with_parameters({"sensor_lag": 0.3, "b": 0.2})
    found = refine_once(start, (record,), None)
    assert found.parameters["sensor_lag"] == pytest.approx(0.7, rel=1e-4)
    np.testing.assert_allclose(found.starts[0].z, [-20.0, -10.0, 5.0], rtol=1e-3)
    found.save(tmp_path / "fit.npz")
    back = eoi.load(tmp_path / "fit.npz", plant=EXCHANGER)
    assert added_effects(back.plant) == added_effects(connected)
    for got, wanted in zip(rates_of(back.plant), rates_of(found.plant), strict=True):
        np.testing.assert_array_equal(got, wanted)
    assert back.plant.open_internal.tolist() == [True, False, True]


def item(effect, **values):
    return SimpleNamespace(
        effect=effect, output="temperature", parameters=values, against="", through=""
    )


def test_equations_are_written_whole():
    gained = " - b·(steam - temperature) - 3·a·flow·z2"
    assert equation_text(EXCHANGER, [item(effects.CellsInSeries(3))]).splitlines() == [
        "temperature' = b·(steam - temperature) + c·power + 3·a·flow·z2",
        "z1' = b·(steam - temperature - z1) + 3·a·flow·(inlet - temperature - z1)" + gained,
        "z2' = b·(steam - temperature - z2) + 3·a·flow·(z1 - z2)" + gained,
    ]
    lagged = [item(LAG, sensor_lag=0.5), item(effects.ConstantOffset(), constant_offset=1.0)]
    assert equation_text(EXCHANGER, lagged) == (
        "temperature' = z/sensor_lag\n"
        "z' = a·flow·(inlet - temperature - z) + b·(steam - temperature - z) + c·power"
        " + constant_offset - z/sensor_lag"
    )


# -- where they fit ---------------------------------------------------------------------------


def test_a_stream_is_an_input_that_renews_the_volume():
    assert stream_inputs(EXCHANGER, 0) == (0,)
    assert stream_inputs(PLATES, 0) == stream_inputs(PLATES, 1) == ()
    growing = eoi.Plant(lambda t, x, u, p: p.a * u * x.y[0] - x.y[0], {"a": 1.0}, 1)
    assert stream_inputs(growing, 0) == ()


def test_cells_have_a_place_only_where_a_stream_is():
    cells = [effects.CellsInSeries()]
    assert [placed.streams for placed in placements(EXCHANGER, cells)] == [(0,)]
    assert placements(PLATES, cells) == placements(MASS, cells) == []
    level = eoi.Plant(exchanger, VALUES, 1, ("flow", "power"), ("height",), units={"height": "m"})
    assert placements(level, cells) == []
    with pytest.raises(ValueError, match=r"`cells_in_series` must act on an output .* stream"):
        place(MASS, cells[0], 0)


def test_dry_friction_does_not_stick_behind_a_sensor_that_lags():
    rubbing = augmented(
        MASS, [place(MASS, effects.CoulombFriction(), 0)], {"coulomb_friction": 0.2}
    )
    assert placements(rubbing, [LAG]) == []
    with pytest.raises(ValueError, match=r"`sensor_lag` must act on .* without dry friction"):
        place(rubbing, LAG, 0)


def test_effects_that_are_asked_for_say_what_they_must_act_on():
    record = noisy(EXCHANGER, 6, 0.01)
    plant = eoi.Plant(
        lambda t, x, u, p: p.k * u[0] - p.r * x.y[0], {"k": 1.0, "r": 1.0}, 1, ("flow", "power"),
        ("temperature",),
    )  # fmt: skip
    with pytest.raises(ValueError, match=r"cells_in_series must act on an output .* stream"):
        eoi.discover(plant, record, effects=["cells_in_series"])


@pytest.mark.parametrize("cells", [1, 0])
def test_a_single_cell_is_the_model_itself(cells):
    with pytest.raises(ValueError, match="`cells` must be a whole number, 2 or more"):
        effects.CellsInSeries(cells)


def test_forms_go_on_to_plug_flow():
    form, counts = effects.CellsInSeries(), [2]
    while (form := form.next_form()) is not None:
        counts.append(form.cells)
    assert counts == [2, 3, 6, 12]
    assert LAG.next_form() is None


def test_an_effect_without_parameters_has_no_size_that_is_unknown():
    assert size_is_known((), {}, {})
    assert not size_is_known(("a",), {"a": 1.0}, {"a": 0.6})


def test_a_lag_of_the_sensor_is_named_with_its_rival():
    added = [Added(LAG, "speed", {"sensor_lag": 0.3}, {"sensor_lag": 0.01}, LAG.sentence)]
    single = eoi.Plant(lambda t, x, u, p: p.k * u - x.y[0], {"k": 1.0}, 1, ("voltage",), ("speed",))
    (note,) = sensor_notes(single, added)
    assert note.startswith("a lag of the actuator of voltage in place of that of the sensor of sp")
    assert sensor_notes(EXCHANGER, added) == []


# -- the score test ---------------------------------------------------------------------------


def test_outputs_along_a_run_are_those_of_the_lag():
    """Of a ramp, τ late, after e^(-t/τ)."""
    time, tau = 0.1 * np.arange(100), 0.7
    along = LAG.outputs_along(2.0 * time[None], 0.1, np.array([tau]))
    wanted = 2.0 * (time - tau * (1.0 - np.exp(-time / tau)))
    np.testing.assert_allclose(along[0], wanted, atol=1e-12)


def test_a_score_test_finds_the_lag_of_a_sensor():
    lagged = with_lag(EXCHANGER, 1.5)
    record = noisy(lagged, 7, 0.01)
    refined = refine_once(EXCHANGER, (record,), None)
    ranking = remaining(refined, [LAG, effects.ConstantOffset(), effects.SecondNode()]).ranking
    assert ranking[0].names == ("sensor_lag",)
    assert ranking[0].share > 0.5
    assert 0.5 < ranking[0].values["sensor_lag"] < 4.0
