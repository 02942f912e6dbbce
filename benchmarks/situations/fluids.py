"""Tanks, ducts, membranes, process loops."""

import numpy as np
import pandas as pd

from benchmarks.situations.situation import (
    Frames,
    Parameters,
    Situation,
    frame,
    levels,
    solve,
    to_csv,
)


def _bottle(p: Parameters) -> Frames:
    frames = {}
    for name, start, seed in (
        ("fill1.csv", 18.0, 1),
        ("fill2.csv", 17.2, 2),
        ("fill3.csv", 16.1, 3),
        ("test.csv", 17.6, 4),
    ):
        rng = np.random.default_rng(600 + seed)
        time = np.cumsum(np.concatenate([[0.0], rng.integers(4, 9, 17)])).astype(float)
        root = np.maximum(np.sqrt(start) - 0.5 * p["k"] * time, 0.0)
        frames[name] = frame(time, cm=root**2)
    return frames


# A leaking bottle, read by hand against a stopwatch: 18 readings, centimetres.
# "Project 3: Leaky Bottles", pages.central.edu/emp/LintonT
BOTTLE = Situation(
    name="bottle",
    kind="short record",
    plant="tank",
    source="pages.central.edu/emp/LintonT, Leaky Bottles",
    parameters={"k": 0.052},
    simulate=_bottle,
    noise={"cm": 0.05},
    step={"cm": 0.1},
    config="""
[model]
outputs = ["cm"]
parameters = { k = 0.1 }
[model.derivatives]
cm = "-k*sqrt(cm)"
[data]
files = ["fill1.csv", "fill2.csv", "fill3.csv"]
time = "t"
inputs = []
outputs = ["cm"]
[validation]
files = ["test.csv"]
""",
    truth={"k": 0.052},
    held_out={"cm": 2.0},
    reason="held out: the start has the error of a single reading",
)


def _membrane(p: Parameters) -> Frames:
    time = np.arange(1800) * 1.0
    frames = {}
    for name, seed in (("run.csv", 611), ("test.csv", 612)):
        wanted = levels(seed, [2.0, 3.0, 4.0, 5.0, 6.0], 20, 90)
        right = lambda _, x, u: [  # noqa: E731
            (u[0] - x[0]) / p["tau"],
            (x[0] - x[1] / p["Rm"]) / p["Cm"],
        ]
        states = solve(right, [2.0, 2.0 * p["Rm"]], time, wanted)
        frames[name] = frame(time, Flow_setpoint=wanted, DeltaP=states[:, 1])
    return frames


# Pressure over a membrane from the set point of the flow; the pump follows late.
# "What is wrong with the way I coded in SINDy?", dynamicslab/pysindy #609
MEMBRANE = Situation(
    name="membrane",
    kind="set points as inputs",
    plant="filter",
    source="github.com/dynamicslab/pysindy/issues/609",
    parameters={"tau": 6.0, "Rm": 0.32, "Cm": 70.0},
    simulate=_membrane,
    noise={"DeltaP": 0.004},
    config="""
[model]
inputs = ["Flow_setpoint"]
outputs = ["DeltaP"]
parameters = { tau = 2.0, Rm = 0.5, Cm = 30.0 }
bounds = { tau = [0.01, 100.0], Rm = [0.01, 10.0], Cm = [0.1, 1000.0] }
input_lag = { Flow_setpoint = "tau" }
[model.derivatives]
DeltaP = "(Flow_setpoint - DeltaP/Rm)/Cm"
[data]
files = ["run.csv"]
time = "t"
inputs = ["Flow_setpoint"]
outputs = ["DeltaP"]
[validation]
files = ["test.csv"]
""",
    command="refine",
    truth={"tau": 6.0, "Rm": 0.32, "Cm": 70.0},
    held_out={"DeltaP": 1.3},
)


def _two_tanks(p: Parameters) -> Frames:
    time = np.arange(1500) * 2.0
    frames = {}
    for name, seed in (("run.csv", 621), ("test.csv", 622)):
        pump = levels(seed, [1.5, 3.0, 4.5, 6.0], 30, 50)

        def right(_, x, u):
            upper, lower = np.sqrt(np.maximum(x, 0.0))
            return [p["g"] * u[0] - p["a1"] * upper, p["a1"] * upper - p["a2"] * lower]

        states = solve(right, [4.0, 5.0], time, pump)
        frames[name] = frame(time, pump=pump, h1=states[:, 0], h2=states[:, 1])
    return frames


def _with_gaps(_: str, table: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    """A level sensor fails for minutes; once the whole logger, while the pump goes on."""
    table.loc[200:340, "h2"] = np.nan
    table.loc[650:760, ["pump", "h1", "h2"]] = np.nan
    table.loc[1100:1180, "h1"] = np.nan
    return table


# Observations are missing for long stretches, once the input too.
# "Running the Kalman filter with missing observations", spmvg/nfoursid #3
TANKS_WITH_GAPS = Situation(
    name="tanks_with_gaps",
    kind="gaps",
    plant="tank",
    source="github.com/spmvg/nfoursid/issues/3",
    parameters={"g": 0.045, "a1": 0.08, "a2": 0.07},
    simulate=_two_tanks,
    noise={"h1": 0.02, "h2": 0.02},
    spoil=_with_gaps,
    config="""
[model]
inputs = ["pump"]
outputs = ["h1", "h2"]
parameters = { g = 0.1, a1 = 0.1, a2 = 0.1 }
[model.derivatives]
h1 = "g*pump - a1*sqrt(h1)"
h2 = "a1*sqrt(h1) - a2*sqrt(h2)"
[data]
files = ["run.csv"]
time = "t"
inputs = ["pump"]
outputs = ["h1", "h2"]
[validation]
files = ["test.csv"]
""",
    command="refine",
    truth={"g": 0.045, "a1": 0.08, "a2": 0.07},
    held_out={"h1": 1.5, "h2": 1.5},
)


def _duct(p: Parameters) -> Frames:
    frames = {}
    for index, name in enumerate(["a.csv", "b.csv", "c.csv", "d.csv", "e.csv", "test.csv"]):
        time = np.arange(400 + 60 * index) * 1.0
        if name == "c.csv":
            heat = np.full(len(time), 40.0)
        else:
            heat = levels(630 + index, [0.0, 30.0, 60.0, 90.0], 40, 30)[: len(time)]
        fan = np.full(len(time), [0.6, 0.8, 1.0, 1.2, 1.4, 0.9][index])
        right = lambda _, x, u: [  # noqa: E731
            (p["e"] * u[0] - (p["h0"] + p["h1"] * u[1]) * (x[0] - 20.0)) / 60.0
        ]
        states = solve(right, [20.0 + 4.0 * index], time, np.column_stack([heat, fan]))
        frames[name] = frame(time, heat=heat, fan=fan, T=states[:, 0])
    return frames


# Five recordings; the fan runs at one speed in each, and in one the heater does too.
# "Support for training from multiple datasets", wilsonrljr/sysidentpy #50
DUCT = Situation(
    name="duct",
    kind="input constant in a file",
    plant="heated duct",
    source="github.com/wilsonrljr/sysidentpy/issues/50",
    parameters={"e": 0.85, "h0": 0.7, "h1": 1.6},
    simulate=_duct,
    noise={"T": 0.1},
    config="""
[model]
inputs = ["heat", "fan"]
outputs = ["T"]
parameters = { e = 1.0, h0 = 1.0, h1 = 1.0 }
[model.derivatives]
T = "(e*heat - (h0 + h1*fan)*(T - 20))/60"
[data]
files = ["a.csv", "b.csv", "c.csv", "d.csv", "e.csv"]
time = "t"
inputs = ["heat", "fan"]
outputs = ["T"]
[validation]
files = ["test.csv"]
""",
    truth={"e": 0.85, "h0": 0.7, "h1": 1.6},
    held_out={"T": 1.4},
)


def _flow_loop(p: Parameters) -> Frames:
    time = np.arange(4000) * 1e-3
    frames = {}
    for name, seed in (("run.csv", 641), ("test.csv", 642)):
        drive = levels(seed, [-1.0, -0.5, 0.5, 1.0], 40, 100)
        right = lambda _, x, u: [  # noqa: E731
            x[1],
            p["w"] ** 2 * (p["K"] * u[0] - x[0]) - 2 * p["zeta"] * p["w"] * x[1],
        ]
        frames[name] = frame(time, u=drive, y=solve(right, [0.0, 0.0], time, drive)[:, 0])
    return frames


# No column of time: the sample period is told.
# "tsample Not Affecting Identification Result", CPCLAB-UNIPI/SIPPY #14
NO_TIME = Situation(
    name="no_time",
    kind="time format",
    plant="valve",
    source="github.com/CPCLAB-UNIPI/SIPPY/issues/14",
    parameters={"K": 2.2, "w": 35.0, "zeta": 0.4},
    simulate=_flow_loop,
    noise={"y": 0.01},
    write=lambda table: to_csv(table.drop(columns="t")),
    config="""
[model]
inputs = ["u"]
outputs = ["y"]
parameters = { K = 1.0, w = 20.0, zeta = 0.7 }
bounds = { w = [0.1, 1000.0], zeta = [0.0, 10.0] }
[model.derivatives]
y = "v"
v = "w**2*(K*u - y) - 2*zeta*w*v"
[data]
files = ["run.csv"]
sample_period = 0.001
inputs = ["u"]
outputs = ["y"]
[validation]
files = ["test.csv"]
""",
    truth={"K": 2.2, "w": 35.0, "zeta": 0.4},
)


def _loop(p: Parameters) -> Frames:
    count = 3000
    decay = np.exp(-1.0 / p["T"])
    frames = {}
    for name, seed in (("run.csv", 651), ("test.csv", 652)):
        wanted = levels(seed, [40.0, 50.0, 60.0, 70.0], 15, 200)
        opening, value = np.empty(count), np.empty(count)
        y, integral = 50.0, 35.0
        for step in range(count):
            # the controller holds its output for a second
            opening[step], value[step] = 1.5 * (wanted[step] - y) + integral, y
            integral += 0.06 * (wanted[step] - y)
            final = p["gain"] * (opening[step] - 30.0) + p["bias"]
            y = final + (y - final) * decay
        frames[name] = frame(1.0 * np.arange(count), U=opening, Y=value)
    return frames


# Gain, time constant and bias of a process under its controller, valve as logged.
# "ClosedLoopUnitIdentifier produces TimeConstant estimates that are sometimes way off" and
# "DefaultModelIdentifier has an issue with estimating the correct bias in some cases",
# equinor/TimeSeriesAnalysis #163 and #26
PROCESS_LOOP = Situation(
    name="process_loop",
    kind="closed loop",
    plant="process",
    source="github.com/equinor/TimeSeriesAnalysis/issues/163",
    parameters={"gain": 1.4, "T": 22.0, "bias": 41.0},
    simulate=_loop,
    noise={"Y": 0.1},
    config="""
[model]
inputs = ["U"]
outputs = ["Y"]
parameters = { gain = 1.0, T = 10.0, bias = 50.0 }
[model.derivatives]
Y = "(gain*(U - 30) + bias - Y)/T"
[data]
files = ["run.csv"]
time = "t"
inputs = ["U"]
outputs = ["Y"]
[validation]
files = ["test.csv"]
""",
    truth={"gain": 1.4, "T": 22.0, "bias": 41.0},
)

SITUATIONS = (
    BOTTLE,
    MEMBRANE,
    TANKS_WITH_GAPS,
    DUCT,
    NO_TIME,
    PROCESS_LOOP,
)
