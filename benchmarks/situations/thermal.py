"""Heaters, houses, cooling bodies."""

import numpy as np
import pandas as pd

from benchmarks.situations.situation import (
    Frames,
    Parameters,
    Situation,
    dated,
    frame,
    levels,
    sines,
    solve,
)


def _heater(p: Parameters) -> Frames:
    time = np.arange(2400) * 1.0
    frames = {}
    for name, seed in (("run.csv", 411), ("test.csv", 412)):
        duty = levels(seed, [0, 20, 40, 60, 80], 12, 200)
        # the delay is made exactly: the staircase starts later
        edges = np.flatnonzero(np.diff(duty)) + 1
        starts = np.concatenate([[0.0], time[edges] + p["theta"]])
        heights = np.concatenate([[duty[0]], duty[edges]])
        temperature = np.full(len(time), 22.0 + p["K"] * duty[0])
        last = temperature[0]
        for start, stop, height in zip(starts, [*starts[1:], np.inf], heights, strict=True):
            inside = (time >= start) & (time < stop)
            final = 22.0 + p["K"] * height
            temperature[inside] = final + (last - final) * np.exp(
                -(time[inside] - start) / p["tau"]
            )
            last = final + (last - final) * np.exp(-(min(stop, 1e9) - start) / p["tau"])
        frames[name] = frame(time, Q1=duty, T1=temperature)
    return frames


# First order plus dead time from a heater board.
# "How to estimate theta value in FOPDT equation using gekko?",
# stackoverflow.com/questions/64447427
DEAD_TIME = Situation(
    name="dead_time",
    kind="delay",
    plant="heater",
    source="stackoverflow.com/questions/64447427",
    parameters={"K": 0.62, "tau": 150.0, "theta": 16.4},
    simulate=_heater,
    noise={"T1": 0.15},
    step={"T1": 0.1},
    config="""
[model]
inputs = ["Q1"]
outputs = ["T1"]
parameters = { K = 1.0, tau = 100.0, theta = 5.0 }
bounds = { K = [0.0, 5.0], tau = [1.0, 1000.0], theta = [0.0, 60.0] }
input_delay = { Q1 = "theta" }
[model.derivatives]
T1 = "(K*Q1 - (T1 - 22))/tau"
[data]
files = ["run.csv"]
time = "t"
inputs = ["Q1"]
outputs = ["T1"]
[validation]
files = ["test.csv"]
""",
    command="refine",
    truth={"K": 0.62, "tau": 150.0, "theta": 16.4},
    held_out={"T1": 1.3},
)


def _weather(seed: int):
    slow = sines(seed, 0.02, 0.12, 4, 1.5)
    return lambda t: 6.0 + 4.0 * np.sin(2 * np.pi * (np.asarray(t) - 9.0) / 24.0) + slow(t)


def _house(p: Parameters) -> Frames:
    time = np.arange(0, 24 * 8, 0.25)  # hours
    frames = {}
    for name, seed in (("run.csv", 421), ("test.csv", 422)):
        outdoor = _weather(seed)(time)
        heat = levels(seed, [0.0, 2.0, 4.0, 6.0], 64, 12)
        at = lambda t, table=outdoor: np.interp(t, time, table)  # noqa: E731
        right = lambda t, x, u, at=at: [((at(t) - x[0]) / p["R"] + u[0]) / p["C"]]  # noqa: E731
        indoor = solve(right, [19.0], time, heat)[:, 0]
        frames[name] = frame(3600 * time, outdoor=outdoor, heat=heat, indoor=indoor)
    return frames


def _irregular(_: str, table: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    """A row when the heating changes, else now and then; once nothing for nine hours."""
    rows = (rng.random(len(table)) > 0.4) | (table["heat"].diff().to_numpy() != 0)
    rows[400:436] = False
    rows[[0, -1]] = True
    return table.loc[rows]


# A house that reports irregularly, with hours missing.
# "House temperature modeling example", baggepinnen/LowLevelParticleFilters.jl #211
HOUSE = Situation(
    name="house",
    kind="irregular sampling",
    plant="building",
    source="github.com/baggepinnen/LowLevelParticleFilters.jl/issues/211",
    parameters={"R": 5.5, "C": 9.0},
    simulate=_house,
    noise={"indoor": 0.05},
    spoil=_irregular,
    config="""
[model]
inputs = ["outdoor", "heat"]
outputs = ["indoor"]
parameters = { R = 3.0, C = 5.0 }
bounds = { R = [0.01, 100.0], C = [0.01, 1000.0] }
[model.derivatives]
indoor = "((outdoor - indoor)/R + heat)/C/3600"
[data]
files = ["run.csv"]
time = "t"
inputs = ["outdoor", "heat"]
outputs = ["indoor"]
[validation]
files = ["test.csv"]
""",
    command="refine",
    truth={"R": 5.5, "C": 9.0},
    reason="R in K/kW, C in kWh/K",
)


def _radiators(p: Parameters) -> Frames:
    time = np.arange(0, 24 * 10, 0.25)
    frames = {}
    for name, seed in (("run.csv", 431), ("test.csv", 432)):
        outdoor = _weather(seed)(time)
        power = levels(seed, [0.0, 3.0, 6.0], 160, 6)
        at = lambda t, table=outdoor: np.interp(t, time, table)  # noqa: E731

        def right(t, x, u, at=at):
            flow = (x[1] - x[0]) / p["Rih"]
            return [(flow + (at(t) - x[0]) / p["Ria"]) / p["Ci"], (u[0] - flow) / p["Ch"]]

        states = solve(right, [20.0, 24.0], time, power)
        frames[name] = frame(3600 * time, Ta=outdoor, Ph=power, Ti=states[:, 0])
    return frames


# The heating system's capacity and resistance, with its temperature not measured.
# "RC params for the heating system", czagoni/darkgreybox #41
HEATING_SYSTEM = Situation(
    name="heating_system",
    kind="hidden state",
    plant="building",
    source="github.com/czagoni/darkgreybox/issues/41",
    parameters={"Ria": 5.0, "Ci": 5.0, "Rih": 0.9, "Ch": 1.3},
    simulate=_radiators,
    noise={"Ti": 0.03},
    config="""
[model]
inputs = ["Ta", "Ph"]
outputs = ["Ti"]
parameters = { Ria = 10.0, Ci = 2.0, Rih = 0.5, Ch = 0.5 }
bounds = { Ria = [0.01, 100], Ci = [0.01, 100], Rih = [0.01, 100], Ch = [0.01, 100] }
[model.derivatives]
Ti = "((Th - Ti)/Rih + (Ta - Ti)/Ria)/Ci/3600"
Th = "(Ph - (Th - Ti)/Rih)/Ch/3600"
[model.initial]
Th = 24.0
[data]
files = ["run.csv"]
time = "t"
inputs = ["Ta", "Ph"]
outputs = ["Ti"]
[validation]
files = ["test.csv"]
""",
    command="refine",
    truth={"Ria": 5.0, "Ci": 5.0, "Rih": 0.9, "Ch": 1.3},
)


def _envelope(p: Parameters) -> Frames:
    time = np.arange(0, 24 * 6, 0.25)
    outdoor = _weather(441)(time)
    power = levels(441, [0.0, 1.5, 3.0], 72, 8)

    def right(t, x, u):
        flow = (x[1] - x[0]) / p["Rie"]
        outside = (np.interp(t, time, outdoor) - x[1]) / p["Rea"]
        return [(flow + u[0]) / p["Ci"], (outside - flow) / p["Ce"]]

    indoor = solve(right, [20.0, p["Te0"]], time, power)[:, 0]
    return {"run.csv": frame(3600 * time, Ta=outdoor, Ph=power, Ti=indoor)}


# The envelope's temperature at the start is a parameter, and comes out absurd.
# "Abnormal value on Te Measured", czagoni/darkgreybox #29
ENVELOPE_START = Situation(
    name="envelope_start",
    kind="unknown start",
    plant="building",
    source="github.com/czagoni/darkgreybox/issues/29",
    parameters={"Ci": 1.6, "Rie": 1.3, "Ce": 9.0, "Rea": 4.5, "Te0": 11.0},
    simulate=_envelope,
    noise={"Ti": 0.03},
    config="""
[model]
inputs = ["Ta", "Ph"]
outputs = ["Ti"]
parameters = { Ci = 3.0, Rie = 2.0, Ce = 5.0, Rea = 3.0, Te0 = 18.0 }
bounds = { Ci = [0, 100], Rie = [0, 100], Ce = [0, 100], Rea = [0, 100], Te0 = [-20, 40] }
[model.derivatives]
Ti = "((Te - Ti)/Rie + Ph)/Ci/3600"
Te = "((Ta - Te)/Rea - (Te - Ti)/Rie)/Ce/3600"
[model.initial]
Te = "Te0"
[data]
files = ["run.csv"]
time = "t"
inputs = ["Ta", "Ph"]
outputs = ["Ti"]
""",
    command="refine",
    truth={"Ci": 1.6, "Rie": 1.3, "Ce": 9.0, "Rea": 4.5, "Te0": 11.0},
)


def _hot_steel(p: Parameters) -> Frames:
    frames = {}
    for name, start in (("run.csv", 620.0), ("run2.csv", 430.0), ("test.csv", 540.0)):
        time = np.arange(0, 1500, 2.0)

        def right(_, x, u):
            radiation = p["e"] * 1e-11 * ((x[0] + 273.15) ** 4 - 295.15**4)
            return [-p["k"] * (x[0] - 22.0) - radiation]

        frames[name] = frame(time, temp=solve(right, [start], time)[:, 0])
    return frames


# Steel cools from 600 °C, and an exponential does not fit.
# "Newton's Cooling Law and Least Squares Fit" (scipy.optimize.leastsq beside a spreadsheet)
HOT_STEEL = Situation(
    name="hot_steel",
    kind="effect not declared",
    plant="cooling body",
    source="Newton's Cooling Law and Least Squares Fit, question on scipy.optimize.leastsq",
    parameters={"k": 8e-4, "e": 0.38},
    simulate=_hot_steel,
    noise={"temp": 0.5},
    config="""
[model]
outputs = ["temp"]
parameters = { k = 0.002 }
[model.units]
temp = "°C"
[model.derivatives]
temp = "-k*(temp - 22)"
[data]
files = ["run.csv", "run2.csv"]
time = "t"
inputs = []
outputs = ["temp"]
[validation]
files = ["test.csv"]
""",
    command="discover",
    effects=(("radiation",),),  # named power_loss before there was one in the library
    held_out={"temp": 3.0},
)


def _tea(p: Parameters) -> Frames:
    frames = {}
    for name, start in (("run.csv", 83.0), ("test.csv", 71.0)):
        time = np.arange(0, 3600, 10.0)
        excess = (start - p["Ts"]) * np.exp(-p["alpha"] * time)
        frames[name] = frame(time, T=p["Ts"] + excess)
    return frames


# The room's temperature is not known, the thermometer shows half degrees.
# "Fitting curve for Newton's cooling law data programatically?", math.stackexchange.com
TEA = Situation(
    name="tea",
    kind="free decay",
    plant="cooling body",
    source="math.stackexchange.com, Fitting curve for Newton's cooling law data programatically",
    parameters={"alpha": 9.5e-4, "Ts": 21.5},
    simulate=_tea,
    noise={"T": 0.1},
    step={"T": 0.5},
    config="""
[model]
outputs = ["T"]
parameters = { alpha = 0.005, Ts = 10.0 }
[model.units]
T = "°C"
[model.derivatives]
T = "-alpha*(T - Ts)"
[data]
files = ["run.csv"]
time = "t"
inputs = []
outputs = ["T"]
[validation]
files = ["test.csv"]
""",
    truth={"alpha": 9.5e-4, "Ts": 21.5},
    held_out={"T": 1.4},
)


def _boiler(p: Parameters) -> Frames:
    time = np.arange(4800) * 0.5
    frames = {}
    for name, seed in (("run.csv", 461), ("test.csv", 462)):
        power = levels(seed, [0.0, 150.0, 300.0, 600.0, 900.0], 40, 120)
        right = lambda _, x, u: [  # noqa: E731
            (x[1] - p["UA"] * (x[0] - 25.0)) / p["C"],
            (u[0] - x[1]) / p["lag"],
        ]
        states = solve(right, [25.0, 0.0], time, power)
        frames[name] = frame(time, W=power, boiler=states[:, 0])
    return frames


# Espresso boiler: heating and loss are declared, the element's own lag is not.
# "SIMC integrator+lag rule + exp-peeling", fixes #672, jniebuhr/gaggimate #683
BOILER_LAG = Situation(
    name="boiler_lag",
    kind="effect not declared",
    plant="heater",
    source="github.com/jniebuhr/gaggimate/pull/683",
    parameters={"C": 1900.0, "UA": 3.2, "lag": 9.0},
    simulate=_boiler,
    noise={"boiler": 0.05},
    config="""
[model]
inputs = ["W"]
outputs = ["boiler"]
parameters = { C = 1000.0, UA = 1.0 }
[model.units]
boiler = "°C"
W = "W"
[model.derivatives]
boiler = "(W - UA*(boiler - 25))/C"
[data]
files = ["run.csv"]
time = "t"
inputs = ["W"]
outputs = ["boiler"]
[validation]
files = ["test.csv"]
""",
    command="discover",
    truth={"C": 1900.0, "UA": 3.2},
    effects=(("actuator_lag", "sensor_lag"),),
    held_out={"boiler": 1.5},
)


def _kept_warm(p: Parameters, room: np.ndarray, relay: np.ndarray | float) -> np.ndarray:
    """Temperature every 20 s: from a relay's record, or with a relay about this set point."""
    temperature, decay, on = [24.0], np.exp(-20.0 / p["tau"]), True
    for step, outside in enumerate(room[:-1]):
        if isinstance(relay, np.ndarray):
            power = relay[step]
        else:
            on = temperature[-1] < relay + (0.8 if on else -0.8)
            power = 100.0 * on
        final = outside + p["K"] * power
        temperature.append(final + (temperature[-1] - final) * decay)
    return np.array(temperature)


def _relay(temperature: np.ndarray, goal: float) -> np.ndarray:
    """What the relay did [%]."""
    states, on = [], True
    for value in temperature:
        on = value < goal + (0.8 if on else -0.8)
        states.append(100.0 * on)
    return np.array(states)


_FERMENTER = {"K": 0.42, "tau": 2700.0}


def _brewing(p: Parameters) -> Frames:
    time = np.arange(1080) * 20.0
    frames = {}
    for name, seed, goal in (("run.csv", 471, 35.0), ("test.csv", 472, 40.0)):
        room = 20.0 + levels(seed, [-3, -1, 1, 3], 18, 60)
        relay = _relay(_kept_warm(_FERMENTER, room, goal), goal)
        frames[name] = frame(time, room=room, relay=relay, temp=_kept_warm(p, room, relay))
    return frames


# A relay keeps a fermenter warm; the log has dates.
# "PID Autotune", kizniche/Mycodo #508
FERMENTER_DATES = Situation(
    name="fermenter_dates",
    kind="time format",
    plant="heater",
    source="github.com/kizniche/Mycodo/issues/508",
    parameters=_FERMENTER,
    simulate=_brewing,
    noise={"temp": 0.04},
    step={"temp": 0.01},
    write=dated("2018-08-04T00:10:39", "date", " "),
    config="""
[model]
inputs = ["room", "relay"]
outputs = ["temp"]
parameters = { K = 1.0, tau = 1000.0 }
[model.derivatives]
temp = "(room + K*relay - temp)/tau"
[data]
files = ["run.csv"]
time = "date"
inputs = ["room", "relay"]
outputs = ["temp"]
[validation]
files = ["test.csv"]
""",
    truth={"K": 0.42, "tau": 2700.0},
    held_out={"temp": 1.5},
)


def _plateau(p: Parameters) -> Frames:
    time = np.arange(180) * 60.0
    outdoor = 66.0 + 0.3 * np.sin(time / 4000.0)
    return {"run.csv": frame(time, outdoor=outdoor, indoor=np.full(len(time), p["level"]))}


# After heating the thermostat shows exactly 70 °F for hours: nothing can be learnt from that.
# "Thermal model rejects valid observations when post-heat temperature plateaus",
# gunkl/ClimateAdvisor #118
PLATEAU = Situation(
    name="plateau",
    kind="no information",
    plant="building",
    source="github.com/gunkl/ClimateAdvisor/issues/118",
    parameters={"level": 70.0},
    simulate=_plateau,
    noise={"indoor": 0.05},
    step={"indoor": 1.0},
    config="""
[model]
inputs = ["outdoor"]
outputs = ["indoor"]
parameters = { k = 1e-4 }
bounds = { k = [0.0, 1.0] }
[model.units]
indoor = "°F"
[model.derivatives]
indoor = "-k*(indoor - outdoor)"
[data]
files = ["run.csv"]
time = "t"
inputs = ["outdoor"]
outputs = ["indoor"]
""",
    refusal=("indoor", "constant"),
    reason="k = 0 fits, and is no answer: the message names the output that is constant",
)

SITUATIONS = (
    DEAD_TIME,
    HOUSE,
    HEATING_SYSTEM,
    ENVELOPE_START,
    HOT_STEEL,
    TEA,
    BOILER_LAG,
    FERMENTER_DATES,
    PLATEAU,
)
