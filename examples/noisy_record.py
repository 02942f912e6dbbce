"""One record at several levels of noise: the plain passes, with instruments, and refined.

    python examples/noisy_record.py [FOLDER]

writes `noisy_record.png`. Noise in the velocity biases the plain passes, for dry friction asks for
its sign; instruments take the bias away, a factor of ten. After them refinement finds little to do:
both are as good as the record.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import eoi_jax as eoi


def main(folder: Path, levels: Sequence[float] = (1e-4, 1e-3, 1e-2, 5e-2)) -> dict[str, list]:
    """Worst relative error of the parameters for each level of noise, printed and drawn."""
    eoi.configure()
    model = eoi.plants.pendulum()
    truth = 1.1 * np.asarray(model.theta)
    time = np.arange(0.0, 30.0, 0.005)
    force = eoi.excitation.random_steps(time, -0.3, 0.3, 1.0, seed=1)
    clean = eoi.simulate(model.with_parameters(truth), time, force, hold="zero")
    scale = float(np.std(clean.outputs))
    errors: dict[str, list] = {"plain": [], "instruments": [], "refined": []}
    for level in levels:
        noise = level * scale * np.random.default_rng(0).standard_normal(clean.outputs.shape)
        record = clean.with_outputs(clean.outputs + noise, f"noise {level:g}")
        found = eoi.identify(model, record, instruments=True)
        estimates = {
            "plain": found.plant.theta - found.correction,  # before instruments moved it
            "instruments": found.plant.theta,
            "refined": eoi.refine(found, record).plant.theta,
        }
        for method, theta in estimates.items():
            worst = float(np.max(np.abs(np.asarray(theta) / truth - 1.0)))
            errors[method].append(worst)
            print(f"noise {level:g} of the output, {method}: worst error {100 * worst:.2g} %")
    _draw(folder / "noisy_record.png", levels, errors)
    return errors


def _draw(path: Path, levels: Sequence[float], errors: dict[str, list]) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.0), layout="constrained")
    axes = figure.add_subplot()
    for (method, values), mark in zip(errors.items(), "osD", strict=True):
        axes.loglog(levels, 100 * np.asarray(values), marker=mark, label=method)
    axes.set_xlabel("noise over the output, rms")
    axes.set_ylabel("worst error of a parameter [%]")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(path)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
