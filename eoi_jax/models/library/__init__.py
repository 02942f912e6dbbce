"""Plants: the grey-box model, the paper's plants, and measured rigs."""

from eoi_jax.models.library.cascaded_tanks import cascaded_tanks as cascaded_tanks
from eoi_jax.models.library.duffing_oscillator import duffing_oscillator as duffing_oscillator
from eoi_jax.models.library.level_tank import level_tank as level_tank
from eoi_jax.models.library.mass_spring_damper import mass_spring_damper as mass_spring_damper
from eoi_jax.models.library.pendulum import pendulum as pendulum
from eoi_jax.models.library.positioning_system import positioning_system as positioning_system
from eoi_jax.models.library.propeller_arm import propeller_arm as propeller_arm
from eoi_jax.models.library.three_mass_spring_damper import (
    three_mass_spring_damper as three_mass_spring_damper,
)
from eoi_jax.models.plant import Plant as Plant
from eoi_jax.models.plant import State as State
