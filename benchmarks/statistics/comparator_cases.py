"""The five plants of `comparators.py`, what drives them, and their second simulators."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import eoi_jax as eoi
from benchmarks import independent
from eoi_jax.data import excitation


@dataclass(frozen=True)
class Case:
    """A plant, what drives it, and its second simulator."""

    plant: eoi.Plant
    truth: eoi.Plant
    time: np.ndarray
    drive: Callable[[np.ndarray, int], np.ndarray]
    simulate: Callable[[np.ndarray], np.ndarray]

    def record(self, seed: int, level: float) -> eoi.Record:
        """The same drive for the same seed; white noise on every output."""
        u = self.drive(self.time, seed)
        y = self.simulate(u)
        sigma = level * np.sqrt(np.mean(y**2, axis=0))
        return eoi.Record(
            self.time, u, independent.with_sensor(y, sigma, 0.0, 100 + seed), f"seed {seed}",
            input_names=self.plant.inputs, output_names=self.plant.outputs, hold="zero",
        )  # fmt: skip


def case(
    plant: eoi.Plant,
    truth: eoi.Plant,
    period: float,
    samples: int,
    drive: Callable[[np.ndarray, int], np.ndarray],
    simulator: Callable[..., np.ndarray],
    **start: float,
) -> Case:
    time = period * np.arange(samples)
    p = truth.parameters
    return Case(plant, truth, time, drive, lambda u: simulator(p, time, u, "zero", **start))


def cases() -> tuple[Case, ...]:
    """The five plants, from the paper's nominal values (Duffing: the linear guess)."""
    make = eoi.plants
    return (
        case(
            make.level_tank(), make.level_tank(true=True), 2e-3, 10_000,
            lambda t, seed: 4.0 + excitation.multisine(t, 0.6, (0.05, 1.0), 12, seed),
            independent.level_tank, start=0.1,
        ),
        case(
            make.mass_spring_damper(), make.mass_spring_damper(true=True), 1e-3, 10_000,
            lambda t, seed: excitation.prbs(t, 1.0, 0.1, seed), independent.one_mass,
        ),
        case(
            make.three_mass_spring_damper(), make.three_mass_spring_damper(true=True), 1e-3, 10_000,
            lambda t, seed: excitation.prbs(t, 1.0, 0.05, seed), independent.three_masses,
        ),
        case(
            make.pendulum(), make.pendulum(true=True), 1e-3, 15_000,
            lambda t, seed: excitation.random_steps(t, -0.5, 0.5, 0.8, seed), independent.pendulum,
        ),
        case(
            make.duffing_oscillator(), make.duffing_oscillator(reference=True), 1 / 610.35, 5000,
            lambda t, seed: excitation.multisine(t, 0.05, (1.0, 150.0), 100, seed),
            independent.duffing,
        ),
    )  # fmt: skip
