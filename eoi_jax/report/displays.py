"""What each class of results prints, draws and gives to pandas and xarray."""

from collections.abc import Callable
from dataclasses import replace

from eoi_jax._display import data_frame, dataset, figure, findings, text
from eoi_jax.comparison.result import Comparison
from eoi_jax.data.inspection import Inspection
from eoi_jax.data.interchange import record_to_pandas, record_to_xarray
from eoi_jax.data.record import Record
from eoi_jax.discovery.diagnosis import Diagnosis
from eoi_jax.discovery.result import Discovery
from eoi_jax.estimation.identify import Identification
from eoi_jax.estimation.online import OnlineEstimator
from eoi_jax.estimation.parameter_history import ParameterHistory
from eoi_jax.models.plant import Plant
from eoi_jax.models.stored_classes import stored_form
from eoi_jax.refinement.remaining import Remaining
from eoi_jax.refinement.result import Refinement
from eoi_jax.report import data_frames, diagnosis
from eoi_jax.report.comparison import comparison_figure, comparison_text
from eoi_jax.report.discovery import discovery_text, texts
from eoi_jax.report.discovery_figures import discovery_figure
from eoi_jax.report.estimate_figures import profile_figure, refinement_figure, uncertainty_figure
from eoi_jax.report.figures import identification_figure, record_figure, validation_figure
from eoi_jax.report.inspection import inspection_figure, inspection_text
from eoi_jax.report.online import online_text
from eoi_jax.report.parameter_history import history_figure, history_text
from eoi_jax.report.plant import plant_text
from eoi_jax.report.record import record_text
from eoi_jax.report.remaining import remaining_figure, remaining_text
from eoi_jax.report.tables import (
    identification_text,
    profile_text,
    refinement_table,
    uncertainty_text,
    validation_text,
)
from eoi_jax.simulation.validation import Validation
from eoi_jax.uncertainty.profile_likelihood import Profile
from eoi_jax.uncertainty.uncertainty import Uncertainty

TABLES: dict[type, Callable] = {
    Plant: plant_text,
    Record: record_text,
    Inspection: inspection_text,
    Identification: identification_text,
    ParameterHistory: history_text,
    OnlineEstimator: online_text,
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
DATA_FRAMES: dict[type, Callable] = {
    Record: record_to_pandas,
    Inspection: data_frames.inspection_frame,
    Identification: data_frames.parameter_frame,
    ParameterHistory: data_frames.history_frame,
    Validation: data_frames.validation_frame,
    Diagnosis: data_frames.diagnosis_frame,
    Refinement: data_frames.parameter_frame,
    Remaining: data_frames.remaining_frame,
    Uncertainty: data_frames.parameter_frame,
    Profile: data_frames.profile_frame,
    Comparison: data_frames.comparison_frame,
    Discovery: data_frames.discovery_frame,
}
DATASETS: dict[type, Callable] = {  # of the others that of their data frame
    Record: record_to_xarray,
    Identification: data_frames.identification_dataset,
    Validation: data_frames.validation_dataset,
    Refinement: data_frames.refinement_dataset,
}
_REGISTERED = ((text, TABLES), (figure, FIGURES), (data_frame, DATA_FRAMES), (dataset, DATASETS))
for function, implementations in _REGISTERED:
    for kind, implementation in implementations.items():
        function.register(kind, implementation)
findings.register(Diagnosis, diagnosis.findings)


@stored_form.register
def _with_texts(result: Discovery) -> Discovery:
    """With its equation as text, for a file that cannot hold the model."""
    try:
        return replace(result, texts=texts(result))
    except ValueError:  # loaded without its model from a file without texts
        return result
