"""Reactions, growth, epidemics, drugs: situations of people with few samples."""

import numpy as np
import pandas as pd

from benchmarks.situations.situation import (
    Frames,
    Parameters,
    Situation,
    dated,
    frame,
    levels,
    solve,
)

# -- reactions --------------------------------------------------------------------------------


def _two_instruments(p: Parameters) -> Frames:
    time = np.arange(600) * 1.0  # minutes
    frames = {}
    for name, seed in (("run.csv", 511), ("test.csv", 512)):
        feed = levels(seed, [0.0, 0.05, 0.1, 0.2], 12, 50)
        right = lambda _, x, u: [  # noqa: E731
            u[0] - p["k1"] * x[0],
            p["k1"] * x[0] - p["k2"] * x[1],
            p["k2"] * x[1] - 0.05 * x[2],
        ]
        states = solve(right, [1.0, 0.0, 0.0], time, feed)
        frames[name] = frame(time, feed=feed, A=states[:, 0], B=states[:, 1], C=states[:, 2])
    return frames


def _by_hand(_: str, table: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    """B every twelfth minute, C now and then: never all three together."""
    table.loc[table.index % 12 != 5, "B"] = np.nan
    table.loc[(table.index % 12 == 5) | (rng.random(len(table)) > 0.05), "C"] = np.nan
    return table


# One species by an instrument every minute, two by hand and never together.
# "Ability to fit with concentration data where all species are not available at all times",
# salvadorgarciamunoz/kipet #128
SPECIES_BY_HAND = Situation(
    name="species_by_hand",
    kind="several rates",
    plant="reaction",
    source="github.com/salvadorgarciamunoz/kipet/issues/128",
    parameters={"k1": 0.08, "k2": 0.03},
    simulate=_two_instruments,
    noise={"A": 0.005, "B": 0.01, "C": 0.01},
    spoil=_by_hand,
    config="""
[model]
inputs = ["feed"]
outputs = ["A", "B", "C"]
parameters = { k1 = 0.2, k2 = 0.2 }
bounds = { k1 = [0.0, 10.0], k2 = [0.0, 10.0] }
[model.derivatives]
A = "feed - k1*A"
B = "k1*A - k2*B"
C = "k2*B - 0.05*C"
[data]
files = ["run.csv"]
time = "t"
inputs = ["feed"]
outputs = ["A", "B", "C"]
[validation]
files = ["test.csv"]
""",
    command="refine",
    truth={"k1": 0.08, "k2": 0.03},
    reason="time in minutes, as rate constants are given",
)

_SAMPLED = np.array([0, 1, 3, 5, 8, 10, 15, 20, 25, 35, 45, 55, 65], float)


def _furfural(p: Parameters) -> Frames:
    frames = {}
    for name, start in (
        ("run1.csv", 182.0),
        ("run2.csv", 90.0),
        ("run3.csv", 45.0),
        ("test.csv", 130.0),
    ):
        right = lambda _, x, u: [  # noqa: E731
            -p["a"] * x[0] ** 2 - p["b"] * x[0],
            p["a"] * x[0] ** 2 - p["c"] * x[1],
        ]
        states = solve(right, [start, 0.0], _SAMPLED, scale=100.0)
        frames[name] = frame(_SAMPLED, xylose=states[:, 0], furfural=states[:, 1])
    return frames


# Thirteen samples at uneven times, three concentrations, a reaction of second order.
# "Chemical Kinetics: Fitting Multiple Sets of Time Series Data Using Multiple Differential
# Reaction Equations", mathematica.stackexchange.com
FURFURAL = Situation(
    name="furfural",
    kind="short record",
    plant="reaction",
    source="mathematica.stackexchange.com, Chemical Kinetics: Fitting Multiple Sets of Time Series",
    parameters={"a": 4e-4, "b": 0.02, "c": 0.01},
    simulate=_furfural,
    noise={"xylose": 0.6, "furfural": 0.6},
    config="""
[model]
outputs = ["xylose", "furfural"]
parameters = { a = 1e-3, b = 0.01, c = 0.005 }
bounds = { a = [0.0, 1.0], b = [0.0, 1.0], c = [0.0, 1.0] }
[model.derivatives]
xylose = "-a*xylose**2 - b*xylose"
furfural = "a*xylose**2 - c*furfural"
[data]
files = ["run1.csv", "run2.csv", "run3.csv"]
time = "t"
inputs = []
outputs = ["xylose", "furfural"]
[validation]
files = ["test.csv"]
""",
    command="refine",
    truth={"a": 4e-4, "b": 0.02, "c": 0.01},
    held_out={"xylose": 1.8, "furfural": 1.8},
)


def _fast_cascade(p: Parameters) -> Frames:
    time = np.arange(41) * 0.05
    frames = {}
    for name, start in (("run1.csv", 5.0), ("run2.csv", 8.0), ("run3.csv", 3.0), ("test.csv", 6.0)):
        right = lambda _, x, u: [  # noqa: E731
            -p["k1"] * x[0],
            p["k1"] * x[0] - p["k2"] * x[1],
            p["k2"] * x[1] - p["k3"] * x[2],
        ]
        states = solve(right, [start, 0.0, 0.0], time)
        frames[name] = frame(time, X1=states[:, 0], X2=states[:, 1], X3=states[:, 2])
    return frames


# The first step is over within a sample or two.
# "PEtab unable to solve (simple?) parameter fitting problem", sebapersson/PEtab.jl #310
FAST_CASCADE = Situation(
    name="fast_cascade",
    kind="fast mode",
    plant="reaction",
    source="github.com/sebapersson/PEtab.jl/issues/310",
    parameters={"k1": 40.0, "k2": 12.0, "k3": 3.0},
    simulate=_fast_cascade,
    noise={"X1": 0.02, "X2": 0.02, "X3": 0.02},
    config="""
[model]
outputs = ["X1", "X2", "X3"]
parameters = { k1 = 10.0, k2 = 5.0, k3 = 1.0 }
bounds = { k1 = [0.0, 1000.0], k2 = [0.0, 1000.0], k3 = [0.0, 1000.0] }
[model.derivatives]
X1 = "-k1*X1"
X2 = "k1*X1 - k2*X2"
X3 = "k2*X2 - k3*X3"
[data]
files = ["run1.csv", "run2.csv", "run3.csv"]
time = "t"
inputs = []
outputs = ["X1", "X2", "X3"]
[validation]
files = ["test.csv"]
""",
    command="refine",
    truth={"k1": 40.0, "k2": 12.0, "k3": 3.0},
    held_out={"X1": 1.6, "X2": 1.6, "X3": 1.6},
)


def _enzyme(p: Parameters) -> Frames:
    time = np.arange(0, 1200, 5.0)
    right = lambda _, x, u: [  # noqa: E731
        -p["Vmax"] * x[0] / (p["Km"] + x[0]),
        p["Vmax"] * x[0] / (p["Km"] + x[0]),
    ]
    return {"run.csv": frame(time, P=solve(right, [p["S0"], 0.0], time)[:, 1])}


# The product is measured, the substrate is not, nor how much of it there was.
# "Parameters should be allowed as initial values to ODEModel", tBuLi/symfit #160
ENZYME = Situation(
    name="enzyme",
    kind="unknown start",
    plant="reaction",
    source="github.com/tBuLi/symfit/issues/160",
    parameters={"Vmax": 0.012, "Km": 1.1, "S0": 4.0},
    simulate=_enzyme,
    noise={"P": 0.01},
    config="""
[model]
outputs = ["P"]
parameters = { Vmax = 0.03, Km = 3.0, S0 = 6.0 }
bounds = { Vmax = [0.0, 1.0], Km = [0.0, 100.0], S0 = [0.0, 100.0] }
[model.derivatives]
S = "-Vmax*S/(Km + S)"
P = "Vmax*S/(Km + S)"
[model.initial]
S = "S0"
[data]
files = ["run.csv"]
time = "t"
inputs = []
outputs = ["P"]
""",
    command="refine",
    truth={"Vmax": 0.012, "Km": 1.1, "S0": 4.0},
)


# -- growth -----------------------------------------------------------------------------------


def _monod(p: Parameters) -> Frames:
    time = np.arange(0, 49, 2.0)
    frames = {}
    for name, biomass, substrate in (
        ("run1.csv", 1.5, 40.0),
        ("run2.csv", 4.0, 18.0),
        ("test.csv", 2.5, 30.0),
    ):

        def right(_, x, u):
            growth = p["umax"] * x[1] * x[0] / (p["Ks"] + x[1])
            return [growth, -growth / p["Y"]]

        states = solve(right, [biomass, substrate], time)
        frames[name] = frame(time, X=states[:, 0], S=states[:, 1])
    return frames


# Growth on a substrate, sampled every two hours.
# "How to obtain model parameters by fitting experimental data to the Monod model", MATLAB Answers
MONOD = Situation(
    name="monod",
    kind="short record",
    plant="growth",
    source="MATLAB Answers, fitting experimental data to the Monod model",
    parameters={"umax": 0.21, "Ks": 9.0, "Y": 0.48},
    simulate=_monod,
    noise={"X": 0.1, "S": 0.2},
    config="""
[model]
outputs = ["X", "S"]
parameters = { umax = 0.5, Ks = 30.0, Y = 1.0 }
bounds = { umax = [0.0, 5.0], Ks = [0.0, 200.0], Y = [0.01, 10.0] }
[model.definitions]
growth = "umax*S*X/(Ks + S)"
[model.derivatives]
X = "growth"
S = "-growth/Y"
[data]
files = ["run1.csv", "run2.csv"]
time = "t"
inputs = []
outputs = ["X", "S"]
[validation]
files = ["test.csv"]
""",
    command="refine",
    truth={"umax": 0.21, "Ks": 9.0, "Y": 0.48},
    tolerance=0.1,
    reason="25 samples a run: Ks is known to 2.7 %",
)


def _amplification(p: Parameters) -> Frames:
    time = np.arange(0, 40, 0.5)
    growth = lambda start: p["K"] / (1 + (p["K"] / start - 1) * np.exp(-p["r"] * time))  # noqa: E731
    return {
        "run1.csv": frame(time, signal=growth(1e-7)),
        "run2.csv": frame(time, signal=growth(1e-5)),
        "run3.csv": frame(time, signal=growth(1e-6)),
    }


# The signal grows from far below the noise.
# "Scaling ODEModel initial value parameters", tBuLi/symfit #284
AMPLIFICATION = Situation(
    name="amplification",
    kind="unknown start",
    plant="growth",
    source="github.com/tBuLi/symfit/issues/284",
    parameters={"r": 0.8, "K": 1.9},
    simulate=_amplification,
    noise={"signal": 4e-3},
    config="""
[model]
outputs = ["signal"]
parameters = { r = 0.5, K = 1.0 }
bounds = { r = [0.0, 10.0], K = [0.01, 100.0] }
[model.derivatives]
signal = "r*signal*(1 - signal/K)"
[data]
files = ["run1.csv", "run2.csv", "run3.csv"]
time = "t"
inputs = []
outputs = ["signal"]
""",
    truth={"r": 0.8, "K": 1.9},
)


def _hares(p: Parameters) -> Frames:
    time = np.arange(0, 101, 1.0)
    right = lambda _, x, u: [  # noqa: E731
        p["a"] * x[0] - p["b"] * x[0] * x[1],
        -p["c"] * x[1] + p["d"] * x[0] * x[1],
    ]
    states = solve(right, [30.0, 8.0], time, scale=10.0)
    return {"run.csv": frame(time, hares=states[:, 0], lynxes=states[:, 1])}


# A hundred yearly counts of two species: twelve samples in a cycle, constants unknown.
# "Fitting Lotka-Volterra equation with unknown constants to data", math.stackexchange.com
YEARLY_COUNTS = Situation(
    name="yearly_counts",
    kind="slow sampling",
    plant="population",
    source="math.stackexchange.com, Fitting Lotka-Volterra equation with unknown constants to data",
    parameters={"a": 0.5, "b": 0.028, "c": 0.62, "d": 0.024},
    simulate=_hares,
    noise={"hares": 1.0, "lynxes": 0.8},
    config="""
[model]
outputs = ["hares", "lynxes"]
parameters = { a = 0.3, b = 0.01, c = 0.3, d = 0.01 }
bounds = { a = [0, 10], b = [0, 1], c = [0, 10], d = [0, 1] }
[model.derivatives]
hares = "a*hares - b*hares*lynxes"
lynxes = "-c*lynxes + d*hares*lynxes"
[data]
files = ["run.csv"]
time = "t"
inputs = []
outputs = ["hares", "lynxes"]
""",
    command="refine",
    truth={"a": 0.5, "b": 0.028, "c": 0.62, "d": 0.024},
)


def _epidemic(p: Parameters) -> Frames:
    time = np.arange(0, 90, 1.0) + np.tile([0.0, 0.0, 0.02, 0.0, -0.04, 0.0], 15)
    time -= time[0]
    right = lambda _, x, u: [  # noqa: E731
        -p["beta"] * x[0] * x[1] / 1e5,
        p["beta"] * x[0] * x[1] / 1e5 - p["gamma"] * x[1],
    ]
    states = solve(right, [99_800.0, 200.0], time, scale=1e3)
    return {"run.csv": frame(86400 * time, active=states[:, 1])}


# Daily reports at about the same hour, with dates.
# "Round times to multiples of the timestep", ECheynet/SEIR #2
DAILY_REPORTS = Situation(
    name="daily_reports",
    kind="time format",
    plant="population",
    source="github.com/ECheynet/SEIR/pull/2",
    parameters={"beta": 0.31, "gamma": 0.12},
    simulate=_epidemic,
    noise={"active": 60.0},
    step={"active": 1.0},
    write=dated("2020-02-24T18:00:00", "data", "T"),
    config="""
[model]
outputs = ["active"]
parameters = { beta = 0.5, gamma = 0.3 }
bounds = { beta = [0.0, 5.0], gamma = [0.0, 5.0] }
[model.derivatives]
active = "(beta*S*active/1e5 - gamma*active)/86400"
S = "-beta*S*active/1e5/86400"
[model.initial]
S = 99800.0
[data]
files = ["run.csv"]
time = "data"
inputs = []
outputs = ["active"]
""",
    command="refine",
    truth={"beta": 0.31, "gamma": 0.12},
)

# -- drugs ------------------------------------------------------------------------------------


def _patients(p: Parameters) -> Frames:
    frames = {}
    for index in range(12):
        rng = np.random.default_rng(540 + index)
        time = np.arange(0, 12.5, 0.5)
        rate = np.where(time < 2.0, rng.choice([20.0, 30.0, 40.0]), 0.0)
        right = lambda _, x, u: [  # noqa: E731
            (u[0] - p["CL"] * x[0] - p["Q"] * (x[0] - x[1])) / p["V"],
            p["Q"] * (x[0] - x[1]) / 20.0,
        ]
        states = solve(right, [0.0, 0.0], time, rate)
        frames[f"patient{index:02d}.csv"] = frame(time, rate=rate, conc=states[:, 0])
    return frames


def _few_samples(_: str, table: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    """Nine blood samples of each patient; the pump is logged throughout."""
    drawn = np.sort(rng.choice(np.arange(1, len(table)), 9, replace=False))
    table.loc[~table.index.isin([0, *drawn]), "conc"] = np.nan
    return table


# Twelve patients with nine blood samples each, at different hours.
# "Multiple subjects and Missing data", dynamicslab/pysindy #200
PATIENTS = Situation(
    name="patients",
    kind="several files",
    plant="drug",
    source="github.com/dynamicslab/pysindy/issues/200",
    parameters={"CL": 3.1, "V": 14.0, "Q": 4.0},
    simulate=_patients,
    noise={"conc": 0.03},
    spoil=_few_samples,
    config=f"""
[model]
inputs = ["rate"]
outputs = ["conc"]
parameters = {{ CL = 5.0, V = 10.0, Q = 2.0 }}
bounds = {{ CL = [0, 100], V = [0.1, 100], Q = [0, 100] }}
[model.derivatives]
conc = "(rate - CL*conc - Q*(conc - tissue))/V"
tissue = "Q*(conc - tissue)/20"
[model.initial]
tissue = 0.0
[data]
files = {[f"patient{index:02d}.csv" for index in range(12)]}
time = "t"
inputs = ["rate"]
outputs = ["conc"]
""",
    command="refine",
    truth={"CL": 3.1, "V": 14.0, "Q": 4.0},
)


def _oral(p: Parameters) -> Frames:
    time = np.arange(0, 48, 0.5)
    rate = np.where(time % 12.0 < 0.5, 200.0, 0.0)
    right = lambda _, x, u: [  # noqa: E731
        p["F"] * u[0] - p["ka"] * x[0],
        (p["ka"] * x[0] - p["CL"] * x[1]) / p["V"],
    ]
    return {"run.csv": frame(time, dose=rate, Cp=solve(right, [0.0, 0.0], time, rate)[:, 1])}


# Bioavailability, clearance and volume from an oral dose alone: a common factor.
# "Nonlinear non-population ODE model", nlmixrdevelopment/nlmixr #15
ORAL_DOSE = Situation(
    name="oral_dose",
    kind="common factor",
    plant="drug",
    source="github.com/nlmixrdevelopment/nlmixr/issues/15",
    parameters={"ka": 0.75, "F": 0.77, "CL": 1.9, "V": 21.0},
    simulate=_oral,
    noise={"Cp": 0.03},
    config="""
[model]
inputs = ["dose"]
outputs = ["Cp"]
parameters = { ka = 0.5, F = 0.5, CL = 1.0, V = 10.0 }
bounds = { ka = [0, 10], F = [0.01, 1], CL = [0, 100], V = [0.1, 1000] }
[model.derivatives]
depot = "F*dose - ka*depot"
Cp = "(ka*depot - CL*Cp)/V"
[model.initial]
depot = 0.0
[data]
files = ["run.csv"]
time = "t"
inputs = ["dose"]
outputs = ["Cp"]
""",
    command="refine",
    truth={"ka": 0.75, "CL/F": 1.9 / 0.77, "V/F": 21.0 / 0.77},
    inseparable=("F", "CL", "V"),
    fitted=("ka", "CL", "V"),
)

SITUATIONS = (
    SPECIES_BY_HAND,
    FURFURAL,
    FAST_CASCADE,
    ENZYME,
    MONOD,
    AMPLIFICATION,
    YEARLY_COUNTS,
    DAILY_REPORTS,
    PATIENTS,
    ORAL_DOSE,
)
