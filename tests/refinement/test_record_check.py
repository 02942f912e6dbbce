"""Records that ask for different parameters, and such as do not."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import eoi_jax as eoi

TIME = np.arange(0.0, 8.0, 0.02)


def plant(**options):
    return eoi.Plant(
        lambda t, x, u, p: [(u[0] - p.b * x.y[1, 0] - p.k * x.y[0, 0]) / p.m],
        inputs=("force",), outputs=("x",), relative_degree=2,
        parameters={"m": 1.2, "b": 0.5, "k": 5.0}, units={"m": "kg"}, **options,
    )  # fmt: skip


def run(mass, seed, noise=1e-3, stop=0.0):
    """A mass on a spring, which may have a cubic part."""
    draw = np.random.default_rng(seed)
    waves, phases = draw.uniform(0.5, 5.0, 6), draw.uniform(0.0, 6.0, 6)

    def force(t):
        return np.sum(np.sin(np.multiply.outer(t, waves) + phases), axis=-1)

    def rates(t, x):
        return [x[1], (force(t) - 0.4 * x[1] - 4.0 * x[0] - stop * x[0] ** 3) / mass]

    y = solve_ivp(rates, (0.0, 8.0), [0.0, 0.0], t_eval=TIME, rtol=1e-9, atol=1e-11).y[0]
    y = y + noise * draw.standard_normal(len(y))
    return eoi.Record(TIME, force(TIME), y, name=f"{mass} kg", hold="smooth")


def asking(result):
    return [note for note in result.notes if "ask for different values" in note]


def test_a_load_that_changes_from_record_to_record_is_named_with_its_values():
    masses = 0.8, 1.0, 1.3
    result = eoi.refine(plant(), [run(mass, i) for i, mass in enumerate(masses)])
    (note,) = asking(result)
    assert "different values of m (" in note
    assert "b (" not in note
    assert "k (" not in note
    for mass, text in zip(masses, note.split("values of m (")[1].split(", "), strict=False):
        value, error = (float(part.split()[0]) for part in text.split(" ± "))
        assert abs(value - mass) < 4.0 * error < 0.02
        assert f"kg in {mass} kg" in text


@pytest.mark.parametrize("stop", [0.0, 3.0])
def test_records_of_one_load_are_not_told_apart(stop):
    """Nor where the model lacks something, and noise is not the same in all."""
    for seed in range(8):
        records = [
            run(1.0, 3 * seed + i, noise, stop) for i, noise in enumerate((1e-3, 2e-3, 5e-3))
        ]
        assert not asking(eoi.refine(plant(), records))
