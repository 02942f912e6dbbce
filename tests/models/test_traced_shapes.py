"""A model that JAX cannot trace: what it used, where, and what to use."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi


def by_branch(t, x, u, p):
    return p.a if x.y[0, 0] > 0 else 0.0


@pytest.mark.parametrize(
    ("law", "message"),
    [
        (by_branch, r"an `if`.* on one \(line \d+ of test_traced_shapes.py\). Use `jnp.where`"),
        (
            lambda t, x, u, p: p.a * np.sin(x.y[0]),
            "a function of NumPy, .* Use that of `jax.numpy`",
        ),
        (lambda t, x, u, p: p.a * math.sin(x.y[0, 0]), "`math` or Python of one"),
        (lambda t, x, u, p: p.a * float(u[0]), "`math` or Python of one"),
    ],
)
def test_a_model_that_needs_values_is_named(law, message):
    rule = (
        "`{}` must not need the values of `t`, `x`, `u` or `p`, which JAX traces, got .*" + message
    )
    with pytest.raises(ValueError, match=rule.format("dynamics")):
        eoi.Plant(law, {"a": 1.0})
    internal = {"internal": law, "internal_initial": [0.0]}
    with pytest.raises(ValueError, match=rule.format("internal")):
        eoi.Plant(lambda t, x, u, p: p.a * x.z, {"a": 1.0}, **internal)


def test_entries_of_different_shapes_are_named_with_those_of_what_the_model_gets():
    message = r"got shapes \(1,\), \(\) \(function in line \d+ of test_traced_shapes.py\)\. .*"
    message += r"`u` has shape \(1,\).* and `u\[0\]` are scalars"
    pair = {"parameters": {"a": 1.0}, "relative_degree": (1, 1), "outputs": ("v", "w")}
    with pytest.raises(ValueError, match=f"`dynamics` must return entries of one shape, {message}"):
        eoi.Plant(lambda t, x, u, p: [u - p.a * x.y[0, 0], -x.y[0, 1]], **pair)
    rule = r"must return shape \(2,\).* got shape \(2, 1\)\. A row of `x.y` .*`u\[0\]` are scalars"
    with pytest.raises(ValueError, match=rule):
        eoi.Plant(lambda t, x, u, p: [u - p.a * x.y[0, 0], u], **pair)


def test_the_sentence_of_an_error_has_one_full_stop():
    with pytest.raises(ValueError, match=r"hapes\.py\)\. It is") as failure:
        eoi.Plant(lambda t, x, u, p: jnp.concatenate([u, x.y]), {"a": 1.0})
    assert ".." not in str(failure.value)


def by_element(t, x, u, p):
    return -p.a * x[0]


@pytest.mark.parametrize(
    ("law", "message"),
    [
        (
            by_element,
            r"TypeError: 'State' object is not subscriptable \(line \d+ of test_traced_sh",
        ),
        (lambda t, x, u, p: -p["a"] * x.y[0], r"TypeError: tuple indices must be .* \(line \d+"),
        (lambda x, u, p: -p.a * x.y[0], "TypeError: .* takes 3 positional arguments but 4 were"),
    ],
)
def test_a_model_that_does_not_run_is_named_with_what_it_is_called_with(law, message):
    advice = r".* It is called with `t`, `x`, `u`, `p`: `x.y` has a row for the outputs and one"
    with pytest.raises(ValueError, match=f"`dynamics` must run where it is called, got {message}"):
        eoi.Plant(law, {"a": 1.0})
    with pytest.raises(ValueError, match=advice):
        eoi.Plant(law, {"a": 1.0})


def test_a_branch_on_a_row_of_the_outputs_says_that_it_is_no_scalar():
    def branched(t, x, u, p):
        (speed,) = x.y
        return u - p.a * jax.lax.cond(speed > 0, lambda v: v, lambda v: 2.0 * v, speed)

    with pytest.raises(
        ValueError, match=r"Pred must be a scalar.* `position, speed = x.y\[:, 0\]`"
    ):
        eoi.Plant(branched, {"a": 1.0})


def test_a_function_without_return_and_arrays_that_do_not_fit_are_named():
    def silent(t, x, u, p):
        u - p.a * x.y[0]

    with pytest.raises(ValueError, match=r"`dynamics` must run .* Does the function lack its `ret"):
        eoi.Plant(silent, {"a": 1.0})

    def misfit(t, x, u, p):
        return p.a * jnp.dot(jnp.eye(3), x.y[0])

    with pytest.raises(ValueError, match=r"`dynamics` must run where it is called, got .*line \d+"):
        eoi.Plant(misfit, {"a": 1.0})


def test_outputs_that_unpack_otherwise_are_told_their_shape():
    def states(t, x, u, p):
        current, place, speed = x.y
        return jnp.stack([u[0] - p.a * current, current - speed - place])

    message = (
        r"values to unpack .*\(line \d+ of .*\)\. `x.y` has shape \(2, 2\): rows are outputs and "
        r"their derivatives, columns outputs\. `u` has shape \(1,\), `x.z` shape \(0,\)\."
    )
    with pytest.raises(ValueError, match=message):
        eoi.Plant(states, {"a": 1.0}, (1, 2), outputs=("current", "place"))


def test_the_rate_of_every_state_is_refused_with_the_reason_also_in_a_column():
    with pytest.raises(
        ValueError, match=r"got shape \(2, 1\)\. The lower ones follow from the high"
    ):
        eoi.Plant(lambda t, x, u, p: (x.y[1], -p.a * x.y[0]), {"a": 1.0}, 2)


@pytest.mark.parametrize(
    ("law", "message"),
    [
        (lambda x, u: x.y[1, 0], r"x.y\[1, 0\] .* write `relative_degree=2`"),
        (lambda x, u: 2.0 * x.y[-2], r"x.y\[-2\] .* has 1 row .* write `relative_degree=2`"),
        (lambda x, u: x.y[0, 2], r"x.y\[0, 2\] .* 2 columns \(h, q\)\.$"),
        (lambda x, u: x.y[0][2], r"x.y\[0\]\[2\] .* 2 columns \(h, q\)\.$"),
        (lambda x, u: u[1], r"u\[1\] .*has 1 input \(pump\): name all that it reads in `inputs`"),
        (lambda x, u: x.z[1], r"x.z\[1\] .* has 1 internal state, as many as `internal_initial`"),
    ],
)
def test_an_index_that_is_out_of_bounds_is_no_other_state(law, message):
    """JAX takes the nearest element."""

    def f(t, x, u, p):
        return jnp.ones(2) * u[0] - p.a * jnp.reshape(law(x, u), -1)[0]

    def g(t, x, u, p):
        return jnp.reshape(law(x, u), -1)[:1]

    def steady(t, x, u, p):
        return u[0] - p.a * x.y[0]

    start = {"internal_initial": [0.0]}
    channels = {"inputs": ("pump",), "outputs": ("h", "q"), **start}
    there = r"must read elements that are there, for others JAX takes the nearest, got "
    with pytest.raises(ValueError, match=f"`dynamics` {there}{message}"):
        eoi.Plant(f, {"a": 1.0}, 1, internal=lambda t, x, u, p: -x.z, **channels)
    with pytest.raises(ValueError, match=f"`internal` {there}{message}"):
        eoi.Plant(steady, {"a": 1.0}, 1, internal=g, **channels)


def test_an_input_that_a_model_does_not_have_is_named():
    with pytest.raises(ValueError, match=r"u\[0\] \(line .* The model has no input: name all that"):
        eoi.Plant(lambda t, x, u, p: p.a * u[0], {"a": 1.0}, inputs=())


def test_what_arrays_of_numpy_cannot_do_is_no_fault():
    def f(t, x, u, p):
        moved = x.y.at[0].set(0.0)
        return p.a * moved[0] + jax.lax.cond(x.y[0, 0] > 0, jnp.sin, jnp.cos, u[0])

    assert eoi.Plant(f, {"a": 1.0}).relative_degree == 1
