"""Dead times far beyond the band's period, and with a lag behind them; rigs of their own."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from found import discovery
from scipy.integrate import solve_ivp

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax._status import Status
from eoi_jax.data.holds import with_hold
from eoi_jax.discovery.cosine_modes import modal_record, model_rows
from eoi_jax.discovery.hold_choice import _stand_ins, with_held_inputs
from eoi_jax.discovery.in_injection import beyond_grid
from eoi_jax.discovery.lags import lags
from eoi_jax.discovery.noise_spectrum import fitted_power, local_power
from eoi_jax.discovery.result import Added

PERIOD, FINE = 5e-3, 5


def sprung(t, x, u, p):
    return p.gain * u - p.stiffness * x.y[0] - p.damping * x.y[1]


DECLARED = eoi.Plant(
    sprung, {"gain": 0.8, "stiffness": 3.0, "damping": 0.3}, 2, ("u",), ("y",), name="rig"
)
TRUTH = {"gain": 1.0, "stiffness": 4.0, "damping": 0.3}


def rate(x, u, lag):
    drive = x[2] if lag else u
    return np.array([x[1], drive - 4.0 * x[0] - 0.3 * x[1], (u - x[2]) / lag if lag else 0.0])


@cache
def measured(seed: int, delay: int, lag: float = 0.0, noise: float = 1e-4) -> eoi.Record:
    """Runge–Kutta; a staircase of 0.4 s drives the rig `delay` samples late, through a lag."""
    draw = np.random.default_rng(seed)
    u = np.repeat(draw.uniform(-6.0, 6.0, 51), 80)[:4000]
    late = np.concatenate([np.full(delay, u[0]), u])[: len(u)]
    x, h, y = np.array([0.1, 0.0, u[0]]), PERIOD / FINE, []
    for now in late:
        y.append(x[0])
        for _ in range(FINE):
            a = rate(x, now, lag)
            b = rate(x + 0.5 * h * a, now, lag)
            c = rate(x + 0.5 * h * b, now, lag)
            x = x + h / 6.0 * (a + 2.0 * b + 2.0 * c + rate(x + h * c, now, lag))
    outputs = np.array(y) + noise * draw.standard_normal(len(u))
    time = PERIOD * np.arange(len(u))
    return eoi.Record(time, u, outputs, f"run {seed}", hold="zero")


def found(delay: int, lag: float = 0.0, noise: float = 1e-4) -> eoi.Discovery:
    return eoi.discover(DECLARED, measured(1, delay, lag, noise), measured(2, delay, lag, noise))


@pytest.mark.slow
@pytest.mark.parametrize(("delay", "noise"), [(16, 0.0), (60, 0.0), (60, 1e-4), (200, 1e-4)])
def test_a_long_delay_is_named_however_clean_the_record(delay, noise):
    answer = found(delay, noise=noise)
    assert answer.effects == ("input_delay",)
    assert any("a delay of the sensor" in note for note in answer.notes)
    assert answer.plant.parameters["input_delay"] == pytest.approx(delay * PERIOD, abs=1e-3)
    for name, value in TRUTH.items():
        assert answer.plant.parameters[name] == pytest.approx(value, rel=2e-2)


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize(("delay", "lag"), [(40, 0.05), (20, 0.2)])
def test_a_delay_gives_back_what_it_took_of_a_lag(delay, lag):
    answer = found(delay, lag)
    assert set(answer.effects) == {"input_delay", "actuator_lag"}
    assert answer.plant.parameters["input_delay"] == pytest.approx(delay * PERIOD, abs=2e-3)
    assert answer.plant.parameters["actuator_lag"] == pytest.approx(lag, rel=5e-2)


def test_lags_are_where_a_residual_follows_the_input_and_nowhere_else():
    one = modal_record(DECLARED, measured(1, 60, noise=1e-3), 60.0)
    residual = model_rows(DECLARED.with_parameters(TRUTH), [one])[0][0]
    local = local_power(one.rows(one.highest[0], 0))
    power = fitted_power(residual, one.noise[:, 0], local, np.zeros(len(residual), int))
    near = lags(DECLARED, [one], residual, power, 0)
    assert np.min(np.abs(near - 0.3)) < 0.5 / 60.0
    noise = np.random.default_rng(0).standard_normal(len(residual))
    assert len(lags(DECLARED, [one], noise, np.ones(len(residual)), 0)) == 0
    assert len(lags(DECLARED, [one], 0.0 * noise, power, 0)) == 0


def driven_slowly(seed, column, count=60, period=0.5):
    """v' = u - 0.3 v - 0.2 v |v|, with an input in steps of six samples and its hold unsaid."""
    draw = np.random.default_rng(seed)
    push = np.repeat(np.abs(draw.uniform(-3.0, 3.0, count // 6 + 1)), 6)[:count]
    v, speed = np.empty(count), 0.0
    for i in range(count):
        v[i] = speed
        speed = solve_ivp(
            lambda _, v, u=push[i]: u - 0.3 * v - 0.2 * v * np.abs(v), (0.0, period), [speed],
            rtol=1e-9,
        ).y[0, -1]  # fmt: skip
    v += 1e-2 * np.std(v) * draw.standard_normal(count)
    return eoi.Record(period * np.arange(count), push, v, input_names=column, output_names="v")


@pytest.mark.slow
@pytest.mark.parametrize("column", ["push", "force command [N]"])
def test_half_a_sample_of_delay_is_a_hold(column):
    """The injection has no law for such drag, and a delay with two other effects explains it."""
    plant = eoi.Plant(
        lambda t, x, u, p: p.b * u[0] - p.a * x.y[0], {"b": 0.8, "a": 0.5}, 1, ("push",), ("v",)
    )
    found = eoi.discover(plant, driven_slowly(1, column), validation=driven_slowly(2, column))
    assert "input_delay" not in found.effects
    assert found.held_out[0].hold == "zero"
    assert found.status.code == "complete"
    assert len(found.effects) == 1
    # Whichever saw it first: free runs with each hold, or a delay that a hold explains.
    assert any(note.startswith("hold zero") or "half a sample" in note for note in found.notes)
    records, held_out = (driven_slowly(seed, column) for seed in (1, 2))
    linear = with_hold((held_out,), "linear")
    for delay, explained in ((0.26, True), (0.5, False)):
        late = replace(
            found.added[0], effect=effects.InputDelay(), output="push", parameters={"delay": delay}
        )
        answer = replace(found, added=(late, *found.added), held_out=linear)
        chosen = with_held_inputs(answer, lambda *_: found, (records,), (held_out,))
        assert (chosen.added == found.added) is explained
        assert (chosen is answer) is not explained
        assert not explained or "half a sample of delay" in chosen.notes[0]
        # Nothing is missing with held inputs: a delay alone is explained as well.
        answer = replace(found, added=(late,), held_out=linear)
        for code, counts in (("nothing_missing", True), ("unexplained", False)):
            rival = replace(found, added=(), status=Status(code, ""))
            chosen = with_held_inputs(answer, lambda *_, r=rival: r, (records,), (held_out,))
            assert (chosen.added == ()) is (explained and counts)


def geared(seed, count=5000, period=0.004, steps=20):
    """A drive with a dead zone of 0.8 and dry friction 2, in small steps; its hold unsaid."""
    random, state, angle = np.random.default_rng(seed), np.zeros(2), np.empty(count)
    volts = np.repeat(random.uniform(-6.0, 6.0, count // 100), 100)
    for k, u in enumerate(volts):
        angle[k], push = state[0], 20.0 * np.sign(u) * max(abs(u) - 0.8, 0.0)
        for _ in range(steps):
            force = push - 8.0 * state[1] - 2.0 * np.tanh(state[1] / 0.01)
            middle = state[1] + 0.5 * period / steps * force
            rate = push - 8.0 * middle - 2.0 * np.tanh(middle / 0.01)
            state = state + period / steps * np.array([middle, rate])
    angle += 0.002 * random.standard_normal(count)
    return eoi.Record(period * np.arange(count), volts, angle, units={"y": "rad"})


@pytest.mark.slow
def test_inputs_are_not_shifted_where_free_runs_miss_by_more():
    """Behind the dead zone the index is smaller with inputs at another time."""
    plant = eoi.Plant(lambda t, x, u, p: p.k * u - p.d * x.y[1], {"k": 15.0, "d": 5.0}, 2)
    found = eoi.discover(plant, geared(1), validation=geared(2))
    assert found.held_out[0].hold == "zero"
    assert not np.any(found.held_out[0].skew)
    assert set(found.effects) == {"input_dead_zone", "coulomb_friction"}
    assert found.plant.parameters["input_dead_zone"] == pytest.approx(0.8, rel=0.01)
    assert found.plant.parameters["coulomb_friction"] == pytest.approx(2.0, rel=0.02)


@pytest.mark.parametrize(("lead", "late"), [(-0.25, 0.3), (0.4, -0.35)])
def test_what_follows_the_rate_of_an_input_stands_for_a_delay_by_its_lag_less_its_lead(lead, late):
    """Half a sample of lead that is negative, with hardly any lag, is a hold as well."""
    answer = discovery()
    name, times = answer.plant.inputs[0], {"lead": lead, "lag": 0.05}
    added = Added(effects.InputRate(), name, times, times, "a response")
    assert _stand_ins(replace(answer, added=(added,))) == {name: pytest.approx(late)}


def steered(seed):
    """A ship under a rudder that is held over half a minute, by SciPy; its sensor has noise."""
    draw, period, count = np.random.default_rng(seed), 0.5, 2400
    rudder = np.repeat(draw.uniform(-0.5, 0.5, count // 60), 60)
    state, heading = np.zeros(2), []
    for u in rudder[::60]:

        def rate(t, x, u=u):
            return [x[1], 0.05 * u - 0.1 * x[1] - 2.0 * x[1] ** 3 + 0.002]

        grid = period * np.arange(61)
        run = solve_ivp(rate, (0.0, grid[-1]), state, t_eval=grid, rtol=1e-9, atol=1e-12)
        heading.append(run.y[0, :-1])
        state = run.y[:, -1]
    output = np.concatenate(heading) + 0.01 * draw.standard_normal(count)
    return eoi.Record(period * np.arange(count), rudder, output, input_names=("rudder",),
                      output_names=("heading",))  # fmt: skip


def test_holds_are_compared_after_as_many_passes():
    """Affine models are fitted by one pass; with a lag in place of the hold there were several."""
    ship = eoi.Plant(lambda t, x, u, p: p.k * u - p.d * x.y[1], {"k": 0.04, "d": 0.12}, 2,
                     inputs=("rudder",), outputs=("heading",))  # fmt: skip
    found = eoi.discover(ship, steered(1), validation=steered(2))
    assert set(found.effects) == {"cubic_damping", "constant_offset"}
    assert found.held_out[0].hold == "zero"


def test_a_delay_that_its_standard_error_tells_from_the_end_of_the_grid_is_not_at_it():
    """A sample of 0.1 ms, in a grid from 0.044 to 120.6 ms."""
    grid = 4.44e-5, 0.1206
    assert beyond_grid(1.001e-4, 1.7e-6, *grid) == ""
    assert beyond_grid(1.001e-4, 5e-5, *grid) == "smaller"
    assert beyond_grid(1.001e-4, np.inf, *grid) == beyond_grid(1.001e-4, np.nan, *grid) == "smaller"
    assert beyond_grid(grid[0], 1e-9, *grid) == "smaller"
    assert beyond_grid(grid[1], 1e-9, *grid) == "larger"


def _stepped(size: float, seed: int) -> eoi.Record:
    """Warming behind a dead time of 8 s; the record begins when the power is switched on."""
    time = np.arange(200.0)
    warmed = 2.0 * size * (1.0 - np.exp(-np.maximum(time - 8.0, 0.0) / 30.0))
    noise = 0.01 * np.random.default_rng(seed).standard_normal(len(time))
    return eoi.Record(time, np.full((200, 1), size), (20.0 + warmed + noise)[:, None], str(size))


def _warmed() -> eoi.Plant:
    return eoi.Plant(
        lambda t, x, u, p: (p.gain * u - (x.y[0] - 20.0)) / p.tau, {"gain": 1.5, "tau": 20.0},
        relative_degree=1, bounds={"tau": (1.0, np.inf)},
    )  # fmt: skip


def test_a_step_that_begins_the_records_tells_of_a_dead_time():
    """The input stands still in them: what it was before is the gain of the score test."""
    refined = eoi.refine(_warmed(), [_stepped(1.0, 1), _stepped(2.0, 2)])
    tried = [effects.InputDelay(), effects.InputDeadZone()]
    first = eoi.remaining(refined, tried).ranking[0]
    assert first.names == ("input_delay",)
    assert first.share > 0.5
    assert first.values["input_delay"] == pytest.approx(8.0, rel=0.3)


@pytest.mark.slow
def test_a_dead_time_is_named_where_records_begin_with_their_step():
    held_out = [_stepped(1.5, 3)]
    found = eoi.discover(_warmed(), [_stepped(1.0, 1), _stepped(2.0, 2)], validation=held_out)
    assert found.effects == ("input_delay",)
    assert found.plant.parameters["input_delay"] == pytest.approx(8.0, abs=0.3)
    assert found.plant.parameters["tau"] == pytest.approx(30.0, rel=0.02)


DRUM = eoi.Plant(
    lambda t, x, u, p: p.k * (u[0] - u[1]), {"k": 0.01}, 1, ("feed", "steam"), ("level",)
)


def drum(seed: int, lead: float, count: int = 900, period: float = 10.0) -> eoi.Record:
    """A drum that swells before its level falls, or takes its steam late; exact between samples."""
    draw, level, swell = np.random.default_rng(seed), 0.0, 0.0
    steam = np.repeat(draw.uniform(60.0, 100.0, count // 60 + 1), 60)[:count] - 80.0
    feed, run, pull = np.zeros(count), np.zeros(count), np.exp(-period / 40.0)
    for i in range(count):
        run[i] = level + swell
        feed[i] = 0.5 * steam[i] - 0.2 * run[i]
        level += period * 0.02 * (feed[i] - steam[i if lead else max(i - 7, 0)])
        swell = pull * swell + (1.0 - pull) * 0.02 * lead * steam[i]
    run += 0.5 * draw.standard_normal(count)
    return eoi.Record(period * np.arange(count), np.stack([feed, steam], axis=1), run, "drum",
                      hold="zero", input_names=DRUM.inputs, output_names=DRUM.outputs)  # fmt: skip


@pytest.mark.slow
def test_a_drum_that_swells_responds_to_the_rate_of_its_steam():
    """A delay does the same to first order, and leaves 1.7 times the noise."""
    answer = eoi.discover(DRUM, drum(1, 75.0), validation=drum(2, 75.0))
    assert answer.effects == ("input_rate",)
    assert answer.status.code == "complete"
    values = answer.plant.parameters
    assert values["k"] == pytest.approx(0.02, rel=0.01)
    assert values["input_rate_lead_steam"] == pytest.approx(-75.0, rel=0.02)
    assert values["input_rate_lag_steam"] == pytest.approx(40.0, rel=0.05)


def test_a_drum_whose_steam_acts_late_keeps_its_delay():
    answer = eoi.discover(DRUM, drum(1, 0.0), validation=drum(2, 0.0))
    assert answer.effects == ("input_delay",)
    assert answer.base is None  # no search in free runs
