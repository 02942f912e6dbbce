"""Tables and figures of each class of results, for `str(result)` and `.plot()`."""

from collections.abc import Callable
from dataclasses import replace

from eoi_jax._display import figure, findings, text
from eoi_jax.comparison.compare import Comparison
from eoi_jax.data.inspection import Inspection
from eoi_jax.data.record import Record
from eoi_jax.discovery.diagnosis import Diagnosis
from eoi_jax.discovery.result import Discovery
from eoi_jax.estimation.identify import Identification
from eoi_jax.estimation.parameter_history import ParameterHistory
from eoi_jax.models.stored_classes import stored_form
from eoi_jax.refinement.remaining import Remaining
from eoi_jax.refinement.result import Refinement
from eoi_jax.report import diagnosis
from eoi_jax.report.comparison import comparison_figure, comparison_text
from eoi_jax.report.discovery import discovery_text, texts
from eoi_jax.report.discovery_figures import discovery_figure
from eoi_jax.report.estimate_figures import profile_figure, refinement_figure, uncertainty_figure
from eoi_jax.report.figures import identification_figure, record_figure, validation_figure
from eoi_jax.report.inspection import inspection_figure, inspection_text
from eoi_jax.report.parameter_history import history_figure, history_text
from eoi_jax.report.record import record_text
from eoi_jax.report.remaining import remaining_figure, remaining_text
from eoi_jax.report.tables import (
    identification_text,
    profile_text,
    refinement_table,
    uncertainty_text,
    validation_text,
)
from eoi_jax.simulation.validate import Validation
from eoi_jax.uncertainty.profile_likelihood import Profile
from eoi_jax.uncertainty.uncertainty import Uncertainty

TABLES: dict[type, Callable] = {
    Record: record_text,
    Inspection: inspection_text,
    Identification: identification_text,
    ParameterHistory: history_text,
    Validation: validation_text,
    Diagnosis: diagnosis.diagnosis_text,
    Refinement: refinement_table,
    Remaining: remaining_text,
    Uncertainty: uncertainty_text,
    Profile: profile_text,
    Comparison: comparison_text,
    Discovery: discovery_text,
}
FIGURES: dict[type, Callable] = {
    Record: record_figure,
    Inspection: inspection_figure,
    Identification: identification_figure,
    ParameterHistory: history_figure,
    Validation: validation_figure,
    Diagnosis: diagnosis.diagnosis_figure,
    Refinement: refinement_figure,
    Remaining: remaining_figure,
    Uncertainty: uncertainty_figure,
    Profile: profile_figure,
    Comparison: comparison_figure,
    Discovery: discovery_figure,
}
for kind, function in TABLES.items():
    text.register(kind, function)
for kind, function in FIGURES.items():
    figure.register(kind, function)
findings.register(Diagnosis, diagnosis.findings)


@stored_form.register
def _with_texts(result: Discovery) -> Discovery:
    """With its equation as text, for a file that cannot hold the model."""
    try:
        return replace(result, texts=texts(result))
    except ValueError:  # loaded without its model from a file without texts
        return result
