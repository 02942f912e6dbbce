"""What is printed of a plant and its effects is what they compute."""

import functools
import re
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.models.augmented import augmented, place
from eoi_jax.models.effects import INPUT_EFFECTS, AbstractActuator
from eoi_jax.models.effects.effect import internal_names
from eoi_jax.models.equations.display import equation_latex, equation_text
from eoi_jax.models.placements import placements

LIBRARY = (*effects.standard(), *effects.rare(), effects.Drift(start=2.5))


def joined(t, x, u, p):
    """-(a + b)/m, -(a - b)·k: grouping and signs as they are written."""
    (a, b), (va, vb) = x.y
    force = -(p.d * va + p.k * a) / p.m + u[0] / p.m
    return jnp.stack([force - (a - b) * p.s, u[0] - (b - a) * p.s - (vb - (va - p.k)) * p.d])


def bent(t, x, u, p):
    """Saturation, dry friction in pieces, powers, roots, angles in degrees."""
    (y,), (v,) = x.y
    dry = jnp.where(v > p.slow, p.level, jnp.where(v < -p.slow, -p.level, 0.0))
    driven = jnp.clip(u[0], -p.limit, p.limit) * p.gain
    rough = jnp.where((y > 0.5) & ~(v > 0.1) | (v <= -1.0), p.level, 1.0)
    smooth = jnp.tanh(v / p.slow) + jnp.exp(-t / 3.0) + jnp.abs(y) ** 1.5 / (2.0 * p.gain)
    angle = jnp.sin(y * jnp.pi / 180.0) + jnp.cos(y + jnp.pi / 2.0)
    return -p.level * (y - 2.0 * jnp.pi * p.slow) - dry + driven + smooth * rough + angle - v**2


def linear(t, x, u, p):
    """Matrices: products with zeros vanish."""
    return jnp.array([[0.0, 1.0], [-2.0, 0.5]]) @ x.y[0] + jnp.stack([u[0], p.k])


PLANTS = {
    "pendulum": eoi.plants.pendulum,
    "level_tank": eoi.plants.level_tank,
    "mass_spring_damper": eoi.plants.mass_spring_damper,
    "three_mass_spring_damper": eoi.plants.three_mass_spring_damper,
    "positioning_system": eoi.plants.positioning_system,
    "cascaded_tanks": eoi.plants.cascaded_tanks,
    "duffing_oscillator": eoi.plants.duffing_oscillator,
    "propeller_arm": eoi.plants.propeller_arm,
    "joined": lambda: eoi.Plant(
        joined, {"d": 0.5, "k": 2.0, "m": 3.0, "s": 4.0}, 2, ("F",), ("a", "b")
    ),
    "bent": lambda: eoi.Plant(
        bent, {"slow": 0.3, "level": 0.7, "limit": 0.4, "gain": 2.0}, 2, ("u",), ("y",)
    ),
    "linear": lambda: eoi.Plant(linear, {"k": 1.5}, 1, ("u",), ("a", "b")),
    "text": lambda: eoi.plant_from_text(
        {"x": "v", "v": "-(k*x + d*v)/m + (a if v > 0 else -a*q)", "q": "-q/T + clip(u, -1, 1)"},
        {"k": 2.0, "d": 0.3, "m": 1.5, "a": 0.2, "T": 0.4}, ["x"], ["u"], initial={"q": 0.0},
    ),
}  # fmt: skip


# -- reading what is printed ------------------------------------------------------------------

_RAISED = "⁰¹²³⁴⁵⁶⁷⁸⁹"
_FUNCTIONS = {
    **{name: getattr(np, name) for name in ("sin", "cos", "exp", "tanh", "sign", "clip", "where")},
    "sqrt": lambda x: np.sqrt(np.maximum(x, 0.0)),
    "max": np.maximum,
    "min": np.minimum,
    "abs": np.abs,
    "pi": np.pi,
}


def code(text):
    """A printed formula as Python."""
    while (found := re.search(r"\|([^|]*)\|", text)) is not None:
        text = f"{text[: found.start()]}abs({found[1]}){text[found.end() :]}"
    text = re.sub(f"[{_RAISED}]+", lambda found: "**" + found[0].translate(
        str.maketrans(_RAISED, "0123456789")), text)  # fmt: skip
    text = re.sub(r"(?<=\w)'+", lambda found: f"__{len(found[0])}", text)
    for old, new in (("·", "*"), ("^", "**"), ("π", "pi"), ("≤", "<="), ("[", "("), ("]", ")")):
        text = text.replace(old, new)
    return text


POINTS = 5


def shown(text, values):
    """What a printed formula is worth at each point; `and` and `not` are of single values."""
    formula = compile(code(text), text, "eval")
    points = [{name: np.broadcast_to(value, POINTS)[k] for name, value in values.items()}
              for k in range(POINTS)]  # fmt: skip
    return np.asarray([eval(formula, {"__builtins__": {}}, _FUNCTIONS | at) for at in points])


def computed(text, values):
    """Left sides of printed equations and what their right sides are worth."""
    lines = text.splitlines()
    values = dict(values)
    for line in lines:
        if line.startswith("with "):
            name, right = line.removeprefix("with ").split(" → ")
            values[name] = shown(right, values)
    pairs = (line.split(" = ", 1) for line in lines if not line.startswith("with "))
    return {left: shown(right, values) for left, right in pairs}


def place_items(plant):
    """Every effect in every way in which it can act, as `discover` reports it, and the whole."""
    ways = {
        (placed.effect, placed.against is None, placed.through is None): placed
        for placed in placements(plant, LIBRARY)
    }
    for placed in ways.values():
        yield found(plant, placed, placed.effect.channels(plant)[placed.channel])


def found(plant, placed, name):
    values = {key: 0.3 + 0.2 * i for i, key in enumerate(placed.names)}
    item = SimpleNamespace(
        effect=placed.effect,
        output=name,
        parameters=values,
        against="" if placed.against is None else plant.outputs[placed.against],
        through="" if placed.through is None else plant.inputs[placed.through],
    )
    return item, augmented(plant, [placed], values)


def compare(plant, text, states):
    """Printed equations with what the plant's functions give, at points drawn at random."""
    draw = np.random.default_rng(5)
    r = plant.relative_degree
    y = draw.uniform(-1.5, 1.5, (POINTS, r, len(plant.outputs)))
    y *= np.asarray([[i < degree for degree in plant.degrees] for i in range(r)])
    t = draw.uniform(0.0, 1.0, POINTS)
    z = draw.uniform(-1.0, 2.0, (POINTS, len(states)))
    u = draw.uniform(-1.0, 1.0, (POINTS, len(plant.inputs)))
    values = {"t": t, **plant.parameters, **dict(zip(states, z.T, strict=True))}
    values |= dict(zip(plant.inputs, u.T, strict=True))
    values |= {
        code(output + "'" * i): y[:, i, j]
        for j, output in enumerate(plant.outputs)
        for i in range(plant.degrees[j])
    }

    def rates(t, y, z, u):
        x, theta = eoi.State(y, z), jnp.asarray(plant.theta)
        return jnp.concatenate(
            [plant.derivative(t, x, u, theta), plant.internal_rate(t, x, u, theta)]
        )

    wanted = jax.vmap(rates)(*map(jnp.asarray, (t, y, z, u)))
    got = list(computed(text, values).values())
    np.testing.assert_allclose(got, wanted.T, rtol=1e-10, atol=1e-10)


@pytest.fixture(params=PLANTS)
def plant(request):
    return PLANTS[request.param]()


def states_of(plant, item=None):
    """As equations name them."""
    own = getattr(plant.internal, "states", None) or ["z"] * (plant.internal is not None)
    count = item.effect.states if item else 0
    first = len(own)
    more = [f"z{first + i + 1}" if first else "z" for i in range(count)]
    return [*own, *more]


def test_the_printed_equation_is_the_plant(plant):
    compare(plant, equation_text(plant), states_of(plant))


def test_the_printed_equation_with_an_effect_is_the_plant_with_it(plant):
    for item, whole in place_items(plant):
        printed = equation_text(plant, [item])
        if not isinstance(item.effect, AbstractActuator):
            compare(whole, printed, states_of(plant, item))
        assert all(name in printed for name in item.parameters)
        assert not re.search(r"[-+] [-+]", printed)
        tex = equation_latex(plant, [item])
        assert tex.count("{") == tex.count("}")
        assert tex.count("(") == tex.count(")")


def test_values_are_those_of_the_names(plant):
    """Five digits of each: what they are worth together is near."""
    values = {**plant.parameters}
    theta = jnp.asarray([float(f"{value:.5g}") for value in values.values()])
    rounded = plant.with_parameters(np.asarray(theta))
    compare(rounded, equation_text(rounded, numeric=True), states_of(plant))


# -- the notation of the field ----------------------------------------------------------------


def still(t, x, u, p):
    return 0.0 * x.y[0]


def rig(degree=2, **internal):
    return eoi.Plant(still, {"p": 1.0}, degree, ("u",), ("y",), **internal)


@functools.cache
def tank():
    return rig(1, internal=lambda t, x, u, p: -x.z, internal_initial=[1.0])


@pytest.mark.parametrize(
    ("effect", "printed"),
    [
        (effects.CoulombFriction(), "-c·sign(y')"),
        (effects.AsymmetricFriction(), "-forward·[y' > 0] + backward·[y' < 0]"),
        (effects.StribeckFriction(), "-(level + rise·exp(-(y'/velocity)²))·sign(y')"),
        (effects.QuadraticDrag(), "-c·y'·|y'|"),
        (effects.EndStop(-1), "lower_stiffness·max(lower_position - y, 0)"),
        (effects.FreePlay(), "stiffness·clip(y, -gap, gap)"),
        (effects.Gravity(degrees=True), "-c·sin(π/180·y)"),
        (effects.Drift(start=-2.5), "c·(t + 2.5)"),
        (effects.Drift(start=1234567.5), "c·(t - 1234567.5)"),
        (effects.InputDelay(), "u(t - c)"),
        (effects.ActuatorLag(), "u/(c·s + 1)"),
        (effects.InputSaturation(), "clip(u, -c, c)"),
        (effects.InputQuadratic(odd=False), "u + c·u²"),
        (
            effects.Hysteresis(),
            "(y' - share·|y'|·z - (1 - share)·y'·|z|)/displacement",
        ),
        (effects.InternalOverflow(), "share·rate·max(z - level, 0)"),
    ],
    ids=lambda value: getattr(value, "name", "printed"),
)
def test_effects_are_written_as_in_the_field(effect, printed):
    plant = tank() if effect.name == "overflow" else rig()
    names = [parameter.name or "c" for parameter in effect.parameters]
    channel = effect.channels(plant)[0]
    item = SimpleNamespace(
        effect=effect, output=channel, parameters=dict.fromkeys(names, 1.0), against="", through=""
    )
    shown_lines = equation_text(plant, [item]).splitlines()
    rights = [line.split("→ " if "→" in line else "= ")[1] for line in shown_lines]
    assert printed in rights


def test_an_effect_that_cannot_be_traced_is_named_with_its_parameters():
    class Tabulated(effects.AbstractTerm):
        name = "tabulated"
        sentence = "a force from a table"
        gains = (effects.Parameter("", "{f}"),)

        def term(self, at, gain, shape):
            return gain[0] * jnp.asarray([1.0, 2.0])[jnp.int32(jnp.abs(at.y))]

    item = SimpleNamespace(
        effect=Tabulated(), output="y", parameters={"a": 1.0}, against="", through=""
    )
    assert equation_text(rig(), [item]) == "y'' = tabulated(a)"


def test_a_formula_that_is_too_long_to_read_has_names_for_what_it_repeats():
    def doubled(t, x, u, p):
        value = x.y[0] * p.a
        for _ in range(12):
            value = jnp.sin(value) * value
        return value

    plant = eoi.Plant(doubled, {"a": 1.0})
    first, *parts = equation_text(plant).splitlines()
    assert first == "y' = sin(w6)·w6"
    assert parts[:2] == ["where w1 = sin(y·a)·y·a", "where w2 = sin(sin(w1)·w1)·sin(w1)·w1"]
    assert len(parts) == 6
    assert "where w1 = sin(y·1)·y·1" in equation_text(plant, numeric=True)


def test_a_formula_of_too_many_parts_is_named_by_what_it_depends_on():
    weights = np.random.default_rng(0).normal(size=(24, 24, 2))

    def network(t, x, u, p):
        first = jnp.tanh(weights[:, 0, 0] * x.y[0])
        second = jnp.tanh(weights[:, :, 0] @ first)
        third = jnp.tanh(weights[:, :, 1] @ second)
        return p.a * jnp.sum(jnp.tanh(weights[:, :, 0].T @ third) * jnp.tanh(second * third))

    assert equation_text(eoi.Plant(network, {"a": 1.0})) == "y' = f(y, u, a)"


def test_a_plant_with_effects_is_printed_whole():
    plant = eoi.plants.mass_spring_damper()
    placed = place(plant, effects.CoulombFriction(), 0)
    whole = augmented(plant, [placed], {"coulomb_friction": 1.0})
    assert equation_text(whole) == (
        "position'' = -alpha·position - beta·position' + rho·voltage"
        " - coulomb_friction·sign(position')"
    )


def test_input_effects_have_a_line_of_their_own():
    for effect in LIBRARY:
        if isinstance(effect, INPUT_EFFECTS):
            item, _ = found(rig(), place(rig(), effect, 0), "u")
            assert equation_text(rig(), [item]).splitlines()[1].startswith("with u → ")


def test_no_internal_state_has_the_name_of_a_channel_or_a_parameter():
    def inner(t, x, u, p):
        return u - p.a * x.z

    def driven(t, x, u, p):
        return x.z[0] - p.a * x.y[0]

    def plant(values, channels, units=None):
        return eoi.Plant(
            driven, values, 1, *channels, internal=inner, internal_initial=(0.0,), units=units
        )

    plain = plant({"a": 1.0}, (("u",), ("y",)))
    assert equation_text(plain) == "y' = z - a·y\nz' = u - a·z"
    for values, channels in (
        ({"a": 1.0}, (("u",), ("z",))),
        ({"a": 1.0}, (("z1",), ("y",))),
        ({"a": 1.0, "z": 1.0}, (("u",), ("y",))),
    ):
        taken = plant(values, channels, {"internal_z": "V"})
        drive, output = taken.inputs[0], taken.outputs[0]
        lines = [f"{output}' = internal_z - a·{output}", f"internal_z' = {drive} - a·internal_z"]
        assert equation_text(taken).splitlines() == lines
        item, whole = found(taken, place(taken, effects.SensorLag(), 0), output)
        assert internal_names(whole) == ("internal_z1", "internal_z2")
        assert not re.search(r"(?<!_)\bz2", equation_text(taken, [item]))
    with pytest.raises(ValueError, match=r"`units` must be one of a, u, z, got 'z1'"):
        plant({"a": 1.0}, (("u",), ("z",)), {"z1": "V"})


def test_states_of_effects_do_not_have_the_names_of_named_states():
    text = eoi.plant_from_text(
        {"y": "z2 - a*y", "z2": "u - z2"}, {"a": 1.0}, ["y"], ["u"], initial={"z2": 0.0}
    )
    _, whole = found(text, place(text, effects.SensorLag(), 0), "y")
    assert internal_names(whole) == ("z2", "internal_z2")
