"""A fixed slice of the benchmark of undeclared effects, and the arithmetic of its report."""

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from benchmarks.truth import effect_cases
from benchmarks.truth import undeclared_effects as driver
from benchmarks.truth import undeclared_tables as tables

# -- the slice --------------------------------------------------------------------------------

SLICE = {
    "mass": ((), ("cubic_stiffness",)),
    "pendulum": ((), ("quadratic_drag",), ("outside:input_times_position",)),
    "tank": ((), ("leak",)),
    "mass, outside": ((), ("outside:van_der_pol",)),
}


LONG = ("pendulum", "mass, outside")
PARAMS = [pytest.param(one, marks=pytest.mark.long) if one in LONG else one for one in SLICE]


@pytest.fixture(scope="module", params=PARAMS)
def cases(request) -> list[effect_cases.Case]:
    """Seed 1 of the benchmark, noise of 1e-3 of rms(y), a third of its length."""
    return effect_cases.cases(
        request.param.split(",")[0], SLICE[request.param], (1,), (1e-3,), samples=10_000
    )


def _answered(case: effect_cases.Case) -> tables.Row:
    key = driver.Key(_kind(case), "", case.truth, case.loop, case.noise, case.seed, 10_000)
    return driver.row(case, key, True, driver.How(Path(), "", False))


def _kind(case: effect_cases.Case) -> str:
    if not case.truth:
        return "none"
    return "outside" if case.truth[0].startswith("outside:") else "single"


@pytest.mark.slow
def test_slice_is_named_exactly_and_the_free_run_becomes_right(cases: list[effect_cases.Case]):
    """Single effects by name, nothing where nothing is hidden, "unexplained" without a name.

    The error falls to the 2 % that the benchmark asks for, or to three times the noise.
    """
    # Nothing hidden is tried on the other two plants: a discovery takes seconds to compile.
    for row in (_answered(one) for one in cases if (one.declared, one.truth) != ("pendulum", ())):
        assert row.right(row.ours), (row.truth, row.ours)
        if row.kind == "single":
            assert row.in_top(row.ours)
            assert row.ours.before > 10 * row.noise_rms  # else the next line says nothing
            assert row.within(row.ours), (row.truth, row.ours)
        elif not row.ours.named:  # what is outside may be a product, see `Row.right`
            # To the digit: where nothing is added the free run is the same one.
            assert row.ours.after == row.ours.before
        if row.kind == "none":
            assert row.ours.status == "nothing_missing"


def test_declared_model_is_that_of_its_simulator(cases: list[effect_cases.Case]):
    """At the true parameters the free run along the held-out input is the output without noise."""
    case = cases[0]
    assert case.truth == ()
    plant, (_, held_out) = driver.declared(case), driver.records(case)
    assert plant.parameters == case.start
    run = eoi.validate(plant.with_parameters(case.parameters), held_out)
    y_hat = run.predictions[0].outputs[:, 0]
    # The start is estimated from 50 noisy samples: of the size of the noise, and it fades.
    assert np.std((y_hat - case.held_out_clean)[driver.SCORED :]) < 1e-3 * np.std(
        case.held_out_clean
    )


@pytest.mark.parametrize(
    ("lacking", "whole", "name"),
    [
        ("mass_no_spring", "mass", "k"),
        ("mass_no_damper", "mass", "c"),
        ("pendulum_frictionless", "pendulum", "c"),
        ("pendulum_no_gravity", "pendulum", "a"),
    ],
)
def test_lacking_model_is_the_whole_one_without_its_term(lacking: str, whole: str, name: str):
    values = dict.fromkeys(effect_cases.DECLARED[lacking][1], 0.7)
    p, q = SimpleNamespace(**values), SimpleNamespace(**values, **{name: 0.0})
    x, u = eoi.State(jnp.array([[0.4], [-1.3]]), jnp.zeros(0)), jnp.array([2.1])
    np.testing.assert_array_equal(
        driver.MODELS[lacking](0.0, x, u, p), driver.MODELS[whole](0.0, x, u, q)
    )


# -- one case on disk -------------------------------------------------------------------------


def _case() -> effect_cases.Case:
    return effect_cases.cases("tank", [("leak",)], (3,), (1e-3,), samples=400)[0]


def test_stored_case_is_read_back_as_it_was(tmp_path: Path):
    case = _case()
    driver.store(case, tmp_path / "a" / "case.npz")
    again = driver.load(tmp_path / "a" / "case.npz")
    for name, value in vars(case).items():
        np.testing.assert_array_equal(getattr(again, name), value, err_msg=name)
        assert type(getattr(again, name)) is type(value)


def test_simulated_block_is_that_of_its_keys_and_not_simulated_twice(tmp_path: Path):
    block = driver.Block("single", "tank", (("leak",),), (3,), (0.0, 1e-3), ("open",), 400)
    driver.simulate(block, tmp_path)
    paths = [key.path(tmp_path) for key in block.listed()]
    assert len(set(paths)) == 2
    np.testing.assert_array_equal(driver.load(paths[1]).outputs, _case().outputs)
    before = [path.stat().st_mtime_ns for path in paths]
    driver.simulate(block, tmp_path)
    assert [path.stat().st_mtime_ns for path in paths] == before


def test_parts_hold_every_case_once():
    block = driver.Block("single", "mass", tuple((str(i),) for i in range(7)), tuple(range(30)))
    for size in (1, 80, 10_000):
        parts = block.parts(size)
        listed = [key for part in parts for key in part.listed()]
        assert len(listed) == 7 * 30 * 10
        assert set(listed) == set(block.listed())
        assert max(len(part.listed()) for part in parts) <= max(size, 10)


def test_full_plan_has_what_the_benchmark_promises():
    keys = [key for block in driver.full(["mass", "pendulum", "tank"], 1, 2)
            for key in block.listed()]  # fmt: skip
    assert len(set(keys)) == len(keys)
    none = [key for key in keys if key.kind == "none"]
    assert sum(key.noise <= 1e-3 for key in none) >= 300
    singles = {key.truth for key in keys if key.kind == "single"}
    assert len(singles) >= 20
    assert len({key.truth for key in keys if key.kind == "pair"}) >= 10


def test_measured_cases_are_skipped_on_resuming():
    block = driver.Block("single", "tank", (("leak",), ("overflow",)), (1, 2), (1e-3,), ("open",))
    done = set(block.listed()[:3])
    assert driver._groups([block], done) == [[block.listed()[3]]]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--resume"], "--resume needs"),
        (["--cache", str(Path(__file__).parent)], "outside the repository"),
        (["--plants", "rocket"], "invalid choice"),
    ],
)
def test_options_that_do_not_fit_are_refused(words, message, capsys):
    with pytest.raises(SystemExit):
        driver.arguments(words)
    assert message in capsys.readouterr().err


# -- what counts as right ---------------------------------------------------------------------


def _answer(*named: str, status: str = "complete", after: float = 0.01) -> tables.Answer:
    return tables.Answer(named, named, status, (), 1.0, after, 0.5)


def _row(kind: str, truth: tuple[str, ...], answer: tables.Answer, noise: float = 1e-3):
    equivalent = (
        ("coulomb_friction", "constant_offset") if truth == ("asymmetric_friction",) else ()
    )
    return tables.Row(
        kind, "mass", "mass", truth, equivalent, "open", noise, 1, 100, (0.1,) * len(truth), 1e-4,
        "abc", False, answer, None,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "truth", "answer", "right"),
    [
        ("single", ("drift",), _answer("drift"), True),
        ("single", ("drift",), _answer("drift", "leak"), False),
        ("single", ("drift",), _answer(status="unexplained"), False),
        ("single", ("asymmetric_friction",), _answer("constant_offset", "coulomb_friction"), True),
        ("single", ("asymmetric_friction",), _answer("coulomb_friction"), False),
        ("pair", ("drift", "leak"), _answer("leak", "drift"), True),
        ("pair", ("drift", "leak"), _answer("leak"), False),
        ("none", (), _answer(status="nothing_missing"), True),
        ("none", (), _answer(status="unexplained"), True),
        ("none", (), _answer("drift"), False),
        ("none", (), _answer(status="error: ValueError: x"), False),
        ("outside", ("outside:x",), _answer(status="unexplained"), True),
        ("outside", ("outside:x",), _answer("curve"), True),
        ("outside", ("outside:x",), _answer("curve", "coulomb_friction"), False),
        ("outside", ("outside:x",), _answer(status="nothing_missing"), False),
        ("outside", ("outside:x",), _answer("drift"), False),
    ],
)
def test_answer_is_right_only_if_it_names_exactly_what_is_hidden(kind, truth, answer, right):
    assert _row(kind, truth, answer).right(answer) is right


def test_ambiguity_counts_apart():
    answer = replace(_answer("cubic_damping"), ambiguous_with=("quadratic_drag",))
    row = _row("single", ("quadratic_drag",), answer)
    assert row.admitted(answer)
    assert not row.right(answer)
    assert not row.in_top(answer)


def test_allowed_error_is_two_percent_or_three_times_the_noise():
    row = _row("single", ("drift",), _answer("drift", after=0.019))
    assert row.within(row.ours)
    assert not row.within(replace(row.ours, after=0.021))
    assert replace(row, noise_rms=0.01).within(replace(row.ours, after=0.029))
    assert not row.within(replace(row.ours, after=math.inf, before=math.inf))


def test_lines_are_read_back_and_one_cut_short_is_left_out(tmp_path: Path):
    rows = [
        _row("single", ("drift",), _answer("drift", after=math.inf)),
        replace(_row("none", (), _answer()), rival=_answer("leak")),
    ]
    text = "\n".join(tables.line(one) for one in rows)
    assert "Infinity" not in text
    (tmp_path / "rows.jsonl").write_text(text + "\n" + tables.line(rows[0])[:50])
    assert tables.read(tmp_path / "rows.jsonl") == rows
    assert tables.read(tmp_path / "absent.jsonl") == []


# -- the report -------------------------------------------------------------------------------


def _rows() -> list[tables.Row]:
    return [
        _row("single", ("drift",), _answer("drift")),
        _row("single", ("drift",), _answer("leak", after=0.5)),
        _row("single", ("drift",), _answer("drift"), noise=5e-2),
        _row("none", (), _answer("leak")),
        *[_row("none", (), _answer(status="nothing_missing"))] * 3,
        _row("pair", ("drift", "leak"), _answer("drift")),
        _row("outside", ("outside:x",), _answer(status="unexplained")),
    ]


def test_targets_are_counted_from_the_rows():
    lines = tables.targets(_rows()).splitlines()
    reached = {cells[1].strip(): cells[3].strip() for cells in (one.split("|") for one in lines)}
    assert reached["exact name, single effects, noise ≤ 1e-3"] == "1 of 2, 50 %"
    assert reached["exact name, single effects, noise 1e-2"] == "-"
    assert reached["exact name, single effects, noise 5e-2"] == "1 of 1, 100 %"
    assert reached["false alarms, noise ≤ 1e-3 (≥ 300 cases)"] == "1 of 4, 25 %"
    assert reached["pairs, noise ≤ 1e-3: both, nothing else"] == "0 of 1, 0 %"
    assert reached['outside the library: "unexplained"'] == "1 of 1, 100 %"
    assert reached["outside the library: a wrong name"] == "0 of 1, 0 %"
    assert reached["time a case, median, kernels compiled"] == "0.5 s"


def test_misses_list_what_was_named_instead():
    text = tables.misses(_rows())
    assert text.startswith("3 of 9 cases.")
    assert text.count("| leak") == 2
    assert tables.misses(_rows()[:1]) == "None."


def test_report_is_complete_also_without_a_rival_or_a_kind():
    text = "\n".join(tables.sections(_rows()))
    for heading in ("Targets", "Single effects", "Nothing hidden", "Pairs", "Misses"):
        assert f"## {heading}" in text
    assert "abc (9 cases)" in text
    assert "## Pairs" not in "\n".join(tables.sections(_rows()[:3]))


def test_confusion_rows_add_up_and_equivalent_names_are_on_the_diagonal():
    both = _row("single", ("asymmetric_friction",), _answer("coulomb_friction", "constant_offset"))
    truths, columns, shares = tables.confusion([*_rows(), both])
    np.testing.assert_allclose(shares.sum(axis=1), 1.0)
    at = {(i, j): shares[truths.index(i), columns.index(j)] for i in truths for j in columns}
    assert at["asymmetric_friction", "asymmetric_friction"] == 1.0
    assert at["drift", "drift"] == pytest.approx(2 / 3)
    assert at["nothing", "leak"] == 0.25
    assert at["nothing", "nothing missing"] == 0.75
    assert at["outside the library", "unexplained"] == 1.0


def test_figure_is_drawn(tmp_path: Path):
    tables.figure(_rows(), tmp_path / "confusion.png")
    assert (tmp_path / "confusion.png").stat().st_size > 10_000
