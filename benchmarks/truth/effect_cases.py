"""Cases for the discovery of effects: records of plants that hide an effect, a pair, or nothing.

Truth values lie within 50 % of the paper's plants, inputs vary in kind, band and amplitude, and the
strength of each effect (rms of what it adds to y^(r), over the rms of y^(r)) is drawn log-uniformly
from 5 to 20 %. A case depends on its own seed, plant, truth, loop and noise only, not on what is
simulated beside it. Nothing here is shared with the library; the simulator is `effect_simulator`.

    python benchmarks/truth/effect_cases.py        # simulates a few and prints strengths and time
"""

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from zlib import crc32

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from benchmarks.truth.effect_excitation import KINDS, excitation, low_pass
from benchmarks.truth.effect_simulator import History, Lanes, simulate
from benchmarks.truth.effect_strength import Seen, design, strength

SAMPLES = 30_000
PERIOD = {"mass": 1e-3, "pendulum": 1e-3, "tank": 0.2}  # [s]
STRIDE = 4  # samples between kept states
COARSE = 8  # samples to a step of the runs in which amplitudes and strengths are found
ROUNDS = 6  # of them, and up to six times as many for cases that do not settle
LANES = 400  # simulated together; bounds the memory

# Declared parameters by name in `Case` -> name in the simulator, and the paper's value.
_MASS = {"k": ("stiffness", 140.9), "c": ("damping", 10.0), "b": ("gain", 2.25)}
_PENDULUM = {
    "a": ("gravity", 81.0), "b": ("damping", 1.7), "c": ("dry", 0.3), "d": ("gain", 99.0)
}  # fmt: skip
_TANK = {"alpha": ("outflow", 0.0268), "beta": ("gain", 0.0030)}
DECLARED: dict[str, tuple[str, dict[str, tuple[str, float]], str]] = {
    "mass": ("mass", _MASS, "y'' = -k y - c y' + b u"),
    "mass_no_spring": ("mass", {key: _MASS[key] for key in "cb"}, "y'' = -c y' + b u"),
    "mass_no_damper": ("mass", {key: _MASS[key] for key in "kb"}, "y'' = -k y + b u"),
    "pendulum": ("pendulum", _PENDULUM, "y'' = -a sin(y) - b y' - c sign(y') + d u"),
    "pendulum_frictionless": (
        "pendulum",
        {key: _PENDULUM[key] for key in "abd"},
        "y'' = -a sin(y) - b y' + d u",
    ),
    "pendulum_no_gravity": (
        "pendulum",
        {key: _PENDULUM[key] for key in "bcd"},
        "y'' = -b y' - c sign(y') + d u",
    ),
    "tank": ("tank", _TANK, "y' = -alpha sqrt(y) + beta u"),
}

_COMMON = (
    "constant_offset", "drift", "sinusoidal_disturbance", "input_dead_zone", "input_saturation",
    "input_delay", "input_quadratic", "actuator_lag",
)  # fmt: skip
_MECHANICAL = (
    *_COMMON, "coulomb_friction", "asymmetric_friction", "stribeck_friction", "quadratic_drag",
    "cubic_damping", "linear_stiffness", "quadratic_stiffness", "cubic_stiffness", "gravity",
    "position_ripple", "end_stop", "hysteresis",
)  # fmt: skip
# Single effects of each plant.
SINGLES: dict[str, tuple[tuple[str, ...], ...]] = {
    "mass": tuple((name,) for name in (*_MECHANICAL, "free_play", "viscous_friction")),
    "pendulum": tuple((name,) for name in _MECHANICAL),
    "tank": tuple((name,) for name in (*_COMMON, "leak", "overflow")),
}
_PAIRS = (
    ("coulomb_friction", "quadratic_drag"),
    ("coulomb_friction", "cubic_stiffness"),
    ("coulomb_friction", "input_delay"),
    ("coulomb_friction", "constant_offset"),
    ("quadratic_drag", "constant_offset"),
    ("sinusoidal_disturbance", "coulomb_friction"),
    ("cubic_stiffness", "input_saturation"),
    ("position_ripple", "coulomb_friction"),
    ("drift", "coulomb_friction"),
    ("input_dead_zone", "cubic_damping"),
    ("hysteresis", "constant_offset"),
    ("end_stop", "quadratic_drag"),
    ("sinusoidal_disturbance", "cubic_stiffness"),
    ("actuator_lag", "quadratic_stiffness"),
)
PAIRS: dict[str, tuple[tuple[str, ...], ...]] = {
    "mass": _PAIRS,
    "pendulum": _PAIRS,
    "tank": (
        ("leak", "constant_offset"),
        ("leak", "input_delay"),
        ("overflow", "sinusoidal_disturbance"),
        ("overflow", "drift"),
        ("input_dead_zone", "leak"),
        ("input_saturation", "constant_offset"),
    ),
}
_OUTSIDE = ("parametric_stiffness", "varying_input_gain", "coloured_disturbance", "random_shocks")
_OUTSIDE_MECHANICAL = (
    "van_der_pol", "input_times_position", "input_times_velocity", "second_resonance",
    "position_friction",
)  # fmt: skip
# What the library tries in free runs alone, where nothing else explains: it may be named.
_IN_FREE_RUNS = {
    "outside:input_times_position": "product",
    "outside:input_times_velocity": "product",
    "outside:van_der_pol": "displacement_damping",
    "outside:second_resonance": "second_mass",  # damped in its bearing
}
# Effects that the library does not have, or does not try at first.
OUTSIDE: dict[str, tuple[tuple[str, ...], ...]] = {
    "mass": tuple((f"outside:{name}",) for name in (*_OUTSIDE, *_OUTSIDE_MECHANICAL)),
    "pendulum": tuple((f"outside:{name}",) for name in (*_OUTSIDE, *_OUTSIDE_MECHANICAL)),
    "tank": tuple((f"outside:{name}",) for name in (*_OUTSIDE, "input_times_position")),
}


@dataclass(frozen=True)
class Case:
    """One record with its held-out twin, and what is hidden in them.

    Attributes:
        declared: what the model says: a key of `DECLARED`.
        truth: names of the hidden effects; () for none, "outside:..." if the library has no name.
        equivalent: another exact description of the same data, or ().
        loop: "open" or "feedback".
        noise: standard deviation of the white noise over the rms of y less its mean.
        seed: what it was drawn from.
        strength: of each effect, reached on this record.
        time, inputs, outputs, clean: estimation record, (N,) each; `clean` is y without noise.
        held_out_inputs, held_out_outputs, held_out_clean: another input, of another kind.
        start: declared parameters to start from, each wrong by up to 30 %.
        parameters: the true ones.
        effect_parameters: those of the effects, {"name.parameter": value}.
    """

    declared: str
    truth: tuple[str, ...]
    equivalent: tuple[str, ...]
    loop: str
    noise: float
    seed: int
    strength: tuple[float, ...]
    time: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray
    clean: np.ndarray
    held_out_inputs: np.ndarray
    held_out_outputs: np.ndarray
    held_out_clean: np.ndarray
    start: dict[str, float]
    parameters: dict[str, float]
    effect_parameters: dict[str, float]


def declared_model(name: str) -> str:
    """Equation of a declared model; its parameters are the keys of `Case.start`."""
    return DECLARED[name][2]


def declared_for(plant: str, truth: Sequence[str]) -> str:
    """The declared model that lacks exactly `truth`: a plant without its spring, for one."""
    if plant == "mass":
        lacking = {"linear_stiffness": "mass_no_spring", "viscous_friction": "mass_no_damper"}
    elif plant == "pendulum":
        lacking = {"gravity": "pendulum_no_gravity"}
        rubbing = ("coulomb_friction", "asymmetric_friction", "stribeck_friction")
        lacking |= dict.fromkeys((*rubbing, "outside:position_friction"), "pendulum_frictionless")
    else:
        lacking = {}
    return next((lacking[name] for name in truth if name in lacking), plant)


def cases(
    plant: str,
    truths: Sequence[tuple[str, ...]],
    seeds: Sequence[int] = (0,),
    noises: Sequence[float] = (1e-3,),
    loops: Sequence[str] = ("open",),
    samples: int = SAMPLES,
) -> list[Case]:
    """Simulate cases, all of them together.

    Args:
        plant: a key of `DECLARED`. For "mass" and "pendulum" the variant is chosen that lacks the
            truth (`declared_for`): a mass without spring for linear stiffness, and so on.
        truths: names of the hidden effects of each case: `SINGLES`, `PAIRS`, `OUTSIDE`, or ().
        seeds: one draw of everything for each.
        noises: relative standard deviations. In open loop they share one trajectory; under feedback
            noise goes through the controller, and each has its own.
        loops: "open", "feedback".
        samples: length of the records.

    Returns:
        A case for each truth, seed, loop and noise, in this order.
    """
    return list(iterate(plant, truths, seeds, noises, loops, samples))


def iterate(
    plant: str,
    truths: Sequence[tuple[str, ...]],
    seeds: Sequence[int] = (0,),
    noises: Sequence[float] = (1e-3,),
    loops: Sequence[str] = ("open",),
    samples: int = SAMPLES,
) -> Iterator[Case]:
    """`cases` one after another, never more than `LANES` lanes in memory (each case has two)."""
    drafts = [
        _Draft(declared_for(plant, truth), tuple(truth), loop, seed, level, samples)
        for truth in truths
        for seed in seeds
        for loop in loops
        for level in (noises if loop == "feedback" else (0.0,))
    ]
    for first in range(0, len(drafts), LANES // 2):
        group = drafts[first : first + LANES // 2]
        history = _simulate(group)
        for place, draft in enumerate(group):
            levels = (draft.noise,) if draft.loop == "feedback" else noises
            for level in levels:
                yield draft.case(history, place, level)


# -- one case before it is simulated ----------------------------------------------------------


class _Draft:
    """Everything of a case that is drawn, and what the coarse runs find: amplitude and effects."""

    def __init__(
        self, declared: str, truth: tuple[str, ...], loop: str, seed: int, noise: float, n: int
    ):
        self.declared, self.truth, self.loop, self.seed = declared, truth, loop, seed
        self.noise, self.n = noise, n
        self.plant, names, _ = DECLARED[declared]
        self.tank, self.period = self.plant == "tank", PERIOD[self.plant]
        key = crc32("/".join((declared, loop, *truth)).encode())
        rng = np.random.default_rng([seed, key])
        self.parameters = {name: v * rng.uniform(0.5, 1.5) for name, (_, v) in names.items()}
        off = rng.uniform(0.7, 1.3, len(names))
        self.start = {
            name: v * factor for (name, v), factor in zip(self.parameters.items(), off, strict=True)
        }
        self.base = {place: self.parameters[name] for name, (place, _) in names.items()}
        self.targets = np.exp(rng.uniform(np.log(0.05), np.log(0.2), len(truth)))
        self.draws = rng.uniform(size=(len(truth), 6))
        self._levels(rng)
        self.kinds = tuple(str(kind) for kind in rng.permutation(KINDS)[:2])
        self.drives = [self._excite(kind, rng) for kind in self.kinds]
        self.signals = [self._disturbance(rng) for _ in range(2)]
        self.key, self.settled, self.turns = key, False, 0
        self.effects: dict[str, dict[str, float]] = {}
        self.control = self._control(rng)
        self.scale = np.full(2, self._first_scale())
        self.sigma = np.zeros(2)

    def _levels(self, rng: np.random.Generator) -> None:
        """Pace of the plant [rad/s], its middle and the swing to reach."""
        self.middle, self.rest = 0.0, 0.0
        if self.tank:
            self.middle = rng.uniform(0.2, 0.5)
            self.rest = self.base["outflow"] * np.sqrt(self.middle) / self.base["gain"]
            self.pace = self.base["outflow"] / np.sqrt(self.middle)
            self.swing = self.middle * rng.uniform(0.55, 0.7)
            return
        nominal = {"mass": 140.9, "pendulum": 81.0}[self.plant]
        own = {"mass": "stiffness", "pendulum": "gravity"}[self.plant]
        self.pace = np.sqrt(self.base.get(own, nominal))
        self.swing = rng.uniform(1.3, 2.2)  # [rad]
        if self.plant == "mass" and "gravity" in self.truth:
            self.swing = rng.uniform(2.0, 2.6)
        elif self.plant == "mass":
            self.swing = np.exp(rng.uniform(np.log(0.05), np.log(0.5)))

    def _excite(self, kind: str, rng: np.random.Generator) -> np.ndarray:
        """Input of size one, in a band where the effect can be told from the plant."""
        fast = 1.5 if self.tank else 1.0
        if "free_play" in self.truth:
            fast = 2.2  # a gap of a tenth of the swing is weak only if the spring does not rule
        if self.tank and "input_dead_zone" in self.truth:
            fast = 4.0  # the pump must stop now and then: else a dead zone is an offset
        shape = excitation(kind, rng, self.n, self.period, fast * self.pace)
        if self.loop == "open" and self.declared in ("mass_no_spring", "pendulum_no_gravity"):
            shape -= low_pass(shape, 0.5 * self.pace, self.period)  # nothing brings it back
        return shape / np.max(np.abs(shape))

    def _control(self, rng: np.random.Generator) -> dict[str, float]:
        """PD on mechanics, PI on the tank; in units of the plant's own pace."""
        gains = dict.fromkeys(("kp", "ki", "kd"), 0.0) | {"tf": 0.2 / self.pace, "bias": self.rest}
        stiff, damp = rng.uniform(0.6, 2.0), rng.uniform(0.2, 0.6)
        if self.loop == "feedback" and self.tank:
            gains["kp"] = stiff * self.pace / self.base["gain"]
            gains["ki"] = 0.3 * gains["kp"] * self.pace
        elif self.loop == "feedback":
            gains["kp"] = stiff * self.pace**2 / self.base["gain"]
            gains["kd"] = damp * self.pace / self.base["gain"]
        return gains

    def _first_scale(self) -> float:
        if self.loop == "feedback":
            return self.swing
        if self.tank:
            return 0.8 * self.rest
        return self.swing * self.pace**2 / self.base["gain"]

    def _disturbance(self, rng: np.random.Generator) -> np.ndarray:
        """What the outside signals push with, rms 1; zeros where there is none."""
        out = np.zeros(self.n)
        if "outside:coloured_disturbance" in self.truth:
            out = low_pass(
                rng.standard_normal(self.n), rng.uniform(0.3, 1.5) * self.pace, self.period
            )
        if "outside:random_shocks" in self.truth:
            length = max(2, int(rng.uniform(0.1, 0.3) / self.pace / self.period))
            for first in rng.integers(0, self.n - length, size=rng.integers(20, 40)):
                out[first : first + length] += rng.uniform(0.4, 1.0) * rng.choice([-1.0, 1.0])
        size = np.sqrt(np.mean(out**2))
        return out / size if size > 0 else out

    def drive(self, lane: int) -> np.ndarray:
        """Input, or reference under feedback, at the present amplitude."""
        shape = self.scale[lane] * self.drives[lane]
        if self.loop == "feedback":
            return self.middle + shape
        return np.maximum(self.rest + shape, 0.0) if self.tank else shape

    def unit_noise(self, lane: int, level: float) -> np.ndarray:
        """White noise of variance one; another draw for each level."""
        key = crc32(f"{level:.3e}".encode())
        return np.random.default_rng([self.seed, self.key, key, lane]).standard_normal(self.n)

    def seen(self, history: History, place: int, period: float) -> Seen:
        """Trajectory of the estimation record, sampled at `period`, for strengths."""
        lane, kept, n = 2 * place, len(history.states), len(history.u)
        stride = -(-n // kept)
        return Seen(
            history.u[:, lane], history.states[..., lane], history.u[::stride, lane],
            np.arange(kept) * stride * period, np.sqrt(np.mean(history.highest[:, lane] ** 2)),
            period, self.period, self.base, self.pace, self.rest,
        )  # fmt: skip

    def adapt(self, history: History, place: int) -> None:
        """Bring amplitudes, noise and strengths closer to what they should be."""
        self.settled = True
        self.turns += 1  # smaller and smaller changes, or amplitude and effect chase each other
        outputs = [history.y[:, 2 * place + lane] for lane in range(2)]
        ratios = [self._ratio(y) for y in outputs]
        for lane, (y, ratio) in enumerate(zip(outputs, ratios, strict=True)):
            if not 0.75 < ratio < 1.3:  # near enough: let the effects settle
                self.scale[lane] *= np.clip(ratio, 0.4, 2.0) ** (0.8 / (1 + self.turns / 4))
                self.settled &= 0.6 < ratio < 1.7
            self.sigma[lane] = self.noise * np.std(y) if ratio > 0 else 0.0
        if ratios[0] <= 0.4:  # not yet the plant's range: an effect means nothing here
            self.effects = {}
        if not 0.4 < ratios[0] < 2.5:  # what damps stays, or the swing without it comes back
            return
        seen = replace(
            self.seen(history, place, COARSE * self.period),
            u=self._fine_input(history.u[:, 2 * place]),
            period=self.period,
        )
        for name, draws, target in zip(self.truth, self.draws, self.targets, strict=True):
            before = self.effects.get(name)
            self.effects[name] = design(name, draws, target, seen, before)
            self.settled &= before is not None and _close(self.effects[name], before)

    def _ratio(self, y: np.ndarray) -> float:
        """The swing to reach over the one that is, 0 where there is none."""
        reached = float(np.max(np.abs(y - self.middle)))
        return self.swing / reached if np.isfinite(reached) and reached > 0 else 0.0

    def _fine_input(self, coarse: np.ndarray) -> np.ndarray:
        """Estimation input at the final period; a controller's lies between its coarse samples."""
        if self.loop == "open":
            return self.drive(0)
        return np.interp(np.arange(self.n) / COARSE, np.arange(len(coarse)), coarse)

    def calm(self) -> None:
        """Begin again with less amplitude, and nothing that softens."""
        self.swing *= 0.85
        self.turns = 0
        self.scale *= 0.7
        self.draws[:, 5] = 0.9
        self.effects = {}

    def lost(self, history: History, place: int) -> bool:
        """Whether a record left the range of the plant."""
        y = history.y[:, 2 * place : 2 * place + 2]
        if not np.all(np.isfinite(y)) or any(name not in self.effects for name in self.truth):
            return True
        if self.tank:
            return bool(np.min(y) < 0.05 * self.middle or np.max(y) > 4 * self.middle)
        return bool(np.max(np.abs(y)) > (2.6 if self.plant == "pendulum" else 2 * self.swing))

    def case(self, history: History, place: int, level: float) -> Case:
        """The finished case at one level of noise."""
        clean = [history.y[:, 2 * place + lane].copy() for lane in range(2)]
        seen = [y + self.noise_of(lane, level, y) for lane, y in enumerate(clean)]
        inputs = [history.u[:, 2 * place + lane].copy() for lane in range(2)]
        trajectory = self.seen(history, place, self.period)
        reached = (float(strength(name, self.effects[name], trajectory)) for name in self.truth)
        return Case(
            self.declared, self.truth, self._equivalent(inputs), self.loop, level, self.seed,
            tuple(reached), np.arange(self.n) * self.period, inputs[0], seen[0], clean[0],
            inputs[1], seen[1], clean[1], self.start, self.parameters,
            {f"{name}.{key}": v for name, own in self.effects.items() for key, v in own.items()},
        )  # fmt: skip

    def noise_of(self, lane: int, level: float, y: np.ndarray | None = None) -> np.ndarray:
        """What the sensor adds. Under feedback its size was settled before the run."""
        size = level * np.std(y) if self.loop == "open" and y is not None else self.sigma[lane]
        return size * self.unit_noise(lane, level)

    def _equivalent(self, inputs: Sequence[np.ndarray]) -> tuple[str, ...]:
        """Dry friction with an offset is asymmetric friction; free runs show some outside."""
        in_free_runs = tuple(_IN_FREE_RUNS[name] for name in self.truth if name in _IN_FREE_RUNS)
        if in_free_runs:
            return in_free_runs
        if self.truth == ("asymmetric_friction",):
            return ("coulomb_friction", "constant_offset")
        if set(self.truth) == {"coulomb_friction", "constant_offset"}:
            offset = abs(self.effects["constant_offset"]["offset"])
            smaller = offset < self.effects["coulomb_friction"]["c"]
            return ("asymmetric_friction",) if smaller else ()
        if self.truth == ("constant_offset",) and self.base.get("dry"):
            return ("asymmetric_friction",)  # with the declared friction taken as its mean
        lowest = min(float(np.min(u)) for u in inputs)
        if self.truth == ("input_dead_zone",) and lowest > self.effects["input_dead_zone"]["g"]:
            return ("constant_offset",)
        return ()


def _close(one: Mapping[str, float], other: Mapping[str, float]) -> bool:
    """Whether two sets of parameters differ by less than a quarter."""
    return all(abs(one[key] - other[key]) <= 0.25 * abs(one[key]) for key in one)


# -- from drafts to trajectories --------------------------------------------------------------


def _simulate(drafts: Sequence[_Draft], attempts: int = 5) -> History:
    """Coarse runs until amplitudes and strengths hold, then the real one.

    A case that leaves its range in the real run begins again with less amplitude.
    """
    for turn in range(6 * ROUNDS):
        moving = [d for d in drafts if turn < ROUNDS or not d.settled]
        if not moving:
            break
        if turn and turn % (3 * ROUNDS) == 0:
            for draft in moving:
                draft.calm()
        coarse = simulate(_lanes(moving).decimated(COARSE))
        for place, draft in enumerate(moving):
            draft.adapt(coarse, place)
    history = simulate(_lanes(drafts), stride=STRIDE)
    wild = [place for place, draft in enumerate(drafts) if draft.lost(history, place)]
    if wild and attempts:
        for place in wild:
            drafts[place].calm()
        again = _simulate([drafts[place] for place in wild], attempts - 1)
        lanes = [2 * place + lane for place in wild for lane in range(2)]
        for old, new in zip(_arrays(history), _arrays(again), strict=True):
            old[..., lanes] = new
    elif wild:
        names = {(drafts[place].declared, drafts[place].truth) for place in wild}
        raise RuntimeError(f"cases that cannot be kept in range: {sorted(names)}")
    return history


def _arrays(history: History) -> tuple[np.ndarray, ...]:
    return history.y, history.u, history.states, history.highest


def _lanes(drafts: Sequence[_Draft]) -> Lanes:
    """Two lanes for each draft: estimation, held out."""
    both = [(draft, lane) for draft in drafts for lane in range(2)]
    places = ("stiffness", "gravity", "damping", "dry", "outflow", "gain")
    names = ("kp", "ki", "kd", "tf", "bias")
    closed = [draft.loop == "feedback" for draft, _ in both]
    silent = np.zeros(drafts[0].n)
    noise = [
        d.noise_of(lane, d.noise) if on else silent
        for (d, lane), on in zip(both, closed, strict=True)
    ]
    return Lanes(
        drafts[0].tank,
        {key: np.array([d.base.get(key, 0.0) for d, _ in both]) for key in places},
        tuple(d.effects for d, _ in both),
        np.stack([d.drive(lane) for d, lane in both], axis=1),
        np.stack(noise, axis=1),
        np.stack([d.signals[lane] for d, lane in both], axis=1),
        {key: np.array([d.control[key] for d, _ in both]) for key in names},
        np.array([d.middle for d, _ in both]),
        0.0 if drafts[0].tank else -np.inf,
        drafts[0].period,
    )


def main() -> None:
    """A few cases of each plant: strengths, ranges, time."""
    for plant in SINGLES:
        started = perf_counter()
        made = cases(plant, [(), *SINGLES[plant], *PAIRS[plant], *OUTSIDE[plant]])
        for case in made:
            reached = " ".join(f"{100 * one:5.1f}" for one in case.strength)
            size = np.max(np.abs(case.clean))
            print(f"{case.declared:22} {'+'.join(case.truth):50} {reached:12} % {size:8.3f}")
        print(f"{plant}: {len(made)} cases in {perf_counter() - started:.1f} s\n")


if __name__ == "__main__":
    main()
