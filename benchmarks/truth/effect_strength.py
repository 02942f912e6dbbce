"""How strong a hidden effect is on a trajectory, and the parameters that make it so strong."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from benchmarks.truth.effect_simulator import BOUC_WEN, DRY, FORCES, INPUTS, PARTNER, Point, V, Y

Values = dict[str, float]
Shapes = Callable[["Seen", np.ndarray], Values]

# What scales an effect that is proportional to one of its parameters.
GAIN: dict[str, tuple[str, ...]] = {
    "viscous_friction": ("c",), "quadratic_drag": ("c",), "cubic_damping": ("c",),
    "coulomb_friction": ("c",), "outside:van_der_pol": ("c",), "outside:position_friction": ("c",),
    "linear_stiffness": ("k",), "quadratic_stiffness": ("k",), "cubic_stiffness": ("k",),
    "end_stop": ("k",), "leak": ("k",), "overflow": ("k",), "hysteresis": ("k",),
    "outside:parametric_stiffness": ("k",), "outside:second_resonance": ("k",), "gravity": ("g",),
    "position_ripple": ("a",), "sinusoidal_disturbance": ("a",), "constant_offset": ("offset",),
    "drift": ("slope",), "input_quadratic": ("q",), "outside:input_times_position": ("q",),
    "outside:input_times_velocity": ("q",), "outside:varying_input_gain": ("q",),
    "outside:coloured_disturbance": ("gain",), "outside:random_shocks": ("gain",),
    "asymmetric_friction": ("c_plus", "c_minus"), "stribeck_friction": ("fc", "fs"),
}  # fmt: skip
# Either sign is physical, and drawn.
SIGNED = (
    "quadratic_stiffness", "cubic_stiffness", "constant_offset", "drift", "input_quadratic",
    "outside:input_times_position", "outside:input_times_velocity",
)  # fmt: skip


@dataclass(frozen=True)
class Seen:
    """One trajectory, and the plant that made it.

    Attributes:
        u: input at every sample of the run.
        states, some, time, rms: state (n, 6), input and time at some samples; rms of y^(r).
        period: between the samples of `u` [s].
        sample: period of the final record [s].
        base: true declared parameters, by the simulator's names.
        pace: of the plant [rad/s].
        rest: input before the record.
    """

    u: np.ndarray
    states: np.ndarray
    some: np.ndarray
    time: np.ndarray
    rms: float
    period: float
    sample: float
    base: Mapping[str, float]
    pace: float
    rest: float

    @property
    def y(self) -> np.ndarray:
        """Output."""
        return self.states[:, Y]

    @property
    def restoring(self) -> float:
        """What brings the plant back at its largest swing [unit of y^(r)]."""
        top = float(np.max(np.abs(self.y)))
        spring = self.base.get("stiffness", 0.0) * top
        return spring + self.base.get("gravity", 0.0) * float(np.sin(top))


def strength(name: str, p: Mapping[str, float], seen: Seen) -> float:
    """Rms of what the effect adds to y^(r), over the rms of y^(r).

    An effect of the input counts by the difference it makes. While the plant sticks, friction
    counts as zero.
    """
    y, v = seen.y, seen.states[:, V]
    point = Point(y, v, seen.some, seen.time, np.sign(v))
    gain = seen.base["gain"]
    if name in FORCES:
        added = FORCES[name](point, p)
    elif name in DRY:
        added = np.sign(v) * DRY[name](point, p)
    elif name in INPUTS:
        added = gain * (INPUTS[name](seen.u, p) - seen.u)
    elif name == "input_delay":
        return gain * _delayed(seen.u, p["tau"] / seen.period, seen.rest) / seen.rms
    elif name == "actuator_lag":
        keep = np.exp(-seen.period / p["time"])
        moved = np.asarray(lfilter([0.0, 1.0 - keep], [1.0, -keep], seen.u - seen.rest))
        added = gain * (moved + seen.rest - seen.u)
    elif name == "hysteresis":
        added = p["k"] * seen.states[:, BOUC_WEN]
    elif name == "outside:second_resonance":
        added = p["k"] * (seen.states[:, PARTNER] - y)
    else:
        return p["gain"] / seen.rms  # a signal of rms one
    return _rms(added) / seen.rms


def _delayed(u: np.ndarray, samples: float, rest: float) -> float:
    """Rms of u(t - tau) - u(t) for a held u; between whole samples the mean square is linear."""
    whole = int(samples)
    share = samples - whole
    near, far = (
        np.mean((np.concatenate((np.full(d, rest), u[: len(u) - d])) - u) ** 2)
        for d in (whole, whole + 1)
    )
    return float(np.sqrt((1 - share) * near + share * far))


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x**2)))


def design(
    name: str, draws: np.ndarray, target: float, seen: Seen, before: Mapping[str, float] | None
) -> Values:
    """Parameters that give an effect the strength `target` on this trajectory.

    Limits of what is physical or stable come first: then the strength is not reached.

    Args:
        name: of the effect.
        draws: six numbers in [0, 1), the case's own.
        target: strength asked for.
        seen: a trajectory of the plant.
        before: parameters that made the trajectory, or None if the effect was not in.
    """
    if name in _KNOB:
        return _turn(name, target, seen)
    values = _SHAPES[name](seen, draws) if name in _SHAPES else {}
    gains = GAIN[name]
    memory = name in ("hysteresis", "outside:second_resonance")
    if memory and before is None:
        size = _rms(seen.y) if name != "hysteresis" else 0.7 / (values["beta"] + values["gamma"])
        return values | {"k": target * seen.rms / size}
    unit = values | {key: values.get(key, 1.0) for key in gains}
    if memory and before is not None:
        unit["k"] = before["k"]
    reached = strength(name, unit, seen)
    ratio = target / reached if reached > 0 else 0.0
    if memory:
        ratio **= 0.6  # its state follows the trajectory that it changes
    factor = min(ratio, _limit(name, seen))
    sign = -1.0 if name in SIGNED and draws[5] < 0.5 else 1.0
    if name == "cubic_stiffness" and factor > _limit("quadratic_stiffness", seen, power=3):
        sign = 1.0  # as a softening one it would let the plant go
    return unit | {key: float(sign * factor * unit[key]) for key in gains}


def _limit(name: str, seen: Seen, power: int = 2) -> float:
    """Largest factor of the gain at which the plant stays where it is."""
    top, u = float(np.max(np.abs(seen.y))), float(np.max(np.abs(seen.u)))
    hold = 0.4 * seen.restoring
    if name == "quadratic_stiffness":
        return hold / top**power
    if name == "outside:parametric_stiffness" and seen.restoring > 0:
        return hold / top
    if name == "outside:input_times_position" and seen.restoring > 0:
        return hold / (top * u)
    if name == "outside:input_times_velocity":
        return 2.0 * seen.base.get("damping", 0.0) / u
    if name == "input_quadratic":
        return 0.4 / u
    return np.inf


def _turn(name: str, target: float, seen: Seen) -> Values:
    """Bisect the one parameter that sets the strength, within its range."""
    low, high = 0.0, 1.0
    for _ in range(24):
        middle = 0.5 * (low + high)
        if strength(name, _KNOB[name](seen, middle), seen) < target:
            low = middle
        else:
            high = middle
    return _KNOB[name](seen, 0.5 * (low + high))


def _between(low: float, high: float, x: float) -> float:
    return low + (high - low) * x


def _loud(seen: Seen, x: float) -> Values:
    """Level exceeded 5 % (x = 0) to 40 % of the time."""
    size = np.abs(seen.u)
    return {"level": _between(float(np.quantile(size, 0.95)), float(np.quantile(size, 0.6)), x)}


# Effects whose strength is not proportional to a parameter: x in [0, 1] from weak to strong.
_KNOB: dict[str, Callable[[Seen, float], Values]] = {
    "free_play": lambda s, x: {
        "k": s.base["stiffness"], "g": _between(0.1, 0.4, x) * float(np.max(np.abs(s.y)))
    },
    "input_dead_zone": lambda s, x: {"g": _between(0.005, 0.6, x) * float(np.max(np.abs(s.u)))},
    "input_saturation": _loud,
    "input_delay": lambda s, x: {"tau": _between(1.5, 50.0, x) * s.sample},
    "actuator_lag": lambda s, x: {"time": _between(2.0, 80.0, x) * s.sample},
}  # fmt: skip


def _contact(seen: Seen, draws: np.ndarray) -> Values:
    """A stop touched 3 to 20 % of the time, on either side."""
    side = 1.0 if draws[0] < 0.5 else -1.0
    share = _between(0.03, 0.2, draws[1])
    return {"side": side, "s": side * float(np.quantile(side * seen.y, 1 - share))}


def _loop(seen: Seen, draws: np.ndarray) -> Values:
    """Bouc-Wen: the height of the loop in units of y, and its shape."""
    both = 1.0 / (_between(0.2, 0.8, draws[0]) * _rms(seen.y))
    share = _between(-0.3, 0.5, draws[1])
    return {"A": 1.0, "beta": (1 - share) * both, "gamma": share * both}


def _uneven(seen: Seen, draws: np.ndarray) -> Values:
    del seen
    ratio = _between(0.3, 0.7, draws[0])
    return {"c_plus": 1.0, "c_minus": ratio} if draws[1] < 0.5 else {"c_plus": ratio, "c_minus": 1}


def _parity(seen: Seen, draws: np.ndarray) -> Values:
    del seen
    return {"odd": float(draws[0] < 0.5)}


def _wave(low: float, high: float) -> Shapes:
    """Angular frequency log-uniform in multiples of the plant's pace, and a phase."""
    return lambda s, d: {
        "w": float(s.pace * np.exp(_between(np.log(low), np.log(high), d[0]))),
        "phi": float(2 * np.pi * d[1]),
    }


_SHAPES: dict[str, Shapes] = {
    "position_ripple": lambda s, d: {
        "kappa": float(2 * np.pi * _between(3, 15, d[0]) / np.ptp(s.y)),
        "phi": float(2 * np.pi * d[1]),
    },
    "end_stop": _contact,
    "overflow": lambda s, d: {"level": float(np.quantile(s.y, _between(0.97, 0.8, d[1])))},
    "hysteresis": _loop,
    "asymmetric_friction": _uneven,
    "stribeck_friction": lambda s, d: {
        "fc": 1.0, "fs": _between(1.5, 3.0, d[0]),
        "vs": _between(0.05, 0.3, d[1]) * _rms(s.states[:, V]),
    },
    "sinusoidal_disturbance": _wave(0.2, 2.5),
    "input_quadratic": _parity,
    "outside:parametric_stiffness": _wave(0.3, 1.5),
    "outside:varying_input_gain": _wave(0.02, 0.3),
    "outside:second_resonance": lambda s, d: {
        "w": _between(0.5, 2.0, d[0]) * s.pace, "zeta": _between(0.02, 0.1, d[1])
    },
}  # fmt: skip
