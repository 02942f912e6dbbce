"""How many lane-steps a second a GPU makes, against its arithmetic and against the CPU.

python benchmarks/speed/gpu.py [--quick] [--write] [--json FILE] [--tflops LIMIT] [--float64]

The paper's pendulum under the second-order observer; without a GPU there is nothing to measure.
"""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
import eoi_jax as eoi
from benchmarks.common import Report, percent, table
from eoi_jax.estimation.engines import AbstractEngine, Lanes, Native, OneKernel, Scan
from eoi_jax.estimation.kernel import Steps
from eoi_jax.estimation.observers import SecondOrder

PLANT = eoi.plants.pendulum()
H = 1e-3
FILTER = eoi.LowPass(20.0).discretise(H)
ON_THE_CPU = 4096  # lanes from which its rate is taken to be constant
# Each counts as one operation; all else moves, compares or selects.
ARITHMETIC = ("add", "sub", "mul", "div", "neg", "sqrt", "sin", "cos", "exp", "pow", "max", "min")


def main() -> None:
    """Lanes by powers of four, up to a million."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a shorter record, fewer lanes")
    parser.add_argument("--write", action="store_true", help="update the result file")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers there too")
    parser.add_argument("--tflops", type=float, help="the card's limit in this precision")
    parser.add_argument("--float64", action="store_true", help="double precision")
    options = parser.parse_args()
    eoi.configure(float64=options.float64)
    if jax.default_backend() != "gpu":
        print("no GPU: not measured")
        return
    length = 500 if options.quick else 5000
    report = Report("One kernel on a GPU")
    operations = arithmetic(length)
    report.add(
        f"{jax.devices()[0].device_kind}; {length} steps of the pendulum, implicit form, best of "
        f"three runs, transfers included. {operations} arithmetic operations a lane and step, "
        "counted in the traced loop; what all lanes share is not among them. CPU: the compiled "
        f"engine on all cores, its rate at {ON_THE_CPU} lanes taken for more."
    )
    rows = [measured(4**k, length) for k in range(3, 8 if options.quick else 11)]
    report.add(_table(rows, operations, options.tflops), _crossover(rows))
    if options.json:
        shown = {"steps": length, "operations": operations, "rows": rows}
        options.json.write_text(json.dumps(shown, indent=2) + "\n", encoding="utf-8")
    report.close(__file__, options.write)


def measured(count: int, length: int) -> dict[str, float]:
    """Lane-steps per second of each engine at that number of lanes."""
    return {
        "lanes": count,
        "kernel": _rate(OneKernel(), count, length),
        "scan": _rate(Scan(tile=count), count, length),
        "cpu": _rate(Native(), min(count, ON_THE_CPU), length),
    }


def _rate(engine: AbstractEngine, count: int, length: int) -> float:
    lanes, steps, best = _lanes(count), _steps(length), np.inf
    for run in range(4):
        started = time.perf_counter()
        engine.run(PLANT, lanes, FILTER, steps)
        if run:  # the first one compiles
            best = min(best, time.perf_counter() - started)
    return float(count * length / best)


def _lanes(count: int) -> Lanes:
    dtype = jax.numpy.result_type(float)
    relay = np.linspace(1e3, 4e3, count, dtype=dtype)
    theta = np.tile(PLANT.theta.astype(dtype), (count, 1))
    observer = SecondOrder(np.full_like(relay, 200.0), np.full_like(relay, 2e4), relay)
    return Lanes(observer, theta, np.zeros_like(theta), np.ones((count, 1), dtype))


def _steps(length: int) -> Steps:
    """A swing of the size of the paper's; engines do not ask whether the plant made it."""
    t = H * np.arange(length + 1)
    y, u = np.sin(3.0 * t)[:, None], np.cos(2.0 * t[:-1])[:, None]
    ones, first = np.ones((length, 1)), np.arange(length) == 0
    return Steps(
        t[:-1] + 0.5 * H, y[:-1], y[1:], u, ones, ones, first, ones[:, 0], first, np.asarray(H)
    )  # type: ignore[call-arg]


# -- arithmetic -------------------------------------------------------------------------------


def arithmetic(length: int) -> int:
    """Operations of one lane in one step: of the longer loop, that of the lanes."""
    engine, steps = OneKernel(interpret=False), _steps(length)
    jaxpr = jax.make_jaxpr(lambda lanes: engine.launch(PLANT, lanes, FILTER, steps))(_lanes(32))
    loop = max(_loops(jaxpr.jaxpr), key=lambda body: len(body.eqns))
    return sum(equation.primitive.name in ARITHMETIC for equation in loop.eqns)


def _loops(jaxpr: Any) -> list[Any]:
    """The bodies of all loops inside."""
    found = []
    for equation in jaxpr.eqns:
        for value in equation.params.values():
            for one in value if isinstance(value, tuple | list) else (value,):
                inner = getattr(one, "jaxpr", one)
                if hasattr(inner, "eqns"):
                    found += [inner] * (equation.primitive.name == "scan") + _loops(inner)
    return found


# -- text -------------------------------------------------------------------------------------


def _table(rows: list[dict[str, float]], operations: int, tflops: float | None) -> str:
    def share(row: dict[str, float]) -> str:
        return "–" if tflops is None else percent(row["kernel"] * operations / (tflops * 1e12))

    header = ["lanes", "one kernel [1/s]", "of the card", "scan, GPU [1/s]", "native, CPU [1/s]"]
    cells = [
        [row["lanes"], _short(row["kernel"]), share(row), _short(row["scan"]), _short(row["cpu"])]
        for row in rows
    ]
    return table(header, cells)


def _short(rate: float) -> str:
    return f"{rate:.3g}"


def _crossover(rows: list[dict[str, float]]) -> str:
    ahead = [row["lanes"] for row in rows if row["kernel"] > row["cpu"]]
    if not ahead:
        return "The CPU is ahead throughout."
    return f"The GPU is ahead of the CPU from {ahead[0]} lanes on, of the sizes measured."


if __name__ == "__main__":
    main()
