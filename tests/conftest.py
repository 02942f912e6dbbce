"""Float64, strict dtypes, shapes checked at run time; where the measured data lie."""

import ctypes
import os
import shutil
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import jaxtyping
import pytest

from tests import checked_types

# Each thread of the compiler would have a pool of its own, that keeps what another could use: some
# hundred megabytes of a worker. Before JAX starts these threads; as MALLOC_ARENA_MAX=1 does.
# Arrays of a megabyte and more go back to the system when they are released; glibc would come to
# keep all of up to 32 MB.
_M_ARENA_MAX, _M_MMAP_THRESHOLD = -8, -3
if sys.platform == "linux" and hasattr(ctypes.CDLL(None), "mallopt"):
    ctypes.CDLL(None).mallopt(_M_ARENA_MAX, 1)
    ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, 1_000_000)

# Hardly any of what XLA compiles here runs long: without LLVM's optimisations that takes half the
# time. Processes that a test starts inherit it.
_QUICK = "--xla_backend_optimization_level=0"
os.environ["XLA_FLAGS"] = f"{_QUICK} {os.environ.get('XLA_FLAGS', '')}".strip()

_BROWSERS = ("chromium", "chromium-browser", "google-chrome")
_FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
)  # fmt: skip

_REPOSITORY = Path(__file__).resolve().parents[1]
# Scalar programs hold no arrays, and make a hundred thousand nodes: checking each call of theirs
# would take longer than all else.
_SCALAR = {"derivatives", "graph", "trace", "loop", "llvm", "instructions"}
_MODULES = [
    ".".join(path.relative_to(_REPOSITORY).with_suffix("").parts)
    for path in (_REPOSITORY / "eoi_jax").rglob("*.py")
    # `stored_classes` checks shapes itself, across calls; the hook would give each call a context
    # of its own. Typer calls a command with values that are not of the annotated types.
    if path.stem not in {"__init__", "stored_classes", "commands", *_SCALAR}
]

jaxtyping.jaxtyped = checked_types.jaxtyped
# For good: names are imported at first use.
jaxtyping.install_import_hook(_MODULES, "beartype.beartype")

from eoi_jax.compiler.jax_setup import configure  # noqa: E402

with warnings.catch_warnings():
    warnings.simplefilter("ignore", RuntimeWarning)  # the backend may run already under plugins
    configure(cache=False, programs=32)  # hardly a test needs those of another one


def pytest_configure(config: pytest.Config) -> None:
    """A record that was changed says so; named here, for pytest would import it before the hook."""
    config.addinivalue_line("filterwarnings", "default::eoi_jax._checks.RecordWarning")


@pytest.fixture(autouse=True)
def compilation_cache() -> Iterator[None]:
    """Pages and examples set the folder of compiled code; no test finds what another kept there."""
    folder = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    yield
    jax.config.update("jax_compilation_cache_dir", folder)


@pytest.fixture(scope="session")
def data_directory() -> Path:
    """Folder of the measured records; tests that need it say so when they skip."""
    folder = Path(os.environ.get("EOI_DATA", _REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"measured records are absent ({folder}); set EOI_DATA to their folder")
    return folder


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A browser without a network."""
    webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")
    service = pytest.importorskip("selenium.webdriver.chrome.service")
    program = next(filter(None, map(shutil.which, _BROWSERS)), None)
    driver = shutil.which("chromedriver")
    if program is None or driver is None:
        pytest.skip("no page is looked at: chromium or chromedriver is not installed")
    options = webdriver.ChromeOptions()
    options.binary_location = program
    for flag in (*_FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    started = webdriver.Chrome(options=options, service=service.Service(driver))
    started.execute_cdp_cmd("Network.enable", {})
    none = {"offline": True, "latency": 0, "downloadThroughput": 0, "uploadThroughput": 0}
    started.execute_cdp_cmd("Network.emulateNetworkConditions", none)
    yield started
    started.quit()
