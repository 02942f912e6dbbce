"""A discovery put together by hand: real fits and free runs, a ranking that is written down."""

import dataclasses
from functools import cache

import numpy as np

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.discovery.result import Added, Discovery, Evidence, Rival
from eoi_jax.models.augmented import augmented, place


def mass_on_spring(t, x, u, p):
    position, rate = x.y
    return (u - p.viscous * rate - p.spring * position) / p.mass


UNITS = {"mass": "kg", "viscous": "N s/m", "spring": "N/m", "force": "N", "position": "m"}
DECLARED = eoi.Plant(
    mass_on_spring,
    {"mass": 1.3, "viscous": 1.5, "spring": 15.0},
    relative_degree=2,
    inputs=("force",),
    outputs=("position",),
    units=UNITS,
    name="mass on a spring",
)
PLACED = (
    place(DECLARED, effects.CoulombFriction(), 0),
    place(DECLARED, effects.ConstantOffset(), 0),
)
TRUTH = {"mass": 2.0, "viscous": 1.0, "spring": 20.0}
HIDDEN = {"coulomb_friction": 0.2, "constant_offset": -0.1}  # [m/s²]: 0.4 N and -0.2 N
DEAD_ZONE = Rival("input_dead_zone", "", "force", 0.34)
STANDINGS = ((0.9996, ()), (0.62, (DEAD_ZONE, Rival("drift", "", "position", 0.04))))


def record(seed: int) -> eoi.Record:
    time = 2e-3 * np.arange(6000)
    drive = eoi.excitation.multisine(time, 2.0, (0.2, 3.0), 12, seed=seed)
    true = augmented(DECLARED.with_parameters(TRUTH), PLACED, HIDDEN)
    clean = eoi.simulate(true, time, drive)
    noise = 1e-5 * np.random.default_rng(seed).standard_normal(clean.outputs.shape)
    return eoi.Record(time, drive, clean.outputs + noise, name=f"run {seed}", hold="linear")


HELD_OUT = record(2)


@cache
def discovery() -> Discovery:
    """Coulomb friction and an offset found in run 1, judged on run 2."""
    records, held_out = record(1), HELD_OUT
    before = eoi.identify(DECLARED, records)
    model = augmented(before.plant, PLACED, dict.fromkeys(HIDDEN, 0.0))
    after = eoi.identify(model, records, before.observer, before.lowpass)
    runs = [
        eoi.validate(one.plant, held_out, window=window)
        for window in (None, 2.0)
        for one in (before, after)
    ]
    added = [
        Added(
            one.effect,
            "position",
            {name: after.parameters[name] for name in one.names},
            {name: after.standard_errors[name] for name in one.names},
            one.effect.sentence,
            probability=probability,
            rivals=rivals,
        )
        for one, (probability, rivals) in zip(PLACED, STANDINGS, strict=True)
    ]
    ranking = (
        Evidence("coulomb_friction", "position", {"coulomb_friction": 0.2}, 0.8, 300.0, ""),
        Evidence("stribeck_friction", "position", {}, 0.79, 290.0, "contains coulomb friction"),
        Evidence("input_dead_zone", "force", {}, 0.2, -3.0, "held-out error grows"),
    )
    return Discovery(
        effects=tuple(HIDDEN),
        added=tuple(added),
        ranking=ranking,
        ambiguous_with=("asymmetric_friction",),
        advice="A record with a smaller offset would tell them apart.",
        explained=0.983,
        before=runs[0],
        after=runs[1],
        windows_before=runs[2],
        windows_after=runs[3],
        declared=before,
        found=after,
        plant=after.plant,
        status=eoi.Status("complete", "Nothing is left above the noise."),
        notes=("run 1: a note.",),
        in_sample=False,
        held_out=(HELD_OUT,),
    )


@dataclasses.dataclass(frozen=True)
class Jerk(effects.AbstractTerm):
    """An effect of the user's own."""

    name = "jerk"
    sentence = "a jerk"
    gains = (effects.Parameter("", "{f}"),)
    power: int = 3

    def term(self, at, gain, shape):
        return gain[0] * at.t**self.power
