"""Output error by optimistix ends where `refine` does; what it does not cover it says."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax import comparators
from eoi_jax.comparison.methods import output_error_optimistix
from eoi_jax.comparison.methods.output_error_optimistix import _Coordinates
from eoi_jax.models.sampled_states import SampledStates

TIME = np.arange(0.0, 2.5, 1e-2)
INPUT = eoi.excitation.prbs(TIME, amplitude=1.0, switching_period=0.1, seed=3)
TRUE = {"k": 100.0, "c": 6.0, "g": 1.6}
METHOD = comparators.OptimistixOutputError()


def oscillator(t, x, u, p):
    position, rate = x.y
    return -p.k * position - p.c * rate + p.g * u


def mass(**options) -> eoi.Plant:
    return eoi.Plant(oscillator, {"k": 120.0, "c": 8.0, "g": 2.0}, 2, **options)


def observed(
    record: eoi.Record, share: float = 0.05, gap: slice | None = None, **options
) -> eoi.Record:
    """With white noise, and with samples that were not measured."""
    draw = np.random.default_rng(1)
    y = record.outputs + share * np.std(record.outputs, axis=0) * draw.standard_normal(
        record.outputs.shape
    )
    if gap is not None:
        y[gap] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", eoi.RecordWarning)
        return eoi.Record(record.time, record.inputs, y, hold="zero", **options)


@pytest.fixture(scope="module")
def records() -> list[eoi.Record]:
    """Of different lengths, one with a gap, the other with a burn-in."""
    run = eoi.simulate(mass().with_parameters(TRUE), TIME, INPUT)
    return [observed(run, gap=slice(100, 150)), observed(run[:180], burn_in=0.3)]


def distance(plant: eoi.Plant, records) -> dict[str, float]:
    """From the estimate of `refine`, in its standard errors; of parameters on a bound, relative."""
    answer, best = METHOD.estimate(plant, records), eoi.refine(plant, records, window=np.inf)
    assert answer.status.code == "converged", answer.status
    assert answer.parameters is not None
    assert best.status.code == "converged"
    errors = {
        name: error if np.isfinite(error) else abs(best.parameters[name])
        for name, error in best.standard_errors.items()
    }
    return {
        name: abs(value - best.parameters[name]) / errors[name] if errors[name] else 0.0
        for name, value in answer.parameters.items()
    }


def solver_tolerance(records) -> float:
    """Standard errors by which `refine` may miss its minimum.

    It converges where a step would lower the cost N σ² by less than a millionth. The cost rises by
    σ² one standard error away, and with the square of the distance.
    """
    return float(np.sqrt(1e-6 * sum(np.sum(record.output_valid) for record in records)))


def test_the_estimate_is_that_of_refine(records):
    near = distance(mass(), records)
    assert max(near.values()) < solver_tolerance(records), near


@pytest.mark.slow
@pytest.mark.parametrize(
    ("start", "bounds"),
    [
        (7.0, {"c": (6.6, np.inf), "g": (0.0, np.inf)}),
        (5.5, {"c": (0.0, 5.5), "k": (-np.inf, 120.0)}),
    ],
)
def test_a_bound_is_kept_where_the_minimum_lies_beyond(records, start, bounds):
    """The search begins on bounds, too, from which it must get away."""
    plant = mass().declared_anew({"c": start}, bounds)
    near = distance(plant, records[1:])
    assert max(near.values()) < solver_tolerance(records[1:]), near
    answer = METHOD.estimate(plant, records[1:])
    assert answer.parameters is not None
    assert answer.parameters["c"] in bounds["c"]
    assert answer.status.message.endswith("on a bound: c")


def test_coordinates_keep_the_bounds_and_reach_them():
    """A unit moves a parameter by its size, near a bound by less; those on a bound are held."""
    bounds = {"k": (100.0, np.inf), "c": (-np.inf, 9.0), "g": (1.0, 40.0)}
    plant = mass(bounds=bounds)
    coordinates = _Coordinates.of(plant)
    np.testing.assert_allclose(coordinates.theta(jnp.zeros(3)), plant.theta, rtol=1e-12)
    share = jnp.diag(jax.jacfwd(coordinates.theta)(jnp.zeros(3))) / plant.theta
    assert np.all((share > 0.1) & (share < 1.0 + 1e-12)), share
    for unknown in np.linspace(-30.0, 30.0, 61):
        theta = np.asarray(coordinates.theta(jnp.full(3, unknown)))
        assert np.all((theta >= plant.lower) & (theta <= plant.upper))
    for bound in ([100.0, 9.0, 40.0], [100.0, 9.0, 1.0]):
        held = coordinates.on_bounds(np.array(bound))
        np.testing.assert_allclose(held.theta(jnp.ones(3)), bound, rtol=1e-12)
    # Without bounds none is held, and a parameter is its unknown times its size.
    free = _Coordinates.of(mass())
    np.testing.assert_array_equal(free.on_bounds(np.zeros(3)).step, free.step)
    np.testing.assert_allclose(free.theta(jnp.ones(3)), 2.0 * plant.theta, rtol=1e-12)


def test_two_outputs_are_weighed_by_their_residuals():
    """One output of relative degree 0, an internal state, a fixed parameter, a known start."""

    def outputs(t, x, u, p):
        return jnp.stack([-p.a * x.y[0, 0] + u[0], p.s * x.z[0]])

    def lag(t, x, u, p):
        return jnp.stack([p.b * (x.y[0, 0] - x.z[0])])

    plant = eoi.Plant(
        outputs,
        {"a": 2.6, "b": 1.5, "s": 4.0},
        (1, 0),
        ("u",),
        ("speed", "torque"),
        lag,
        lambda p: jnp.stack([0.1 * p.b]),
        fixed=("s",),
        initial={"speed": 0.0},
    )
    run = eoi.simulate(plant.with_parameters({"a": 2.0, "b": 1.0}), TIME, INPUT)
    draw = np.random.default_rng(2)
    noise = np.array([0.3, 0.02]) * np.std(run.outputs, axis=0)
    y = run.outputs + noise * draw.standard_normal(run.outputs.shape)
    near = distance(plant, [eoi.Record(TIME, INPUT, y, hold="zero")])
    assert near.pop("s") == 0.0
    # Weights have settled where another fit would change them by 2 %, in both: those of the
    # squares differ by 8 % at most, and the estimate by less than as many standard errors.
    assert max(near.values()) < 0.08, near


def test_a_second_part_of_a_split_begins_anywhere():
    """Its internal state is estimated, not where the plant declares it."""

    def tank(t, x, u, p):
        return -p.a * x.y[0] + x.z[0]

    def lag(t, x, u, p):
        return p.b * (u - x.z[0])

    plant = eoi.Plant(tank, {"a": 1.2, "b": 3.0}, internal=lag, internal_initial=(0.0,))
    run = eoi.simulate(plant.with_parameters({"a": 1.0, "b": 2.0}), TIME, INPUT + 1.0)
    parts = [*observed(run, 0.01).split(0.4)]
    assert parts[1].continues
    near = distance(plant, parts[1:])
    assert max(near.values()) < solver_tolerance(parts[1:]), near


def test_compare_runs_it_by_name_only(records):
    assert METHOD.name not in [one.name for one in comparators.standard()]
    assert METHOD.name in [one.name for one in comparators.on_request()]
    result = eoi.compare(mass(), records, methods=["output_error", METHOD.name])
    first, second = result.entries
    assert second.status.ok
    np.testing.assert_allclose(second.rmse, first.rmse, rtol=1e-4)
    assert METHOD.name in str(result)


# -- no answer ------------------------------------------------------------------------------------


def test_a_start_whose_free_run_diverges_is_said(records):
    wild = mass().with_parameters({"k": -1e5, "c": -1e4})
    answer = METHOD.estimate(wild, records[1:])
    assert answer.parameters is None
    assert answer.status.code == "diverged"
    assert "free run from the nominal values" in answer.status.message


def test_what_leaves_no_trace_is_named(records):
    def double(t, x, u, p):
        return -(p.a + p.b) * x.y[0] - p.c * x.y[1] + p.g * u

    plant = eoi.Plant(double, {"a": 50.0, "b": 50.0, "c": 6.0, "g": 2.0}, 2)
    answer = METHOD.estimate(plant, records[1:])
    assert answer.parameters is None
    assert answer.status.code == "unidentifiable"
    assert "change of a, b:" in answer.status.message


def test_too_few_steps_are_said(records, monkeypatch):
    few = output_error_optimistix.OptimistixSettings(max_steps=2)
    monkeypatch.setattr(output_error_optimistix, "_SETTINGS", few)
    answer = METHOD.estimate(mass(fixed=("g",)), records[1:])
    assert answer.status.code == "passes_exhausted"
    assert "after 2 steps" in answer.status.message


def test_nothing_to_score_is_no_data(records):
    never = eoi.Record(TIME, INPUT, np.sin(TIME), burn_in=1e3)
    assert METHOD.estimate(mass(), [never]).status.code == "no_data"


def changed(**options) -> eoi.Record:
    return eoi.Record(TIME, INPUT, np.sin(TIME), **options)


def anywhere(p):
    return jnp.zeros(1)


anywhere.weights = (1.0,)  # type: ignore[attr-defined]


def gap() -> eoi.Record:
    u = INPUT.copy()
    u[100:120] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", eoi.RecordWarning)
        return eoi.Record(TIME, u, np.sin(TIME), hold="zero")


@pytest.mark.parametrize(
    ("plant", "record", "text"),
    [
        (mass(), [changed(hold="smooth")], "holds all inputs zero or linear"),
        (mass(), [changed(hold="zero"), changed(hold="linear")], "records have different holds"),
        (mass(), [changed(hold="zero").with_delayed_inputs([0.004])], "earlier or later"),
        (mass(), [gap()], "have gaps"),
        (mass(actuator=lambda t, u, p: u), [changed(hold="zero")], "before the record"),
        (
            mass(internal=lambda t, x, u, p: -x.z, internal_initial=anywhere),
            [changed(hold="zero")],
            "effects that start at any value",
        ),
        (
            mass(
                internal=lambda t, x, u, p: jnp.array([0.0, -1.0]),
                internal_initial=[0.0, 0.0],
                sampled=SampledStates(lambda *_: 0.0, 1, 0.1),
            ),
            [changed(hold="zero")],
            "change at samples only",
        ),
    ],
)
def test_what_rollout_does_not_cover_is_not_applicable(plant, record, text):
    answer = METHOD.estimate(plant, record)
    assert answer.parameters is None
    assert answer.status.code == "not_applicable"
    assert text in answer.status.message
