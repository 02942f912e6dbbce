r"""Unstable plants with the controller in the loop: against windows with the recorded input.

    python benchmarks/truth/controller_in_loop.py [--quick] [--write]

The plants of `unstable_plants.py`, simulated by SciPy (DOP853, relative tolerance 1e-10), under a
digital controller that reads the *measured* outputs: state feedback with filtered differences for
the rates, so noise acts on the plant through it. The record has its input and the reference.
`identify` starts from a model that is 10 to 50 % wrong; `refine` goes on from its answer in
windows, driven by the recorded input, and with `controller=` over whole records. Twice: with noise
alone, and with a disturbance beside the input, white from sample to sample, that nobody logged.
"""

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
import eoi_jax as eoi
from benchmarks.common import Report, arguments, table
from benchmarks.truth.unstable_plants import Rig, rigs, rms

# Noise over the rms of each output about its mean, disturbance over that of the input.
CONDITIONS = ((1e-3, 0.0), (1e-2, 0.0), (1e-3, 0.02))
SEEDS = 6
FILTER = 2.0  # time constant of the filtered differences [samples]


@dataclass(frozen=True)
class Feedback:
    """State feedback with filtered differences, of outputs and rates.

    Attributes:
        rig: with its law.
    """

    rig: Rig

    @property
    def outputs(self) -> int:
        """Number of outputs."""
        return len(self.rig.model.outputs)

    @property
    def states(self) -> int:
        """Of the controller: outputs of the sample before, and filtered rates."""
        return 2 * self.outputs if self.rig.states > self.outputs else 0

    def step(self, xp: Any, r: Any, y: Any, s: Any) -> tuple[Any, Any]:
        """Input and next state, by NumPy or JAX; y (ny, ...), s (states, ...)."""
        if not self.states:
            return self.rig.control(r, y), s
        before, rate = s[: self.outputs], s[self.outputs :]
        rate = (FILTER * self.rig.period * rate + y - before) / ((FILTER + 1) * self.rig.period)
        return self.rig.control(r, xp.concatenate([y, rate])), xp.concatenate([y, rate])

    def controller(self) -> eoi.Controller:
        """The same for the library."""

        def law(t: Any, r: Any, y: Any, s: Any) -> Any:
            del t
            u, states = self.step(jnp, r[0], y, s)
            return (u, states) if self.states else u

        return eoi.Controller(law, "r", states=self.states)


def measured(rig: Rig, seeds: range, samples: int, noise: float, push: float) -> list[eoi.Record]:
    """Records of one condition, simulated side by side."""
    truth, shape = list(rig.truth.values()), (rig.states, len(seeds))
    draws = [np.random.default_rng([seed, round(1e6 * noise), round(1e6 * push)]) for seed in seeds]
    steps = -(-samples // rig.each)
    levels = np.stack([
        rig.high * np.random.default_rng(seed).uniform(-1.0, 1.0, steps) for seed in seeds
    ])  # fmt: skip
    reference = np.repeat(levels, rig.each, axis=1)[:, :samples]
    feedback = Feedback(rig)
    ny = feedback.outputs
    # A first time without noise, for the sizes of outputs and input.
    spread, deviation = np.zeros(ny), 0.0
    for _ in range(2):
        x = np.zeros(shape)
        x[0] = 0.01 if rig.name == "magnetic levitation" else 0.0
        s = np.zeros((feedback.states, len(seeds)))
        s[:ny] = x[:ny] if feedback.states else s[:ny]
        inputs, outputs = np.empty((len(seeds), samples)), np.empty((len(seeds), samples, ny))
        white = np.stack([draw.standard_normal((samples, ny + 1)) for draw in draws])
        for k in range(samples):
            y = x[:ny] + noise * spread[:, None] * white[:, k, :ny].T
            u, s = feedback.step(np, reference[:, k], y, s)
            inputs[:, k], outputs[:, k] = u, y.T
            acting = u + push * deviation * white[:, k, ny]

            def right(_: float, flat: np.ndarray, u: np.ndarray = acting) -> np.ndarray:
                return rig.rate(flat.reshape(shape), u, truth).ravel()

            x = solve_ivp(right, (0.0, rig.period), x.ravel(), method="DOP853",
                          rtol=1e-10, atol=1e-12).y[:, -1].reshape(shape)  # fmt: skip
        spread = np.mean(np.std(outputs, axis=1), axis=0)
        deviation = float(np.mean(np.std(inputs, axis=1)))
    time_axis = rig.period * np.arange(samples)
    return [
        eoi.Record(time_axis, np.stack([u, r], axis=1), y, f"seed {seed}",
                   input_names=(*rig.model.inputs, "r"), output_names=rig.model.outputs)
        for seed, u, r, y in zip(seeds, inputs, reference, outputs, strict=True)
    ]  # fmt: skip


@dataclass(frozen=True)
class Fitted:
    """One refinement: relative errors of the parameters, these over their standard errors."""

    relative: np.ndarray
    standard: np.ndarray
    seconds: float
    status: str


def fitted(rig: Rig, refinement: eoi.Refinement, seconds: float) -> Fitted:
    """Compared with the truth."""
    names = list(rig.truth)
    errors = np.asarray([refinement.parameters[name] - rig.truth[name] for name in names])
    with np.errstate(divide="ignore", invalid="ignore"):
        standard = errors / np.asarray([refinement.standard_errors[name] for name in names])
    return Fitted(errors / np.asarray(list(rig.truth.values())), standard, seconds,
                  refinement.status.code)  # fmt: skip


def main() -> None:
    """One row for each rig and condition."""
    options = arguments(__doc__)
    seeds = range(700, 700 + (2 if options.quick else SEEDS))
    report = Report("Unstable plants with the controller in the loop")
    report.add(
        f"{len(seeds)} records a row, seeds from {seeds[0]}. Relative errors of the parameters in "
        "per cent, rms over parameters and records; in brackets the errors over their own standard "
        "errors, rms. Times: median of `refine`."
    )
    rows = []
    for rig in rigs():
        samples = rig.samples // 2 if options.quick else rig.samples
        controller = Feedback(rig).controller()
        for noise, push in CONDITIONS:
            before, windows, loop = [], [], []
            for record in measured(rig, seeds, samples, noise, push):
                driven = record.without_inputs("r").with_hold("zero")
                passes = eoi.identify(rig.model, driven)
                truth = np.asarray(list(rig.truth.values()))
                values = np.asarray([passes.parameters[name] for name in rig.truth])
                before.append(values / truth - 1.0)
                started = time.perf_counter()
                short = eoi.refine(passes, driven)
                between = time.perf_counter()
                whole = eoi.refine(passes, record, controller=controller)
                windows.append(fitted(rig, short, between - started))
                loop.append(fitted(rig, whole, time.perf_counter() - between))
            cells = [rig.name, f"{noise:g}", f"{push:g}", f"{100 * rms(before):.3g}"]
            for fits in (windows, loop):
                relative, standard = (
                    rms([getattr(fit, name) for fit in fits]) for name in ("relative", "standard")
                )
                seconds = np.median([fit.seconds for fit in fits])
                statuses = ", ".join(sorted({fit.status for fit in fits}))
                cells += [f"{100 * relative:.3g} ({standard:.2g})", f"{seconds:.1f} s", statuses]
            rows.append(cells)
            print(rows[-1], flush=True)
    report.add(table(["rig", "noise", "disturbance", "passes", "windows", "time", "status",
                      "in the loop", "time", "status"], rows))  # fmt: skip
    report.close(__file__, options.write)


if __name__ == "__main__":
    main()
