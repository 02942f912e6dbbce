"""The scripts in `examples/`, made short: what their texts promise is so, and figures are drawn."""

import importlib.util
from pathlib import Path
from types import ModuleType

import matplotlib as mpl
import numpy as np
import pytest

FOLDER = Path(__file__).resolve().parents[2] / "examples"


def script(name: str) -> ModuleType:
    """An example as a module."""
    spec = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(autouse=True)
def _draw_into_files(monkeypatch):
    monkeypatch.setitem(mpl.rcParams, "backend", "agg")


def test_every_example_is_tried_here_and_shown_in_the_documentation():
    tried = {"first_rig", "gain_sweep", "missing_effect", "noisy_record"}
    assert {path.stem for path in FOLDER.glob("*.py")} == tried
    page = (FOLDER.parent / "docs" / "examples.md").read_text()
    for name in tried:
        assert f"## `{name}.py`" in page
        assert f"(images/examples/{name}.png)" in page


@pytest.mark.filterwarnings("ignore:.*backend:RuntimeWarning")
def test_the_first_rig_is_identified_from_parameters_that_are_far_off(tmp_path):
    found = script("first_rig").main(tmp_path, duration=10.0)
    assert found.status.ok
    # Some 30 standard errors of the estimate, of either parameter.
    assert found.parameters == pytest.approx({"alpha": 1.6047, "beta": 0.5030075}, rel=1e-3)
    assert (tmp_path / "first_rig.png").stat().st_size > 10_000


@pytest.mark.filterwarnings("ignore:.*backend:RuntimeWarning")
def test_the_missing_effect_is_the_gap_in_the_spring(tmp_path):
    tried = ["free_play", "cubic_stiffness", "coulomb_friction"]
    found = script("missing_effect").main(tmp_path, effects=tried)
    assert found.effects == ("free_play",)
    assert found.plant.parameters["free_play_gap"] == pytest.approx(0.2, rel=0.01)
    assert (tmp_path / "missing_effect.png").stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*backend:RuntimeWarning")
def test_the_best_gains_of_the_sweep_slide(tmp_path):
    chosen = script("gain_sweep").main(tmp_path, relays=6, dampings=2)
    assert float(chosen["sliding_fraction"].squeeze()) > 0.9
    assert (tmp_path / "gain_sweep.png").stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*backend:RuntimeWarning")
def test_instruments_take_the_bias_of_a_noisy_record_away(tmp_path):
    errors = script("noisy_record").main(tmp_path, levels=(1e-2,))
    # A factor of ten as a rule; three is beyond the scatter of one record.
    assert errors["instruments"][0] < errors["plain"][0] / 3.0
    assert np.isfinite(errors["refined"][0])
    assert (tmp_path / "noisy_record.png").stat().st_size > 10_000
