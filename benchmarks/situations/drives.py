"""Motors, servos, actuators: situations of people who drive something."""

import numpy as np

from benchmarks.situations.situation import (
    Frames,
    Parameters,
    Situation,
    frame,
    levels,
    sines,
    solve,
)

RPM = 60.0 / (2.0 * np.pi)  # revolutions a minute in a radian per second


def _motor(p: Parameters) -> Frames:
    time = np.arange(3000) * 1e-3
    frames = {}
    for name, frequency in (("run.csv", 15.0), ("test.csv", 10.0)):

        def volts(t, frequency=frequency):
            return 6.0 + 3.0 * np.sin(2 * np.pi * frequency * t)

        def right(_, x, u):
            return [
                (u[0] - p["R"] * x[0] - p["K"] * x[1]) / p["L"],
                (p["K"] * x[0] - p["B"] * x[1]) / p["J"],
            ]

        states = solve(right, [0.0, 0.0], time, volts, scale=1e-2)
        frames[name] = frame(time, V=volts(time), i=states[:, 0], w=states[:, 1])
    return frames


# One sine with an offset, so that the current never reverses; five parameters.
# "Trouble Estimating Motor Parameters with Least Squares in MATLAB",
# scicomp.stackexchange.com/questions/36459
MOTOR_ONE_SINE = Situation(
    name="motor_one_sine",
    kind="poor excitation",
    plant="motor",
    source="scicomp.stackexchange.com/questions/36459",
    parameters={"R": 2.0, "L": 8e-3, "K": 0.05, "J": 6e-5, "B": 1.5e-4},
    simulate=_motor,
    noise={"i": 5e-3, "w": 0.3},
    config="""
[model]
inputs = ["V"]
outputs = ["i", "w"]
parameters = { R = 1.0, L = 5e-3, K = 0.03, J = 1e-4, B = 1e-4 }
bounds = { R = [0, 100], L = [1e-6, 1], K = [0, 10], J = [1e-8, 1], B = [0, 1] }
[model.derivatives]
i = "(V - R*i - K*w)/L"
w = "(K*i - B*w)/J"
[data]
files = ["run.csv"]
time = "t"
inputs = ["V"]
outputs = ["i", "w"]
[validation]
files = ["test.csv"]
""",
    command="refine",
    truth={"R": 2.0, "L": 8e-3, "K": 0.05, "J": 6e-5, "B": 1.5e-4},
    held_out={"i": 1.3, "w": 1.3},
)


def _setpoint_servo(p: Parameters) -> Frames:
    time = np.arange(2000) * 0.01
    frames = {}
    for name, seed in (("run.csv", 111), ("test.csv", 112)):
        goal = levels(seed, [-0.9, -0.4, 0.0, 0.4, 0.9], 20, 100)
        states = solve(
            lambda _, x, u: [x[1], (p["kp"] * (u[0] - x[0]) - p["d"] * x[1]) / p["J"]],
            [0, 0],
            time,
            goal,
        )
        frames[name] = frame(time, goal=goal, pos=states[:, 0])
    return frames


# A hobby servo: only its set point is known, the gain inside is not.
# "Identification for hobby servo motors with high gear ratios", leggedrobotics/pace-sim2real #13
SETPOINT_SERVO = Situation(
    name="setpoint_servo",
    kind="common factor",
    plant="servo",
    source="github.com/leggedrobotics/pace-sim2real/issues/13",
    parameters={"J": 0.004, "kp": 1.1, "d": 0.09},
    simulate=_setpoint_servo,
    noise={"pos": 1e-3},
    step={"pos": 0.0015},
    config="""
[model]
inputs = ["goal"]
outputs = ["pos"]
parameters = { J = 0.01, kp = 2.0, d = 0.1 }
bounds = { J = [1e-5, 1.0], kp = [0.01, 100.0], d = [0.0, 10.0] }
[model.derivatives]
pos = "vel"
vel = "(kp*(goal - pos) - d*vel)/J"
[data]
files = ["run.csv"]
time = "t"
inputs = ["goal"]
outputs = ["pos"]
[validation]
files = ["test.csv"]
""",
    command="refine",
    truth={"kp/J": 275.0, "d/J": 22.5},
    inseparable=("J", "kp", "d"),
    fitted=("kp", "d"),
)


def _joint(p: Parameters) -> Frames:
    time = np.arange(4000) * 0.005
    frames = {}
    for name, seed in (("run.csv", 121), ("test.csv", 122)):
        wanted = sines(seed, 0.4, 6.0, 5, 0.35)

        def torque(t, x, wanted=wanted):
            return 9.0 * (wanted(t) - x[0]) - 0.35 * x[1]

        def right(t, x, u):
            push = torque(t, x) - p["d"] * x[1] - p["c"] * np.tanh(x[1] / 1e-3)
            return [x[1], push / p["J"]]

        states = solve(right, [0.0, 0.0], time, lambda _: 0.0)
        frames[name] = frame(
            time,
            torque=np.array([torque(t, x) for t, x in zip(time, states, strict=True)]),
            q=states[:, 0],
        )
    return frames


# Armature, damping and friction loss of a joint from a run under its position controller.
# "How to identify the parameter of frictionloss, armature, damping and stiffness of a motor?",
# google-deepmind/mujoco #1131
JOINT_IN_LOOP = Situation(
    name="joint_in_loop",
    kind="closed loop",
    plant="servo",
    source="github.com/google-deepmind/mujoco/issues/1131",
    parameters={"J": 0.045, "d": 0.22, "c": 0.31},
    simulate=_joint,
    noise={"q": 2e-4, "torque": 5e-3},
    config="""
[model]
inputs = ["torque"]
outputs = ["q"]
parameters = { J = 0.02, d = 0.1, c = 0.1 }
bounds = { J = [1e-4, 1.0], d = [0.0, 5.0], c = [0.0, 5.0] }
[model.derivatives]
q = "qd"
qd = "(torque - d*qd - c*sign(qd))/J"
[data]
files = ["run.csv"]
time = "t"
inputs = ["torque"]
outputs = ["q"]
[validation]
files = ["test.csv"]
""",
    truth={"J": 0.045, "d": 0.22, "c": 0.31},
)


def _no_load(p: Parameters) -> Frames:
    time = np.arange(3000) * 0.01
    frames = {}
    for name, seed in (("run.csv", 131), ("test.csv", 132)):
        torque = levels(seed, [-0.5, -0.35, -0.2, 0.2, 0.35, 0.5], 30, 100)
        states = solve(
            lambda _, x, u: [(u[0] - p["k"] * x[0] - p["b"] * np.tanh(x[0] / 0.02)) / p["J"]],
            [0.0],
            time,
            torque,
        )
        frames[name] = frame(time, torque=torque, speed=states[:, 0])
    return frames


# Speed over torque without a load has an offset that the model lacks.
# "How to Set Motor Friction Parameters When Identified from No-Load Condition?",
# isaac-sim/IsaacLab #3410
NO_LOAD = Situation(
    name="no_load",
    kind="effect not declared",
    plant="motor",
    source="github.com/isaac-sim/IsaacLab/issues/3410",
    parameters={"J": 0.012, "k": 0.011, "b": 0.07},
    simulate=_no_load,
    noise={"speed": 0.05},
    config="""
[model]
inputs = ["torque"]
outputs = ["speed"]
parameters = { J = 0.02, k = 0.02 }
bounds = { J = [1e-4, 1.0], k = [0.0, 1.0] }
[model.units]
speed = "rad/s"
torque = "N m"
[model.derivatives]
speed = "(torque - k*speed)/J"
[data]
files = ["run.csv"]
time = "t"
inputs = ["torque"]
outputs = ["speed"]
[validation]
files = ["test.csv"]
""",
    command="discover",
    truth={"J": 0.012, "k": 0.011},
    effects=(("coulomb_friction",),),
    held_out={"speed": 1.5},
)


def _power(p: Parameters) -> Frames:
    time = np.arange(1200) * 0.5
    frames = {}
    for name, seed in (("run.csv", 141), ("test.csv", 142)):
        kilowatts = levels(seed, [2.0, 4.0, 7.0, 10.0, 14.0], 24, 50)

        def right(_, x, u):
            omega = x[0] / RPM
            return [RPM * (1000.0 * u[0] / omega - p["b"] * omega - p["c"]) / p["J"]]

        states = solve(right, [900.0], time, kilowatts, scale=1e3)
        frames[name] = frame(time, Power=kilowatts, Speed=states[:, 0])
    return frames


# Power and speed of a rotating machine: kilowatts over revolutions a minute.
# "Setting up a model identification in real life data", dynamicslab/pysindy #491
POWER_AND_SPEED = Situation(
    name="power_and_speed",
    kind="units",
    plant="motor",
    source="github.com/dynamicslab/pysindy/issues/491",
    parameters={"J": 14.0, "b": 0.32, "c": 18.0},
    simulate=_power,
    noise={"Speed": 3.0},
    step={"Speed": 1.0},
    config="""
[model]
inputs = ["Power"]
outputs = ["Speed"]
parameters = { J = 5.0, b = 0.1, c = 5.0 }
[model.units]
Power = "kW"
Speed = "rpm"
[model.definitions]
omega = "Speed*2*pi/60"
[model.derivatives]
Speed = "60/(2*pi)*(1000*Power/omega - b*omega - c)/J"
[data]
files = ["run.csv"]
time = "t"
inputs = ["Power"]
outputs = ["Speed"]
[validation]
files = ["test.csv"]
""",
    command="refine",
    truth={"J": 14.0, "b": 0.32, "c": 18.0},
    held_out={"Speed": 1.3},
)


def _solenoid(p: Parameters) -> Frames:
    time = np.arange(4000) * 1e-3
    frames = {}
    for name, seed in (("run.csv", 151), ("test.csv", 152)):
        volts = levels(seed, [2.0, 6.0, 10.0, 14.0, 18.0], 40, 100)
        stroke = 2.0 + sines(seed + 5, 3.0, 40.0, 4, 0.35)(time)  # mm
        stroke_at = lambda t, table=stroke: np.interp(t, time, table)  # noqa: E731

        def right(t, x, u):
            return [(u[0] - p["R"] * x[0]) / p["L"]]

        current = solve(right, [2.0 / p["R"]], time, volts)[:, 0]
        force = p["k"] * current**2 / (stroke_at(time) + p["a"]) ** 2
        frames[name] = frame(time, u=volts, x=stroke, F=force)
    return frames


# Force of a proportional solenoid over its current and position; the current is not logged.
# "Unsure on the correct use of pySINDy", dynamicslab/pysindy #505
SOLENOID_FORCE = Situation(
    name="solenoid_force",
    kind="algebraic output",
    plant="actuator",
    source="github.com/dynamicslab/pysindy/issues/505",
    parameters={"R": 7.5, "L": 0.09, "k": 110.0, "a": 0.8},
    simulate=_solenoid,
    noise={"F": 0.2},
    config="""
[model]
inputs = ["u", "x"]
outputs = ["F"]
parameters = { R = 7.5, L = 0.05, k = 60.0, a = 1.5 }
fixed = ["R"]
bounds = { L = [1e-3, 10.0], k = [0.0, 1e4], a = [0.01, 10.0] }
[model.derivatives]
i = "(u - R*i)/L"
[model.output]
F = "k*i**2/(x + a)**2"
[model.initial]
i = 0.2667
[data]
files = ["run.csv"]
time = "t"
inputs = ["u", "x"]
outputs = ["F"]
[validation]
files = ["test.csv"]
""",
    truth={"L": 0.09, "k": 110.0, "a": 0.8},
    fitted=("L", "k", "a"),
    held_out={"F": 1.3},
)


def _drivetrain(p: Parameters) -> Frames:
    time = np.arange(2400) * 0.02
    frames = {}
    for name, seed in (("run.csv", 161), ("test.csv", 162)):
        volts = levels(seed, [-9, -7, -4, -2, 2, 4, 7, 9], 40, 60)

        def right(_, x, u):
            return [(u[0] - p["kS"] * np.tanh(x[0] / 1e-3) - p["kV"] * x[0]) / p["kA"]]

        frames[name] = frame(time, volts=volts, speed=solve(right, [0.0], time, volts)[:, 0])
    return frames


_DRIVETRAIN = """
[model]
inputs = ["volts"]
outputs = ["speed"]
parameters = { kS = 0.1, kV = 1.0, kA = 0.1 }
[model.derivatives]
speed = "(volts - kS*sign(speed) - kV*speed)/kA"
[data]
files = ["run.csv"]
time = "t"
inputs = ["volts"]
outputs = ["speed"]
[validation]
files = ["test.csv"]
"""

# A tachometer that counts in coarse steps of a rotation per second.
# "CTRE Tachometer velocites are too large by a factor of 1024" and "Quasistatic test trimming
# removed all data", wpilibsuite/sysid #209 and #319
COARSE_TACHOMETER = Situation(
    name="coarse_tachometer",
    kind="coarse sensor",
    plant="drivetrain",
    source="github.com/wpilibsuite/sysid/issues/319",
    parameters={"kS": 0.6, "kV": 2.4, "kA": 0.5},
    simulate=_drivetrain,
    noise={"speed": 0.01},
    step={"speed": 0.1},
    config=_DRIVETRAIN,
    command="refine",
    truth={"kS": 0.6, "kV": 2.4, "kA": 0.5},
    held_out={"speed": 1.4},
)

# The encoder counts backwards: every parameter changes its sign.
# "Document SysId sign conventions in frc-docs and SysIdRoutine callback docs",
# wpilibsuite/allwpilib #6320
ENCODER_BACKWARDS = Situation(
    name="encoder_backwards",
    kind="wrong sign",
    plant="drivetrain",
    source="github.com/wpilibsuite/allwpilib/issues/6320",
    parameters={"kS": -0.6, "kV": -2.4, "kA": -0.5},
    simulate=_drivetrain,
    noise={"speed": 0.01},
    step={"speed": 0.002},
    config=_DRIVETRAIN,
    truth={"kS": -0.6, "kV": -2.4, "kA": -0.5},
    reason="as recorded, V = -kS sign(v) - kV v - kA v'",
)


def _wheel_arm(p: Parameters) -> Frames:
    time = np.arange(2500) * 0.02
    frames = {}
    for name, seed in (("run.csv", 171), ("test.csv", 172)):
        wanted = sines(seed, 0.3, 3.0, 5, 0.25)

        def volts(t, x, wanted=wanted):
            return 20.0 * (wanted(t) - x[0]) - 1.0 * x[1] + 0.9 * np.cos(x[0])

        def right(t, x, u):
            push = volts(t, x) - p["kV"] * x[1] - p["kG"] * np.cos(x[0])
            return [x[1], push / p["kA"]]

        states = solve(right, [0.0, 0.0], time, lambda _: 0.0)
        supply = np.array([volts(t, x) for t, x in zip(time, states, strict=True)])
        frames[name] = frame(time, volts=supply, angle=np.degrees(states[:, 0]))
    return frames


# An arm's angle in degrees, gravity in the cosine of it.
# "Don't allow angular units for elevators or linear units for arms", wpilibsuite/sysid #505
ARM_IN_DEGREES = Situation(
    name="arm_in_degrees",
    kind="units",
    plant="drivetrain",
    source="github.com/wpilibsuite/sysid/issues/505",
    parameters={"kV": 1.6, "kG": 0.75, "kA": 0.12},
    simulate=_wheel_arm,
    noise={"angle": 0.03, "volts": 0.01},
    config="""
[model]
inputs = ["volts"]
outputs = ["angle"]
parameters = { kV = 1.0, kG = 0.3, kA = 0.3 }
[model.units]
angle = "deg"
[model.definitions]
q = "angle*pi/180"
qd = "rate*pi/180"
[model.derivatives]
angle = "rate"
rate = "180/pi*(volts - kV*qd - kG*cos(q))/kA"
[data]
files = ["run.csv"]
time = "t"
inputs = ["volts"]
outputs = ["angle"]
[validation]
files = ["test.csv"]
""",
    truth={"kV": 1.6, "kG": 0.75, "kA": 0.12},
)

SITUATIONS = (
    MOTOR_ONE_SINE,
    SETPOINT_SERVO,
    JOINT_IN_LOOP,
    NO_LOAD,
    POWER_AND_SPEED,
    SOLENOID_FORCE,
    COARSE_TACHOMETER,
    ENCODER_BACKWARDS,
    ARM_IN_DEGREES,
)
