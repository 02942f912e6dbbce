"""Cars, drones, vessels: situations of people with a log."""

import numpy as np
import pandas as pd

from benchmarks.situations.situation import (
    Frames,
    Parameters,
    Situation,
    frame,
    levels,
    sines,
    solve,
)

KMH = 3.6


def _two_ways(p: Parameters) -> Frames:
    frames = {}
    for index, (name, way) in enumerate(
        (
            ("north1.csv", 1),
            ("south1.csv", -1),
            ("north2.csv", 1),
            ("south2.csv", -1),
            ("test.csv", 1),
        )
    ):
        time = np.arange(0, 70 + 4 * index, 0.5)
        drag = lambda _, x, u, way=way: [  # noqa: E731
            -(p["F0"] + p["C"] * (x[0] + way * p["wind"]) ** 2) / 1150.0
        ]
        speed = solve(drag, [28.0 - 0.7 * index], time)[:, 0]
        frames[name] = frame(time, way=np.full(len(time), way), speed=KMH * speed)
    return frames


# Coast-down in both directions, with a wind that nobody measured: a column that is constant in
# each file.
# "Coastdown", thread with a tail wind, ecomodder.com/forum/106105-post14.html
TWO_WAY_COASTDOWN = Situation(
    name="two_way_coastdown",
    kind="input constant in a file",
    plant="car",
    source="ecomodder.com/forum/106105-post14.html",
    parameters={"F0": 130.0, "C": 0.40, "wind": 2.2},
    simulate=_two_ways,
    noise={"speed": 0.15},
    step={"speed": 0.1},
    config="""
[model]
inputs = ["way"]
outputs = ["speed"]
parameters = { F0 = 100.0, C = 0.3, wind = 0.5 }
[model.units]
speed = "km/h"
[model.derivatives]
speed = "-3.6*(F0 + C*(speed/3.6 + way*wind)**2)/1150"
[data]
files = ["north1.csv", "south1.csv", "north2.csv", "south2.csv"]
time = "t"
inputs = ["way"]
outputs = ["speed"]
[validation]
files = ["test.csv"]
""",
    command="refine",
    truth={"F0": 130.0, "C": 0.40, "wind": 2.2},
    held_out={"speed": 1.4},
)


def _road_load(p: Parameters) -> Frames:
    frames = {}
    for name, seed in (("run1.csv", 211), ("run2.csv", 212), ("test.csv", 213)):
        time = np.arange(600) * 0.5
        force = levels(seed, [0, 300, 900, 1600, 2200], 15, 40)
        resist = lambda _, x, u: [  # noqa: E731
            (u[0] - p["A"] - p["B"] * x[0] - p["C"] * x[0] ** 2) / 1500.0
        ]
        frames[name] = frame(time, force=force, v=solve(resist, [15.0], time, force)[:, 0])
    return frames


# Road load with and without drive; the model has no drag, the speed never reverses.
# "Coastdown procedure to extract road loads", eng-tips.com/viewthread.cfm?qid=129390
ROAD_LOAD = Situation(
    name="road_load",
    kind="speed never reverses",
    plant="car",
    source="eng-tips.com/viewthread.cfm?qid=129390",
    parameters={"A": 150.0, "B": 4.0, "C": 0.45},
    simulate=_road_load,
    noise={"v": 0.02},
    config="""
[model]
inputs = ["force"]
outputs = ["v"]
parameters = { A = 100.0, B = 10.0 }
[model.units]
v = "m/s"
force = "N"
[model.derivatives]
v = "(force - A - B*v)/1500"
[data]
files = ["run1.csv", "run2.csv"]
time = "t"
inputs = ["force"]
outputs = ["v"]
[validation]
files = ["test.csv"]
""",
    command="discover",
    effects=(("quadratic_drag",),),
    held_out={"v": 1.5},
)


def _steering(p: Parameters) -> Frames:
    time = np.arange(6000) * 0.01
    frames = {}
    for name, seed in (("run.csv", 221), ("test.csv", 222)):
        command = sines(seed, 0.5, 9.0, 8, 3.0)
        states = solve(
            lambda t, x, u, command=command: [
                (p["gain"] * command(t - p["delay"]) - x[0]) / p["tau"]
            ],
            [0.0],
            time,
            lambda _: 0.0,
        )
        frames[name] = frame(time, cmd=command(time), angle=states[:, 0])
    return frames


# Steering actuator whose delay is no whole number of samples.
# "Tune steer actuator delay for TSS1 Corolla", commaai/openpilot #2250
STEERING_DELAY = Situation(
    name="steering_delay",
    kind="delay",
    plant="car",
    source="github.com/commaai/openpilot/pull/2250",
    parameters={"gain": 0.93, "tau": 0.18, "delay": 0.123},
    simulate=_steering,
    noise={"angle": 0.05},
    config="""
[model]
inputs = ["cmd"]
outputs = ["angle"]
parameters = { gain = 1.0, tau = 0.1, delay = 0.05 }
bounds = { tau = [0.001, 5.0], delay = [0.0, 1.0] }
input_delay = { cmd = "delay" }
[model.derivatives]
angle = "(gain*cmd - angle)/tau"
[data]
files = ["run.csv"]
time = "t"
inputs = ["cmd"]
outputs = ["angle"]
[validation]
files = ["test.csv"]
""",
    command="refine",
    truth={"gain": 0.93, "tau": 0.18, "delay": 0.123},
    held_out={"angle": 1.2},
)


def _bicycle(p: Parameters) -> Frames:
    time = np.arange(4000) * 0.01
    frames = {}
    for name, seed in (("run.csv", 231), ("test.csv", 232)):
        steer = sines(seed, 0.4, 8.0, 6, 0.006)
        speed = 18.0 + sines(seed + 5, 0.05, 0.3, 3, 2.0)(time)
        speed_at = lambda t, table=speed: np.interp(t, time, table)  # noqa: E731

        def right(t, x, u, steer=steer, speed_at=speed_at):
            v = speed_at(t)
            front = p["Cf"] * (steer(t) - (x[0] + 1.2 * x[1]) / v)
            rear = p["Cr"] * (-(x[0] - 1.5 * x[1]) / v)
            return [(front + rear) / 1700.0 - v * x[1], (1.2 * front - 1.5 * rear) / 2600.0]

        states = solve(right, [0.0, 0.0], time, lambda _: 0.0)
        frames[name] = frame(time, steer=steer(time), v=speed, vy=states[:, 0], yaw=states[:, 1])
    return frames


# Cornering stiffness of a car, 1e5 N/rad, from yaw rate and lateral speed at changing speed.
# "question about dynamic models used in LQR controller", ApolloAuto/apollo #2841
CORNERING = Situation(
    name="cornering",
    kind="very large or small values",
    plant="car",
    source="github.com/ApolloAuto/apollo/issues/2841",
    parameters={"Cf": 82e3, "Cr": 121e3},
    simulate=_bicycle,
    noise={"vy": 0.02, "yaw": 0.003},
    config="""
[model]
inputs = ["steer", "v"]
outputs = ["vy", "yaw"]
parameters = { Cf = 1.5e5, Cr = 1.5e5 }
[model.definitions]
front = "Cf*(steer - (vy + 1.2*yaw)/v)"
rear = "-Cr*(vy - 1.5*yaw)/v"
[model.derivatives]
vy = "(front + rear)/1700 - v*yaw"
yaw = "(1.2*front - 1.5*rear)/2600"
[data]
files = ["run.csv"]
time = "t"
inputs = ["steer", "v"]
outputs = ["vy", "yaw"]
[validation]
files = ["test.csv"]
""",
    truth={"Cf": 82e3, "Cr": 121e3},
)


def _attitude(p: Parameters) -> Frames:
    time = np.arange(2500) * 0.02
    frames = {}
    for name, seed in (("run.csv", 241), ("test.csv", 242)):
        wanted = levels(seed, [-0.3, -0.15, 0.0, 0.15, 0.3], 50, 50)
        states = solve(lambda _, x, u: [(p["K"] * u[0] - x[0]) / p["tau"]], [0.0], time, wanted)
        frames[name] = frame(time, roll_ref=wanted, roll=states[:, 0])
    return frames


# Set points of a quadrotor's inner loop and what the attitude does.
# "how to get the parameters of px4", HKPolyU-UAV/airo_control_interface #1
INNER_LOOP = Situation(
    name="inner_loop",
    kind="set points as inputs",
    plant="drone",
    source="github.com/HKPolyU-UAV/airo_control_interface/issues/1",
    parameters={"tau": 0.14, "K": 1.04},
    simulate=_attitude,
    noise={"roll": 2e-3},
    config="""
[model]
inputs = ["roll_ref"]
outputs = ["roll"]
parameters = { tau = 0.3, K = 1.0 }
[model.derivatives]
roll = "(K*roll_ref - roll)/tau"
[data]
files = ["run.csv"]
time = "t"
inputs = ["roll_ref"]
outputs = ["roll"]
[validation]
files = ["test.csv"]
""",
    truth={"tau": 0.14, "K": 1.04},
    held_out={"roll": 1.3},
)


def _tricopter(p: Parameters) -> Frames:
    time = np.arange(3000) * 0.01
    frames = {}
    for name, seed in (("run.csv", 251), ("test.csv", 252)):
        wanted = sines(seed, 0.5, 5.0, 5, 0.1)

        def moment(t, x, wanted=wanted):
            return 0.5 * (wanted(t) - x[0]) - 0.08 * x[1]

        def right(t, x, u):
            return [x[1], (p["k"] * moment(t, x) - p["d"] * x[1])]

        states = solve(right, [0.0, 0.0], time, lambda _: 0.0)
        control = np.array([moment(t, x) for t, x in zip(time, states, strict=True)])
        frames[name] = frame(time, ctrl=control, phi=states[:, 0], p=states[:, 1])
    return frames


def _at_two_rates(_: str, table: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    """The attitude at every fifth row, and 0.6 s of the log lost, twice."""
    table.loc[table.index % 5 != 2, "phi"] = np.nan
    for start in (700, 1900):
        table.loc[start : start + 60, ["ctrl", "phi", "p"]] = np.nan
    return table


# A tricopter's log: rates and angles at different rates, and the log stops twice.
# "System Identification using the log data", dronecrew/px4tools #19
TRICOPTER_LOG = Situation(
    name="tricopter_log",
    kind="several rates",
    plant="drone",
    source="github.com/dronecrew/px4tools/issues/19",
    parameters={"k": 42.0, "d": 1.6},
    simulate=_tricopter,
    noise={"phi": 2e-3, "p": 0.01},
    spoil=_at_two_rates,
    config="""
[model]
inputs = ["ctrl"]
outputs = ["phi", "p"]
parameters = { k = 20.0, d = 1.0 }
[model.derivatives]
phi = "p"
p = "k*ctrl - d*p"
[data]
files = ["run.csv"]
time = "t"
inputs = ["ctrl"]
outputs = ["phi", "p"]
[validation]
files = ["test.csv"]
""",
    truth={"k": 42.0, "d": 1.6},
)


def _submarine(p: Parameters) -> Frames:
    time = np.arange(1800) * 0.2
    frames = {}
    for name, seed in (("run.csv", 261), ("test.csv", 262)):
        thrust = levels(seed, [-60, -35, -15, 0, 15, 35, 60], 36, 50)
        right = lambda _, x, u: [  # noqa: E731
            (u[0] - p["d"] * x[0] - p["q"] * abs(x[0]) * x[0]) / p["M"]
        ]
        frames[name] = frame(time, thrust=thrust, surge=solve(right, [0.0], time, thrust)[:, 0])
    return frames


# Drag of an underwater vehicle, declared linear; mass with the added mass of the water.
# "Model SubjuGator's drag", uf-mil/SubjuGator #391
SUBMARINE = Situation(
    name="submarine",
    kind="effect not declared",
    plant="vessel",
    source="github.com/uf-mil/SubjuGator/issues/391",
    parameters={"M": 85.0, "d": 9.0, "q": 38.0},
    simulate=_submarine,
    noise={"surge": 6e-3},
    config="""
[model]
inputs = ["thrust"]
outputs = ["surge"]
parameters = { M = 60.0, d = 20.0 }
[model.units]
surge = "m/s"
thrust = "N"
[model.derivatives]
surge = "(thrust - d*surge)/M"
[data]
files = ["run.csv"]
time = "t"
inputs = ["thrust"]
outputs = ["surge"]
[validation]
files = ["test.csv"]
""",
    command="discover",
    truth={"M": 85.0},
    effects=(("quadratic_drag",),),
    held_out={"surge": 1.5},
)

SITUATIONS = (
    TWO_WAY_COASTDOWN,
    ROAD_LOAD,
    STEERING_DELAY,
    CORNERING,
    INNER_LOOP,
    TRICOPTER_LOG,
    SUBMARINE,
)
