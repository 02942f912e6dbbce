"""Identify dynamical systems from the equivalent output injection of sliding-mode observers."""

from eoi_jax import effects as effects
from eoi_jax import observers as observers
from eoi_jax import plants as plants
from eoi_jax.backend import configure as configure
from eoi_jax.checks import RecordWarning as RecordWarning
from eoi_jax.data import excitation as excitation
from eoi_jax.data.readers import read_record as read_record
from eoi_jax.data.record import Record as Record
from eoi_jax.diagnose import diagnose as diagnose
from eoi_jax.diagnosis import Diagnosis as Diagnosis
from eoi_jax.discover import discover as discover
from eoi_jax.discovery import Discovery as Discovery
from eoi_jax.identify import Identification as Identification
from eoi_jax.identify import identify as identify
from eoi_jax.lowpass import LowPass as LowPass
from eoi_jax.plants.plant import Plant as Plant
from eoi_jax.plants.plant import State as State
from eoi_jax.refine import Refinement as Refinement
from eoi_jax.refine import refine as refine
from eoi_jax.results import Status as Status
from eoi_jax.simulate import simulate as simulate
from eoi_jax.store import load as load
from eoi_jax.validate import Validation as Validation
from eoi_jax.validate import validate as validate
