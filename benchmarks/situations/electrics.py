"""Circuits, batteries, loudspeakers."""

import numpy as np

from benchmarks.situations.situation import (
    Frames,
    Parameters,
    Situation,
    frame,
    levels,
    solve,
)


def _series_circuit(p: Parameters) -> Frames:
    time = np.arange(5000) * 2e-6
    frames = {}
    for name, period in (("run.csv", 5e-3), ("test.csv", 4e-3)):
        volts = np.where((time % period) < period / 2, 5.0, -5.0)
        right = lambda _, x, u: [  # noqa: E731
            (u[0] - p["R"] * x[0] - 1e-3 * x[1]) / p["L"],
            1e3 * x[0] / p["C"],
        ]
        # the second state is in millivolts: both are then of the size of the current
        states = solve(right, [0.0, 0.0], time, volts, scale=1e-4)
        frames[name] = frame(time, V1=volts, I=states[:, 0])
    return frames


# Resistance and capacitance of a series circuit from an oscilloscope of eight bits.
# "How to get the values of components from a series RLC circuit with scope readings?",
# r/ElectricalEngineering, 1id4m22
RLC_SCOPE = Situation(
    name="rlc_scope",
    kind="coarse sensor",
    plant="circuit",
    source="reddit.com/r/ElectricalEngineering/comments/1id4m22",
    parameters={"R": 2500.0, "L": 1.0, "C": 2e-9},
    simulate=_series_circuit,
    noise={"I": 1e-6},
    step={"I": 4e-6},
    config="""
[model]
inputs = ["V1"]
outputs = ["I"]
parameters = { R = 1000.0, C = 1e-9 }
bounds = { R = [0.0, 1e6], C = [1e-12, 1e-6] }
[model.derivatives]
I = "(V1 - R*I - vc)/1.0"
vc = "I/C"
[model.initial]
vc = 0.0
[data]
files = ["run.csv"]
time = "t"
inputs = ["V1"]
outputs = ["I"]
[validation]
files = ["test.csv"]
""",
    command="refine",
    truth={"R": 2500.0, "C": 2e-9},
    fitted=("R", "C"),
)


def _network(p: Parameters) -> Frames:
    time = np.arange(1500) * 1e-6
    frames = {}
    for name, seed in (("run.csv", 311), ("test.csv", 312)):
        volts = levels(seed, [-1.0, 0.0, 1.0], 15, 100)
        right = lambda _, x, u: [((u[0] - x[0]) / 1e5 - x[0] / p["Rp"]) / p["Cp"]]  # noqa: E731
        frames[name] = frame(time, u=volts, v=solve(right, [0.0], time, volts)[:, 0])
    return frames


# A capacitance of 1e-10 F with a lower bound of zero.
# "Fitting fails when 'min=' attribute is included for one parameter", lmfit/lmfit-py #278
NETWORK_WITH_BOUND = Situation(
    name="network_with_bound",
    kind="very large or small values",
    plant="circuit",
    source="github.com/lmfit/lmfit-py/issues/278",
    parameters={"Rp": 6.8e5, "Cp": 150e-12},
    simulate=_network,
    noise={"v": 2e-3},
    config="""
[model]
inputs = ["u"]
outputs = ["v"]
parameters = { Rp = 1e6, Cp = 50e-12 }
bounds = { Rp = [0, 1e9], Cp = [0, 1] }
[model.derivatives]
v = "((u - v)/1e5 - v/Rp)/Cp"
[data]
files = ["run.csv"]
time = "t"
inputs = ["u"]
outputs = ["v"]
[validation]
files = ["test.csv"]
""",
    command="refine",
    truth={"Rp": 6.8e5, "Cp": 150e-12},
    held_out={"v": 1.2},
)


def _photodiode(p: Parameters) -> Frames:
    time = np.arange(2000) * 0.005
    frames = {}
    for name, seed in (("run.csv", 321), ("test.csv", 322)):
        light = levels(seed, [0.0, 0.25, 0.5, 1.0], 20, 100)
        right = lambda _, x, u: [  # noqa: E731
            (p["S"] * u[0] + p["dark"] - x[0] / p["Rf"]) / 25e-12
        ]
        frames[name] = frame(time, light=light, V=solve(right, [0.0], time, light)[:, 0])
    return frames


# Currents of nanoamperes over gigaohms: all parameters far from one.
# "Fit fails for small fitting parameters", JuliaNLSolvers/LsqFit.jl #178
NANOAMPERES = Situation(
    name="nanoamperes",
    kind="very large or small values",
    plant="circuit",
    source="github.com/JuliaNLSolvers/LsqFit.jl/issues/178",
    parameters={"S": 1.4e-9, "dark": 6e-11, "Rf": 2.2e9},
    simulate=_photodiode,
    noise={"V": 3e-3},
    config="""
[model]
inputs = ["light"]
outputs = ["V"]
parameters = { S = 1e-9, dark = 1e-11, Rf = 1e9 }
[model.derivatives]
V = "(S*light + dark - V/Rf)/25e-12"
[data]
files = ["run.csv"]
time = "t"
inputs = ["light"]
outputs = ["V"]
[validation]
files = ["test.csv"]
""",
    truth={"S": 1.4e-9, "dark": 6e-11, "Rf": 2.2e9},
    held_out={"V": 1.3},
)


def _cell(p: Parameters) -> Frames:
    time = np.arange(2400) * 1.0
    current = levels(331, [-1.0, 0.0, 1.0, 2.0, 3.0], 40, 60)
    right = lambda _, x, u: [-u[0] / 7920.0, (u[0] - x[1] / p["R1"]) / p["C1"]]  # noqa: E731
    soc, drop = solve(right, [p["soc0"], 0.0], time, current).T
    voltage = 3.3 + 0.6 * soc + 0.3 * soc**3 - p["R0"] * current - drop
    return {"run.csv": frame(time, current=current, voltage=voltage)}


# A cell whose state of charge at the start is not known.
# "Compute initial concentrations from initial OCV", pybop-team/PyBOP #424
CELL_START = Situation(
    name="cell_start",
    kind="unknown start",
    plant="battery",
    source="github.com/pybop-team/PyBOP/issues/424",
    parameters={"R0": 0.025, "R1": 0.018, "C1": 1800.0, "soc0": 0.72},
    simulate=_cell,
    noise={"voltage": 1e-3},
    config="""
[model]
inputs = ["current"]
outputs = ["voltage"]
parameters = { R0 = 0.05, R1 = 0.05, C1 = 1000.0, soc0 = 0.5 }
bounds = { R0 = [0, 1], R1 = [0, 1], C1 = [1, 1e5], soc0 = [0, 1] }
[model.derivatives]
soc = "-current/7920"
v1 = "(current - v1/R1)/C1"
[model.output]
voltage = "3.3 + 0.6*soc + 0.3*soc**3 - R0*current - v1"
[model.initial]
soc = "soc0"
v1 = 0.0
[data]
files = ["run.csv"]
time = "t"
inputs = ["current"]
outputs = ["voltage"]
""",
    truth={"R0": 0.025, "R1": 0.018, "C1": 1800.0, "soc0": 0.72},
)


def _two_pairs(p: Parameters) -> Frames:
    time = np.arange(3600) * 1.0
    frames = {}
    for name, seed in (("run.csv", 341), ("test.csv", 342)):
        current = np.repeat(np.random.default_rng(seed).choice([0.0, 0.0, 2.0, 4.0], 12), 300)
        right = lambda _, x, u: [  # noqa: E731
            (u[0] - x[0] / p["R1"]) / p["C1"],
            (u[0] - x[1] / p["R2"]) / p["C2"],
            -u[0] / 18000.0,
        ]
        states = solve(right, [0.0, 0.0, 0.95], time, current)
        voltage = 3.5 + 0.65 * states[:, 2] - p["R0"] * current - states[:, 0] - states[:, 1]
        frames[name] = frame(time, I=current, V=voltage)
    return frames


# Two pairs of R and C, 4 s and 150 s, from pulses.
# "Estimating Battery Parameters Using Curve Fitting", MATLAB Answers
TWO_PAIRS = Situation(
    name="two_pairs",
    kind="algebraic output",
    plant="battery",
    source="MATLAB Answers, Estimating Battery Parameters Using Curve Fitting",
    parameters={"R0": 0.02, "R1": 0.012, "C1": 350.0, "R2": 0.02, "C2": 7500.0},
    simulate=_two_pairs,
    noise={"V": 5e-4},
    config="""
[model]
inputs = ["I"]
outputs = ["V"]
parameters = { R0 = 0.01, R1 = 0.01, C1 = 1000.0, R2 = 0.01, C2 = 10000.0 }
bounds = { R0 = [0, 1], R1 = [0, 1], C1 = [1, 1e6], R2 = [0, 1], C2 = [1, 1e6] }
[model.derivatives]
v1 = "(I - v1/R1)/C1"
v2 = "(I - v2/R2)/C2"
soc = "-I/18000"
[model.output]
V = "3.5 + 0.65*soc - R0*I - v1 - v2"
[model.initial]
v1 = 0.0
v2 = 0.0
soc = 0.95
[data]
files = ["run.csv"]
time = "t"
inputs = ["I"]
outputs = ["V"]
[validation]
files = ["test.csv"]
""",
    command="refine",
    truth={"R0": 0.02, "R1": 0.012, "C1": 350.0, "R2": 0.02, "C2": 7500.0},
)


def _loudspeaker(p: Parameters) -> Frames:
    rate = 48_000
    time = np.arange(4 * rate) / rate
    frames = {}
    for name, seed in (("run.csv", 351), ("test.csv", 352)):
        rng = np.random.default_rng(seed)
        omega = 2 * np.pi * rng.uniform(20.0, 300.0, 12)
        # long after the start: each sine has its own answer
        mechanical = p["Kms"] + 1j * omega * p["Rms"] - omega**2 * p["Mms"]
        electrical = p["Re"] + 1j * omega * p["Le"] + 1j * omega * p["Bl"] ** 2 / mechanical
        voltage = 0.5 * np.exp(2j * np.pi * rng.random(12))
        current = voltage / electrical
        displacement = p["Bl"] * current / mechanical
        waves = np.exp(1j * np.multiply.outer(time, omega))
        voltage, current, displacement = (
            (waves @ part).imag for part in (voltage, current, 1e3 * displacement)
        )
        frames[name] = frame(time, V=voltage, i=current, x=displacement)
    return frames


# A loudspeaker: voltage, current, displacement by laser in millimetres; 192 000 samples.
# "Update mataa_impedance_fit_speaker.m line 138" (a fit that gives Qms = 0), mbrennwa/mataa #8
LOUDSPEAKER = Situation(
    name="loudspeaker",
    kind="long record",
    plant="loudspeaker",
    source="github.com/mbrennwa/mataa/issues/8",
    parameters={"Re": 6.2, "Le": 4.5e-4, "Bl": 7.1, "Rms": 1.3, "Kms": 2100.0, "Mms": 0.0165},
    simulate=_loudspeaker,
    noise={"i": 2e-3, "x": 2e-3},
    config="""
[model]
inputs = ["V"]
outputs = ["i", "x"]
parameters = { Re = 4.0, Le = 1e-3, Bl = 5.0, Rms = 1.0, Kms = 1000.0, Mms = 0.01 }
[model.units]
x = "mm"
[model.derivatives]
i = "(V - Re*i - Bl*v/1000)/Le"
x = "v"
v = "(1000*Bl*i - Rms*v - Kms*x)/Mms"
[data]
files = ["run.csv"]
time = "t"
inputs = ["V"]
outputs = ["i", "x"]
[validation]
files = ["test.csv"]
""",
    truth={"Re": 6.2, "Le": 4.5e-4, "Bl": 7.1, "Rms": 1.3, "Kms": 2100.0, "Mms": 0.0165},
    seconds=120.0,
    reason="two minutes: 192 000 samples of two outputs",
)


def _voice_coil(p: Parameters) -> Frames:
    time = np.arange(2400) * 0.5
    frames = {}
    for name, seed in (("run.csv", 361), ("test.csv", 362)):
        power = levels(seed, [0.0, 2.0, 5.0, 10.0], 30, 80)
        right = lambda _, x, u: [  # noqa: E731
            (u[0] - (x[0] - x[1]) / p["Rc"]) / p["Cc"],
            ((x[0] - x[1]) / p["Rc"] - (x[1] - 25.0) / p["Rm"]) / p["Cm"],
        ]
        states = solve(right, [25.0, 25.0], time, power)
        frames[name] = frame(time, P=power, coil=states[:, 0])
    return frames


# The coil's temperature is known from its resistance, the magnet's is not measured.
# "Speaker protection research", AsahiLinux/linux #53
VOICE_COIL = Situation(
    name="voice_coil",
    kind="hidden state",
    plant="loudspeaker",
    source="github.com/AsahiLinux/linux/issues/53",
    parameters={"Rc": 6.0, "Cc": 0.65, "Rm": 9.0, "Cm": 7.8},
    simulate=_voice_coil,
    noise={"coil": 0.3},
    config="""
[model]
inputs = ["P"]
outputs = ["coil"]
parameters = { Rc = 3.0, Cc = 1.0, Rm = 5.0, Cm = 15.0 }
bounds = { Rc = [0, 100], Cc = [0.01, 100], Rm = [0, 100], Cm = [0.1, 1000] }
[model.units]
coil = "°C"
[model.derivatives]
coil = "(P - (coil - magnet)/Rc)/Cc"
magnet = "((coil - magnet)/Rc - (magnet - 25)/Rm)/Cm"
[model.initial]
magnet = 25.0
[data]
files = ["run.csv"]
time = "t"
inputs = ["P"]
outputs = ["coil"]
[validation]
files = ["test.csv"]
""",
    command="refine",
    truth={"Rc": 6.0, "Cc": 0.65, "Rm": 9.0, "Cm": 7.8},
    held_out={"coil": 1.3},
)

SITUATIONS = (
    RLC_SCOPE,
    NETWORK_WITH_BOUND,
    NANOAMPERES,
    CELL_START,
    TWO_PAIRS,
    LOUDSPEAKER,
    VOICE_COIL,
)
