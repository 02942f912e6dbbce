"""One process that calls `discover` for a new rig each time: what it keeps in memory.

    python benchmarks/robustness/long_process.py [--quick] [--write]

Every call has a plant of new functions with another constant written into them, and a record of
another length. Five kinds of rig by turns; each lacks something. Nothing is kept on disk.
"""

import gc
import resource
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
import eoi_jax as eoi
from benchmarks.common import Report, arguments, table

CALLS, SHOWN, WARM = 200, 20, 20
PERIOD, SAMPLES = 1e-2, 1500
Rig = tuple[eoi.Plant, eoi.Plant]  # the declared one, and the one that makes the data


def _pair(declared: Callable, hidden: Callable, parameters: dict[str, float], order: int) -> Rig:
    def true(_: Any, x: Any, u: Any, p: Any) -> Any:
        return declared(_, x, u, p) + hidden(x)

    first, second = (eoi.Plant(one, parameters, relative_degree=order) for one in (declared, true))
    return first, second


def _oscillator(constant: float) -> Rig:
    def force(_: Any, x: Any, u: Any, p: Any) -> Any:
        return constant * u - p.k * x.y[0] - p.d * x.y[1]

    return _pair(force, lambda x: -0.4 * jnp.sign(x.y[1]), {"k": 20.0, "d": 1.0}, 2)


def _pendulum(constant: float) -> Rig:
    def torque(_: Any, x: Any, u: Any, p: Any) -> Any:
        return constant * u - p.a * jnp.sin(x.y[0]) - p.d * x.y[1]

    return _pair(torque, lambda x: -2.0 * x.y[0] ** 3, {"a": 15.0, "d": 1.0}, 2)


def _heater(constant: float) -> Rig:
    def flow(_: Any, x: Any, u: Any, p: Any) -> Any:
        return constant * u - p.loss * x.y[0]

    return _pair(flow, lambda x: 0.3 + 0.0 * x.y[0], {"loss": 1.0}, 1)


def _drag(constant: float) -> Rig:
    def speed(_: Any, x: Any, u: Any, p: Any) -> Any:
        return p.gain * u - constant * p.b * x.y[0] * jnp.abs(x.y[0])

    return _pair(speed, lambda x: -0.5 * x.y[0], {"gain": 2.0, "b": 0.3}, 1)


def _two_masses(constant: float) -> Rig:
    def forces(_: Any, x: Any, u: Any, p: Any) -> Any:
        spring = p.k * (x.y[0, 1] - x.y[0, 0])
        first = constant * u[0] - 12.0 * x.y[0, 0] - p.d * x.y[1, 0] + spring
        return jnp.stack([first, -spring - p.d * x.y[1, 1]])

    def hidden(x: Any) -> Any:
        return jnp.stack([-0.5 * jnp.sign(x.y[1, 0]), 0.0 * x.y[1, 1]])

    parameters = {"k": 9.0, "d": 0.8}
    first, second = (
        eoi.Plant(one, parameters, relative_degree=2, outputs=("first", "second"))
        for one in (forces, lambda _, x, u, p: forces(_, x, u, p) + hidden(x))
    )
    return first, second


KINDS = (_oscillator, _pendulum, _heater, _drag, _two_masses)


def rig(number: int) -> tuple[eoi.Plant, eoi.Record, eoi.Record]:
    """A declared plant, and two records of the true one."""
    draw = np.random.default_rng(number)
    declared, true = KINDS[number % len(KINDS)](float(draw.uniform(2.0, 4.0)))
    samples = SAMPLES + int(draw.integers(0, 600))
    records = []
    for name in ("fitted", "held out"):
        grid = PERIOD * np.arange(samples)
        held = np.repeat(draw.uniform(-2.0, 2.0, samples // 50 + 1), 50)[:samples]
        run = eoi.simulate(true, grid, held)
        noise = 1e-4 * np.std(run.outputs, axis=0) * draw.standard_normal(run.outputs.shape)
        records.append(eoi.Record(grid, held, run.outputs + noise, name, hold="zero"))
    return declared, *records


def memory() -> tuple[float, int]:
    """Resident memory [MB], and mappings."""
    status = Path("/proc/self/status").read_text().split("VmRSS:")[1]
    return int(status.split()[0]) / 1024, Path("/proc/self/maps").read_text().count("\n")


def main() -> None:
    """A row each twenty calls."""
    options = arguments(__doc__)
    eoi.configure(cache=False)
    warnings.simplefilter("ignore")
    rows, largest, seconds, warm = [], 0, [], 0.0
    calls = 20 if options.quick else CALLS
    for number in range(calls):
        plant, fitted, held_out = rig(number)
        started = time.perf_counter()
        found = eoi.discover(plant, fitted, held_out)
        seconds.append(time.perf_counter() - started)
        gc.collect()
        resident, maps = memory()
        largest = max(largest, maps)
        warm = resident if number + 1 == WARM else warm
        if (number + 1) % SHOWN == 0 or number == 0:
            named = ", ".join(found.effects) or found.status.code.replace("_", " ")
            median = f"{np.median(seconds[-SHOWN:]):.1f} s"
            rows.append([number + 1, f"{resident:.0f} MB", maps, median, named])
            print(*rows[-1], flush=True)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    report = Report("A process that lives long")
    grown = (memory()[0] - warm) / max(calls - WARM, 1)
    report.add(
        f"{calls} calls, each with a new plant and a record of a new length; five kinds of rig.",
        table(["call", "resident", "mappings", "time of a call, median", "named last"], rows),
        f"At most {peak:.0f} MB and {largest} mappings; {grown:.1f} MB a call after {WARM} calls.",
    )
    report.close(__file__, options.write)


if __name__ == "__main__":
    main()
