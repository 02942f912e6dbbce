"""Instrumental variables: the mathematics, what noise does to them, and when they are used."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import grid

from eoi_jax.data.record import Record
from eoi_jax.estimation import instrumental_variables as module
from eoi_jax.estimation.identify import identify
from eoi_jax.estimation.instrument_kernel import Simulated, run_pairs, sum_over_runs
from eoi_jax.estimation.instrumental_variables import noise_in_residual
from eoi_jax.estimation.lowpass import LowPass
from eoi_jax.estimation.observers import FirstOrder, SecondOrder
from eoi_jax.estimation.preparation import prepare_records, prepare_steps, step_inputs
from eoi_jax.estimation.regression.instrumental import instrumental_variables, within_bounds
from eoi_jax.models.library import Plant, mass_spring_damper, pendulum
from eoi_jax.models.plant import State
from eoi_jax.simulation.known_direction import directed, turn
from eoi_jax.simulation.simulate import simulate
from eoi_jax.uncertainty.uncertainty import uncertainty

H = 2e-3
TRUTH = mass_spring_damper(true=True)
NOMINAL = mass_spring_damper()


def noisy(record, share, seed, name="noisy"):
    """White noise of a share of each output's rms."""
    rms = np.sqrt(np.mean(record.outputs**2, axis=0))
    draw = np.random.default_rng(seed).standard_normal(record.outputs.shape)
    return record.with_outputs(record.outputs + share * rms * draw, name)


def excited(samples, h, seed=0, levels=(-1.0, 1.0), hold=0.12):
    """Random levels, each held for a while."""
    draw = np.random.default_rng(100 + seed)
    count = int(np.ceil(samples * h / hold)) + 1
    return np.repeat(draw.uniform(levels[0], levels[1], count), round(hold / h))[:samples]


def run(plant, samples=2001, h=H, **options):
    """A simulated record of a plant."""
    u = np.column_stack([excited(samples, h, i) for i in range(len(plant.inputs))])
    return simulate(plant, grid(samples, h), u, options.pop("initial", None), hold="zero",
                    substeps=4, **options)  # fmt: skip


@pytest.fixture(scope="module")
def clean():
    """The mass on its spring, without noise."""
    return run(TRUTH)


# -- the solution ---------------------------------------------------------------------------


def test_instruments_that_are_the_regressors_give_least_squares():
    draw = np.random.default_rng(0)
    phi, theta = draw.standard_normal((50, 3)), np.array([1.0, -2.0, 0.5])
    information = phi.T @ phi
    increment, inverse = instrumental_variables(
        information, information, phi.T @ (phi @ theta), np.ones(3)
    )
    np.testing.assert_allclose(increment, theta, rtol=1e-10)
    np.testing.assert_allclose(inverse, np.linalg.inv(information), rtol=1e-10)


def test_fixed_parameters_stay_and_directions_without_instrument_too():
    draw = np.random.default_rng(1)
    zeta, psi = draw.standard_normal((2, 50, 3))
    psi, zeta = psi + 3.0 * zeta, zeta * np.array([1.0, 1.0, 0.0])
    rhs = zeta.T @ psi @ np.array([2.0, 3.0, 0.0])
    increment, inverse = instrumental_variables(
        zeta.T @ psi, zeta.T @ zeta, rhs, np.array([1.0, 0.0, 1.0])
    )
    assert increment[0] == pytest.approx(rhs[0] / (zeta.T @ psi)[0, 0], rel=1e-10)
    assert np.all(increment[1:] == 0.0)
    assert np.all(inverse[1:] == 0.0)


def test_instruments_that_know_nothing_of_the_regressors_say_so():
    increment, inverse = instrumental_variables(np.zeros((2, 2)), np.eye(2), np.ones(2), np.ones(2))
    assert not np.any(np.isfinite(increment))
    assert not np.any(np.isfinite(inverse))


def test_what_would_leave_its_bounds_is_put_on_them_and_the_rest_is_solved_anew():
    cross = np.array([[2.0, 1.0], [0.5, 3.0]])
    rhs = cross @ np.array([1.0, -4.0])
    room = (np.array([-9.0, -1.0]), np.array([9.0, 1.0]))
    increment, inverse = within_bounds(cross, np.eye(2), rhs, np.ones(2), room)
    assert increment[1] == -1.0
    assert increment[0] == pytest.approx((rhs[0] + 1.0) / 2.0)  # the first equation alone
    np.testing.assert_allclose(inverse, [[0.5, 0.0], [0.0, 0.0]], atol=1e-12)


# -- dry friction whose direction is known ----------------------------------------------------


@pytest.fixture(scope="module")
def told():
    """f and φ of a pendulum under a direction and a grip of 5/s, at a rate; and f without."""
    plant = pendulum(true=True)
    followed, theta, t = directed(plant, (True,)), jnp.asarray(plant.theta), jnp.array(0.0)

    @jax.jit
    def at(rate, way):
        x = State(jnp.array([0.3, rate])[:, None], jnp.zeros(0))
        u = jnp.array([0.1, way, 5.0])
        f = followed.derivative(t, x, u, theta)[0]
        return f, followed.regressor(t, x, u, theta), plant.derivative(t, x, u[:1], theta)[0]

    assert not any(followed.dry_friction)
    return at


def test_a_directed_plant_is_the_plant_where_it_moves_that_way(told):
    for rate in (0.7, -0.7):
        f, _, without = told(rate, np.sign(rate))
        assert float(f) == pytest.approx(float(without), rel=1e-12)


def test_a_directed_plant_goes_on_beyond_rest_and_is_held_at_rest(told):
    beyond, *between = (float(told(rate, 1.0)[0]) for rate in (-0.2, 0.1, 0.4))
    # Affine in the rate on one side of rest, so that the line goes through both sides.
    assert beyond == pytest.approx(2.0 * between[0] - between[1], rel=1e-9)
    assert float(told(0.4, 0.0)[0]) == pytest.approx(-5.0 * 0.4)
    np.testing.assert_array_equal(told(0.0, 0.0)[1], 0.0)


def test_sensitivities_of_the_velocity_change_by_the_ratio_of_accelerations():
    plant = pendulum(true=True)
    followed, theta, t = directed(plant, (True,)), jnp.asarray(plant.theta), jnp.array(0.0)
    x = State(jnp.array([[0.01], [-1e-3]]), jnp.zeros(0))

    @jax.jit
    def factor(before, way):
        return turn(followed, theta, t, x, jnp.array([0.1, way, 5.0]), jnp.array([before]))[0]

    p = plant.parameters
    force = p["d"] * 0.1 - p["a"] * np.sin(0.01)
    want = (force - p["c"]) / (force + p["c"])  # it moved down, and turns up
    assert float(factor(-1.0, 1.0)) == pytest.approx(want, rel=1e-6)  # rest is 1e-9 away
    assert float(factor(-1.0, 0.0)) == 0.0
    assert float(factor(0.0, 1.0)) == 1.0
    assert float(factor(1.0, 1.0)) == 1.0


# -- one pass over a pair ---------------------------------------------------------------------


def paired(plant, record, simulated, observer, substeps=4, **options):
    """Sums of a pass over two records, at the plant's parameters; its rows add up to them."""
    prepared = prepare_records(plant, (record,), LowPass(60.0, 3), False, substeps)
    fine = simulated.resample(substeps)
    inputs = [step_inputs(one, False) for one in prepared.fine]
    steps = prepare_steps(plant, prepared.fine, inputs, 1, 0.0, 0.1, [np.zeros(1)], False, 0.1)
    beside = Simulated(fine.outputs[None, :-1], fine.outputs[None, 1:])
    one = jnp.asarray
    weight = one([3.0])
    theta, leak = one(plant.theta), one(0.0)
    sums, rows = run_pairs(plant, observer, steps, beside, theta, weight, leak, **options)
    scores = np.einsum("rsj,rsja->ra", rows.error, rows.zeta)
    np.testing.assert_allclose(scores, 3.0 * np.asarray(sums.rhs)[:, 0], rtol=1e-9)
    return sum_over_runs(sums)


def test_the_error_of_a_pair_is_that_of_the_output_and_instruments_are_its_sensitivities(clean):
    """e = y - ȳ and ζ = ∂ȳ/∂θ, so that Σζᵀζ and Σζᵀe are those of an output-error method."""
    theta = np.asarray(TRUTH.theta)
    moved = TRUTH.with_parameters(theta * (1.0 + np.array([1e-3, -2e-3, 1e-3])))
    record = simulate(moved, clean.time, clean.inputs, hold="zero", substeps=4)
    got = paired(TRUTH, record, clean, SecondOrder(20.0, 100.0, 500.0))
    slopes = []
    for i in range(3):
        step = 1e-5 * theta[i] * (np.arange(3) == i)
        ends = [simulate(TRUTH.with_parameters(theta + side * step), clean.time, clean.inputs,
                         hold="zero", substeps=4).outputs for side in (1, -1)]  # fmt: skip
        slopes.append((ends[0] - ends[1])[1:, 0] / (2.0 * step[i]))
    slopes, error = np.stack(slopes, axis=1), (record.outputs - clean.outputs)[1:, 0]
    want = 4 * slopes.T @ slopes  # four sub-steps a sample
    size, scale = np.sqrt(np.diagonal(want)), np.linalg.norm(2 * error)
    # The start is weighed less (0.1 s of 5 s), and a step of 0.5 ms is half a step late.
    close = functools.partial(np.testing.assert_allclose, rtol=0.0, atol=0.06)
    close(got.information[0] / np.outer(size, size), want / np.outer(size, size))
    close(got.cross[0] / np.outer(size, size), want / np.outer(size, size))
    close(got.rhs[0] / size / scale, 4 * slopes.T @ error / size / scale)
    assert got.square[0] == pytest.approx(4 * error @ error, rel=0.06)


def test_a_pass_in_parts_is_the_same_as_in_one_go(clean):
    observer = SecondOrder(20.0, 100.0, 500.0)
    moved = TRUTH.with_parameters(1.01 * np.asarray(TRUTH.theta))
    record = simulate(moved, clean.time, clean.inputs, hold="zero", substeps=4)
    whole = paired(TRUTH, record, clean, observer)
    count = 4 * (len(record) - 1)
    assert count % -(-count // -(-count // 300))  # the last part is a shorter one
    in_parts = paired(TRUTH, record, clean, observer, max_steps=300)
    for one, other in zip(jax.tree.leaves(whole), jax.tree.leaves(in_parts), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)


# -- what noise does ------------------------------------------------------------------------


def bound(plant, record, share, sides=1e-5):
    """Cramér–Rao standard deviations of the parameters, initial state unknown, by differences."""
    rms = np.sqrt(np.mean(record.outputs**2, axis=0))
    start = np.zeros((plant.relative_degree, len(plant.outputs)))

    def free_run(theta, moved):
        model = plant.with_parameters(theta)
        got = simulate(model, record.time, record.inputs, start + moved, hold="zero", substeps=4)
        return (got.outputs / (share * rms)).ravel()

    theta, columns = np.asarray(plant.theta), []
    for i in range(len(theta)):
        step = sides * abs(theta[i]) * (np.arange(len(theta)) == i)
        columns.append((free_run(theta + step, 0.0) - free_run(theta - step, 0.0))
                       / (2.0 * step[i]))  # fmt: skip
    for i in range(start.size):
        step = 1e-3 * np.max(rms) * (np.arange(start.size) == i).reshape(start.shape)
        columns.append((free_run(theta, step) - free_run(theta, -step)) / (2.0 * np.max(step)))
    slopes = np.stack(columns, axis=1)
    size = np.linalg.norm(slopes, axis=0)
    covariance = np.linalg.inv((slopes / size).T @ (slopes / size)) / np.outer(size, size)
    return np.sqrt(np.diagonal(covariance))[: len(theta)]


def scattered(plant, truth, record, share, seeds, **options):
    """Errors and half widths of 95 % intervals over seeds, both shape (seeds, np)."""
    errors, claimed = [], []
    for seed in range(seeds):
        got = identify(plant, noisy(record, share, seed), **options)
        errors.append(np.asarray(got.plant.theta) - truth.theta)
        claimed.append([0.5 * np.ptp(one) for one in uncertainty(got).intervals().values()])
    return np.array(errors), np.array(claimed)


@pytest.mark.slow
def test_instruments_are_unbiased_where_least_squares_is_biased(clean):
    """A wide filter lets noise into the regressors: errors in variables."""
    options = {"lowpass": LowPass(400.0, 3), "smoothing": False, "substeps": 1}
    seeds = 15
    bias = {}
    for used in (False, True):
        errors, _ = scattered(NOMINAL, TRUTH, clean, 0.03, seeds, instruments=used, **options)
        spread = np.std(errors, axis=0, ddof=1) / np.sqrt(seeds)
        bias[used] = np.max(np.abs(np.mean(errors, axis=0)) / spread)
    assert bias[False] > 5.0
    assert bias[True] < 3.7  # Student's t, 14 degrees, three parameters: 1 %


@pytest.mark.slow
def test_instruments_reach_the_cramer_rao_bound_and_know_it(clean):
    share, seeds = 1e-3, 20
    errors, claimed = scattered(NOMINAL, TRUTH, clean, share, seeds, substeps=2)
    best = bound(TRUTH, clean, share)
    rms = np.sqrt(np.mean(errors**2, axis=0))
    assert np.all(rms < 1.5 * best)  # the spread of an rms over 20 is 16 %
    assert np.all(rms > 0.6 * best)
    covered = np.mean(np.abs(errors) < claimed, axis=0)
    assert np.all(covered >= 0.8)  # 95 % of 20, less three standard deviations


def test_dry_friction_costs_nothing_though_the_plant_comes_to_rest():
    """Reversals and rests are used: plain passes leave them out, and are far worse."""
    truth, plant = pendulum(true=True), pendulum()
    t = grid(2001, 4e-3)
    u = 0.05 * np.sign(np.sin(2 * np.pi * t / 4.0 + 0.1))
    record = simulate(truth, t, u, hold="zero", substeps=4)
    assert np.mean(np.diff(record.outputs[:, 0]) == 0.0) > 0.05  # it does rest
    share, seeds = 1e-3, 4
    best = bound(truth, record, share)
    rms = {}
    for used in (False, True):
        errors, _ = scattered(plant, truth, record, share, seeds, instruments=used, substeps=2)
        rms[used] = np.sqrt(np.mean(errors**2, axis=0)) / best
    assert np.all(rms[True] < 2.5)
    assert np.max(rms[False]) > 3.0 * np.max(rms[True])


def braked(t, x, u, p):
    """A motor whose speed is measured, with dry friction."""
    return p.gain * u - p.loss * x.y[0] - p.dry * jnp.sign(x.y[0])


def test_instruments_of_a_speed_are_its_sensitivities_across_reversals():
    """In whatever row the speed stands: here that of the velocities holds an internal state."""

    def geared(t, x, u, p):
        return p.gain * x.z[0] - p.loss * x.y[0] - p.dry * jnp.sign(x.y[0])

    def charged(t, x, u, p):
        return (u[:1] - x.z) / p.tau

    values = {"gain": 40.0, "loss": 0.2, "dry": 8.0, "tau": 0.05}
    plant = Plant(geared, values, 1, internal=charged, internal_initial=[0.0])
    t = grid(1001, 4e-3)
    u = 0.4 * np.sin(2.0 * np.pi * t / 1.6) + 0.2 * np.sin(2.0 * np.pi * t / 0.37)

    def speeds(theta):
        return simulate(plant.with_parameters(theta), t, u, hold="zero", substeps=4).outputs

    theta, speed = np.asarray(plant.theta), speeds(plant.theta)
    steps = 1e-5 * np.diag(theta)
    slopes = np.concatenate([speeds(theta + step) - speeds(theta - step) for step in steps], axis=1)
    slopes = slopes[1:] / (2.0 * np.diagonal(steps))
    ways = np.sign(np.append(speed[1:] + speed[:-1], speed[-1:], axis=0))
    inputs = np.concatenate([u[:, None], ways, np.full_like(ways, 5.0)], axis=1)
    record = Record(t, inputs, speed, hold="zero")
    ways = np.repeat(ways[:-1], 4, axis=0)[None]
    before = np.concatenate([ways[:, :1], ways[:, :-1]], axis=1)
    observer = FirstOrder(delta=1e6, leak=1.0)
    model = directed(plant, (1,))
    got = paired(model, record, record, observer, previous_direction=before)
    want = 4 * slopes.T @ slopes  # four sub-steps a sample
    sizes = np.sqrt(np.outer(np.diagonal(want), np.diagonal(want)))
    np.testing.assert_allclose(got.information[0] / sizes, want / sizes, rtol=0.0, atol=0.06)


@pytest.mark.slow
def test_a_speed_with_dry_friction_reaches_the_bound_though_it_stands_still():
    truth = Plant(braked, {"gain": 40.0, "loss": 2.0, "dry": 8.0}, 1)
    t = grid(4001, 2e-3)
    u = 0.4 * np.sin(2.0 * np.pi * t / 1.6) + 0.2 * np.sin(2.0 * np.pi * t / 0.37)
    record = simulate(truth, t, u, hold="zero", substeps=4)
    assert np.mean(record.outputs == 0.0) > 0.02
    share, seeds = 1e-2, 6
    start = truth.with_parameters({"gain": 30.0, "loss": 2.6, "dry": 5.0})
    errors, _ = scattered(start, truth, record, share, seeds, instruments=True, substeps=2)
    assert np.all(np.sqrt(np.mean(errors**2, axis=0)) < 2.5 * bound(truth, record, share))


# -- plants of every kind -------------------------------------------------------------------


def lagging(t, x, u, p):
    """Driven by a state that nobody measures."""
    del t, u
    return -p.a * x.y[0] - 3.0 * x.y[1] + p.b * x.z[0]


def lag(t, x, u, p):
    """Rate of that state."""
    del t
    return (u - x.z) / p.tau


def sprung(t, x, u, p):
    """Driven through an actuator."""
    del t
    return -p.a * x.y[0] - 4.0 * x.y[1] + p.b * u


def slow(t, u, p):
    """First-order lag of the inputs: means over the steps of its exact response to held ones."""
    step = t[1] - t[0]
    decay = jnp.exp(-step / p.tau)
    late = (1.0 - decay) * p.tau / step

    def body(state, now):
        return decay * state + (1.0 - decay) * now, now + late * (state - now)

    return jax.lax.scan(body, jnp.zeros_like(u[0]), u)[1]


def mixed(t, x, u, p):
    """Outputs of relative degree 1 and 2, two inputs, a parameter in both outputs."""
    del t
    first = -p.a * x.y[0, 0] + u[0]
    return jnp.stack([first, p.k * x.y[0, 0] - p.a * x.y[1, 1] - 30.0 * x.y[0, 1] + p.b * u[1]])


def turning(t, x, u, p):
    """An angle and its speed, both measured, with dry friction."""
    del t
    angle, speed = x.y[0]
    return jnp.stack([speed, p.b * u[0] - p.a * angle - p.c * jnp.sign(speed)])


PLANTS = {
    "internal state": Plant(lagging, {"a": 40.0, "b": 20.0, "tau": 0.1}, 2, internal=lag,
                            internal_initial=[0.0]),
    "actuator": Plant(sprung, {"a": 40.0, "b": 20.0, "tau": 0.05}, 2, actuator=slow),
    "mixed degrees": Plant(mixed, {"a": 5.0, "k": 40.0, "b": 20.0}, (1, 2), ("u1", "u2"),
                           ("y1", "y2")),
    "measured speed": Plant(turning, {"a": 40.0, "b": 20.0, "c": 3.0}, (1, 1), ("u",),
                            ("angle", "speed")),
}  # fmt: skip


@pytest.mark.parametrize("name", PLANTS)
def test_plants_of_every_kind_are_estimated_within_their_standard_errors(name):
    truth = PLANTS[name]
    start = truth.with_parameters(np.asarray(truth.theta) * 1.15)
    record = noisy(run(truth, 2001), 2e-3, 0)
    got = identify(start, record, instruments=True, substeps=2)
    assert any("instrumental variables in" in reason for reason in got.reasons), got.reasons
    errors = np.asarray(got.plant.theta) - np.asarray(truth.theta)
    claimed = np.array(list(got.standard_errors.values()))
    assert np.all(np.abs(errors) < 4.0 * claimed)
    assert np.all(claimed < 0.2 * np.abs(truth.theta))
    np.testing.assert_allclose(
        got.plant.theta, got.parameter_history[got.best_pass] + got.correction, rtol=1e-12
    )


def test_fixed_parameters_and_bounds_are_kept(clean):
    record = noisy(clean, 1e-2, 3)
    values = {**NOMINAL.parameters, "beta": 10.5, "rho": TRUTH.parameters["rho"]}
    plant = Plant(NOMINAL.dynamics, values, 2, bounds={"beta": (10.4, np.inf)}, fixed=("rho",))
    got = identify(plant, record, instruments=True, substeps=2)
    assert got.parameters["rho"] == TRUTH.parameters["rho"]
    assert got.parameters["beta"] == 10.4  # the truth lies beyond
    assert got.standard_errors["rho"] == 0.0
    assert np.isnan(got.standard_errors["beta"])
    assert got.notes[-1] == "beta ended on its bound, 10.4"
    assert any("instrumental variables in" in reason for reason in got.reasons)


def test_several_records_with_gaps_make_one_estimate(clean):
    holes = np.array(noisy(clean, 1e-3, 1).outputs)
    holes[700:760] = np.nan
    with pytest.warns(UserWarning, match="masked"):
        gap = Record(clean.time, clean.inputs, holes, "gap", hold="zero")
    records = [gap, noisy(clean, 1e-3, 2)[:1501]]
    got = identify(NOMINAL, records, instruments=True, substeps=2)
    errors = np.asarray(got.plant.theta) - TRUTH.theta
    assert np.all(np.abs(errors) < 4.0 * np.array(list(got.standard_errors.values())))


def test_a_record_too_short_for_instruments_leaves_them_to_the_others(clean):
    record = noisy(clean, 1e-2, 1)
    alone, both = (identify(NOMINAL, several, substeps=2) for several in
                   (record, [record, record[1000:1020]]))  # fmt: skip
    assert any("instrumental variables in" in reason for reason in alone.reasons)
    assert both.reasons == alone.reasons
    assert both.parameters == pytest.approx(alone.parameters, rel=1e-9)
    assert both.standard_errors == pytest.approx(alone.standard_errors, rel=1e-6)
    assert both.notes[-1].startswith("noisy: 0.")
    assert "too short beside the other records" in both.notes[-1]
    assert len(both.injection) == 2


# -- when a free run departs ------------------------------------------------------------------


def falling(t, x, u, p):
    """Unstable: a rod that stands."""
    del t
    return p.a * x.y[0] - p.b * x.y[1] + p.c * u


@pytest.fixture(scope="module")
def standing():
    """A rod held up by feedback of its true angle, and moved about."""
    truth = Plant(falling, {"a": 15.0, "b": 1.0, "c": 30.0}, 2)
    moves, x, rows = excited(3001, H), np.zeros(2), []

    def rate(x, u):
        return np.array([x[1], 15.0 * x[0] - x[1] + 30.0 * u])

    for move in moves:
        u = move - 2.0 * x[0] - 0.3 * x[1]
        rows.append([u, x[0]])
        for _ in range(4):  # Heun
            first = rate(x, u)
            x = x + H / 8 * (first + rate(x + H / 4 * first, u))
    u, y = np.array(rows).T
    return truth, Record.from_period(H, u, y, hold="zero")


def test_runs_start_anew_in_windows_where_one_departs(standing):
    truth, record = standing
    record = noisy(record, 5e-4, 0)
    plain = identify(truth.with_parameters({"a": 13.0}), record, instruments=False)
    got = identify(truth.with_parameters({"a": 13.0}), record, instruments=True)
    reason = next(one for one in got.reasons if "instrumental" in one)
    assert "runs restarted" in reason
    wrong = [np.abs(np.asarray(one.plant.theta) / truth.theta - 1.0) for one in (plain, got)]
    assert np.max(wrong[1]) < max(0.01, np.max(wrong[0]))


def test_the_plain_estimate_stays_where_the_free_run_departs_in_every_window(clean):
    """A motion that the inputs do not cause."""
    y = np.cumsum(np.random.default_rng(0).standard_normal(2001)) * 1e-3
    record = clean.with_outputs(y[:, None], "astray")
    got = identify(NOMINAL, record, instruments=True, substeps=2)
    plain = identify(NOMINAL, record, instruments=False, substeps=2)
    assert any(
        "no instrumental variables, though requested: the free run" in one for one in got.reasons
    ), got.reasons
    assert got.parameters == plain.parameters
    assert got.standard_errors == plain.standard_errors
    assert not np.any(got.correction)


def test_passes_that_do_not_settle_leave_the_plain_estimate(clean, monkeypatch):
    single = functools.partial(module.instrumental_estimate, max_iterations=1)
    monkeypatch.setattr(module, "instrumental_estimate", single)
    got = identify(NOMINAL, noisy(clean, 1e-3, 0), instruments=True, substeps=2)
    assert any("did not converge within 1" in one for one in got.reasons)
    assert not np.any(got.correction)


def coupled(t, x, u, p):
    """Friction of the first mass acts on the second one by inertia."""
    del t
    (y1, y2), (v1, _) = x.y
    force = -p.a * y1 - 2.0 * v1 - p.c * jnp.sign(v1) + p.b * u[0]
    return jnp.stack([force, 0.5 * force - 30.0 * y2])


def mutual(t, x, u, p):
    """Friction of both masses acts on both."""
    v2 = x.y[1, 1]
    pull = jnp.sign(v2) + 2.0 * v2
    return coupled(t, x, u, p) - jnp.stack([0.1 * pull, pull])


@pytest.mark.parametrize(
    ("f", "why"),
    [(mutual, "acts on another output"), (coupled, "acts on another output")],
)
def test_dry_friction_that_acts_on_other_outputs_leaves_the_plain_estimate(f, why):
    plant = Plant(f, {"a": 40.0, "b": 10.0, "c": 0.5}, 2, ("u",), ("y1", "y2"))
    u = excited(1501, H)
    y = np.column_stack([np.sin(7 * grid(1501, H)), np.sin(5 * grid(1501, H))])
    got = identify(plant, Record.from_period(H, u, y, hold="zero"), instruments=True, substeps=2)
    assert any(why in one for one in got.reasons), got.reasons


def test_a_record_too_short_for_a_free_run_leaves_the_plain_estimate(clean):
    got = identify(NOMINAL, noisy(clean, 1e-3, 0)[:48], instruments=True, substeps=2)
    assert any("its free run cannot be made: `record" in one for one in got.reasons), got.reasons


# -- when they are used -----------------------------------------------------------------------


def test_a_record_without_noise_gives_what_it_gives_without_instruments(clean):
    one, other = (identify(NOMINAL, clean, instruments=used) for used in (None, False))
    assert one.parameters == other.parameters
    assert one.standard_errors == other.standard_errors
    assert one.reasons == other.reasons
    assert not np.any(one.correction)


def test_they_are_used_where_noise_is_what_is_left_and_the_result_says_so(clean):
    got = identify(NOMINAL, noisy(clean, 1e-3, 0), substeps=2)
    (reason,) = [one for one in got.reasons if "instrumental variables" in one]
    assert "measurement noise, 0.00" in reason
    assert np.any(got.correction)


def test_they_are_not_used_where_the_model_lacks_more_than_the_noise(clean):
    """Dry friction that nobody declared."""
    friction = Plant(
        lambda t, x, u, p: NOMINAL.dynamics(t, x, u, p) - p.c * jnp.sign(x.y[1]),
        {**TRUTH.parameters, "c": 0.3}, 2,
    )  # fmt: skip
    got = identify(NOMINAL, noisy(run(friction), 1e-4, 0), substeps=2)
    assert not any("instrument" in one for one in got.reasons)


def test_they_are_not_used_with_the_explicit_form_or_a_relay_that_saturates(clean):
    record = noisy(clean, 1e-3, 0)
    explicit = SecondOrder(20.0, 100.0, 500.0, scheme="explicit")
    weak = SecondOrder(20.0, 100.0, 0.05)
    for observer in (explicit, weak):
        got = identify(NOMINAL, record, observer, LowPass(40.0), smoothing=False, substeps=1)
        assert not any("instrument" in one for one in got.reasons)


@pytest.mark.parametrize("share", [1e-4, 1e-3, 1e-2])
def test_the_noise_that_is_foretold_is_the_one_that_is_left(clean, share, monkeypatch):
    seen = []

    def spy(*arguments):
        seen.append(noise_in_residual(*arguments))
        return 0.0

    monkeypatch.setattr(module, "noise_in_residual", spy)
    identify(NOMINAL, noisy(clean, share, 0), smoothing=False, substeps=1, lowpass=LowPass(60.0, 3))
    # The power of narrow-band noise over 5 s: about 100 degrees of freedom, and the estimate of σ.
    assert seen[0] == pytest.approx(1.0, abs=0.4)
