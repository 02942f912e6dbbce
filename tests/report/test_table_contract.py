"""Every number of every table is the one that its row and column say, of the result it is of.

The results are real ones whose numbers were replaced by others, no two alike: a number that stands
in another's place does not pass.
"""

import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from found import DECLARED, discovery

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax._status import Status
from eoi_jax.comparison.result import Comparison, Entry
from eoi_jax.data.channel import Channel
from eoi_jax.data.inspection import Inspection
from eoi_jax.data.time_axis import Clock
from eoi_jax.estimation.covariance import Certainty, computed
from eoi_jax.models.augmented import place
from eoi_jax.refinement.remaining import Remaining, Trial
from eoi_jax.refinement.score_test import Candidate
from eoi_jax.report import comparison as comparisons
from eoi_jax.report import contents, tables
from eoi_jax.report import discovery as discoveries
from eoi_jax.report.diagnosis import diagnosis_text
from eoi_jax.report.inspection import inspection_text
from eoi_jax.report.sweep import sweep_text
from eoi_jax.uncertainty.profile_likelihood import Profile
from eoi_jax.uncertainty.uncertainty import Uncertainty

Row = Sequence[Any]


def rows_below(text: str, head: str) -> list[list[str]]:
    """Cells of the lines below the one that starts so, up to a blank one."""
    lines = text.splitlines()
    first = next(i for i, line in enumerate(lines) if line.strip().startswith(head))
    rows = []
    for line in lines[first + 1 :]:
        if not line.strip():
            break
        rows.append(re.split(r"\s{2,}", line.strip()))
    return rows


def assert_rows(got: Sequence[Row], want: Sequence[Row]) -> None:
    """Cell by cell; numbers to the digits that are shown, empty cells wherever they stand."""
    cells = [[cell for cell in row if cell != ""] for row in got]
    wanted = [[cell for cell in row if cell != ""] for row in want]
    assert len(cells) == len(wanted), cells
    for row, other in zip(cells, wanted, strict=True):
        assert len(row) == len(other), (row, other)
        for cell, value in zip(row, other, strict=True):
            if isinstance(value, str):
                assert cell == value
            else:
                shown = cell.removesuffix("%").strip().removesuffix("*")
                digits = len(shown.lower().partition("e")[0].replace(".", "").lstrip("+-0"))
                assert float(shown) == pytest.approx(value, rel=0.51 * 10.0 ** (1 - digits)), row


def numbers(seed: int, *shape: int) -> np.ndarray:
    """Positive, of different sizes, no two alike to three digits."""
    draw = np.random.default_rng(seed)
    return draw.uniform(1.0, 9.0, shape) * 10.0 ** draw.integers(-2, 3, shape)


def coupled(t, x, u, p):
    import jax.numpy as jnp

    first, second = x.y[0]
    return jnp.stack([p.b * u[0] - p.k * (first - second), p.k * (first - second) - p.c * second])


NAMES: tuple[str, ...] = ("b", "k", "c")
PLANT = eoi.Plant(
    coupled, {"b": 1.0, "k": 0.5, "c": 0.8}, (1, 1), ("flow",), ("upper", "lower"),
    units={"b": "1/m²", "k": "1/s", "flow": "m³/s", "upper": "m", "lower": "cm"}, fixed=("c",),
    name="two tanks",
)  # fmt: skip


@pytest.fixture(scope="module")
def record() -> eoi.Record:
    time = 0.02 * np.arange(1500)
    true = PLANT.with_parameters({"b": 1.2, "k": 0.7})
    return eoi.simulate(true, time, eoi.excitation.chirp(time, 1.0, 0.1, 3.0), hold="linear")


@pytest.fixture(scope="module")
def identified(record) -> eoi.Identification:
    found = eoi.identify(PLANT, record, passes=4, instruments=False)
    errors = dict(zip(NAMES, [*numbers(4, 2), 0.0], strict=True))
    return replace(
        found,
        parameters=dict(zip(NAMES, numbers(1, 3).tolist(), strict=True)),
        index=numbers(2, 5, 2),
        increments=numbers(3, 5, 3),
        parameter_history=numbers(6, 5, 3),
        best_pass=2,
        nominal=PLANT.with_parameters({"b": 3.21, "k": 45.6, "c": 0.789}),
        sliding_fraction=np.array([0.871, 0.965]),
        unexplained=np.array([0.123, 0.0456]),
        certainty=Certainty(np.diag(numbers(5, 3)), np.array([7.0, 8.0, 9.0]), errors),
    )


# -- identify -------------------------------------------------------------------------------------


def parameter_table_of(found: eoi.Identification) -> list[Row]:
    nominal = found.nominal.parameters
    return [
        (
            name,
            nominal[name],
            value,
            "fixed" if name == "c" else found.standard_errors[name],
            "" if name == "c" else 100.0 * (value / nominal[name] - 1.0),
            {"b": "1/m²", "k": "1/s", "c": ""}[name],
        )
        for name, value in found.parameters.items()
    ]


def test_tables_of_an_identification(identified):
    text = str(identified)
    assert_rows(rows_below(text, "parameter"), parameter_table_of(identified))
    wanted = [
        (f"{i + 1}*" if i == 2 else str(i + 1), *identified.index[i], *identified.increments[i])
        for i in range(5)
    ]
    assert_rows(rows_below(text, "pass"), wanted)
    assert_rows(
        rows_below(text, "output"), [("upper", 87.1, 12.3), ("lower", 96.5, 4.56)]
    )  # per cent


def test_answer_of_an_identification_names_its_best_pass(identified):
    line = tables.identification_answer(identified)
    assert line == (
        "2 parameters of two tanks identified from 1500 samples (30 s) in pass 3 of 5; 12 % of the "
        "highest derivative remains unexplained."
    )
    worse = replace(identified, unexplained=np.array([768.8, 0.5]))
    assert tables.identification_answer(worse).endswith(
        "; what remains is 769 times the highest derivative: worse than no model."
    )
    assert "769 times all, worse than no model" in tables.health_table(worse)
    held = replace(fake_validation(identified), fit=np.array([91.2, 88.76]))
    assert tables.identification_answer(identified, held).endswith(
        ", and the free-run fit to held-out data is 88.76 %."
    )
    still = replace(held, fit=np.full_like(held.fit, -np.inf))
    assert tables.identification_answer(identified, still).endswith(
        ", and the held-out data are constant, so that no fit can be told."
    )


@pytest.fixture(scope="module")
def diagnosed(identified) -> eoi.Diagnosis:
    return eoi.diagnose(identified)


def test_report_of_an_identification(identified, diagnosed):
    held = fake_validation(identified)
    shown = contents.identification_contents(
        identified, {"validation": held, "diagnosis": diagnosed}
    )
    assert_rows(shown.tables[0].rows, parameter_table_of(identified))
    assert_rows(shown.tables[1].rows, validation_table_of(held))
    assert [one.numeric for one in shown.tables] == [(1, 2, 3, 4), (1, 2, 3)]
    tiles = [(one.label, one.value, one.note) for one in shown.tiles]
    assert tiles == [
        ("Free run of upper, held out", f"{held.fit[0]:.4g} %",
         f"error {tables.quantity(held.rmse[0], 'm')}"),
        ("Free run of lower, held out", f"{held.fit[1]:.4g} %",
         f"error {tables.quantity(held.rmse[1], 'cm')}"),
        ("Unexplained in upper", "12 %", "injection over highest derivative"),
        ("Unexplained in lower", "4.6 %", "injection over highest derivative"),
    ]  # fmt: skip


# -- validate -------------------------------------------------------------------------------------


def fake_validation(found: eoi.Identification, seed: int = 11) -> eoi.Validation:
    held = eoi.validate(PLANT, found.records[0])
    return replace(
        held, rmse=numbers(seed, 2), nrmse=0.01 * numbers(seed + 1, 2),
        fit=np.array([91.23, 45.67]) - seed, scored=1234,
        scored_at=(),
    )  # fmt: skip


def validation_table_of(held: eoi.Validation) -> list[Row]:
    return [
        (name, held.rmse[j], f"{held.nrmse[j]:.4f}", f"{held.fit[j]:.2f}", unit)
        for j, (name, unit) in enumerate([("upper", "m"), ("lower", "cm")])
    ]


def test_table_of_a_validation(identified):
    held = fake_validation(identified)
    text = str(held)
    assert text.startswith("Free run, 1 record, 1234 samples (24.68 s) scored")
    assert_rows(rows_below(text, "output"), validation_table_of(held))


# -- refine, uncertainty, profile -----------------------------------------------------------------


@pytest.fixture(scope="module")
def refined(record) -> eoi.Refinement:
    found = eoi.refine(PLANT, record, max_steps=3)
    errors = dict(zip(NAMES, [*numbers(24, 2), 0.0], strict=True))
    return replace(
        found,
        parameters=dict(zip(NAMES, numbers(21, 3).tolist(), strict=True)),
        standard_errors=errors,
        covariance=np.diag(np.array(list(errors.values())) ** 2),
        nominal=PLANT.with_parameters({"b": 6.54, "k": 0.321, "c": 78.9}),
        rmse=np.array([0.0123, 4.56]),
        before=np.array([0.789, 32.1]),
        window=1.5,
        degrees_of_freedom=np.array([7.0, 11.0, 3.0]),
        status=Status("converged", "well"),
    )


def refined_table_of(found: eoi.Refinement) -> list[Row]:
    return [
        (
            name,
            found.nominal.parameters[name],
            value,
            "fixed" if name == "c" else found.standard_errors[name],
            {"b": "1/m²", "k": "1/s", "c": ""}[name],
        )
        for name, value in found.parameters.items()
    ]


def test_tables_of_a_refinement(refined, identified):
    text = str(refined)
    rows = rows_below(text, "parameter")
    assert_rows(rows[:3], refined_table_of(refined))
    assert rows[3] == ["rmse of 1 run, windows of 1.5 s:"]
    assert rows[4:6] == [["upper: 0.789 → 0.0123 m"], ["lower: 32.1 → 4.56 cm"]]
    before, after = fake_validation(identified), fake_validation(identified, 31)
    whole = tables.refinement_text(refined, before, after)
    parts = whole.partition("Held out, refined:")
    assert_rows(rows_below(parts[0].partition("Held out, before:")[2], "output"),
                validation_table_of(before))  # fmt: skip
    assert_rows(rows_below(parts[2], "output"), validation_table_of(after))


def test_answer_of_a_refinement(refined, identified):
    after = fake_validation(identified, 31)
    assert tables.refinement_answer(refined, after) == (
        "Refined: free-run error of two tanks 789 mm before, 12.3 mm after (upper); 32.1 cm "
        f"before, 4.56 cm after (lower); the fit to held-out data is {min(after.fit):.4g} %."
    )


def test_report_of_a_refinement(refined, identified, diagnosed):
    before, after = fake_validation(identified), fake_validation(identified, 31)
    beside = {"start": identified, "diagnosis": diagnosed,
              "before": before, "after": after}  # fmt: skip
    shown = contents.refinement_contents(refined, beside)
    assert [(one.label, one.value, one.note) for one in shown.tiles] == [
        ("Free-run error of upper", "12.3 mm", "before 789 mm"),
        ("Free-run error of lower", "4.56 cm", "before 32.1 cm"),
    ]
    wanted = refined_table_of(refined), validation_table_of(before), validation_table_of(after)
    for table, rows in zip(shown.tables, wanted, strict=True):
        assert_rows(table.rows, rows)
    assert [table.numeric for table in shown.tables] == [(1, 2, 3)] * 3


@pytest.mark.parametrize("level", [0.95, 0.6])
def test_table_of_an_uncertainty(refined, level):
    from scipy.stats import t

    known = eoi.uncertainty(refined)
    text = tables.uncertainty_text(known, level)
    assert f"{100 * level:g} % interval" in text
    rows = rows_below(text, "parameter")
    wanted = []
    for i, (name, value) in enumerate(refined.parameters.items()):
        error = refined.standard_errors[name]
        half = error * t.ppf(0.5 + 0.5 * level, refined.degrees_of_freedom[i])
        unit = {"b": "1/m²", "k": "1/s", "c": ""}[name]
        ends = ("fixed",) if name == "c" else (error, value - half, value + half)
        wanted.append((name, value, *ends, unit))
    assert_rows(rows[:3], wanted)


def test_text_of_a_profile():
    points = numbers(41, 7)
    known = Profile(
        "k", points, points, points[:, None], 12.34, 0.5, 3.8, 0.9, (10.5, 15.25), 321.0,
        ("a note",), "N/m",
    )  # fmt: skip
    assert str(known).splitlines() == [
        "k: 12.34, 90 % interval 10.5 … 15.25 N/m",
        "profile of 7 points, 321 effective samples",
        "- a note",
    ]


# -- discover -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def discovered() -> eoi.Discovery:
    found = discovery()
    runs = [
        replace(one, rmse=numbers(50 + i, 1), fit=np.array([99.0 - 7.3 * i]))
        for i, one in enumerate(
            (found.before, found.after, found.windows_before, found.windows_after)
        )
        if one is not None
    ]
    fits = [
        replace(
            one,
            parameters={
                name: float(value)
                for name, value in zip(
                    one.parameters, numbers(60 + i, len(one.parameters)), strict=True
                )
            },
            index=numbers(70 + i, *one.index.shape),
            best_pass=1,
            certainty=replace(
                computed(one.certainty),
                standard_errors={
                    name: float(value)
                    for name, value in zip(
                        one.parameters, numbers(80 + i, len(one.parameters)), strict=True
                    )
                },
            ),
        )
        for i, one in enumerate((found.declared, found.found))
    ]
    return replace(
        found, before=runs[0], after=runs[1], windows_before=runs[2], windows_after=runs[3],
        declared=fits[0], found=fits[1],
    )  # fmt: skip


def change_table_of(found: eoi.Discovery) -> list[Row]:
    units = found.plant.units
    rows = []
    for name, value in found.found.parameters.items():
        old = found.declared.parameters.get(name)
        rows.append((
            name,
            "-" if old is None else DECLARED.parameters[name],
            "-" if old is None else old,
            "-" if old is None else found.declared.standard_errors[name],
            value,
            found.found.standard_errors[name],
            units.get(name, ""),
        ))  # fmt: skip
    return rows


def error_table_of(found: eoi.Discovery) -> list[Row]:
    rows: list[Row] = []
    pairs = ("", found.before, found.after), (" in windows", found.windows_before,
                                              found.windows_after)  # fmt: skip
    for how, before, after in pairs:
        assert before is not None
        assert after is not None
        old, new = before.rmse[0], after.rmse[0]
        rows.append((f"held-out RMSE of position{how}", old, new, new / old, "m"))
        fits = f"{before.fit[0]:.2f}", f"{after.fit[0]:.2f}"
        rows.append((f"held-out fit of position{how}", *fits, "%"))
    old, new = found.declared.index[1, 0], found.found.index[1, 0]
    return [*rows, ("index P of position", old, new, new / old)]


def others_of(found: eoi.Discovery) -> list[Row]:
    return [
        (one.effect, one.output, 100 * one.explained, one.score, one.remark)
        for one in found.ranking
        if one.effect not in ("coulomb_friction", "constant_offset")
    ]


CHANCES: list[Row] = [
    ("> 99.9 %", "coulomb_friction", "position"),
    ("62 %", "constant_offset", "position", "input_dead_zone at force 34 %, drift at position 4 %"),
]


def test_tables_of_a_discovery(discovered):
    text = str(discovered)
    assert_rows(rows_below(text, "parameter"), change_table_of(discovered))
    block = next(part for part in text.split("\n\n") if "after/before" in part)
    assert_rows(rows_below(block, "before"), error_table_of(discovered))
    assert_rows(rows_below(text, "probability"), CHANCES)
    assert_rows(rows_below(text, "other candidate"), others_of(discovered))
    assert "The effects explain 98.3 % of" in text
    small, big = discovered.before.rmse[0], discovered.after.rmse[0]
    ends = f"{tables.quantity(small, 'm')} before, {tables.quantity(big, 'm')} after."
    assert text.splitlines()[0].endswith(ends)


def test_report_of_a_discovery(discovered, diagnosed):
    shown = contents.discovery_contents(discovered, {"diagnosis": diagnosed})
    wanted = change_table_of(discovered), error_table_of(discovered), CHANCES
    for table, rows in zip(shown.tables, wanted, strict=True):
        assert_rows(table.rows, rows)
    assert [table.numeric for table in shown.tables] == [(1, 2, 3, 4, 5), (1, 2, 3), (0,)]
    assert shown.tables[1].head[0] == "error"
    assert_rows(shown.final_tables[0].rows, others_of(discovered))
    assert shown.final_tables[0].numeric == (2, 3)
    assert [(one.label, one.value, one.note) for one in shown.tiles] == [
        ("Free-run error of position, held-out data",
         tables.quantity(discovered.after.rmse[0], "m"),
         f"before {tables.quantity(discovered.before.rmse[0], 'm')}"),
        ("Explained", "98.3 %", "of the residual's power above the noise"),
        ("Added", "Coulomb (dry) friction, a constant offset", ""),
    ]  # fmt: skip


def test_report_of_a_discovery_that_added_nothing(discovered, diagnosed):
    nothing = replace(
        discovered, effects=(), added=(), after=discovered.before, found=discovered.declared,
        windows_after=discovered.windows_before, plant=discovered.declared.plant, explained=0.0,
        ambiguous_with=(),
    )  # fmt: skip
    before, short = nothing.before, nothing.windows_before
    wanted: list[Row] = [
        ("held-out RMSE of position", before.rmse[0], "m"),
        ("held-out fit of position", f"{before.fit[0]:.2f}", "%"),
        ("held-out RMSE of position in windows", short.rmse[0], "m"),
        ("held-out fit of position in windows", f"{short.fit[0]:.2f}", "%"),
        ("index P of position", nothing.declared.index[1, 0]),
    ]
    rows = discoveries.error_rows(nothing)
    assert rows[0] == ("", "declared", "unit")
    assert_rows(rows[1:], wanted)
    shown = contents.discovery_contents(nothing, {"diagnosis": diagnosed})
    assert_rows(shown.tables[1].rows, wanted)
    assert shown.tables[1].numeric == (1,)
    assert shown.final_tables[0].text == ""
    assert [one.note for one in shown.tiles] == ["", ""]


# -- diagnose, compare, sweep, inspect, remaining -------------------------------------------------


def test_tables_of_a_diagnosis(diagnosed):
    count = len(diagnosed.maps)
    known = replace(
        diagnosed,
        residual_rms=numbers(91, 2),
        noise_floor=numbers(92, 2),
        more_than_noise=np.array([True, False]),
        whiteness=np.array([0.0345, 1e-7]),
        units={"upper": "m", "lower": "cm"},
        maps=tuple(
            replace(one, statistic=float(a), p_value=float(b), explained=float(c))
            for one, a, b, c in zip(
                diagnosed.maps, numbers(93, count), np.linspace(0.01, 0.99, count),
                np.linspace(0.9, 0.1, count), strict=True,
            )
        ),
    )  # fmt: skip
    known = replace(known, strongest=(known.maps[1], None))
    text = diagnosis_text(known)
    assert_rows(rows_below(text, "output"), [
        ("upper", known.residual_rms[0], known.noise_floor[0], "yes", 0.0345, "m/s"),
        ("lower", known.residual_rms[1], known.noise_floor[1], "no", "< 1e-4", "cm/s"),
    ])  # fmt: skip
    assert_rows(rows_below(text, "residual of"), [
        (one.output, one.variable, 100 * one.explained, one.statistic, one.p_value,
         "strongest" if i == 1 else "")
        for i, one in enumerate(known.maps)
    ])  # fmt: skip


def entries(outputs: int) -> tuple[Entry, ...]:
    def entry(i: int) -> Entry:
        names = NAMES[:2]
        good = i < 2
        parameters = dict(zip(names, numbers(100 + i, 2).tolist(), strict=True)) | {"c": 0.8}
        known = dict(zip(names, (0.01 * numbers(110 + i, 2)).tolist(), strict=True))
        errors = {"b": 0.123 * (i + 1), "k": -0.0456 * (i + 5)}
        return Entry(
            f"method {i}", "", parameters if good else None, known if i == 0 else None,
            Status("converged" if good else "no_data", f"ended {i}"),
            numbers(120 + i, outputs) if good else np.full(outputs, np.nan),
            numbers(130 + i, outputs), numbers(140 + i, outputs), errors if good else None,
            float(numbers(150 + i, 1)[0]), float(numbers(160 + i, 1)[0]),
        )  # fmt: skip

    return tuple(entry(i) for i in range(3))


def comparison(outputs: int) -> Comparison:
    truth = {"b": 1.25, "k": 0.75}
    plant = PLANT if outputs == 2 else eoi.Plant(
        lambda t, x, u, p: p.b * u - p.k * x.y[0] - p.c, PLANT.parameters, 1, ("flow",), ("upper",)
    )  # fmt: skip
    return Comparison(entries(outputs), plant, truth, True, 2.5, (), ("a note",))


def estimates_of(known: Comparison) -> list[Row]:
    rows: list[Row] = [("nominal", 1.0, 0.5, 0.8), ("truth", 1.25, 0.75)]
    for one in known.entries[:2]:
        errors = one.standard_errors or {}
        rows.append((one.method, *(
            tables.with_error(value, errors.get(name, np.nan))
            for name, value in (one.parameters or {}).items()
        )))  # fmt: skip
    return rows


def test_tables_of_a_comparison_of_one_output():
    known = comparison(1)
    text = str(known)
    assert "windows: initial state re-estimated every 2.5 s" in text
    assert "free runs on held-out records" in text
    worst = [100 * max(abs(e) for e in one.errors.values()) if one.errors else "-"
             for one in known.entries]  # fmt: skip
    assert_rows(rows_below(text, "method"), [
        (one.method, one.status.code, worst[i], "-" if i == 2 else one.rmse[0], one.windows[0],
         one.index[0], one.seconds, one.first_seconds)
        for i, one in enumerate(known.entries)
    ])  # fmt: skip
    assert_rows(rows_below(text, "parameter"), estimates_of(known))
    assert comparisons.worst_error(known.entries[1]) == 0.0456 * 6


def test_tables_of_a_comparison_of_two_outputs():
    known = comparison(2)
    text = str(known)
    assert_rows(rows_below(text, "method"), [
        (one.method, one.status.code,
         100 * max(abs(e) for e in one.errors.values()) if one.errors else "-",
         one.seconds, one.first_seconds)
        for one in known.entries
    ])  # fmt: skip
    for head, name in (("rmse  ", "rmse"), ("windows  ", "windows"), ("P  ", "index")):
        rows = [(one.method, *("-" if np.isnan(v) else v for v in getattr(one, name)))
                for one in known.entries]  # fmt: skip
        assert_rows(rows_below(text, head), rows)
    assert_rows(rows_below(text, "parameter"), estimates_of(known))


@pytest.mark.parametrize(
    ("samples", "reason"), [(60, "2 blocks of the length"), (1000, "a value on a bound has none")]
)
def test_a_sweep_without_standard_errors_says_why(record, samples, reason):
    plant = eoi.Plant(
        lambda t, x, u, p: p.b * u - p.k * x.y[0], {"b": 1.0, "k": 0.5}, 1, ("flow",), ("upper",)
    )
    y = record.outputs[:samples, :1]
    one = eoi.Record(record.time[:samples], record.inputs[:samples], y, "first", hold="linear",
                     input_names=("flow",), output_names=("upper",))  # fmt: skip
    swept = eoi.sweep(plant, [[one]], lowpass=eoi.LowPass(20.0), passes=2)
    best = eoi.best(swept)
    if samples > 100:
        best["standard_error"] = best["standard_error"] * np.nan
    text = sweep_text(swept, best)
    assert "nan" not in text
    assert f"\nfirst: no standard error of b and k: {reason}" in text


@pytest.mark.parametrize("resamples", [0, 12])
def test_tables_of_a_sweep(record, resamples):
    plant = eoi.Plant(
        lambda t, x, u, p: p.b * u - p.k * x.y[0], {"b": 1.0, "k": 0.5}, 1, ("flow",), ("upper",)
    )
    y = record.outputs[:, :1]
    one = eoi.Record(record.time, record.inputs, y, "first", hold="linear", input_names=("flow",),
                     output_names=("upper",))  # fmt: skip
    swept = eoi.sweep(
        plant,
        [[one]],
        lowpass=[eoi.LowPass(20.0), eoi.LowPass(31.25)],
        resamples=resamples,
        passes=2,
    )
    best = eoi.best(swept)
    text = sweep_text(swept, best)
    assert text.startswith(f"{swept.attrs['plant']}: {swept['status'].size} lanes: ")
    lanes = sum(int(part.split()[0]) for part in text.splitlines()[0].split(": ")[-1].split(", "))
    assert lanes == swept["status"].size
    rows = dict(row[:2] for row in rows_below(text, "best"))
    assert float(rows["score"]) == pytest.approx(float(best["score"]), rel=1e-5)
    assert float(rows["cut-off [rad/s]"]) == pytest.approx(
        float(np.ravel(best["cutoff"].values)[0]), rel=1e-5
    )
    values = np.ravel(best["parameters"].sel(resample=0).values)
    if resamples:
        drawn = best["parameters"].isel(record=0, resample=slice(1, None))
        drawn = np.asarray(drawn.transpose("resample", ...))
        errors = np.std(drawn.reshape(resamples, 2), axis=0)
        assert "±: standard deviation over the resamples" in text
    else:
        errors = np.ravel(best["standard_error"].sel(resample=0).values)
    ((_, *shown),) = rows_below(text.replace("\n±: ", "\n\n±: "), "record")
    for cell, value, error in zip(shown, values, errors, strict=True):
        left, _, right = cell.partition(" ± ")
        assert float(left) == pytest.approx(value, rel=1e-5)
        assert float(right) == pytest.approx(error, rel=0.06)


def test_tables_of_an_inspection():
    clock = Clock(
        "t", factor=0.001, why="why", sample_period=0.004, duration=2.5, spacing=(0.0039, 0.0041),
        jitter=0.0123, gaps=(3, 0.5), repeated=4, backwards=(5, 1), others=("stamp",),
    )  # fmt: skip
    rows = [
        Channel("y", "numbers", "V", "output", "smooth", -1.25, 3.5, 2, 0.9, 0.0123, 0.25,
                ((3.5, 0.1),), 12.3),
        Channel("u", "numbers", "A", "input", "steps", 0.5, 7.75, 0, 0.1, None, None, (), 45.6),
        Channel("t", "numbers", "ms", "time", "rises", 0.0, 2500.0),
        Channel("label", "text", role="text"),
        Channel("aux", "whole numbers", low=1.0, high=9.0),
    ]  # fmt: skip
    known = Inspection(Path("rig.csv"), 777, clock, tuple(rows), ("a matrix",), ("n",), ("look",),
                       {})  # fmt: skip
    text = inspection_text(known)
    assert text.startswith("rig.csv: 777 rows, 5 columns")
    assert "time: `t`, 0.001 s per unit (why)" in text
    assert "every 0.004 s (250 Hz) for 2.5 s" in text
    assert "stamps 0.0039 to 0.0041 s apart, jitter 1.2 %" in text
    assert "3 gaps, 4 repeated, 5 backwards" in text
    assert "other candidates: stamp" in text
    assert_rows(rows_below(text, "column"), [
        ("t", "time", "ms", 0.0, 2500.0),
        ("u", "input", "A", 0.5, 7.75, "45.6 Hz"),
        ("y", "output", "V", -1.25, 3.5, 2, 0.0123, 0.25, "12.3 Hz"),
        ("aux", "whole numbers", 1.0, 9.0),
        ("label", "text"),
    ])  # fmt: skip
    assert "  u input: steps\n  y output: smooth" in text
    assert text.endswith("- n\n- Omitted: a matrix\n- look")


def test_table_of_what_remains(refined, identified):
    each = count()

    def candidate(*several: Any) -> Candidate:
        i = next(each)
        placed = tuple(place(PLANT, one, 0) for one in several)
        names = [name for one in placed for name in one.names]
        values = dict(zip(names, numbers(170 + i, len(names)).tolist(), strict=True))
        share, chance = float(numbers(180 + i, 1)[0]) / 1e3, 1e-5 * (i + 1)
        return Candidate(placed, values, share, chance)

    one, two = candidate(effects.Leak()), candidate(effects.ConstantOffset())
    both = candidate(effects.Leak(), effects.ConstantOffset())
    before, after = fake_validation(identified), fake_validation(identified, 31)
    known = Remaining(PLANT, (one, two), (both,), np.array([1.0, 2.0]), 0.01, before,
                      (Trial(one, refined, after),))  # fmt: skip
    lines = str(known).splitlines()
    for line, each_of in zip(lines[1:], (one, two, both), strict=False):
        label, share, chance, values = re.split(r"\s{2,}", line.replace(" %", ""))
        assert label == " + ".join(f"{name} at upper" for name in each_of.names)
        assert float(share) == pytest.approx(100 * each_of.share, abs=0.051)
        assert float(chance) == pytest.approx(each_of.significance, rel=0.05)
        shown = dict(pair.rsplit(" ", 1) for pair in values.split(", "))
        assert {name: float(value) for name, value in shown.items()} == pytest.approx(
            each_of.values, rel=1e-3
        )
    assert lines[4] == (
        f"held out with leak at upper: {', '.join(f'{v:.4g}' for v in before.rmse)} before, "
        f"{', '.join(f'{v:.4g}' for v in after.rmse)} after"
    )


def test_intervals_of_what_follows_from_parameters_are_those_of_the_delta_method():
    """A ratio of two correlated estimates."""
    covariance = np.array([[0.04, 0.01], [0.01, 0.09]])
    known = Uncertainty(
        {"m": 2.0, "k": 8.0}, covariance, np.array([5.0, 9.0]), np.zeros((2, 0)), (), {}
    )
    ratio = known.physical(lambda p: {"k/m": p.k / p.m}, {"k/m": "1/s²"})
    slope = np.array([-2.0, 0.5])
    error = np.sqrt(slope @ covariance @ slope)
    assert ratio.standard_errors["k/m"] == pytest.approx(error)
    assert ratio.degrees_of_freedom[0] == 5.0
    (row,) = rows_below(str(ratio), "parameter")
    assert_rows([row[:3]], [("k/m", 4.0, error)])
    assert row[-1] == "1/s²"
