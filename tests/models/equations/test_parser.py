"""The grammar of equations: what it reads, what that is worth, and what it refuses and how."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eoi_jax.models.equations.expression import FUNCTIONS, Symbol, value_of
from eoi_jax.models.equations.parser import (
    DEEPEST,
    MOST_BRACKETS,
    MOST_CHARACTERS,
    MOST_TOKENS,
    parse,
)

NAMES = {name: Symbol(name) for name in ("x", "y", "rate", "α")}
VALUES = {Symbol("x"): 0.7, Symbol("y"): -1.3, Symbol("rate"): 0.2, Symbol("α"): 2.5,
          Symbol("t"): 3.0}  # fmt: skip


def worth(text):
    return float(value_of(parse(text, NAMES, "field"), VALUES, np))


x, y, rate, alpha, t = (VALUES[Symbol(name)] for name in ("x", "y", "rate", "α", "t"))


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("-x*sin(y) - 2.5*rate + 1e-1*t", -x * math.sin(y) - 2.5 * rate + 0.3),
        ("-x**2", -(x**2)),  # as on paper: the power comes first
        ("x - y - rate", x - y - rate),
        ("x/y/rate", x / y / rate),
        ("2**x", 2**x),
        ("x**-2 + .5 + 1. + 1.5e+1", x**-2 + 17.0 - 0.5),
        ("+x", x),
        ("\n  x +\n\ty", x + y),
        ("cos(pi)", -1.0),
        ("α*x", alpha * x),
        ("x if y < 0 else rate", x),
        ("where(x > 0 and not y > 0, 1, 2)", 1.0),
        ("where(x < 0 or y == 1, 1, 2)", 2.0),
        ("(0 < x < 1) + (x != y)", 2.0),  # true counts as one
        ("(x <= y) + (x >= y)", 1.0),
        ("sqrt(y)", 0.0),
        ("sqrt(x)", math.sqrt(x)),
        ("min(x, y, rate) + max(x, y)", y + x),
        ("clip(y, -1, 1)", -1.0),
        ("atan2(x, y)", math.atan2(x, y)),
        ("rem(y, x)", math.fmod(y, x)),
        ("sign(y)*abs(y)", y),
        ("round(2.5) + floor(y) + ceil(y) + trunc(y)", 2.0 - 2.0 - 1.0 - 1.0),
        ("9.81*(2 + 3)/2", 9.81 * 5 / 2),
    ],
)
def test_an_equation_is_worth_what_it_says(text, value):
    assert worth(text) == pytest.approx(value, rel=1e-15)


def test_every_function_can_be_called():
    for name, one in FUNCTIONS.items():
        inside = ["x > 0", "x", "y"] if name == "where" else ["x"] * one.min_arguments
        with np.errstate(invalid="ignore"):
            value = worth(f"{name}({', '.join(inside)})")
        assert math.isfinite(value) or name == "acosh"  # of a number below one


@pytest.mark.parametrize(
    ("text", "column", "message"),
    [
        ("x^2", 2, r"must not hold \^.*Write powers with \*\*"),
        ("x²", 1, "must not hold x²"),
        ("x - ratee", 5, r"must use declared names, got ratee.*Did you mean rate\?"),
        ("x - ratee\n", 5, "got ratee"),
        ("  ratee", 3, "got ratee"),
        ("α*x + q", 7, "got q"),  # α takes two bytes, but one column
        ("ln(x)", 1, r"must use known functions, got ln.*Write log\(x\), the natural"),
        ("heaviside(x)", 1, r"must use known functions.*Write where\(x > 0, 1, 0\)\. Known"),
        ("2*X", 3, r"must use declared names, got X.*Did you mean x\?"),
        ("Pi*x", 1, r"must use declared names, got Pi.*Did you mean pi\?"),
        ("x*e**(-a)", 3, r"must use declared names, got e.*Write exp\(x\)"),
        ("x if x > 0 ? a", 12, r"must not hold \?.*Write a if condition else b"),
        ("foo(x)", 1, r"must use known functions, got foo.*Did you mean floor\?"),
        ("sin + x", 1, r"must call the function sin.*Write sin\(…\)"),
        ("sin()", 1, r"must give sin 1 argument, got 0"),
        ("min(x)", 1, r"must give min 2 to 8 arguments, got 1"),
        ("2x", 2, r"must have a sign between a number.*2\*a"),
        ("2(x)", 2, "must have a sign between a number"),
        ("0x10", 2, "must have a sign between a number"),
        ("1_000", 2, "must have a sign between a number"),
        ("1j", 2, "must have a sign between a number"),
        ("1.2.3", 4, "must have a sign between a number"),
        ("x(y)", 1, r"must have a sign between x and a bracket"),
        ("(x)(y)", 1, "must have a sign between x and a bracket"),
        ("sin(x)(y)", 1, "must be arithmetic"),
        ("x,5*y", 1, "with a comma in calls only.*decimals with a point"),
        ("x y", 3, "must be one expression"),
        ("x + ", 4, "must be one expression"),
        ("x//y", 1, "must be arithmetic"),
        ("x % y", 3, r"must not hold %.*rem\(x, y\)"),
        ("x.real", 2, r"must not hold \..*without a dot"),
        ("x[0]", 2, r"must not hold \[.*no indices"),
        ("angle' + x", 6, "must not hold '.*a name of its own"),
        ("x = 1", 3, "must not hold =.*right-hand side only"),
        ("x is y", 3, "must not hold is"),
        ("lambda: x", 1, "must not hold lambda"),
        ("None", 1, "must not hold None"),
        ("__import__('os')", 12, "must not hold '"),
        ("__import__", 1, "got __import__"),
        ("sin(*x)", 5, "must be arithmetic"),
        ("sin(x=1)", 6, "must not hold ="),
        ("(x", 1, "must close each bracket"),
        ("x)", 2, "must open each bracket"),
        ("", 1, "must hold an expression"),
        (" \n", 1, "must hold an expression"),
        ("x\0y", 2, "must not hold the character 0x0000"),
        ("ﬁ", 1, "must not hold ﬁ"),  # Python would read it as two letters
        ("1/0", 1, "constants that are real"),
        ("(-8)**0.5", 1, "constants that are real"),
        ("exp(10**3)", 1, "constants that are real"),
        ("1e101", 1, "numbers up to"),
        ("9" * 500, 1, "numbers up to"),
        ("x**65", 1, "powers between -64 and 64"),
        ("9**9**9", 1, "powers between -64 and 64"),
        ("where(x, 1, 2)", 7, "must have a condition here"),
        ("x if y else 1", 6, "must have a condition here"),
        ("not x", 5, "must have a condition here"),
        ("1 < 2", 1, "must not compare two constants"),
        ("x < y in x", 7, "must not hold in"),
        ("x" * (MOST_CHARACTERS + 1), 1, f"at most {MOST_CHARACTERS} characters"),
        ("-" * MOST_TOKENS + "x", 1, f"at most {MOST_TOKENS} parts"),
        ("(" * (MOST_BRACKETS + 1), MOST_BRACKETS + 1, f"at most {MOST_BRACKETS} brackets"),
        ("-" * (DEEPEST + 1) + "x", DEEPEST + 2, f"at most {DEEPEST} operations"),
        ("+".join("x" * (DEEPEST + 2)), 1, f"at most {DEEPEST} operations"),
        ("<".join("x" * (DEEPEST + 2)), 1, f"at most {DEEPEST} operations"),
        ("x<y and " * (DEEPEST + 1) + "x<y", 1, f"at most {DEEPEST} operations"),
    ],
)
def test_what_is_no_equation_is_refused_at_its_column(text, column, message):
    with pytest.raises(ValueError, match=rf"(?s)`field` .*{message}") as caught:
        parse(text, NAMES, "field")
    first, shown, mark, *_ = str(caught.value).split("\n")
    assert first.endswith(f", at column {column}:")
    # The mark stands under the character that the column means.
    if len(text) <= 80:
        assert mark == "    " + " " * (column - 1) + "^"
        assert shown[4:] == text.translate({ord("\n"): " ", 0: " "})


def test_a_long_text_is_shown_around_the_mark():
    text = "x + " * 50 + "wrong" + " + x" * 20
    with pytest.raises(ValueError, match="got wrong") as caught:
        parse(text, NAMES, "field")
    shown, mark = str(caught.value).splitlines()[1:3]
    assert shown[mark.index("^") :].startswith("wrong")
    assert len(shown) < 90


SIGNS = st.sampled_from([" + ", "-", "*", "/", "**", "<", ">=", "==", ",", " and ", " or "])
ATOMS = st.sampled_from(["x", "y", "t", "pi", "0", "2", "1.5e3", "rate", "q", "9" * 30, "α"])
TEXTS = st.recursive(
    ATOMS,
    lambda inner: st.one_of(
        st.builds("{}{}{}".format, inner, SIGNS, inner),
        st.builds("({})".format, inner),
        st.builds("-{}".format, inner),
        st.builds("not {}".format, inner),
        st.builds("{} if {} else {}".format, inner, inner, inner),
        st.builds("{}({})".format, st.sampled_from([*FUNCTIONS, "eval", "exec"]), inner),
    ),
    max_leaves=25,
)


@settings(max_examples=1500, deadline=1000)
@given(st.one_of(TEXTS, st.text(max_size=60), st.text("x()+-*/.,<>=' 12", max_size=60)))
def test_any_text_is_an_equation_or_a_plain_error(text):
    try:
        found = parse(text, NAMES, "field")
    except ValueError as error:
        assert str(error).startswith("`field` ")  # noqa: PT017
    else:
        with np.errstate(all="ignore"):
            float(value_of(found, VALUES, np))


PLAIN = st.recursive(
    st.sampled_from(["x", "y", "rate", "t", "2.0", "0.3"]),
    lambda inner: st.one_of(
        st.builds("({} {} {})".format, inner, st.sampled_from("+-*/"), inner),
        st.builds("-{}".format, inner),
        st.builds("{}({})".format, st.sampled_from(["sin", "cos", "tanh", "atan"]), inner),
    ),
    max_leaves=12,
)


@settings(max_examples=300, deadline=1000)
@given(PLAIN)
def test_values_are_those_of_python(text):
    """Python itself, on a text that this test made: an independent reading of the grammar."""
    known = {"x": x, "y": y, "rate": rate, "t": t, "sin": math.sin, "cos": math.cos,
             "tanh": math.tanh, "atan": math.atan}  # fmt: skip
    try:
        wanted = eval(text, {"__builtins__": {}}, known)
    except ZeroDivisionError:
        return
    if abs(wanted) < 1e90:
        try:
            assert worth(text) == pytest.approx(wanted, rel=1e-12, abs=1e-300)
        except ValueError as error:
            assert "constants" in str(error)  # noqa: PT017 - a constant part without a value


def test_names_in_messages_are_cut_from_forty_characters_on():
    for length, shown in ((40, "a" * 40 + r"[^a…]"), (41, "a" * 40 + "…")):
        with pytest.raises(ValueError, match=f"got {shown}"):
            parse("a" * length, NAMES, "field")
