"""A cell whose charge at the start of a record is not known, and records from several ones."""

import numpy as np
from output_cases import BATTERY, cell_states, current

import eoi_jax as eoi

NOISE = 1e-3
FAR = {"R0": 0.02, "R1": 0.03, "C1": 1000.0, "Q": 6000.0}


def cell(initial, **values):
    """The cell as text; v1 starts at rest unless `initial` says more."""
    return eoi.plant_from_text(
        {"soc": "-current/Q", "v1": "(current - v1/R1)/C1"}, {**FAR, **values}, ["voltage"],
        ["current"], output={"voltage": "3.4 + 0.7*soc - R0*current - v1"}, initial=initial,
    )  # fmt: skip


def run(seed, soc, lacking=0.0, samples=1200):
    """A record from a charge; so many volts a second more are what the model lacks."""
    amperes = current(seed, samples)
    z = cell_states(amperes)
    noise = NOISE * np.random.default_rng(seed).standard_normal(samples)
    time = np.arange(samples, dtype=float)
    y = 3.4 + 0.7 * (z[:, 0] - 0.8 + soc) - BATTERY["R0"] * amperes - z[:, 1] + lacking * time
    return eoi.Record(time, amperes, y + noise, f"from {soc:g}", input_names=["current"],
                      output_names=["voltage"], hold="zero")  # fmt: skip
