"""Results as values of JSON."""

import json

import pytest

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.report.provenance import json_values


def rig(t, x, u, p):
    return p.a * u[0] - x.y[0]


RIG = eoi.Plant(rig, {"a": 1.0}, (1, 1), ("flow", "heat"), ("left", "right"))
EVERY = (
    *effects.standard(), *effects.wider(), *effects.rare(), *effects.on_request(),
    *effects.couplings(RIG)[:3], *effects.input_products(RIG)[:3],
)  # fmt: skip


@pytest.mark.parametrize("effect", EVERY, ids=lambda effect: effect.label)
def test_what_an_effect_is_made_of_is_json(effect):
    form = json_values(vars(effect))
    assert json.loads(json.dumps(form, allow_nan=False)) == form
    signals = [vars(signal) for signal in getattr(effect, "signals", ())]
    assert form.get("signals", []) == signals
