r"""The Wiener–Hammerstein circuit (SYSID 2009): a filter, a diode, a filter.

Only its ends are measured. Third-order Chebyshev low-pass (4.4 kHz, 0.5 dB); a resistor, with a
diode and a second resistor to ground; third-order inverse Chebyshev low-pass (−40 dB from 5 kHz).
Tables of filters give the poles of the first and the zero of the second to start from; the rest is
a guess.

The diode takes the current i from w, over the resistor R and, in its branch, r:
w = (R + r) i + V ln(1 + i/I), with V its emission coefficient times kT/q. With q = (i + I)(R + r)/V
this is q + ln q = (w − level)/V: Wright's ω. The voltage behind R is w − share V q + constant,
share = R/(R + r).
"""

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

import eoi_jax as eoi

RATE = 51200.0  # [Hz]
INITIAL = 50  # samples that are not scored: those of the official loader
TRAIN, TEST = (5200, 105200), (105200, 184000)
_KHZ = 2e3 * np.pi  # rates in kHz: their sizes are alike
_NEWTON = 4  # steps, that leave a relative error of 6e-14 or less


def wright(z: Any) -> Any:
    """ω(z): ω + ln ω = z."""
    omega = jnp.logaddexp(0.0, z) + jnp.finfo(float).tiny  # the right asymptotes
    for _ in range(_NEWTON):
        omega = omega * (1.0 + z - jnp.log(omega)) / (1.0 + omega)
    return omega


def _limited(w: Any, p: Any) -> Any:
    diode = p.share * p.thermal_voltage * wright((w - p.level) / p.thermal_voltage)
    return p.gain * (w - diode + p.offset)


def output(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
    """Last pole, behind a pair of poles with zeros on the imaginary axis."""
    del t, u
    w, _, _, slow, rate = x.z
    ahead = _limited(w, p) - slow - 2.0 * p.damping_4 * rate / p.pole_4
    notched = slow + (p.pole_4 / p.zero) ** 2 * ahead
    return _KHZ * p.pole_3 * (notched - x.y[0, 0])


def inside(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
    """First filter (output, its rate, first pole); the pair of the second, and its rate."""
    del t
    w, climb, first, slow, rate = x.z
    return _KHZ * jnp.stack(
        [
            climb,
            p.pole_2**2 * (first - w) - 2.0 * p.damping_2 * p.pole_2 * climb,
            p.pole_1 * (u[0] - first),
            rate,
            p.pole_4**2 * (_limited(w, p) - slow) - 2.0 * p.damping_4 * p.pole_4 * rate,
        ]
    )


def plant() -> eoi.Plant:
    """At its starting values."""
    start = {
        "pole_1": 2.75, "pole_2": 4.69, "damping_2": 0.293, "pole_3": 2.0, "pole_4": 2.0,
        "damping_4": 0.5, "zero": 5.77, "gain": 0.8, "share": 0.5, "level": 0.5,
        "thermal_voltage": 0.1, "offset": 0.0,
    }  # fmt: skip
    positive = [key for key in start if key[:4] in ("pole", "damp", "zero", "ther")]
    units = {
        "pole_1": "kHz", "pole_2": "kHz", "pole_3": "kHz", "pole_4": "kHz", "zero": "kHz",
        "level": "V", "thermal_voltage": "V", "offset": "V", "drive": "V", "voltage": "V",
    }  # fmt: skip
    return eoi.Plant(
        output, start, relative_degree=1, inputs=("drive",), outputs=("voltage",),
        internal=inside, internal_initial=[0.0] * 5, units=units,
        bounds=dict.fromkeys(positive, (1e-3, np.inf)),
    )  # fmt: skip


def record(folder: Path, part: tuple[int, int], name: str) -> eoi.Record:
    """Of the file, with the input between samples that its band allows."""
    return eoi.read_record(
        folder / "wiener_hammerstein/WienerHammerBenchMark.mat",
        inputs="uBenchMark", outputs="yBenchMark", name=name, sample_period=1.0 / RATE,
        renames={"uBenchMark": "drive", "yBenchMark": "voltage"},
        units={"uBenchMark": "V", "yBenchMark": "V"}, hold="smooth", slice=part,
        burn_in=INITIAL / RATE,
    )  # fmt: skip
