"""The estimator in real time: when its alarm finds that the model fails, and its cost in C.

    python benchmarks/statistics/residual_alarm.py [--quick] [--write]

A mass on a spring under random levels of force, its position measured with noise of 1e-3 of its
rms at 100 Hz. It is identified on one minute; then something begins at a random time of a run that
was not seen: dry friction, an offset, a delay. Runs are simulated here, all at once, and share no
code with the library.
"""

import ctypes
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
import eoi_jax as eoi
from benchmarks.common import Report, arguments, percent, table

STEP = 0.01
SUBSTEPS = 8
NOISE = 1e-3  # over the rms of the position
HOLD = 25  # samples of a level of the force, within ±1
RATE = 1.0 / 3600.0  # of false alarms that is asked for [1/s]
BEGINS = (10.0, 20.0)  # when something begins [s]
CASES = (
    ("dry friction", "friction", (0.01, 0.02, 0.05), "of the largest force"),
    ("offset", "offset", (0.01, 0.02, 0.05), "of the largest force"),
    ("delay", "delay", (1, 2, 5), "samples"),
)


def simulated(
    kind: str, size: float, begins: np.ndarray, seconds: float, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Forces and positions of as many runs as there are times, shape (samples, runs)."""
    count, samples = len(begins), round(seconds / STEP)
    draw = np.random.default_rng(seed)
    levels = draw.uniform(-1.0, 1.0, (samples // HOLD + 1, count))
    force = np.repeat(levels, HOLD, axis=0)[:samples]
    late = np.concatenate([np.repeat(force[:1], int(size), 0), force])[:samples]
    state, positions = np.zeros((2, count)), np.zeros((samples, count))

    def rate(state: np.ndarray, u: np.ndarray, t: float) -> np.ndarray:
        begun = t >= begins
        total = u - 0.4 * state[1] - 4.0 * state[0]
        if kind == "friction":  # nearly a sign: its slope is far beyond what the record resolves
            total = total - begun * size * np.tanh(state[1] / 1e-4)
        if kind == "offset":
            total = total + begun * size
        return np.stack([state[1], total])

    d = STEP / SUBSTEPS
    for k in range(samples - 1):
        u = np.where(k * STEP >= begins, late[k], force[k]) if kind == "delay" else force[k]
        for part in range(SUBSTEPS):
            t = k * STEP + part * d
            k1 = rate(state, u, t)
            k2 = rate(state + d / 2 * k1, u, t + d / 2)
            k3 = rate(state + d / 2 * k2, u, t + d / 2)
            k4 = rate(state + d * k3, u, t + d)
            state = state + d / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        positions[k + 1] = state[0]
    return force, positions


def with_noise(positions: np.ndarray, sigma: float, seed: int) -> np.ndarray:
    return positions + sigma * np.random.default_rng(seed).standard_normal(positions.shape)


@jax.jit
def alarms(estimator: eoi.OnlineEstimator, y: jax.Array, u: jax.Array) -> jax.Array:
    """Whether the alarm is on, shape (runs, samples)."""

    def one(y: jax.Array, u: jax.Array) -> jax.Array:
        def body(state: object, sample: tuple) -> tuple[object, jax.Array]:
            state, estimate = estimator.step(state, *sample)  # type: ignore[arg-type]
            return state, estimate.alarm

        return jax.lax.scan(body, estimator.init(), (y[:, None], u[:, None]))[1]

    return jax.vmap(one, in_axes=1)(y, u)


def identified() -> tuple[eoi.OnlineEstimator, float]:
    """The estimator, from a minute without any change, and the standard deviation of the noise."""
    plant = eoi.Plant(
        lambda _t, x, u, p: [u[0] - p.c * x.y[1, 0] - p.k * x.y[0, 0]],
        {"c": 0.3, "k": 3.0}, 2, inputs=("force",), outputs=("position",),
    )  # fmt: skip
    force, position = simulated("none", 0.0, np.full(1, np.inf), 60.0, 1)
    sigma = NOISE * float(np.sqrt(np.mean(position**2)))
    noisy = with_noise(position, sigma, 2)
    record = eoi.Record(STEP * np.arange(len(noisy)), force, noisy, hold="zero")
    return eoi.online_estimator(eoi.identify(plant, record), record, false_alarms=RATE), sigma


def detections(
    estimator: eoi.OnlineEstimator, sigma: float, kind: str, size: float, runs: int
) -> np.ndarray:
    """Delay of the first alarm of each run [s]; infinite without one."""
    begins = np.random.default_rng(3).uniform(*BEGINS, runs)
    force, position = simulated(kind, size, begins, BEGINS[1] + 10.0, 4)
    on = np.asarray(alarms(estimator, jnp.asarray(with_noise(position, sigma, 5)), force)) > 0.0
    times = STEP * np.arange(on.shape[1])
    after = on & (times >= begins[:, None])
    first = times[np.argmax(after, axis=1)] - begins
    return np.where(np.any(after, axis=1), first, np.inf)


def nanoseconds(estimator: eoi.OnlineEstimator, precision: str, calls: int = 1_000_000) -> str:
    """Time of a step in C; empty without a compiler."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        return ""
    with tempfile.TemporaryDirectory() as folder:
        source = eoi.export_estimator(estimator, Path(folder) / "rig.c", precision)
        number = "double" if precision == "double" else "float"
        loop = f"""
#include <stdio.h>
double rig_many(int count) {{
    static rig_state state; static rig_estimate estimate; {number} y, u; int k; double sum = 0.0;
    rig_init(&state);
    for (k = 0; k < count; k++) {{
        y = ({number})((k % 97) * 1e-3); u = ({number})(k % 3);
        rig_step(&state, &y, &u, &estimate);
        sum += (double)estimate.parameters[0] + (double)estimate.power;
    }}
    return sum;
}}
"""
        source.write_text(source.read_text() + loop)
        library = Path(folder) / "rig.so"
        command = [compiler, "-O2", "-shared", "-fPIC", str(source), "-o", str(library), "-lm"]
        subprocess.run(command, check=True)
        many = ctypes.CDLL(str(library)).rig_many
        many.restype = ctypes.c_double
        spent = []
        for _ in range(5):
            started = time.perf_counter()
            many(calls)
            spent.append((time.perf_counter() - started) / calls)
    return f"{1e9 * float(np.median(spent)):.0f}"


def main() -> None:
    options = arguments(__doc__)
    eoi.configure()
    runs = 20 if options.quick else 200
    report = Report("Alarm of the estimator in real time")
    estimator, sigma = identified()
    assert estimator.alarm is not None
    rows = []
    for name, kind, sizes, unit in CASES:
        for size in sizes:
            delays = detections(estimator, sigma, kind, size, runs)
            rows.append(
                [name, f"{size:g} {unit}", percent(float(np.mean(delays <= 2.0))),
                 *(f"{value:.2f} s" for value in np.quantile(delays, (0.5, 0.9, 1.0)))]
            )  # fmt: skip
    report.add(
        table(["what begins", "size", "within 2 s", "median", "90 %", "all"], rows),
        f"{runs} runs each; one false alarm an hour is asked for, the threshold is "
        f"{estimator.alarm.threshold:.3g} times the power of the noise, over "
        f"{estimator.alarm.memory:g} s.",
    )
    minutes = 1.0 if options.quick else 5.0
    force, position = simulated("none", 0.0, np.full(runs, np.inf), 60.0 * minutes, 6)
    on = np.asarray(alarms(estimator, jnp.asarray(with_noise(position, sigma, 7)), force))
    starts, hours = int(np.sum(np.diff(on, axis=1) > 0)), runs * minutes / 60.0
    report.add(f"False alarms without a change: {starts} in {hours:.1f} hours.")
    cost = [[precision, nanoseconds(estimator, precision)] for precision in ("double", "single")]
    report.add(table(["step in C, gcc -O2", "ns"], cost))
    report.close(__file__, options.write)


if __name__ == "__main__":
    main()
