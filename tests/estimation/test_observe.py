"""The pass of one record inside JAX code: that of `identify`, and its derivatives."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.estimation.engines.single import single_pass
from eoi_jax.estimation.observers.observer import AbstractObserver, Observation
from eoi_jax.estimation.preparation import TAPER, prepare_records, prepare_steps

H = 0.01
TIME = H * np.arange(500)
INPUT = 5.0 * np.round(np.sin(4.0 * TIME))
LOWPASS = eoi.LowPass(20.0, 3)
GAINS = (20.0, 100.0, 200.0)


def stuck(t, x, u, p):
    rate = x.y[1, 0]
    return u[0] - p.k * x.y[0, 0] - p.d * rate - p.c * jnp.sign(rate)


ROUGH = eoi.Plant(stuck, {"k": 8.0, "d": 0.5, "c": 3.0}, 2)
SMOOTH = eoi.Plant(
    lambda t, x, u, p: p.b * u - p.k * x.y[0] - p.d * x.y[1], {"k": 9.0, "d": 0.8, "b": 1.0}, 2
)
SPEED = eoi.Plant(lambda t, x, u, p: p.b * u - p.a * x.y[0], {"a": 1.0, "b": 2.0}, 1)
HIDDEN = eoi.Plant(
    lambda t, x, u, p: u[0] - p.k * x.y[0] - p.d * x.y[1] + p.s * x.z[0],
    {"k": 9.0, "d": 0.8, "s": 1.0, "T": 0.3},
    2,
    internal=lambda t, x, u, p: (x.y[0, 0] - x.z[0]) / p.T,
    internal_initial=[0.0],
)  # fmt: skip
SECOND = eoi.observers.SecondOrder(*GAINS)
FIRST = eoi.observers.FirstOrder(100.0)
PAIRS = {
    "friction": (ROUGH, SECOND),
    "smooth": (SMOOTH, SECOND),
    "explicit": (SMOOTH, eoi.observers.SecondOrder(*GAINS, scheme="explicit")),
    "super-twisting": (SMOOTH, eoi.observers.SuperTwisting(500.0)),
    "first order": (SPEED, FIRST),
    "internal state": (HIDDEN, SECOND),
}


def measured(plant, hold="zero"):
    return np.asarray(eoi.rollout(plant, None, None, INPUT, H, hold=hold, substeps=4).y[:, 0])


def changed(plant):
    return np.asarray(plant.theta) * (1.0 + 0.1 * np.cos(np.arange(len(plant.names))))


def observed(name, theta=None, **options):
    plant, observer = PAIRS[name]
    theta = changed(plant) if theta is None else theta
    return eoi.observe(
        plant, observer, theta, H, measured(plant), INPUT, lowpass=LOWPASS, **options
    )


def pass_of_identify(plant, observer, y, theta, hold, transient, valid=None):
    """As `identify` runs it, for one record without smoothing and sub-steps."""
    y = y if valid is None else np.where(valid[:, None], y, np.nan)
    record = eoi.Record(TIME, INPUT, y, hold=hold)
    explicit = observer.scheme == "explicit"
    prepared = prepare_records(plant, (record,), LOWPASS, False, 1, explicit)
    steps = prepare_steps(
        plant, prepared.fine, prepared.inputs, np.atleast_2d(observer.kernel).shape[1], transient,
        LOWPASS.memory, [np.zeros(len(plant.outputs))], explicit, TAPER / LOWPASS.cutoff,
    )  # fmt: skip
    lowpass = jax.tree.map(lambda leaf: leaf[None], LOWPASS.discretise(H))
    sums, trace = single_pass(plant, observer, lowpass, steps)(theta, "signals")
    return jax.tree.map(lambda leaf: leaf[0], (sums, trace)), np.asarray(steps.score[0])


@pytest.mark.parametrize(("name", "hold"), [*zip(PAIRS, ["zero", "linear"] * 3, strict=True)])
def test_the_sums_are_those_of_identify(name, hold):
    plant, observer = PAIRS[name]
    y, theta = measured(plant, hold), changed(plant)
    (sums, trace), score = pass_of_identify(plant, observer, y, theta, hold, 0.4)
    got = eoi.observe(
        plant, observer, theta, H, y, INPUT, lowpass=LOWPASS, hold=hold, transient=0.4
    )
    np.testing.assert_array_equal(got.score, score)
    for value, want in (
        (got.information, sums.information),
        (got.rhs, sums.rhs),
        (got.index, sums.square / sums.weight),
        (got.injection, trace.injection),
        (got.regressors, trace.Phi),
        (got.weight, trace.weight),
    ):
        np.testing.assert_allclose(value, want, rtol=1e-9, atol=1e-10 * np.max(np.abs(want)))


@pytest.mark.filterwarnings("ignore:Record `record`. 30 of 500 samples")
def test_dry_friction_at_rest_does_not_count_and_gaps_do_not_either():
    y, valid = measured(ROUGH), np.ones(len(TIME), bool)
    valid[200:230] = False
    (sums, _), score = pass_of_identify(ROUGH, SECOND, y, changed(ROUGH), "zero", 0.4, valid)
    arguments = {"lowpass": LOWPASS, "transient": 0.4, "valid": valid}
    got = eoi.observe(ROUGH, SECOND, changed(ROUGH), H, y, INPUT, **arguments)
    np.testing.assert_array_equal(got.score, score)
    assert 0.2 < np.mean(score) < 0.8
    np.testing.assert_allclose(got.information, sums.information, rtol=1e-9, atol=1e-12)
    spoilt = np.where(valid[:, None], y, 1e3)
    other = eoi.observe(ROUGH, SECOND, changed(ROUGH), H, spoilt, INPUT, **arguments)
    np.testing.assert_allclose(other.information, got.information, rtol=1e-6)


def test_one_step_of_least_squares_finds_the_parameters():
    """Of a model that is affine in them, but for the order of the sampled pass, h²."""
    got = observed("friction", noise=0.0)
    increment = np.linalg.solve(got.information[0], got.rhs[0])
    np.testing.assert_allclose(changed(ROUGH) + increment, ROUGH.theta, rtol=0.02)
    assert observed("friction", signals=False).injection is None


def test_parameters_come_by_name_or_in_order():
    theta = changed(SMOOTH)
    named = dict(zip(SMOOTH.names, theta, strict=True))
    np.testing.assert_array_equal(observed("smooth", named).rhs, observed("smooth", theta).rhs)
    part = observed("smooth", {"k": 7.0})
    np.testing.assert_array_equal(part.rhs, observed("smooth", [7.0, 0.8, 1.0]).rhs)


def test_a_padded_record_is_the_short_one():
    y, short = measured(SMOOTH), slice(0, 400)
    mask = np.arange(len(TIME)) < 400
    padded = np.where(mask[:, None], y, y[399])
    arguments = {"lowpass": LOWPASS, "transient": 0.4}
    got = eoi.observe(SMOOTH, SECOND, changed(SMOOTH), H, padded, INPUT, valid=mask, **arguments)
    want = eoi.observe(SMOOTH, SECOND, changed(SMOOTH), H, y[short], INPUT[short], **arguments)
    assert np.sum(got.score) == np.sum(want.score)
    # Their weights rise beside the end, where the other has no neighbour: some steps differ.
    inner = slice(0, 380)
    np.testing.assert_allclose(got.injection[inner], want.injection[inner], rtol=1e-9, atol=1e-12)


# -- derivatives --------------------------------------------------------------------------


def difference(function, at, step):
    return (function(at + step) - function(at - step)) / (2 * step)


@pytest.mark.parametrize("name", ["friction", "first order", "super-twisting", "internal state"])
def test_gradients_of_the_index_equal_differences(name):
    """By parameters and by the data; noise says when a velocity with dry friction is zero."""
    plant, observer = PAIRS[name]
    y, theta = measured(plant), changed(plant)
    direction = np.cos(np.arange(len(theta)) + 1.0)
    wave = np.sin(3.0 * TIME)[:, None]

    def cost(shift, size):
        got = eoi.observe(
            plant, observer, theta + shift * direction, H, y + size * wave, INPUT, lowpass=LOWPASS,
            noise=1e-5, signals=False,
        )  # fmt: skip
        return jnp.log(got.index[0])

    slopes = jax.grad(cost, (0, 1))(0.0, 0.0)
    want = (
        difference(lambda s: cost(s, 0.0), 0.0, 1e-6),
        difference(lambda s: cost(0.0, s), 0.0, 1e-6),
    )
    np.testing.assert_allclose(slopes, want, rtol=1e-5)
    forward = jax.jvp(cost, (0.0, 0.0), (1.0, 0.0))[1]
    np.testing.assert_allclose(forward, slopes[0], rtol=1e-9)


def test_the_gradient_by_a_gain_and_a_cut_off_equals_differences():
    """The relay is too small to slide throughout: the index depends on it."""
    y = measured(SMOOTH)

    def cost(c3, cutoff):
        observer = eoi.observers.SecondOrder(20.0, 100.0, c3)
        lowpass = eoi.LowPass(cutoff, 3)
        got = eoi.observe(
            SMOOTH, observer, changed(SMOOTH), H, y, INPUT, lowpass=lowpass, transient=0.5
        )
        return got.index[0]

    at = 0.3, 20.0
    slopes = jax.jit(jax.grad(cost, (0, 1)))(*at)
    want = (
        difference(jax.jit(lambda c3: cost(c3, at[1])), at[0], 1e-6),
        difference(jax.jit(lambda cutoff: cost(at[0], cutoff)), at[1], 1e-4),
    )
    assert abs(want[0]) > 1e-6
    np.testing.assert_allclose(slopes, want, rtol=1e-5)


# -- batches ------------------------------------------------------------------------------


def test_vmap_over_records_gain_sets_and_parameters_equals_single_passes():
    scales = jnp.asarray([1.0, 0.7])
    y = jnp.stack([measured(SMOOTH)[:, 0], 0.7 * measured(SMOOTH)[:, 0]])
    u = scales[:, None] * INPUT
    relays, stiffness = jnp.asarray([50.0, 200.0, 400.0]), jnp.asarray([7.0, 8.5, 10.0])

    def power(y, u, c3, k):
        observer = eoi.observers.SecondOrder(20.0, 100.0, c3)
        got = eoi.observe(SMOOTH, observer, {"k": k}, H, y, u, lowpass=LOWPASS)
        return got.index[0], got.information

    over_lanes = jax.vmap(power, (None, None, 0, 0))
    index, information = jax.jit(jax.vmap(over_lanes, (0, 0, None, None)))(y, u, relays, stiffness)
    assert index.shape == (2, 3)
    assert information.shape == (2, 3, 1, 3, 3)
    for i in range(2):
        for j in range(3):
            single = power(y[i], u[i], relays[j], stiffness[j])
            np.testing.assert_allclose(index[i, j], single[0], rtol=1e-9)


def test_gain_sets_of_a_sweep_are_batches_of_observers():
    sets = eoi.observers.gains(
        eoi.observers.SecondOrder, {"c1": 20.0, "c2": 100.0, "c3": [50.0, 200.0]}
    )
    y = measured(SMOOTH)

    def power(observer):
        return eoi.observe(SMOOTH, observer, None, H, y, INPUT, lowpass=LOWPASS).index[0]

    batch = jax.vmap(power)(jax.tree.map(jnp.asarray, sets.observer))
    single = [power(eoi.observers.SecondOrder(20.0, 100.0, c3)) for c3 in (50.0, 200.0)]
    np.testing.assert_allclose(batch, single, rtol=1e-9)


def test_it_runs_in_a_scan_of_the_user():
    """Iterations of the least squares, θ ← θ + Δθ, reach a fixed point."""
    y = measured(SMOOTH)

    def improve(theta, _):
        got = eoi.observe(SMOOTH, SECOND, theta, H, y, INPUT, lowpass=LOWPASS, signals=False)
        return theta + jnp.linalg.solve(got.information[0], got.rhs[0]), got.index[0]

    theta, index = jax.lax.scan(improve, jnp.asarray([5.0, 2.0, 0.5]), None, length=3)
    np.testing.assert_allclose(theta, SMOOTH.theta, rtol=0.02)
    assert index[-1] < 1e-3 * index[0]


class Follower(AbstractObserver):
    """An observer of a user: y⁽¹⁾ is the difference of the samples."""

    scheme: str = eqx.field(static=True, default="implicit")

    @property
    def relative_degree(self):
        return 1

    @property
    def kernel(self):
        return (1.0,)

    def init(self, y, rates):
        return y

    def rates(self, state):
        return jnp.zeros((0, *state.shape))

    def step(self, state, y, y_next, drift, sample_period):
        observed = (y_next - y) / sample_period
        always = jnp.ones(y.shape, bool)
        rates = jnp.zeros((0, *y.shape))
        return y_next, Observation(observed - drift, observed, rates, always)


def test_an_observer_of_the_user_takes_part():
    y = measured(SPEED)
    got = eoi.observe(SPEED, Follower(), [2.0, 1.0], H, y, INPUT, lowpass=LOWPASS)
    increment = np.linalg.solve(got.information[0], got.rhs[0])
    np.testing.assert_allclose(np.array([2.0, 1.0]) + increment, SPEED.theta, rtol=1e-3)


class OneValue(Follower):
    """It forgets its state."""

    def step(self, state, y, y_next, drift, sample_period):
        return super().step(state, y, y_next, drift, sample_period)[1]


def test_an_observer_that_returns_one_value_is_named():
    y = measured(SPEED)
    message = "`OneValue.step` must return two values, the new state and an `Observation`, got Obs"
    with pytest.raises(ValueError, match=message):
        eoi.observe(SPEED, OneValue(), None, H, y, INPUT)
    with pytest.raises(ValueError, match=message):
        eoi.identify(SPEED, eoi.Record(TIME, INPUT, y, hold="zero"), OneValue())


# -- the default filter, and wrong calls -----------------------------------------------------


def test_by_default_the_filter_is_a_tenth_of_the_sampling_rate():
    y = measured(SMOOTH)
    want = eoi.observe(SMOOTH, SECOND, None, H, y, INPUT, lowpass=eoi.LowPass(0.2 * np.pi / H, 3))
    got = eoi.observe(SMOOTH, SECOND, None, H, y, INPUT)
    np.testing.assert_allclose(got.rhs, want.rhs, rtol=1e-12)
    traced = jax.jit(lambda h: eoi.observe(SMOOTH, SECOND, None, h, y, INPUT).rhs)(H)
    np.testing.assert_allclose(traced, want.rhs, rtol=1e-7)


RIGHT = {"plant": SMOOTH, "observer": SECOND, "theta": None, "h": H, "y": INPUT, "u": INPUT}


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"h": -0.01}, "`h` must be positive and finite, got -0.01"),
        ({"observer": FIRST}, "`observer` must have the relative degree of the plant's outputs"),
        ({"y": np.ones((500, 2))}, r"`y` must have shape \(any, 1\): one row a sample"),
        ({"y": np.ones((500, 2, 1))}, r"Outputs of `rollout` are `.y\[:, 0\]`; several records"),
        ({"u": np.ones((500, 2))}, r"`u` must have shape \(any, 1\): one row a sample"),
        ({"u": INPUT[:-1]}, "`u` must have as many samples as `y`, 500, got 499"),
        ({"y": INPUT[:2], "u": INPUT[:2]}, "`y` must have at least three samples, got 2"),
        ({"hold": "smooth"}, "`hold` must be one of zero, linear, got 'smooth'"),
        ({"theta": {"kk": 1.0}}, "`parameters` must be one of k, d, b, got 'kk'"),
    ],
)
def test_a_wrong_call_is_named(wrong, message):
    with pytest.raises(ValueError, match=message):
        eoi.observe(**{**RIGHT, **wrong})
