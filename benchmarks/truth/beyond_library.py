"""Plants that lack what the library has no law for: is a curve named, or nothing, or a wrong law?

    python benchmarks/truth/beyond_library.py [--quick] [--write]

The laws were written down before curves were tried on them, and before the library had damping
with the square of the displacement, products of three signals, a loss that saturates and a spring
and a damper in series, which four of them are. Simulated by the rule of `other_rigs`.
"""

import math
import sys
import time
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
import eoi_jax as eoi
from benchmarks.common import Report, arguments, table
from benchmarks.truth.other_rigs import NOISE, SEEDS, Rate, Rig, levels, multisine, record


@dataclass(frozen=True)
class Case:
    """One plant.

    Attributes:
        rig: how it is simulated. right: kinds of effects, each of which is an answer.
    """

    rig: Rig
    right: tuple[str, ...]


def mass() -> eoi.Plant:
    """m y'' = u - k y - c y'."""
    return eoi.Plant(
        lambda _, x, u, p: p.b * u - p.k * x.y[0] - p.c * x.y[1],
        {"k": 40.0, "c": 1.2, "b": 1.0}, 2, inputs=("u",), outputs=("y",),
    )  # fmt: skip


def tank() -> eoi.Plant:
    """y' = b u - a y."""
    return eoi.Plant(
        lambda _, x, u, p: p.b * u - p.a * x.y[0],
        {"a": 0.8, "b": 1.0}, 1, inputs=("u",), outputs=("y",),
    )  # fmt: skip


def _sprung(hidden: str, rate: Rate, *right: str, states: int = 2) -> Case:
    drive = multisine(30.0, 3.0)
    return Case(Rig("mass", hidden, (), mass(), rate, (0.0,) * states, 5e-3, 8000, drive), right)


def _filled(hidden: str, rate: Rate, *right: str) -> Case:
    return Case(Rig("tank", hidden, (), tank(), rate, (0.2,), 0.02, 8000, levels(2.0, 50)), right)


def _sign(x: float) -> int:
    return (x > 0) - (x < 0)


def cases() -> list[Case]:
    """All of them."""
    return [
        _sprung("damping with the distance, |y| y'",
                lambda x, u: (x[1], u - 40 * x[0] - (1.2 + 1.5 * abs(x[0])) * x[1]), "curve y v"),
        _sprung("a spring of fifth order",
                lambda x, u: (x[1], u - 40 * x[0] - 1.2 * x[1] - 30 * x[0] ** 5), "curve y"),
        _sprung("friction with tanh(y'/2)",
                lambda x, u: (x[1], u - 40 * x[0] - 1.2 * x[1] - 4 * math.tanh(x[1] / 2)),
                "curve v"),
        _sprung("friction with the root of the velocity",
                lambda x, u: (x[1], u - 40 * x[0] - 1.2 * x[1]
                              - 2 * _sign(x[1]) * abs(x[1]) ** 0.5), "curve v"),
        _sprung("a force of y y'²",
                lambda x, u: (x[1], u - 40 * x[0] - 1.2 * x[1] - x[0] * x[1] ** 2),
                "product y v v"),
        _sprung("an exponential spring",
                lambda x, u: (x[1], u - 40 * x[0] - 1.2 * x[1] - 3 * (math.exp(x[0]) - 1)),
                "curve y"),
        _sprung("an input with its cube",
                lambda x, u: (x[1], u - 2e-4 * u**3 - 40 * x[0] - 1.2 * x[1]), "input_curve"),
        _sprung("an input with a soft saturation",
                lambda x, u: (x[1], 25 * math.tanh(u / 25) - 40 * x[0] - 1.2 * x[1]),
                "input_curve"),
        _sprung("damping with cos(5 y)",
                lambda x, u: (x[1], u - 40 * x[0] - 1.2 * x[1] * (1 + 0.8 * math.cos(5 * x[0]))),
                "curve y v"),
        _sprung("a spring with a dashpot in series",
                lambda x, u: (x[1], u - 40 * x[0] - 1.2 * x[1] - 20 * (x[0] - x[2]),
                              20 * (x[0] - x[2])), "maxwell_element", states=3),
        _sprung("a damper that a gap of 0.4 leaves out",
                lambda x, u: (x[1], u - 40 * x[0] - 1.2 * x[1]
                              - 3 * x[1] * (abs(x[0]) > 0.4)), "curve y v"),
        _filled("an outlet with the root of the level",
                lambda x, u: (u - 0.3 * x[0] - 0.5 * math.sqrt(max(x[0], 0.0)),), "power_loss"),
        _filled("an input with its logarithm",
                lambda x, u: (1.5 * math.log1p(u) - 0.8 * x[0],), "input_curve"),
        _filled("an uptake that saturates, y/(0.4 + y)",
                lambda x, u: (u - 0.3 * x[0] - 0.8 * x[0] / (0.4 + x[0]),), "curve y",
                "saturating_loss"),
        _filled("a loss with sin(4 y)",
                lambda x, u: (u - 0.8 * x[0] - 0.3 * math.sin(4 * x[0]),), "curve y"),
    ]  # fmt: skip


def verdict(case: Case, found: eoi.Discovery) -> str:
    """``right``, ``open`` without an effect, or ``wrong``."""
    kinds = {added.effect.kind for added in found.added} - {"constant_offset"}
    if not kinds:
        return "open"
    return "right" if len(kinds) == 1 and kinds <= {*case.right} else "wrong"


def main() -> None:
    """One row a plant."""
    options = arguments(__doc__)
    warnings.simplefilter("ignore")
    report = Report("Beyond the library")
    report.add(
        f"Noise {NOISE:g} of the rms of the output; records of seeds {SEEDS[0]} (fitted) and "
        f"{SEEDS[1]} (held out); whole library, nothing set. *Error*: rms of held-out free runs in "
        "windows over the standard deviation of the noise. *open*: no effect named. Times are of "
        "first calls, with compilation, beside other work."
    )
    rows, verdicts = [], []
    for case in cases()[:: 5 if options.quick else 1]:
        rig = case.rig
        fitted, held = (record(rig, seed, rig.samples) for seed in SEEDS)
        started = time.perf_counter()
        found = eoi.discover(rig.model, fitted, held)
        seconds = time.perf_counter() - started
        sigma = NOISE * np.std(held.outputs, axis=0)
        assert found.windows_before is not None
        assert found.windows_after is not None
        before, after = (
            float(np.max(runs.rmse / sigma)) for runs in (found.windows_before, found.windows_after)
        )
        verdicts.append(verdict(case, found))
        rows.append([rig.name, rig.hidden,
                     ", ".join(added.effect.kind for added in found.added) or "–",
                     found.status.code, verdicts[-1], f"{before:.3g} → {after:.3g}",
                     f"{seconds:.0f} s"])  # fmt: skip
    counts = [f"{name}: {verdicts.count(name)}" for name in ("right", "open", "wrong")]
    report.add(f"{', '.join(counts)}, of {len(verdicts)}.")
    header = ["plant", "it has", "answer", "status", "verdict", "error", "time"]
    report.add(table(header, rows))
    report.close(__file__, options.write)


if __name__ == "__main__":
    main()
