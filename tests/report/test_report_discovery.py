"""A discovery as text, equation and figures: the answer first, and nothing that is not so."""

import dataclasses
import re

import jax.numpy as jnp
import numpy as np
import pytest
from found import DECLARED, HELD_OUT, HIDDEN, Jerk, discovery

import eoi_jax as eoi
from eoi_jax import effects, plants
from eoi_jax.data.clipping import AT_END
from eoi_jax.discovery.diagnose import diagnose
from eoi_jax.discovery.result import Added, Evidence, Rival
from eoi_jax.models.equations.display import equation_latex, equation_text
from eoi_jax.models.equations.printer import name_latex
from eoi_jax.models.storage import save
from eoi_jax.report import discovery_figures, tables
from eoi_jax.report.contents import discovery_contents
from eoi_jax.report.discovery import answer, described, discovery_text, phrase, texts
from eoi_jax.report.free_runs import record_title


@pytest.fixture(scope="module")
def found():
    return discovery()


@pytest.fixture(scope="module")
def nothing(found):
    """The same records where no effect was added."""
    return dataclasses.replace(
        found,
        effects=(),
        added=(),
        after=found.before,
        windows_after=found.windows_before,
        found=found.declared,
        plant=found.declared.plant,
        status=eoi.Status("unexplained", "No effect tried is justified."),
    )


def mass_of(found):
    return found.found.parameters["mass"]


# -- the answer -------------------------------------------------------------------------------


def test_the_first_line_names_effects_with_values_errors_and_units_and_both_errors(found):
    line = discovery_text(found).splitlines()[0]
    friction, offset = found.added
    push = mass_of(found) * offset.parameters["constant_offset"]
    mass = mass_of(found)
    # f = … + force/mass: an acceleration is told as the force that makes it.
    force = mass * friction.parameters["coulomb_friction"]
    shown = line.removeprefix("The model lacks Coulomb (dry) friction of ").split()
    assert float(shown[0]) == pytest.approx(force, rel=1e-4)
    wanted = mass * friction.standard_errors["coulomb_friction"]
    assert float(shown[2]) == pytest.approx(wanted, rel=0.05)  # two digits are shown
    assert shown[3:7] == ["N", "and", "a", "constant"]
    assert float(line.partition("constant offset of ")[2].split()[0]) == pytest.approx(
        push, rel=1e-3
    )
    before, after = found.before.rmse[0], found.after.rmse[0]
    ends = f"{tables.quantity(before, 'm')} before, {tables.quantity(after, 'm')} after."
    assert line.endswith(f"free-run error on held-out data {ends}")
    assert after < 0.05 * before


def test_an_error_without_held_out_data_says_so(found):
    line = answer(dataclasses.replace(found, in_sample=True))
    assert "held-out" not in line
    assert "on the same data (no data held out)" in line


def test_an_unexplained_residual_is_not_given_a_name(nothing):
    line = answer(nothing)
    assert line.startswith("The model lacks something that none of the tested effects explains: ")
    assert not any(one.sentence in line for one in effects.standard())
    text = discovery_text(nothing)
    assert "after" not in text
    assert "coulomb_friction" in text  # among the candidates, with its score


def test_a_partly_explained_residual_names_what_is_known(found):
    status = eoi.Status("unexplained", "")
    line = answer(dataclasses.replace(found, status=status))
    assert "a constant offset of -0." in line
    assert "and something that none of the tested effects explains" in line


def test_a_complete_model_lacks_nothing(nothing):
    status = eoi.Status("nothing_missing", "The residual is noise.")
    line = answer(dataclasses.replace(nothing, status=status))
    assert line.startswith("The model lacks nothing that the records show: free-run error")


def test_only_an_open_answer_points_to_the_ends_of_a_sensor_first(found, nothing):
    notes = (f"run 1: position stays at 0, {AT_END}, in 7 % of its samples",)
    shown = [answer(dataclasses.replace(case, notes=notes)) for case in (found, nothing)]
    assert ["First look at the notes" in text for text in shown] == [False, True]


def test_a_fit_that_failed_is_no_answer(nothing):
    status = eoi.Status("unidentifiable", "`mass` leaves no trace.")
    line = answer(dataclasses.replace(nothing, status=status))
    assert line == "No answer: unidentifiable: `mass` leaves no trace."


def test_a_run_that_diverges_has_no_number(found):
    bad = dataclasses.replace(found.before, rmse=np.array([np.inf]), fit=np.array([-np.inf]))
    text = discovery_text(dataclasses.replace(found, before=bad))
    assert "unbounded before" in text
    (line,) = [line for line in text.splitlines() if line.startswith("held-out RMSE of position  ")]
    assert "diverges" in line


def worse(runs, factor):
    return dataclasses.replace(runs, rmse=factor * runs.rmse)


@pytest.mark.parametrize("factor", [1.5, np.inf])
def test_where_whole_runs_drift_the_answer_speaks_of_short_ones(found, factor):
    drifting = dataclasses.replace(found, after=worse(found.before, factor))
    short = [
        tables.quantity(one.rmse[0], "m") for one in (found.windows_before, found.windows_after)
    ]
    assert answer(drifting).endswith(
        f"free-run error on held-out data in windows {short[0]} before, {short[1]} after "
        "(over whole records the free run drifts)."
    )
    tiles = [
        (one.label, one.value)
        for one in discovery_contents(drifting, {"diagnosis": diagnose(drifting.found)}).tiles
    ]
    assert ("Free-run error of position, held-out data, windows", short[1]) in tiles


def test_a_free_run_is_said_to_drift_only_where_it_does(found):
    """Whole runs that grow by a hundredth, and are hardly worse than those in windows."""
    before, after = found.windows_before, worse(found.windows_before, 0.9)
    long_runs = worse(found.before, before.rmse / found.before.rmse)
    alike = dataclasses.replace(
        found, before=long_runs, after=worse(long_runs, 1.01), windows_after=after
    )
    assert "in windows" in answer(alike)
    assert "drifts" not in answer(alike)
    lost = dataclasses.replace(
        alike, before=dataclasses.replace(long_runs, window=4.0),
        after=dataclasses.replace(worse(long_runs, 2.0), window=4.0),
    )  # fmt: skip
    assert answer(lost).endswith("(over windows of 4 s the free run drifts).")


def test_where_short_runs_are_no_better_the_answer_speaks_of_whole_ones(found):
    bad = dataclasses.replace(
        found,
        after=worse(found.before, 1.5),
        windows_after=worse(found.windows_before, 1.2),
    )
    assert "in windows" not in answer(bad)
    none = dataclasses.replace(
        found, after=worse(found.before, 1.5), windows_before=None, windows_after=None
    )
    assert "in windows" not in answer(none)


def test_the_table_shows_each_parameter_before_and_after(found):
    text = discovery_text(found)
    rows = {line.split()[0]: line.split() for line in text.splitlines() if line.strip()}
    for name, value in found.declared.parameters.items():
        assert float(rows[name][1]) == pytest.approx(DECLARED.parameters[name])
        assert float(rows[name][2]) == pytest.approx(value, rel=1e-5)
        assert float(rows[name][4]) == pytest.approx(found.found.parameters[name], rel=1e-5)
    for name in HIDDEN:
        assert rows[name][1:4] == ["-", "-", "-"]
        assert float(rows[name][4]) == pytest.approx(found.found.parameters[name], rel=1e-5)


def test_errors_are_shown_for_the_whole_record_for_windows_and_for_the_index(found):
    text = discovery_text(found)
    for how, before, after in (
        ("held-out RMSE of position ", found.before.rmse[0], found.after.rmse[0]),
        ("held-out RMSE of position in windows", *(
            one.rmse[0] for one in (found.windows_before, found.windows_after))),
        ("index P of position", *(
            one.index[one.best_pass, 0] for one in (found.declared, found.found))),
    ):  # fmt: skip
        line = next(line for line in text.splitlines() if line.startswith(how))
        numbers = [float(word) for word in line.removeprefix(how).split()[:3]]
        np.testing.assert_allclose(
            numbers, [before, after, after / before], rtol=6e-3
        )  # three digits


def test_share_ambiguity_advice_candidates_and_notes_are_told(found):
    text = discovery_text(found)
    assert "The effects explain 98.3 % of the residual's power above the noise." in text
    assert "do not distinguish it from asymmetric friction." in text
    assert found.advice in text
    lines = [line.split() for line in text.splitlines()]
    assert ["input_dead_zone", "force", "20", "%", "-3", "held-out", "error", "grows"] in lines
    assert not any(line[:2] == ["coulomb_friction", "position"] for line in lines)  # it is in
    assert "- run 1: a note." in text
    assert max(map(len, text.splitlines()[1:])) <= 120


def test_a_rival_that_is_nearly_as_probable_is_named_in_the_answer_and_every_one_in_a_table(found):
    text = discovery_text(found)
    sentence = text.splitlines()[0]
    assert " N or input dead zone: " in sentence
    assert "drift" not in sentence
    lines = text.splitlines()
    head = next(i for i, line in enumerate(lines) if line.startswith("probability"))
    friction, offset = (line.split() for line in lines[head + 1 : head + 3])
    assert lines[head].split() == ["probability", "added", "effect", "at", "else"]
    assert friction == [">", "99.9", "%", "coulomb_friction", "position"]
    assert offset[:4] == ["62", "%", "constant_offset", "position"]
    rivals = "input_dead_zone at force 34 %, drift at position 4 %"
    assert " ".join(offset[4:]) == rivals
    sure = [dataclasses.replace(one, probability=None, rivals=()) for one in found.added]
    assert "probability" not in discovery_text(dataclasses.replace(found, added=tuple(sure)))


FRICTION, OFFSET = "Coulomb (dry) friction of F", "a constant offset of F"


@pytest.mark.parametrize("stored", [False, True])
@pytest.mark.parametrize(
    ("chances", "said"),
    [
        ((0.5, 0.9), f"lacks {FRICTION} and {OFFSET}: "),
        ((0.483, 0.9), f"lacks {OFFSET} and possibly {FRICTION} (48.3 %): "),
        ((0.06, 0.02), f"possibly lacks {FRICTION} (6 %) and possibly {OFFSET} (2 %): "),
    ],
)
def test_an_effect_that_is_less_probable_than_not_is_told_as_possible(found, stored, chances, said):
    added = tuple(
        dataclasses.replace(item, probability=chance, rivals=())
        for item, chance in zip(found.added, chances, strict=True)
    )
    told = dataclasses.replace(found, added=added)
    if stored:
        told = dataclasses.replace(told, texts=texts(told))
    line = re.sub(r"of [-\d.]+ ± [\d.e-]+ N", "of F", answer(told))
    assert line.startswith(f"The model {said}")
    (tile,) = [
        tile.value
        for tile in discovery_contents(told, {"diagnosis": diagnose(told.found)}).tiles
        if tile.label == "Added"
    ]
    assert tile.count("possibly") == said.count("possibly")
    assert told.effects == found.effects


def test_a_rival_that_is_more_probable_is_named_before_the_effect(found):
    rivals = tuple(
        Rival(name, "", "force", chance)
        for name, chance in (("sensor_lag", 0.034), ("input_dead_zone", 0.0241), ("drift", 0.01))
    )
    added = dataclasses.replace(found.added[0], probability=0.0236, rivals=rivals)
    told = dataclasses.replace(found, added=(added,))
    line = re.sub(r"of [-\d.]+ ± [\d.e-]+ N", "of F", answer(told))
    rivals_text = "sensor lag (3.4 %) or input dead zone (2.41 %) or "
    assert line.startswith(f"The model possibly lacks {rivals_text}{FRICTION} (2.36 %): ")
    assert [rival.effect for rival in added.alternatives] == ["sensor_lag", "input_dead_zone"]


@pytest.mark.parametrize(("stiffness", "merged"), [(6100.0, True), (9000.0, False)])
def test_a_spring_that_a_gap_takes_away_again_is_told_as_stops_at_both_ends(
    found, stiffness, merged
):
    def item(effect, errors, **values):
        errors = dict(zip(values, errors, strict=True))
        return Added(effect, "position", values, errors, effect.sentence)

    springs = (
        item(effects.LinearStiffness(), (400.0,), linear_stiffness=6000.0),
        item(effects.FreePlay(), (400.0, 0.003), free_play_stiffness=stiffness, free_play_gap=0.25),
    )
    line = answer(dataclasses.replace(found, added=springs))
    assert line.startswith("The model lacks a linear spring") is not merged
    wanted = "The model lacks a spring that acts beyond a gap only, as stops at both ends do (stiff"
    assert line.startswith(wanted) is merged


def test_candidates_of_one_name_are_told_apart(found):
    stops = [
        Evidence("end_stop", "position", {}, 0.1, 1.0, "", form=stop.form)
        for stop in (effects.EndStop(+1), effects.EndStop(-1))
    ]
    text = discovery_text(dataclasses.replace(found, ranking=(*found.ranking, *stops)))
    names = [" ".join(line.split()[:3]) for line in text.splitlines()]
    assert names.count("end_stop (above) position") == 1
    assert names.count("end_stop (below) position") == 1


def test_effects_of_one_name_are_told_apart_by_form_and_place(found):
    frictions = [
        Added(effects.CoulombFriction(), output, {}, {}, "Coulomb (dry) friction")
        for output in ("cart", "arm")
    ]
    stop = Added(effects.EndStop(-1), "arm", {}, {}, "an end stop: contact on one side")
    two = eoi.Plant(lambda t, x, u, p: -p.k * x.y[0], {"k": 1.0}, 2, outputs=("cart", "arm"))
    both = dataclasses.replace(found, plant=two, added=(*frictions, stop))
    assert [described(both, added) for added in both.added] == [
        "Coulomb (dry) friction at cart", "Coulomb (dry) friction at arm",
        "an end stop (below) at arm",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("value", "unit", "shown"),
    [
        (0.0959, "m", "95.9 mm"),
        (0.99996, "m", "1 m"),
        (4.2e-7, "V", "0.42 µV"),
        (1234.0, "N", "1.23 kN"),
        (0.0959, "m/s²", "0.0959 m/s²"),
        (0.5, "", "0.5"),
        (0.0, "m", "0 m"),
    ],
)
def test_a_quantity_takes_a_prefix_where_its_unit_has_one(value, unit, shown):
    assert tables.quantity(value, unit) == shown


@pytest.mark.parametrize(
    ("value", "error", "shown"),
    [
        (20.4196, 0.0834, "20.420 ± 0.083"),
        (-3.26, 0.5, "-3.26 ± 0.50"),
        (0.400083, 6.1e-8, "0.40008 ± 6.1e-08"),
        (185012.0, 420.0, "185010 ± 420"),
        (1781.0, 112.0, "1780 ± 110"),
        (123456.0, 0.5, "123456 ± 0.50"),
        (7.299e-8, 7.5e-8, "(7.3 ± 7.5)e-08"),
        (1.27e-6, 2.7e-7, "(1.27 ± 0.27)e-06"),
        (-7.28e6, 1.4e4, "(-7.280 ± 0.014)e+06"),
        (2.5, np.nan, "2.5"),
        (2.5, 0.0, "2.5"),
    ],
)
def test_an_estimate_has_the_digits_that_its_error_leaves(value, error, shown):
    assert tables.with_error(value, error) == shown


def test_a_value_on_its_bound_is_told_in_place_of_its_error(found):
    stribeck = effects.StribeckFriction()
    names = ["stribeck_friction_level", "stribeck_friction_rise", "stribeck_friction_velocity"]
    parameters = dict(zip(names, (0.0, 0.4, 0.1), strict=True))
    errors = dict(zip(names, (np.nan, 0.05, 0.02), strict=True))
    added = Added(stribeck, "position", parameters, errors, "Stribeck friction")
    text = phrase(found, added)
    assert text == (
        "Stribeck friction (level 0, its bound, rise 0.400 ± 0.050, velocity 0.100 ± 0.020)"
    )


# -- the equation -----------------------------------------------------------------------------


def added(effect, channel, **parameters):
    return Added(effect, channel, parameters, {}, effect.sentence)


def test_the_declared_part_is_as_it_is_written_and_effects_follow(found):
    assert equation_text(DECLARED, found.added) == (
        "position'' = (force - viscous·position' - spring·position)/mass"
        " - coulomb_friction·sign(position') + constant_offset"
    )


def test_values_take_the_place_of_names():
    plant = plants.pendulum()
    friction = added(effects.CubicStiffness(), "angle", cubic_stiffness=-2.25)
    offset = added(effects.ConstantOffset(), "angle", constant_offset=-3.5)
    assert equation_text(plant, [friction, offset], numeric=True) == (
        "angle'' = -76·sin(angle) - 2.5·angle' - 0.5·sign(angle') + 103·voltage + 2.25·angle³ - 3.5"
    )


def test_an_effect_of_the_input_is_a_line_of_its_own():
    zone = added(effects.InputDeadZone(), "voltage", input_dead_zone=0.25)
    _, line = equation_text(plants.pendulum(), [zone], numeric=True).splitlines()
    assert line == "with voltage → voltage - clip(voltage, -0.25, 0.25)"


def test_internal_states_have_lines_of_their_own():
    assert equation_text(plants.cascaded_tanks()).splitlines() == [
        "lower_level' = k2·sqrt(z) - k3·sqrt(lower_level)",
        "z' = -k1·sqrt(z) + k4·pump",
    ]


def test_several_outputs_are_several_lines():
    leak = added(effects.ConstantOffset(), "position_2", offset=1.0)
    lines = equation_text(plants.three_mass_spring_damper(), [leak]).splitlines()
    assert [line.split()[0] for line in lines] == [f"position_{i}''" for i in (1, 2, 3)]
    assert lines[1].endswith("- b4·position_2' + offset")
    assert lines[2] == "position_3'' = c1·position_2 - c2·position_3 - c3·position_3'"


def test_local_names_indices_brackets_and_numbers_are_read():
    def dynamics(t, x, u, p):
        """Left out."""
        (a, b), (_, vb) = x.y
        difference = a - b
        force = -p.k * difference * jnp.abs(vb) ** 1.5
        force += GRAVITY
        return [force / (p.m * 2.0), jnp.where(x.y[1, 0] > 0, p.m, -u[1]) ** 2]

    plant = eoi.Plant(dynamics, {"k": -1.0, "m": 3.0}, 2, ("u1", "u2"), ("p", "q"))
    assert equation_text(plant).splitlines() == [
        "p'' = (-k·(p - q)·|q'|^1.5 + 9.81)/(2·m)",
        "q'' = where(p' > 0, m, -u2)²",
    ]
    assert equation_text(plant, numeric=True).splitlines()[0] == (
        "p'' = (1·(p - q)·|q'|^1.5 + 9.81)/(2·3)"
    )


GRAVITY = 9.81


def looping(t, x, u, p):
    total = 0.0
    for _ in range(3):
        total = total + p.a * x.y[0]
    return total


def tabulated(t, x, u, p):
    return p.a * jnp.asarray([1.0, 2.0, 3.0])[jnp.int32(jnp.abs(x.y[0]))]


def test_a_loop_is_written_out_and_a_table_is_shown_by_what_it_depends_on():
    friction = added(effects.CoulombFriction(), "y", level=1.0)
    plant = eoi.Plant(looping, {"a": 1.0}, relative_degree=2)
    assert equation_text(plant, [friction]) == "y'' = a·y + a·y + a·y - level·sign(y')"
    plant = eoi.Plant(tabulated, {"a": 1.0}, relative_degree=2)
    assert equation_text(plant, [friction]) == "y'' = f(y, y', u, a) - level·sign(y')"


def test_functions_in_one_line_of_source_are_told_apart():
    two = (lambda t, x, u, p: p.a * x.y[0], lambda t, x, u, p: p.a * x.y[0] ** 2)
    first, second = (eoi.Plant(one, {"a": 1.0}) for one in two)
    assert equation_text(first) == "y' = a·y"
    assert equation_text(second) == "y' = a·y²"


def test_latex_has_dots_fractions_and_subscripts(found):
    text = equation_latex(DECLARED, found.added)
    assert r"\ddot{\mathrm{position}} &= \frac{\mathrm{force} - " in text
    friction = r"\operatorname{sign}\left(\dot{\mathrm{position}}\right)"
    assert rf"- \mathrm{{coulomb\_friction}}\,{friction}" in text
    assert text.count("{") == text.count("}")
    assert r"\sqrt{19.62\,\mathrm{level}}" in equation_latex(plants.level_tank())
    assert r"\dot{z} &= -k_{1}\,\sqrt{z}" in equation_latex(plants.cascaded_tanks())


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("alpha", r"\alpha"),
        ("a2", "a_{2}"),
        ("position_1", r"\mathrm{position}_{1}"),
        ("k", "k"),
        ("viscous_friction", r"\mathrm{viscous\_friction}"),
    ],
)
def test_names_in_latex(name, shown):
    assert name_latex(name) == shown


@pytest.mark.parametrize("effect", effects.standard(), ids=lambda one: type(one).__name__)
def test_every_effect_has_a_formula_in_balanced_latex(effect):
    values = {f"p{i}": -0.5 - i for i in range(len(effect.parameters))}
    inner = isinstance(effect, effects.AbstractInternalEffect)
    plant = plants.cascaded_tanks() if inner else plants.pendulum()
    channel = effect.channels(plant)[0]
    for numeric in (False, True):
        text = equation_text(plant, [added(effect, channel, **values)], numeric=numeric)
        latex = equation_latex(plant, [added(effect, channel, **values)], numeric=numeric)
        assert latex.count("{") == latex.count("}")
        for name, value in values.items():
            assert (f"{abs(value)}" if numeric else name) in text
            assert (f"{abs(value)}" if numeric else name_latex(name)) in latex
        assert "+ -" not in text
        assert "- -" not in text


# -- the figures ------------------------------------------------------------------------------


def test_the_residual_is_drawn_before_and_after_to_its_peaks(found):
    (axes,) = discovery_figures.discovery_figures(found)["residual"].axes
    for line, result in zip(axes.lines, (found.declared, found.found), strict=True):
        assert np.nanmax(line.get_ydata()) == np.nanmax(result.residual[0])
        assert np.nanmin(line.get_ydata()) == np.nanmin(result.residual[0])
        assert len(line.get_ydata()) < len(result.residual[0])
    assert axes.get_ylabel() == "residual of\nposition [m/s²]"


def test_friction_is_drawn_against_the_rate_and_the_fit_goes_through_the_means(found):
    rate, time = discovery_figures.discovery_figures(found)["effect"].axes
    assert rate.get_xlabel() == "rate of position [m/s]"
    assert time.get_xlabel() == "time [s]"  # the offset
    means, fitted = rate.lines[0], rate.lines[1]
    x, y = np.asarray(means.get_xdata()), np.asarray(means.get_ydata())
    # The step at rest: 2 × 0.2 m/s², less what the declared viscous friction makes up for.
    step = np.max(y[x < 0]) - np.min(y[x > 0])
    assert 0.2 < step < 0.6
    # Only what is left after the effects parts the two: noise and rounding.
    np.testing.assert_allclose(fitted.get_ydata(), y, atol=0.02 * step)


def test_an_effect_of_the_input_is_drawn_against_the_input(found):
    zone = added(effects.InputDeadZone(), "force", input_dead_zone=0.25)
    other = dataclasses.replace(found, added=(zone,), effects=("input_dead_zone",))
    (axes,) = discovery_figures.discovery_figures(other)["effect"].axes
    assert axes.get_xlabel() == "force [N]"


def test_without_an_effect_the_residual_is_drawn_against_everything(nothing):
    drawn = discovery_figures.discovery_figures(nothing)
    labels = [axes.get_xlabel() for axes in drawn["effect"].axes]
    assert labels == ["position [m]", "rate of position [m/s]", "time [s]", "force [N]"]
    (axes,) = drawn["residual"].axes
    assert len(axes.lines) == 1
    assert drawn["free_run"].axes[0].get_legend().get_texts()[1].get_text() == "declared model"


def test_free_runs_are_drawn_against_the_measurement_with_their_errors(found):
    upper, lower = discovery_figures.discovery_figures(found)["free_run"].axes
    assert [text.get_text() for text in upper.get_legend().get_texts()] == [
        "measured", "before", "after",
    ]  # fmt: skip
    worst = [np.max(np.abs(np.asarray(line.get_ydata()))) for line in lower.lines]
    assert worst[1] < 0.05 * worst[0]
    assert lower.get_xlabel() == "time [s], held-out record run 2"
    unnamed = HELD_OUT.with_outputs(HELD_OUT.outputs, "record")
    assert record_title(unnamed) == "record"


def test_a_run_that_diverges_does_not_hide_the_measurement(found):
    prediction = found.before.predictions[0]
    wild = eoi.Record(prediction.time, prediction.inputs, 1e3 * prediction.outputs, name="wild")
    before = dataclasses.replace(found.before, predictions=(wild,))
    upper, lower = discovery_figures.discovery_figures(dataclasses.replace(found, before=before))[
        "free_run"
    ].axes
    reach = np.max(np.abs(HELD_OUT.outputs))
    for axes in (upper, lower):
        low, high = axes.get_ylim()
        assert -7 * reach < low < high < 7 * reach


def test_the_single_figure_holds_all_three(found):
    axes = discovery_figures.discovery_figure(found).axes
    assert len(axes) == 1 + 2 + 2


# -- on file ----------------------------------------------------------------------------------


def test_a_loaded_discovery_has_the_same_numbers_and_can_be_used_on(found, tmp_path):
    found.save(tmp_path / "found.npz")
    back = eoi.load(tmp_path / "found.npz", plant=DECLARED)
    assert str(back) == str(found)
    assert type(back.added[0].effect) is effects.CoulombFriction
    assert back.plant.parameters == found.plant.parameters
    again = eoi.validate(back.plant, HELD_OUT)
    assert again.rmse[0] == pytest.approx(found.after.rmse[0], rel=1e-9)


def test_a_loaded_discovery_prints_the_same_without_its_model(found, nothing, tmp_path):
    for one in (found, nothing):
        one.save(tmp_path / "found.npz")
        back = eoi.load(tmp_path / "found.npz")
        assert str(back) == str(one)
        assert (back.equation, back.latex) == (one.equation, one.latex)
        back.save(tmp_path / "again.npz")
        assert str(eoi.load(tmp_path / "again.npz")) == str(one)
        with pytest.raises(ValueError, match="`plant` must be given to `load`"):
            eoi.validate(back.plant, HELD_OUT)


def test_a_file_that_holds_no_texts_can_be_saved_again_without_its_model(found, tmp_path):
    found.save(tmp_path / "found.npz")
    older = dataclasses.replace(eoi.load(tmp_path / "found.npz"), texts=None)
    older.save(tmp_path / "older.npz")
    assert eoi.load(tmp_path / "older.npz").texts is None
    back = eoi.load(tmp_path / "older.npz", plant=DECLARED)
    assert str(back) == str(found)


def test_an_array_that_several_parts_share_is_written_once(found, tmp_path):
    found.save(tmp_path / "found.npz")
    twice = dataclasses.replace(found, found=found.declared)
    twice.save(tmp_path / "twice.npz")
    with np.load(tmp_path / "found.npz") as one, np.load(tmp_path / "twice.npz") as other:
        assert len(other.files) < len(one.files)
    back = eoi.load(tmp_path / "twice.npz", plant=DECLARED)
    np.testing.assert_array_equal(back.found.residual[0], found.declared.residual[0])


def test_an_effect_of_the_users_own_is_given_again_on_loading(found, tmp_path):
    own = Added(Jerk(5), "position", {"jerk": 1.0}, {"jerk": 0.1}, "a jerk")
    dataclasses.replace(found, added=(own,)).save(tmp_path / "own.npz")
    back = eoi.load(tmp_path / "own.npz", plant=DECLARED)
    assert back.added[0].effect.name == "jerk"
    assert "a jerk of 2." in str(back)
    with pytest.raises(ValueError, match=r"`effects` must be given to `load`.*jerk"):
        back.added[0].effect.term(None, (1.0,), ())
    back.save(tmp_path / "again.npz")
    whole = eoi.load(tmp_path / "again.npz", plant=DECLARED, effects=(Jerk(),))
    assert whole.added[0].effect == Jerk(5)
    assert "a jerk of 2." in str(whole)


def test_a_ranking_is_a_result_like_any_other(found, tmp_path):
    save(found.ranking[2], tmp_path / "one.npz")
    assert eoi.load(tmp_path / "one.npz") == found.ranking[2]


def test_a_diagnosis_survives_a_file(found, tmp_path):
    diagnosis = diagnose(found.declared)
    diagnosis.save(tmp_path / "diagnosis.npz")
    assert str(eoi.load(tmp_path / "diagnosis.npz", plant=DECLARED)) == str(diagnosis)


def test_residual_effects_and_free_run_stand_one_below_the_other(found):
    figure = discovery_figures.discovery_figure(found)
    figure.draw_without_rendering()
    residual, effect, free_run = figure.subfigs
    assert len(residual.axes) == len(found.plant.outputs)
    assert residual.bbox.y0 >= effect.bbox.y1 > effect.bbox.y0 >= free_run.bbox.y1


def test_where_nothing_is_known_the_residual_is_drawn_against_every_variable(found):
    none = dataclasses.replace(found, added=())
    variables = [variable for _, variable, _ in discovery_figures._maps(none)]
    assert variables == ["y", "v", "t", "force"]
    level = plants.level_tank()
    tank = dataclasses.replace(none, plant=level)
    variables = [variable for _, variable, _ in discovery_figures._maps(tank)]
    assert variables == ["y", "t", *level.inputs]  # the velocity of a level is what f is


# -- the table --------------------------------------------------------------------------------


def test_a_data_frame_has_a_row_for_each_effect(found):
    frame = found.to_pandas()
    assert list(frame["effect"]) == [candidate.effect for candidate in found.ranking]
    assert list(frame["added"]) == [True, False, False]
    assert frame.loc[2, "remark"] == "contains coulomb friction"
    assert frame.loc[3, "at"] == "force"
    assert found.to_xarray()["score"].values.tolist() == [300.0, 290.0, -3.0]
    effects = found.found.to_pandas()["effect"]
    assert effects["coulomb_friction"] == "coulomb_friction"
    assert effects["mass"] == ""
    assert dataclasses.replace(found, ranking=()).to_pandas().empty
