"""A slice of `benchmarks/truth/equation_forms.py`: its forms are forms of one plant."""

import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from benchmarks.truth import equation_forms, form_cases
from eoi_jax.models.plant import State


@pytest.fixture(scope="module")
def cases():
    return form_cases.cases(2 * len(form_cases.KINDS), 3)


def test_every_form_is_the_same_equation_at_the_nominal_values(cases):
    draw = np.random.default_rng(0)
    for i, case in enumerate(cases):
        affine, *others = form_cases.forms(case, [3, i])
        degree, ny = case.kind.degree, len(case.kind.outputs)
        y = jnp.asarray(draw.uniform(0.1, 1.0, (degree, ny)))
        point = jnp.asarray(0.0), State(y, jnp.zeros(0)), jnp.asarray([0.7])
        model = equation_forms.plant(case, affine, as_text=False)
        expected = model.derivative(*point, jnp.asarray(model.theta))
        for j, form in enumerate(others):
            for key, value in form.to_affine(form.parameters).items():
                assert value == pytest.approx(case.nominal[key], rel=1e-12)
            written = equation_forms.plant(case, form, as_text=bool(j % 2))
            got = written.derivative(*point, jnp.asarray(written.theta))
            np.testing.assert_allclose(got, expected, rtol=1e-12)
            assert written.fixed == form.fixed


@pytest.mark.slow
@pytest.mark.long
def test_half_of_the_plants_hide_something_and_it_is_in_the_record(cases):
    assert sum(bool(case.hidden) for case in cases) == len(cases) // 2
    for case in cases:
        assert np.all(np.isfinite(case.outputs))
        if case.hidden and case.hidden != "input_dead_zone":
            draw_again = form_cases.cases(1 + cases.index(case), 3)[-1]
            np.testing.assert_array_equal(draw_again.outputs, case.outputs)
    names = {effect.name for effect in eoi.effects.standard()}
    assert {name for kind in form_cases.KINDS for name in kind.hidden} <= names


def test_an_effect_leaves_every_coefficient_its_sign():
    """Fitted without the effect, a coefficient keeps a third of its value."""
    time = 0.01 * np.arange(2000)
    y = np.sin(3.0 * time)[:, None]
    mass = form_cases.KINDS[0]
    rate = np.gradient(y[:, 0], time)
    values = {"a": 9.0, "b": 0.01, "c": 1.0}
    size = form_cases._size(mass, values, -np.sign(rate), time, np.zeros_like(time), y)
    # Dry friction of this size is damping of 4/(3π) of it; here it pushes, and damping is lost.
    lost = 0.2 * size * 4.0 / (3.0 * np.pi)
    assert lost == pytest.approx(2.0 / 3.0 * values["b"], rel=1e-2)


def test_errors_are_moved_to_the_affine_coefficients(cases):
    case = cases[0]
    affine, scaled, *_ = form_cases.forms(case, [3, 0])
    record = eoi.Record(case.time, case.inputs, case.outputs, "run", hold="zero")
    fits = [
        eoi.identify(equation_forms.plant(case, form, as_text=True), record)
        for form in (affine, scaled)
    ]
    (values, errors), (others, their_errors) = (
        equation_forms.moved(form, fit) for form, fit in zip((affine, scaled), fits, strict=True)
    )
    for name, error in fits[0].standard_errors.items():
        assert values[name] == fits[0].parameters[name]
        assert errors[name] == pytest.approx(error, rel=1e-6)
        assert others[name] == pytest.approx(values[name], rel=1e-6)
        assert their_errors[name] == pytest.approx(error, rel=1e-3)
    reference, other = (
        equation_forms.Answer(coefficients, errors, "converged", (), 0.0)
        for coefficients in (values, {**values, "a": values["a"] + 0.7 * errors["a"]})
    )
    assert equation_forms.distance(reference, other) == pytest.approx(0.7)
    assert equation_forms.distance(reference, reference) == 0.0
