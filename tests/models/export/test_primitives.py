"""Each operation of an exported model, alone: as the model has it, at ties and elsewhere."""

import ctypes
import runpy
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.models.export.c import SINGLE, c_listing, helper_functions
from eoi_jax.models.export.program import program

TIES = (-2.5, -1.0, -0.5, -0.0, 0.0, 0.5, 1.0, 1.5, 2.5)

# Of two numbers; what a branch takes says which way a comparison went.
OPERATIONS = {
    "less": lambda a, b: jnp.where(a < b, 1.0, 2.0),
    "less_equal": lambda a, b: jnp.where(a <= b, 1.0, 2.0),
    "greater": lambda a, b: jnp.where(a > b, 1.0, 2.0),
    "greater_equal": lambda a, b: jnp.where(a >= b, 1.0, 2.0),
    "equal": lambda a, b: jnp.where(a == b, 1.0, 2.0),
    "not_equal": lambda a, b: jnp.where(a != b, 1.0, 2.0),
    "less_than_number": lambda a, b: jnp.where(a < 0.5, b, 9.0),
    "number_less": lambda a, b: jnp.where(0.5 < a, b, 9.0),  # noqa: SIM300
    "number_less_equal": lambda a, b: jnp.where(0.5 <= a, b, 9.0),  # noqa: SIM300
    "number_greater": lambda a, b: jnp.where(0.5 > a, b, 9.0),  # noqa: SIM300
    "number_greater_equal": lambda a, b: jnp.where(0.5 >= a, b, 9.0),  # noqa: SIM300
    "both": lambda a, b: jnp.where((a > 0) & (b > 0), 1.0, 2.0),
    "either": lambda a, b: jnp.where((a > 0) | (b > 0), 1.0, 2.0),
    "one_of_both": lambda a, b: jnp.where((a > 0) ^ (b > 0), 1.0, 2.0),
    "none": lambda a, b: jnp.where(~(a > 0), 1.0, 2.0),
    "chosen_flag": lambda a, b: jnp.where(jnp.where(a > 0, b > 0, b < 0.5), 1.0, 2.0),
    "within": lambda a, b: jnp.where((a >= -1.0) & (a < b), a, b),
    "clip": lambda a, b: jnp.clip(a, -0.5, 1.5) + 0.0 * b,
    "maximum": jnp.maximum,
    "minimum": jnp.minimum,
    "sign": lambda a, b: jnp.sign(a) + 3.0 * jnp.sign(b),
    "absolute": lambda a, b: jnp.abs(a) - jnp.abs(b),
    "round": lambda a, b: jnp.round(a) + 10.0 * jnp.round(b),  # halves to the even one
    "floor": lambda a, b: jnp.floor(a) + 10.0 * jnp.ceil(b),
    "truncate": lambda a, b: jnp.trunc(a) + 10.0 * b,
    "remainder": lambda a, b: jnp.fmod(a, 0.75) + b,
    "root": lambda a, b: jnp.where(a > 0, jnp.sqrt(jnp.where(a > 0, a, 1.0)), 0.0) + b,
    "minus": lambda a, b: a - (b - (a - 2.0)) - -b,
    "quotient": lambda a, b: a / (2.0 + b * b) / (a - 7.0) * (b / 3.0),
    "power": lambda a, b: a**3 - b**2 - (-a) ** 2 + 2.0**b,
    "inverse": lambda a, b: jnp.arcsinh(a) + jnp.arctanh(0.3 * b) + jnp.arccosh(2.0 + a * a),
    "steep": lambda a, b: jnp.exp(-a) * jnp.tanh(b) - jnp.arctan2(a, b + 3.0),
}


def all_of(t, x, u, p):
    """One internal state for each operation: nothing else is made of their rates."""
    a, b = u
    return jnp.stack([p.scale * operation(a, b) for operation in OPERATIONS.values()])


PLANT = eoi.Plant(
    lambda t, x, u, p: jnp.sum(x.z) - p.scale * x.y[0, 0],
    {"scale": 1.0},
    1,
    ("a", "b"),
    ("y",),
    internal=all_of,
    internal_initial=[0.0] * len(OPERATIONS),
    name="all",
)
STATES = np.zeros(1 + len(OPERATIONS))


@pytest.fixture(scope="module")
def points() -> tuple[np.ndarray, np.ndarray]:
    """Pairs of numbers: all ties, and some at random; what the model gives there."""
    draw = np.random.default_rng(0)
    ties = np.array([(a, b) for a in TIES for b in TIES])
    pairs = np.concatenate([ties, draw.uniform(-3.0, 3.0, (40, 2))])
    return pairs, np.stack(
        [np.stack([operation(*map(jnp.asarray, pair)) for operation in OPERATIONS.values()])
         for pair in pairs.tolist()]
    )  # fmt: skip


def assert_alike(got: np.ndarray, want: np.ndarray, tolerance: float = 1e-12) -> None:
    for j, name in enumerate(OPERATIONS):
        np.testing.assert_allclose(
            got[:, j], want[:, j], rtol=tolerance, atol=0.1 * tolerance, err_msg=name
        )


def test_python_takes_every_branch_that_the_model_takes(points, tmp_path):
    pairs, want = points
    path = eoi.export(PLANT, tmp_path / "all_rates.py")
    function = runpy.run_path(str(path))["all_rates"]
    assert_alike(np.array([function(0.0, STATES, pair)[1:] for pair in pairs]), want)


def compiled(source: Path, *flags: str) -> Callable:
    """A function in C with four arguments, the last three arrays."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler here (gcc or cc)")
    library = source.with_suffix(".so")
    command = [compiler, "-std=c99", *flags, "-O1", "-shared", "-fPIC", str(source), "-o", library]
    subprocess.run([*command, "-lm"], check=True, timeout=60)
    return ctypes.CDLL(str(library)).all_rates


def test_c_takes_every_branch_that_the_model_takes(points, tmp_path):
    pairs, want = points
    function = compiled(eoi.export(PLANT, tmp_path / "all_rates.c"))
    array = np.ctypeslib.ndpointer(dtype=np.float64, flags="C_CONTIGUOUS")
    function.argtypes, function.restype = [ctypes.c_double, array, array, array], None
    got = np.zeros((len(pairs), len(STATES)))
    for k, pair in enumerate(pairs):
        function(0.0, STATES, pair, got[k])
    assert_alike(got[:, 1:], want)


def test_c_in_single_precision_takes_every_branch_and_nothing_of_it_is_double(points, tmp_path):
    pairs, want = points
    listing = c_listing(program(PLANT), SINGLE)
    lines = [
        *listing.parameters(),
        *listing.elements(lambda vector, k: f"{vector}[{k}]"),
        *listing.definitions(),
        *(f"rates[{k}] = {listing.code(tree)};" for k, tree in enumerate(listing.model.rates)),
    ]
    head = "void all_rates(float t, const float *states, const float *inputs, float *rates)"
    source, helpers = tmp_path / "all_rates.c", helper_functions(listing.called, SINGLE)
    body = "\n".join(lines)
    source.write_text(f"#include <math.h>\n{helpers}{head}\n{{\n(void)t;\n{body}\n}}\n")
    function = compiled(source, "-Wdouble-promotion", "-Werror")
    array = np.ctypeslib.ndpointer(dtype=np.float32, flags="C_CONTIGUOUS")
    function.argtypes, function.restype = [ctypes.c_float, array, array, array], None
    got = np.zeros((len(pairs), len(STATES)), np.float32)
    for k, pair in enumerate(pairs):
        function(0.0, STATES.astype(np.float32), pair.astype(np.float32), got[k])
    assert_alike(got[:, 1:], want, 1e-5)


def test_json_read_back_takes_every_branch_that_the_model_takes(points, tmp_path):
    pairs, want = points
    back = eoi.load(eoi.export(PLANT, tmp_path / "all.json"))
    assert isinstance(back, eoi.Plant)
    theta, zero = jnp.asarray(back.theta), jnp.zeros(())
    state = eoi.State(jnp.zeros((1, 1)), jnp.zeros(len(OPERATIONS)))
    rates = jax.jit(lambda pair: back.internal_rate(zero, state, pair, theta))
    assert_alike(np.array([rates(jnp.asarray(pair)) for pair in pairs]), want)


# -- MATLAB, read by the few rules of its that the files use --------------------------------------


def matlab_value(text: str, values: dict[str, float]) -> float:
    """An expression of MATLAB, as Python's: other signs for powers, logic and what is not equal."""
    for old, new in (("^", "**"), ("~=", "!="), ("&&", " and "), ("||", " or "), ("~", " not ")):
        text = text.replace(old, new)

    def nearest_even(a: float) -> float:
        return float(np.rint(a))

    functions = {
        "asinh": np.arcsinh, "acosh": np.arccosh, "atanh": np.arctanh,
        "abs": abs, "sign": np.sign, "exp": np.exp, "tanh": np.tanh, "atan2": np.arctan2,
        "floor": np.floor, "ceil": np.ceil, "fix": np.trunc, "rem": np.fmod, "max": max,
        "min": min, "sqrt": np.sqrt, "nearest_even": nearest_even,
        "choose": lambda flag, a, b: a if flag else b,
    }  # fmt: skip
    return float(eval(text, {"__builtins__": {}}, functions | values))


def test_matlab_says_every_branch_that_the_model_takes(points, tmp_path):
    """No interpreter is needed: operators bind in MATLAB as they do in Python, but for powers."""
    pairs, want = points
    text = eoi.export(PLANT, tmp_path / "all_rates.m").read_text(encoding="utf-8")
    body = text[text.index("\n") :].partition("\nend")[0]
    lines = [line.partition("%")[0].strip().removesuffix(";") for line in body.splitlines()]
    got = np.zeros((len(pairs), len(STATES)))
    for k, pair in enumerate(pairs.tolist()):
        values: dict[str, float] = {"t": 0.0}
        for line in lines:
            name, sign, formula = line.partition(" = ")
            if not sign:
                continue
            if name.startswith("rates("):
                got[k, int(name[6:-1]) - 1] = matlab_value(formula, values)
            elif formula.startswith("inputs("):
                values[name] = pair[int(formula[7:-1]) - 1]
            elif formula.startswith("states("):
                values[name] = 0.0
            elif name != "rates":
                values[name] = matlab_value(formula, values)
    assert_alike(got[:, 1:], want)
