"""Actions of one output on another: where they fit, what they add, how they are found."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import eoi_jax as eoi
from eoi_jax import effects, plants
from eoi_jax.models.augmented import augmented
from eoi_jax.models.effects.signals import Signal
from eoi_jax.models.placements import placed_label, placements

H = 0.5


def feeds(t, x, u, p):
    a, b = x.y[0]
    return jnp.stack([p.feed * u[0] - p.loss * a, p.feed * u[1] - p.loss * b])


REACTOR = eoi.Plant(
    feeds, {"feed": 0.08, "loss": 0.04}, 1, inputs=("fa", "fb"), outputs=("ca", "cb")
)


def reaction(seed: int, samples: int = 800) -> eoi.Record:
    """Two feeds that react: A + B → C."""
    draw = np.random.default_rng(seed)
    u = np.repeat(1.0 + draw.uniform(-1.0, 1.0, (samples // 20, 2)), 20, axis=0)
    y = np.empty((samples, 2))
    y[0] = 0.5
    for k in range(samples - 1):

        def rate(t, c, u=u[k]):
            reacting = 0.3 * c[0] * c[1]
            return 0.1 * u - 0.05 * c - reacting

        y[k + 1] = solve_ivp(rate, (0.0, H), y[k], rtol=1e-8).y[:, -1]
    y += 1e-3 * np.std(y, axis=0) * draw.standard_normal(y.shape)
    return eoi.Record(
        H * np.arange(samples), u, y, input_names=("fa", "fb"), output_names=("ca", "cb")
    )


def test_a_plant_of_one_output_has_none():
    assert effects.couplings(plants.pendulum()) == ()
    single = eoi.Plant(lambda t, x, u, p: p.a * u - x.y[0], {"a": 1.0}, 1)
    alone = eoi.Record(H * np.arange(100), np.ones(100), np.linspace(0.0, 1.0, 100))
    with pytest.raises(ValueError, match="coupling needs a plant of several outputs"):
        eoi.discover(single, alone, effects="coupling")


def test_every_coupling_acts_from_another_output():
    masses = plants.three_mass_spring_damper()
    candidates = placements(masses, effects.couplings(masses))
    assert candidates
    for placed in candidates:
        assert isinstance(placed.effect, effects.Coupling)
        channels = {signal.column for signal in placed.effect.signals if signal.row is not None}
        assert channels - {placed.channel}
    labels = [placed_label(masses, placed) for placed in candidates]
    assert len(set(labels)) == len(labels)


def test_a_coupling_adds_the_product_of_its_signals():
    product = effects.Coupling((Signal("ca", 0), Signal("cb", 1)))
    (first, _) = placements(REACTOR, [product])
    assert first.names == ("coupling_ca_cb_ca",)
    coupled = augmented(REACTOR, [first], {"coupling_ca_cb_ca": -0.3})
    state = eoi.State(jnp.array([[2.0, 5.0]]), jnp.zeros(0))
    args = jnp.zeros(()), state, jnp.zeros(2)
    before, after = (
        plant.derivative(*args, jnp.asarray(plant.theta)) for plant in (REACTOR, coupled)
    )
    assert after - before == pytest.approx([-3.0, 0.0])
    by_input = effects.Coupling((Signal("fb", 1, None), Signal("cb", 1)))
    assert by_input.form == "fb·cb"
    assert effects.Coupling((Signal("q", 0, 1),) * 2).form == "q'²"
    assert not by_input.fits(REACTOR, 1)
    assert not by_input.fits(plants.three_mass_spring_damper(), 0)


@pytest.mark.parametrize(
    "tried", ["coupling", pytest.param(None, marks=pytest.mark.slow)], ids=["asked for", "all"]
)
def test_a_reaction_is_found(tried):
    found = eoi.discover(REACTOR, reaction(1), validation=reaction(2), effects=tried)
    assert [(added.label, added.output) for added in found.added] == [
        ("coupling (ca·cb)", "ca"), ("coupling (ca·cb)", "cb"),
    ]  # fmt: skip
    for added in found.added:
        (value,) = added.parameters.values()
        assert value == pytest.approx(-0.3, rel=2e-3)
    assert "coupling_ca_cb_ca·ca·cb" in str(found)
    assert found.status.code == "complete"


@pytest.mark.slow
def test_nothing_is_added_to_a_reaction_that_is_declared():
    def reacting(t, x, u, p):
        return feeds(t, x, u, p) - p.rate * x.y[0, 0] * x.y[0, 1]

    whole = eoi.Plant(
        reacting, {"feed": 0.08, "loss": 0.04, "rate": 0.2}, 1,
        inputs=("fa", "fb"), outputs=("ca", "cb"),
    )  # fmt: skip
    assert eoi.discover(whole, reaction(1), validation=reaction(2)).effects == ()
