"""Float64, strict dtypes, shapes checked at run time; where the measured data lie."""

import os
import warnings
from pathlib import Path

import pytest
from jaxtyping import install_import_hook

with install_import_hook("eoi_jax", "beartype.beartype"):
    import eoi_jax  # noqa: F401
    from eoi_jax.backend import configure

with warnings.catch_warnings():
    warnings.simplefilter("ignore", RuntimeWarning)  # the backend may run already under plugins
    configure(cache=False)


def pytest_configure(config: pytest.Config) -> None:
    """A record that was changed says so; named here, for pytest would import it before the hook."""
    config.addinivalue_line("filterwarnings", "default::eoi_jax.checks.RecordWarning")


_REPOSITORY = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def data_directory() -> Path:
    """Folder of the measured records; tests that need it say so when they skip."""
    folder = Path(os.environ.get("EOI_DATA", _REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"measured records are absent ({folder}); set EOI_DATA to their folder")
    return folder
