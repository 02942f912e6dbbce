"""Every numerical table of the paper beside ours: index of each pass, error of each increment.

    python benchmarks/truth/paper_tables.py [--quick] [--write]

The records come from `independent.py`, which shares no code with the library. Gains, filter and
nominal values come from `configs/`, which hold the paper's.
"""

import functools
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
import eoi_jax as eoi
from benchmarks.common import (
    Case,
    Report,
    arguments,
    case,
    explicit,
    percent,
    results,
    table,
    with_outputs,
)
from benchmarks.independent import one_mass, with_sensor


@dataclass(frozen=True)
class Published:
    """What the paper prints for one experiment.

    Attributes:
        title: which tables.
        config: the file in `configs/`.
        index: P of each iteration, one column an output.
        estimate: final increments (simulation) or final parameters (laboratory), as printed.
        note: where the paper contradicts itself, and what we do.
    """

    title: str
    config: str
    index: Sequence[Sequence[float]]
    estimate: dict[str, float]
    note: str


SIMULATED = (
    Published(
        "Table 1, level tank, simulated",
        "level_tank",
        [[0.0013], [4.0293e-7]],
        {"alpha": 0.9999, "beta": 0.5},
        "The text gives Δα = −1, the table +0.9999. With −1 the outflow would be an inflow: "
        "+1 is meant, and used.",
    ),
    Published(
        "Tables 3 to 5, three masses, simulated",
        "three_masses",
        [
            [0.0444, 0.1783, 0.0726],
            [6.9645e-5, 5.0329e-5, 3.8947e-5],
            [6.5718e-5, 3.4503e-5, 5.942e-5],
            [6.0197e-5, 3.8463e-5, 2.1241e-5],
        ],
        {
            "a1": 0.049492, "a2": 9.8749, "a3": -3.0748, "a4": 1.000279,
            "b1": -5.0304, "b2": 11.9155, "b3": 0.9468, "b4": 0.400305,
            "c1": -5.017468, "c2": 4.982555, "c3": 0.999919,
        },
        "The minimum of P2 is named as iteration 3, the final values of b sum three increments "
        "(k = 4). By the rule, two increments, Δb1 = −5.1391 (error +2.8 %) and Δb3 = 0.7909 "
        "(−21 %). We choose one k for all outputs, the minimum of Σ log P. Observer (18) carries "
        "friction terms that the plant does not have: left out.",
    ),
    Published(
        "Table 9, pendulum with Coulomb friction, simulated",
        "pendulum",
        [[11.3516], [0.3507], [0.0595], [0.0223], [0.0171], [0.0159]],
        {"a": 4.9257, "b": -0.8009, "c": -0.18915, "d": -4.1018},
        '"Fifth iteration" is called the minimum, but iteration 6 is smaller and the final values '
        "sum five increments: k = 6, as the rule says. The nominal d is not given, see Table 10.",
    ),
)  # fmt: skip

LABORATORY = (
    Published(
        "Table 2, level tank, laboratory",
        "level_tank_lab",
        [[3.2863e-4], [8.1318e-5], [1.7447e-4], [1.1578e-4]],
        {"alpha": 0.0017759, "beta": 0.0047834},
        "By the paper's rule α = 0.0017759 and β = 0.0002775; the text adds the increment of α to "
        "β (0.0047834). The twin's truth follows the rule.",
    ),
    Published(
        "Tables 6 to 8, three masses, laboratory",
        "three_masses_lab",
        [
            [3.7413, 0.0445, 0.1055],
            [0.548, 0.051, 0.003],
            [0.0132, 0.0035, 0.0011],
            [0.0111, 0.003, 0.0015],
            [0.0505, 0.0056, 0.0045],
        ],
        {
            "a1": 2.1671, "a2": 653.85, "a3": 517.58, "a4": 6.8732, "b1": 541.43, "b2": 795.4,
            "b3": 227.63, "b4": 3.2338, "c1": 216.65, "c2": 219.49, "c3": 2.3237,
        },
        "Δa1 = −45.46 in row 4 of Table 6 repeats the next column and is not in the sum. Final "
        "values of a and b sum three increments (k = 4), those of c two (k = 3), as the rule says.",
    ),
    Published(
        "Table 10, pendulum, laboratory",
        "pendulum_lab",
        [[608.1348], [1.2931], [0.3781], [0.3543], [0.4494]],
        {"a": 24.709, "b": 0.1657, "c": 0.479985, "d": 6.657},
        "The minimum is iteration 4, so three increments count; the final a, b, c are that sum, "
        "the increments in the text sum four. The nominal d is not given: 6.657 minus three "
        "increments is 103.000, minus the text's sum 102.7024. The rule, and its roundness, speak "
        "for 103.",
    ),
)  # fmt: skip

# Asked of the implicit form: worst error of an increment, and index.
ASKED = {"level_tank": (1e-4, 1e-12), "three_masses": (1e-3, 1e-10), "pendulum": (2e-3, 1e-5)}
FILTER = 90.0  # [rad/s], of all three simulated cases


def main() -> None:
    """Print, and write if asked."""
    options = arguments(__doc__)
    report = Report("The paper's tables, beside ours")
    report.add(
        "Increments are compared with the true ones, Δθ. P is the index of eq. (14), one value an "
        "output. *Implicit* is the default form of the observers, *explicit* the published one "
        "(Euler, sign of the error at the start of the step) with the paper's gains; both with the "
        "same filter on both sides of the regression (the paper: on what is noisy). Data: "
        "`independent.py`."
    )
    _asked(report, options.quick)
    report.add("## Simulated experiments")
    for published in SIMULATED:
        _simulated(report, published, options.quick)
    _substeps(report, options.quick)
    _sweep(report, options.quick, options.write)
    report.add("## Laboratory experiments, as simulated twins")
    report.add(
        "The paper's final parameters make the record; its nominal values and gains start the "
        "estimate; a plausible sensor measures (noise and quantisation in the config, 0.1 ms). "
        "Inputs of the experiments are not given, so indices can be compared in kind only."
    )
    for published in LABORATORY:
        _laboratory(report, published, options.quick)
    _one_mass(report, options.quick)
    report.close(__file__, options.write)


# -- what was asked ---------------------------------------------------------------------------


def _asked(report: Report, quick: bool) -> None:
    rows = []
    for name, h in (
        ("level_tank", 1e-4),
        ("three_masses", 1e-4),
        ("pendulum", 1e-4),
        ("pendulum", 1e-3),
    ):
        one = case(name, h, _duration(name, quick))
        result, other = one.identify(), one.identify(one.library)
        error, index = ASKED[name]
        apart = np.max(np.abs(one.record.outputs - one.library.outputs))
        reached = one.worst(result) <= error and np.max(_best(result)) <= index
        rows.append([
            name, f"{1e3 * h:g} ms", percent(error), percent(one.worst(result)), f"{index:g}",
            f"{np.max(_best(result)):.2g}", len(result.index), "yes" if reached else "NO",
            percent(one.worst(other)), f"{apart:.1g}",
        ])  # fmt: skip
    report.add(
        "## What was asked, implicit form",
        table(
            ["plant", "h", "error asked", "worst error", "P asked", "P", "passes", "reached",
             "error, library's simulator", "largest difference of the simulators"],
            rows,
        ),
    )  # fmt: skip


def _simulated(report: Report, published: Published, quick: bool) -> None:
    one = case(published.config, 1e-4, _duration(published.config, quick))
    ours, library = one.identify(), one.identify(one.library)
    h = 1e-4 if quick else 1e-5
    fine, euler = _swept(published.config, h, "explicit")
    report.add(f"### {published.title}", published.note)
    report.add(_index_table(published, ours, euler, f"explicit, {1e6 * h:g} µs"))
    start = one.plant.parameters
    rows = []
    for key, error in one.errors(ours).items():
        true = one.truth[key] - start[key]
        rows.append([
            f"Δ{key}", f"{true:.6g}", f"{published.estimate[key]:.6g}",
            percent(published.estimate[key] / true - 1.0),
            f"{ours.parameters[key] - start[key]:.8g}", percent(error),
            percent(one.errors(library)[key]), percent(fine.errors(euler)[key]),
        ])  # fmt: skip
    report.add(
        table(
            ["increment", "true", "paper", "error", "ours, 0.1 ms", "error",
             "error, library's simulator", f"error, explicit, {1e6 * h:g} µs"],
            rows,
        ),
    )  # fmt: skip


def _index_table(
    published: Published, ours: eoi.Identification, euler: eoi.Identification, label: str
) -> str:
    passes = max(len(published.index), len(ours.index), len(euler.index))
    rows = [
        [i + 1, *(_numbers(index, i) for index in (published.index, ours.index, euler.index))]
        for i in range(passes)
    ]
    rows.append([
        "first / smallest",
        *(_factors(np.asarray(index)) for index in (published.index, ours.index, euler.index)),
    ])  # fmt: skip
    return table(["P of pass", "paper", "implicit, 0.1 ms", label], rows)


def _numbers(index: Sequence[Sequence[float]] | np.ndarray, i: int) -> str:
    return ", ".join(f"{value:.3g}" for value in index[i]) if i < len(index) else ""


def _factors(index: np.ndarray) -> str:
    return ", ".join(f"{value:.3g}" for value in index[0] / np.min(index, axis=0))


def _best(result: eoi.Identification) -> np.ndarray:
    return result.index[result.best_pass]


def _duration(name: str, quick: bool) -> float | None:
    # The tank's multisine needs its 20 s.
    return 10.0 if quick and name != "level_tank" else None


# -- sub-steps and the step of the record -----------------------------------------------------


def _substeps(report: Report, quick: bool) -> None:
    one = case("three_masses", 1e-3, _duration("three_masses", quick))
    rows = []
    for count in (1, 5, None) if quick else (1, 2, 5, 10, 20, None):
        result = one.identify(substeps=count)
        label = count or "by default"
        rows.append([label, f"{np.max(_best(result)):.2g}", percent(one.worst(result))])
    report.add(
        "### Three masses sampled at 1 ms, with sub-steps (asked: within 0.5 %)",
        table(["sub-steps", "P, largest", "worst error of an increment"], rows),
        "The record is interpolated by a quintic spline; the error is the trapezoid's and falls "
        "with the square of the step.",
    )


@dataclass(frozen=True)
class Point:
    """One record of the sweep over h, in one form."""

    h: float
    first: float
    index: float
    error: float
    floor: float


def _sweep(report: Report, quick: bool, write: bool) -> None:
    steps = (1e-4, 1e-3) if quick else (5e-6, 1e-5, 2.5e-5, 1e-4, 2.5e-4, 1e-3, 2.5e-3)
    curves = {
        (name, scheme): [_point(name, h, scheme) for h in steps]
        for name in _SWEEP
        for scheme in ("explicit", "implicit")
    }
    report.add("## Why the implicit form: index and error against the step")
    rows = []
    for (name, scheme), points in curves.items():
        for one in points:
            rows.append([
                name, scheme, f"{1e6 * one.h:g}", f"{one.index:.2g}",
                f"{one.floor:.2g}" if one.floor else "", f"{one.first / one.index:.3g}",
                percent(one.error),
            ])  # fmt: skip
    header = ["plant", "form", "h [µs]", "P of output 1", "predicted", "first / smallest P",
              "worst error"]  # fmt: skip
    report.add(table(header, rows), _WHY)
    if write:
        _figure(curves)
        report.add("![Index and error against the step](implicit_explicit.png)")


# Duration of the records of the sweep [s].
_SWEEP = {"level_tank": 20.0, "three_masses": 10.0, "pendulum": 20.0}


@functools.cache
def _swept(name: str, h: float, scheme: str) -> tuple[Case, eoi.Identification]:
    """An experiment of the paper sampled every `h`, without sub-steps."""
    one = case(name, h, _SWEEP[name])
    observer = explicit(one.observer) if scheme == "explicit" else one.observer
    return one, one.identify(observer=observer, substeps=1)


def _point(name: str, h: float, scheme: str) -> Point:
    one, result = _swept(name, h, scheme)
    observer, floor = result.observer, 0.0
    if scheme == "explicit" and isinstance(observer, eoi.observers.SecondOrder):
        relay, damping = float(np.ravel(observer.c3)[0]), float(np.ravel(observer.c1)[0])
        floor = 0.5 * (4.0 * relay / np.pi * FILTER**2 * h / damping) ** 2
    return Point(h, float(result.index[0, 0]), float(_best(result)[0]), one.worst(result), floor)


_WHY = r"""An explicit relay sees the error one step late. In $\ddot e = -c_1 \dot e - c_3\,
\mathrm{sign}(e)$ the damping $c_1$ and that delay $h$ balance at $\omega^2 = c_1/h$: there the
observer chatters, whatever the model. The relay's first harmonic, of amplitude $4 c_3/\pi$, passes
the filter (19) with the gain $(\omega_c/\omega)^2 = \omega_c^2 h/c_1$, so the index stops at

$$P_{\min} \approx \tfrac12 \left(\frac{4 c_3}{\pi}\,\frac{\omega_c^2\,h}{c_1}\right)^2$$

("predicted" above). Gains, filter and step make it, not the plant or its input; it falls with
$h^2$, and the increments' error with $h$. Run alone on a plant at rest (c1 from 17.5 to 70, h from
10 µs to 1 ms) the observer chatters within 9 % of that frequency, with an index 0 to 42 % above
that P. The paper does not state the step of its simulations. Its smallest indices (6.0e-5 and
3.5e-5 for masses one and two, 0.0159 for the pendulum) are near what our explicit form leaves at
10 µs (6.8e-5, 3.2e-5, 0.018), so they may well be chatter and not what the model lacks; its third
mass, 2.1e-5, lies a factor of three below ours. The implicit relay takes the value that
makes the end of the step exact and does not chatter; what remains is the trapezoid's error, of
order $h^2$ in the increments and $h^4$ in the index. The tank's injection is continuous: its
explicit form has no such floor and is merely of first order.

The ratio first / smallest P depends on the first index too, hence on inputs and nominal values
that the paper does not give in full. With ours it grows as $1/h^2$ and passes the
paper's factors, 738 for the first mass and 714 for the pendulum, between 10 µs and 5 µs."""


def _figure(curves: dict[tuple[str, str], list[Point]]) -> None:
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(name for name, _ in curves))
    figure = Figure(figsize=(9.0, 5.6), layout="constrained")
    axes = figure.subplots(2, len(names), sharex=True, squeeze=False)
    paper = {"level_tank": 4.0293e-7, "three_masses": 6.0197e-5, "pendulum": 0.0159}
    for j, name in enumerate(names):
        for scheme, colour in (("explicit", "C3"), ("implicit", "C0")):
            points = curves[name, scheme]
            h = [point.h for point in points]
            axes[0, j].loglog(h, [p.index for p in points], "o-", color=colour, label=scheme)
            axes[1, j].loglog(h, [p.error for p in points], "o-", color=colour)
            if any(point.floor for point in points):
                floor = [point.floor for point in points]
                axes[0, j].loglog(h, floor, "--", color="0.4", label="predicted chatter")
        axes[0, j].axhline(paper[name], color="0.6", linestyle=":", label="paper's smallest P")
        axes[0, j].set_title(name.replace("_", " "))
        axes[1, j].set_xlabel("step h [s]")
        for axis in axes[:, j]:
            axis.grid(visible=True, alpha=0.3)
    axes[0, 0].set_ylabel("smallest index P, output 1")
    axes[1, 0].set_ylabel("worst error of an increment")
    handles, labels = axes[0, 1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    figure.savefig(results(__file__) / "implicit_explicit.png", dpi=110)


# -- laboratory twins -------------------------------------------------------------------------


def _laboratory(report: Report, published: Published, quick: bool) -> None:
    one = case(published.config, None, 20.0 if quick else None)
    ours, library = one.identify(), one.identify(one.library)
    assert one.observer is not None
    euler = one.identify(observer=explicit(one.observer))
    report.add(f"### {published.title}", published.note)
    report.add(_index_table(published, ours, euler, "explicit, 0.1 ms"))
    default = one.identify(observer=None, lowpass=None, smoothing=None)
    others = {"library's simulator": library, "explicit": euler, "default gains": default}
    report.add(_parameters(one, published.estimate, ours, others))


def _parameters(
    one: Case,
    printed: dict[str, float],
    ours: eoi.Identification,
    others: dict[str, eoi.Identification],
) -> str:
    rows = []
    for key, true in one.truth.items():
        errors = [percent(other.parameters[key] / true - 1.0) for other in others.values()]
        rows.append([
            key, f"{one.plant.parameters[key]:.6g}", f"{printed[key]:.6g}", f"{true:.6g}",
            f"{ours.parameters[key]:.6g} ± {ours.standard_errors[key]:.1g}",
            percent(ours.parameters[key] / true - 1.0), *errors,
        ])  # fmt: skip
    header = ["", "nominal", "paper, laboratory", "twin's truth", "ours", "error"]
    return table([*header, *(f"error, {name}" for name in others)], rows)


def _one_mass(report: Report, quick: bool) -> None:
    """Section 6; no config holds it."""
    plant, truth = eoi.plants.mass_spring_damper(), eoi.plants.mass_spring_damper(true=True)
    time = np.arange(0.0, 12.0 if quick else 36.0, 1e-4)
    u = eoi.excitation.square(time, amplitude=1.0, frequency=1.0 / 6.0)
    clean = eoi.simulate(truth, time, u, name="one mass")
    y = one_mass(truth.parameters, time, u, str(clean.hold))
    sensor = (5e-6, 1e-5)  # [m], as for the three masses
    record = with_outputs(clean, with_sensor(y, *sensor, seed=6))
    other = with_outputs(clean, with_sensor(clean.outputs, *sensor, seed=7))
    observer, lowpass = eoi.observers.SecondOrder(c1=94.0, c2=94.0, c3=10.0), eoi.LowPass(FILTER)
    one = Case(plant, truth.parameters, observer, lowpass, 5, None, record, other)
    ours = one.identify()
    others = {
        "library's simulator": one.identify(other),
        "default gains": one.identify(observer=None, lowpass=None),
    }
    report.add(
        "### Section 6, one mass, laboratory",
        "The paper starts from the toolbox's parameters (P 0.0207; the VSS-based method reaches "
        "0.0245) and ends after five iterations at P 0.0028. Its observer gains are not given: c1, "
        "c2 and the filter of section 5.2.2, a relay of 10. Index of ours: "
        + ", ".join(f"{value:.3g}" for value in ours.index[:, 0])
        + ".",
        _parameters(one, truth.parameters, ours, others),
    )


if __name__ == "__main__":
    main()
