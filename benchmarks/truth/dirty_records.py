"""The same rigs, measured badly: what `discover` makes of sensors as they are.

    python benchmarks/truth/dirty_records.py [--quick] [--write]

Each rig of `other_rigs` below is simulated as there; what its sensor does to the outputs is added
here, to the record that is fitted and to the held-out one alike. The library is told nothing.
"""

import math
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
import eoi_jax as eoi
from benchmarks.common import Report, arguments, table
from benchmarks.truth.other_rigs import Rig, multisine, noiseless, sprung

SEEDS = (15, 16)  # of the record that is fitted, and of the held-out one
SAMPLES, PERIOD = 6000, 2e-3
NOISE = 1e-3  # white, of the rms of the output about its mean, where nothing else is said
Draw = np.random.Generator
Measured = tuple[np.ndarray, np.ndarray, np.ndarray]  # time, inputs, outputs
Dirt = Callable[[np.ndarray, np.ndarray, np.ndarray, Draw], Measured]
Force = Callable[[float, float], float]  # of displacement and velocity


def white(y: np.ndarray, draw: Draw, level: float = NOISE) -> np.ndarray:
    """With white noise."""
    return y + level * np.std(y) * draw.standard_normal(y.shape)


def _clean(t: np.ndarray, u: np.ndarray, y: np.ndarray, draw: Draw) -> Measured:
    return t, u, white(y, draw)


def _encoder(steps: int) -> Dirt:
    def dirt(t: np.ndarray, u: np.ndarray, y: np.ndarray, draw: Draw) -> Measured:
        del draw
        quantum = np.ptp(y) / steps
        return t, u, quantum * np.round(y / quantum)

    return dirt


def _coloured(memory: int) -> Dirt:
    def dirt(t: np.ndarray, u: np.ndarray, y: np.ndarray, draw: Draw) -> Measured:
        a, noise, last = math.exp(-1.0 / memory), np.zeros_like(y), 0.0
        for k, shock in enumerate(draw.standard_normal(len(y))):
            last = a * last + math.sqrt(1.0 - a * a) * shock
            noise[k] = last
        return t, u, white(y, draw, 0.3 * NOISE) + NOISE * np.std(y) * noise

    return dirt


def _wandering(t: np.ndarray, u: np.ndarray, y: np.ndarray, draw: Draw) -> Measured:
    walk = np.cumsum(draw.standard_normal(y.shape), axis=0) / math.sqrt(len(y))
    return t, u, white(y, draw) + 1e-2 * np.std(y) * walk


def _spikes(t: np.ndarray, u: np.ndarray, y: np.ndarray, draw: Draw) -> Measured:
    hit = draw.random(y.shape) < 2e-3
    return t, u, white(y, draw) + hit * np.std(y) * draw.uniform(-0.1, 0.1, y.shape)


def _lost(t: np.ndarray, u: np.ndarray, y: np.ndarray, draw: Draw) -> Measured:
    y = white(y, draw)
    for first in draw.integers(0, len(y) - 30, 12):
        y[first : first + draw.integers(3, 30)] = np.nan
    return t, u, y


def _jitter(t: np.ndarray, u: np.ndarray, y: np.ndarray, draw: Draw) -> Measured:
    """Stamps that are wrong by 2 % of a period; the samples were taken on time."""
    return t + 0.02 * PERIOD * draw.standard_normal(t.shape), u, white(y, draw)


def _late(t: np.ndarray, u: np.ndarray, y: np.ndarray, draw: Draw) -> Measured:
    return t + 1.7e9, u, white(y, draw)


def _hum(t: np.ndarray, u: np.ndarray, y: np.ndarray, draw: Draw) -> Measured:
    wave = np.sin(2.0 * np.pi * 50.0 * t + draw.uniform(0.0, 6.28))
    return t, u, white(y, draw) + 1e-2 * np.std(y) * wave[:, None]


def _input_noise(t: np.ndarray, u: np.ndarray, y: np.ndarray, draw: Draw) -> Measured:
    return t, u + 1e-2 * np.std(u) * draw.standard_normal(u.shape), white(y, draw)


DIRT: dict[str, Dirt] = {
    "white noise": _clean,
    "encoder, 4096 steps over the stroke": _encoder(4096),
    "encoder, 400 steps": _encoder(400),
    "noise coloured over 5 samples": _coloured(5),
    "noise coloured over 100 samples": _coloured(100),
    "a zero that wanders by 1 %": _wandering,
    "spikes of up to 10 %, one sample in 500": _spikes,
    "twelve losses of up to 30 samples": _lost,
    "stamps that jitter by 2 % of a period": _jitter,
    "stamps in seconds since 1970": _late,
    "hum of 50 Hz, 1 %": _hum,
    "1 % of noise on the measured input": _input_noise,
}


def rigs() -> list[Rig]:
    """Masses on springs with nothing, one thing and two things hidden."""
    model, drive = sprung(170.0, 5.0, 1.2), multisine(30.0, 8.0)

    def rig(hidden: str, effects: tuple[str, ...], force: Force) -> Rig:
        def rate(x: Sequence[float], u: float) -> Sequence[float]:
            return x[1], u - 200.0 * x[0] - 4.0 * x[1] - force(x[0], x[1])

        return Rig(hidden, hidden, effects, model, rate, (0.0, 0.0), PERIOD, SAMPLES, drive)

    return [
        rig("nothing", (), lambda *_: 0.0),
        rig("Coulomb friction 4", ("coulomb_friction",), lambda _, v: 4.0 * math.tanh(v / 2e-3)),
        rig("cubic stiffness 4000", ("cubic_stiffness",), lambda y, _: 4000.0 * y**3),
        rig("quadratic drag 4, offset 3", ("constant_offset", "quadratic_drag"),
            lambda _, v: 4.0 * v * abs(v) + 3.0),
    ]  # fmt: skip


def dirty(rig: Rig, dirt: Dirt, seed: int) -> eoi.Record:
    """One record."""
    draw = np.random.default_rng(seed)
    t, u, y = noiseless(rig, draw, rig.samples)
    t, u, y = dirt(t, u, y, draw)
    return eoi.Record(t, u, y, f"seed {seed}", hold="zero")


def main() -> None:
    """One row a rig and kind of dirt."""
    options = arguments(__doc__)
    warnings.simplefilter("ignore")
    report, rows = Report("Dirty records"), []
    report.add(
        f"{SAMPLES} samples at {1.0 / PERIOD:g} Hz; white noise of {NOISE:g} of the output's rms "
        f"where nothing else is said; records of seeds {SEEDS[0]} (fitted) and {SEEDS[1]} (held "
        "out); nothing set. *Right*: what is hidden is named and nothing else. Where the dirt is "
        "more than the records themselves predict, nothing named is right for nothing hidden."
    )
    for rig in rigs():
        for name, dirt in list(DIRT.items())[:: 4 if options.quick else 1]:
            fitted, held = (dirty(rig, dirt, seed) for seed in SEEDS)
            started = time.perf_counter()
            found = eoi.discover(rig.model, fitted, held)
            seconds = time.perf_counter() - started
            named = ", ".join(found.effects) or found.status.code.replace("_", " ")
            right = set(found.effects) == set(rig.effects)
            rows.append([rig.hidden, name, named, "yes" if right else "**no**", f"{seconds:.0f} s"])
    report.add(table(["hidden", "measured with", "named", "right", "time"], rows))
    report.close(__file__, options.write)


if __name__ == "__main__":
    main()
