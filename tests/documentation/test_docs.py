"""The documentation: its pages run and show what is printed, it builds, and names everything."""

import ast
import importlib
import inspect
import itertools
import os
import re
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pages
import pytest
import typer

import eoi_jax as eoi
from eoi_jax.cli.commands import app
from eoi_jax.models.equations.display import equation_text

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
# The longest first, so that two workers share them evenly.
EXECUTED = (
    "tutorial",
    "uncertainty",
    "extend",
    "inside_jax",
    "real_time",
    "observers",
    "records",
    "results",
)


@pytest.mark.slow
@pytest.mark.parametrize("name", EXECUTED)
def test_a_page_runs_and_shows_what_it_prints(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    assert pages.Page(DOCS / f"{name}.md").run() > 1


@pytest.mark.slow
@pytest.mark.long
def test_the_page_on_measured_data_shows_what_it_prints(data_directory, tmp_path, monkeypatch):
    if not (data_directory / "silverbox").is_dir():
        pytest.skip(f"the silverbox is absent ({data_directory}); set EOI_DATA to its folder")
    pytest.importorskip("pooch", reason="the extra `docs` is not installed")
    monkeypatch.setenv("EOI_DATA", str(data_directory.resolve()))
    monkeypatch.setenv("MPLBACKEND", "agg")
    monkeypatch.chdir(tmp_path)
    assert pages.Page(DOCS / "measured.md").run() > 1


def test_the_first_page_shows_the_example_of_the_readme():
    """Which has a test of its own."""
    readme, first = (path.read_text() for path in (ROOT / "README.md", DOCS / "index.md"))
    for language in ("python", "text"):
        pattern = re.compile(rf"```{language}\n.*?```", re.DOTALL)
        assert pattern.findall(readme)[0] == pattern.findall(first)[0]


@pytest.mark.parametrize(
    ("shown", "printed"),
    [
        ("a 1.00\nb 2", "a 1.02\nb 2"),
        ("a 1\n...\nc 3", "a 1\nb 2\nb 3\nc 3"),
        ("a 1\n...", "a 1\nb 2"),
        ("...\nb 2", "a 1\nb 2"),
        ("left 1e-14", "left -3e-15"),
    ],
)
def test_a_page_may_round_and_leave_lines_out(shown, printed):
    pages.shows(shown, printed)


@pytest.mark.parametrize(
    ("shown", "printed"),
    [
        ("a 1.00\nb 2", "a 1.10\nb 2"),
        ("a 1\nb 2", "a 1\nb 2\nc 3"),
        ("a 1\nb 2\nc 3", "a 1\nb 2"),
        ("a 1\n...\nd 3", "a 1\nb 2\nc 3"),
        ("a 1\n...\nb 2", "a 1\nb 2\nc 3"),
        ("a 1", "b 1"),
        ("left 1e-14", "left 3e-5"),
        ("a 1 2", "a 1"),
    ],
)
def test_a_page_that_shows_something_else_is_found(shown, printed):
    with pytest.raises(AssertionError):
        pages.shows(shown, printed)


TEXTS = ["README.md", *sorted(str(path.relative_to(ROOT)) for path in DOCS.rglob("*.md"))]


@pytest.mark.parametrize("path", TEXTS)
def test_names_in_the_code_of_a_page_exist(path):
    """Also where a page needs files that nobody has here, and is not run."""
    for block in re.findall(r"```python\n(.*?)```", (ROOT / path).read_text(), re.DOTALL):
        for node in ast.walk(ast.parse(block)):
            names = []
            while isinstance(node, ast.Attribute):
                names.append(node.attr)
                node = node.value
            if isinstance(node, ast.Name) and node.id == "eoi":
                item = eoi
                for name in reversed(names):
                    item = getattr(item, name)


def exists(address: str) -> bool:
    """Whether a name of the package exists: of a module, a class, or a field of one."""
    item: Any = eoi
    for name in address.split("."):
        if name in getattr(item, "__dataclass_fields__", {}):
            return True
        if not hasattr(item, name):
            return False
        item = getattr(item, name)
    return True


@pytest.mark.parametrize("path", TEXTS)
def test_names_in_the_text_of_a_page_exist(path):
    for address in re.findall(r"`eoi\.([\w.]*\w)[^`]*`", (ROOT / path).read_text()):
        assert exists(address), address


def test_the_page_for_users_of_other_tools_names_what_exists():
    text = (DOCS / "coming_from.md").read_text()
    named = set(re.findall(r"eoi\.([\w.]*\w)", text)) - {"py"}
    assert len(named) > 30
    assert [address for address in named if not exists(address)] == []
    commands = set(re.findall(r"`eoi ([a-z]+) ", text))
    assert commands <= set(typer.main.get_command(app).commands)  # type: ignore[attr-defined]
    rows = [line for line in text.splitlines() if line.startswith("| ")]
    assert all(len(re.findall(r"(?<!\\)\|", row)) == 4 for row in rows)


# -- the site ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The built site; a broken link or reference ends the build."""
    pytest.importorskip("mkdocs", reason="the extra `docs` is not installed")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder


def test_the_site_needs_no_network(site):
    for path in (*site.rglob("*.html"), *site.rglob("*.css")):
        loaded = re.findall(
            r"<(?:script|img|iframe|source)[^>]* src=\"([^\"]+)\""
            r"|<link[^>]* href=\"([^\"]+)\"|url\(([^)]+)\)|@import \"([^\"]+)\"",
            path.read_text(encoding="utf-8"),
        )
        outside = [one for found in loaded for one in found if re.match(r"[\"']?(https?:)?//", one)]
        assert not outside, path.name


def test_formulas_are_mathml(site):
    text = (site / "method.html").read_text(encoding="utf-8")
    assert text.count("<math") > 50
    assert "$" not in re.sub(r"<(script|style|annotation).*?</\1>", "", text, flags=re.DOTALL)


@pytest.mark.parametrize("width", [390, 1400])
def test_pages_fit_a_phone_and_a_desk(site, browser, width):
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    for name in ("index", "coming_from", "other_tools", "reference/effects"):
        browser.get_log("browser")
        browser.get((site / f"{name}.html").as_uri())
        wide = "return document.documentElement.scrollWidth"
        assert browser.execute_script(wide) <= width, name
        assert browser.get_log("browser") == [], name


def test_pages_that_are_opened_as_files_can_be_searched(site, browser):
    size = {"width": 1400, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    browser.get((site / "index.html").as_uri())
    browser.execute_script("document.querySelector('[for=__search].md-header__button').click()")
    field = browser.find_element("css selector", ".md-search__input")
    deadline, found = time.monotonic() + 20.0, []
    while not field.is_displayed() and time.monotonic() < deadline:
        time.sleep(0.1)
    field.send_keys("stribeck")
    while not found and time.monotonic() < deadline:
        time.sleep(0.1)
        found = browser.find_elements("css selector", ".md-search-result__link")
    assert any("reference/effects.html" in link.get_attribute("href") for link in found)


def test_the_wheel_holds_no_documentation():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    wheel = settings["tool"]["hatch"]["build"]["targets"]["wheel"]
    held = {path.split("/")[0] for path in (*wheel["packages"], *wheel["force-include"])}
    assert not held & {"docs", "examples", "tests"}


# -- the reference ----------------------------------------------------------------------------

MODULES = (
    "eoi_jax",
    "eoi_jax.comparators",
    "eoi_jax.data.excitation",
    "eoi_jax.effects",
    "eoi_jax.engines",
    "eoi_jax.observers",
    "eoi_jax.plants",
)


def public() -> Iterator[tuple[str, Any]]:
    """Every public function and class by the address at which it is defined."""
    for name in MODULES:
        module = importlib.import_module(name)
        for key in dir(module):
            item = getattr(module, key)
            own = getattr(item, "__module__", "").startswith("eoi_jax")
            if key.startswith("_") or not own or not (inspect.isclass(item) or callable(item)):
                continue
            if name.endswith("excitation") and item.__module__ != name:
                continue  # what it imports
            yield f"{item.__module__}.{key}", item


PUBLIC = dict(sorted(public()))


def test_every_public_name_is_in_the_reference():
    text = "".join(path.read_text() for path in (DOCS / "reference").glob("*.md"))
    named = re.findall(r"^::: (\S+)$", text, re.MULTILINE)
    assert len(named) == len(set(named))
    missing = sorted(set(PUBLIC) - set(named))
    assert not missing, "add `::: name` to a page of docs/reference"


def test_the_reference_names_every_verb_in_its_overview():
    text = (DOCS / "reference" / "index.md").read_text()
    for name in dir(eoi):
        if not name.startswith("_") and inspect.isfunction(getattr(eoi, name)):
            assert f"`{name}`" in text, name


def test_the_table_of_effects_is_that_of_the_library():
    text = (DOCS / "reference" / "effects.md").read_text().replace("\\|", "|")
    rare = eoi.effects.rare()
    library = eoi.effects.standard(), rare, eoi.effects.wider(), eoi.effects.on_request()
    for one in itertools.chain(*library):
        remark = " (rare)" if one in rare else ""
        assert f"| `{one.name}`{remark} | {one.sentence} | `{printed(one)}` |" in text


def printed(effect: Any) -> str:
    """What an effect adds to the output's highest derivative, to another's; or makes of u."""
    inner = isinstance(effect, eoi.effects.AbstractInternalEffect)
    if isinstance(effect, eoi.effects.AbstractCascade) and effect.name != "sensor_lag":
        return shown(eoi.Plant(stream, {"a": 1.0, "inlet": 1.0}), effect)
    states = {"internal": lambda t, x, u, p: 0.0 * x.z, "internal_initial": [0.0]}
    return shown(
        eoi.Plant(lambda t, x, u, p: 0.0 * x.y[0], {"none": 1.0}, 2, **states if inner else {}),
        effect,
    )


def stream(t, x, u, p):
    return p.a * u * (p.inlet - x.y[0])


def shown(plant: eoi.Plant, effect: Any) -> str:
    added = SimpleNamespace(
        effect=effect,
        output=effect.channels(plant)[0],
        parameters=dict.fromkeys([part.name or "c" for part in effect.parameters], 1.0),
        against="",
        through="",
    )
    lines = [line for line in equation_text(plant, [added]).splitlines() if line != "y'' = 0"]
    return "; ".join(re.sub(r"^(with |y'+ = )", "", line) for line in lines)


def test_the_page_on_comparing_has_every_method():
    text = (DOCS / "compare.md").read_text()
    assert re.findall(r"^\| `(\w+)` \|", text, re.MULTILINE) == [
        one.name for one in (*eoi.comparators.standard(), *eoi.comparators.on_request())
    ]


def test_the_command_line_s_page_names_every_command():
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    module, function = scripts["scripts"]["eoi"].split(":")
    call = f"from {module} import {function}; {function}()"
    settings = {**os.environ, "COLUMNS": "100", "NO_COLOR": "1", "PYTHONIOENCODING": "utf-8"}
    shown = subprocess.run(
        [sys.executable, "-c", call, "--help"],
        cwd=ROOT,
        env=settings,
        capture_output=True,
        encoding="utf-8",
        check=True,
    ).stdout
    commands = re.findall(r"^\W*([a-z]+) {2,}\w", shown.split("Commands")[1], re.MULTILINE)
    assert {"identify", "discover"} <= set(commands)
    text = (DOCS / "reference" / "cli.md").read_text()
    for name in commands:
        assert f"| `eoi {name} " in text, f"docs/reference/cli.md lacks `eoi {name}`"


# -- docstrings -------------------------------------------------------------------------------


def fields(item: Any) -> list[str]:
    """What a reader meets: arguments of a function, those of a class, or its fields."""
    if inspect.isclass(item) and (inspect.isabstract(item) or issubclass(item, Warning)):
        return []
    if inspect.isclass(item) and issubclass(item, eoi.effects.AbstractEffect):
        return []
    return [key for key in inspect.signature(item).parameters if key not in ("self", "cls")]


@pytest.mark.parametrize("name", PUBLIC)
def test_every_argument_is_described(name):
    text = inspect.getdoc(PUBLIC[name]) or ""
    listed = " ".join(re.findall(r"^\s+((?:\w+, )*\w+)(?: and \w+)?:", text, re.MULTILINE))
    for key in fields(PUBLIC[name]):
        assert re.search(rf"\b{key}\b", listed) or f"`{key}`" in text or f"{key}:" in text, key


# What has a unit wherever it appears.
UNITS = {
    "transient": r"\[s\]",
    "window": r"\[s\]",
    "sample_period": r"\[s\]",
    "burn_in": r"\[s\]",
    "cutoff": r"\[rad/s\]",
    "smoothing": r"\[rad/s\]",
    "frequency": r"\[Hz\]|\[rad/s\]",
    "time": r"\[s\b",
}


@pytest.mark.parametrize("name", PUBLIC)
def test_times_and_frequencies_have_their_unit(name):
    text = inspect.getdoc(PUBLIC[name]) or ""
    for key in fields(PUBLIC[name]):
        entry = re.search(rf"^(\s+)(?:\w+, )*{key}(?:, \w+)*:(.*?)(?=^\1\w|^\S|\Z)", text, _ENTRY)
        if key in UNITS and entry:
            assert re.search(UNITS[key], entry.group(2)), f"{key} of {name} has no unit"


_ENTRY = re.MULTILINE | re.DOTALL


def checks(item: Any) -> bool:
    """Whether it, or what builds it, calls one of the package's checks."""
    made_by = ("__init__", "__post_init__", "__check_init__")
    makers = [vars(item)[key] for key in made_by if key in vars(item)]
    for maker in makers if inspect.isclass(item) else [item]:
        code = getattr(inspect.unwrap(maker), "__code__", None)
        if code and any(re.match(r"_?check(_|$)", name) for name in code.co_names):
            return True
    return False


@pytest.mark.parametrize("name", [name for name, item in PUBLIC.items() if checks(item)])
def test_what_checks_its_arguments_says_what_it_raises(name):
    assert "Raises:" in (inspect.getdoc(PUBLIC[name]) or "")


# What follows a publication, besides observers; the rest is ours, or bookkeeping.
PUBLISHED = {
    "bootstrap",
    "diagnose",
    "discover",
    "identify",
    "profile",
    "refine",
    "remaining",
    "FirstOrder",
    "HighOrder",
    "Hysteresis",
    "InternalOverflow",
    "OptimistixOutputError",
    "OutputError",
    "SecondOrder",
    "StateVariableFilter",
    "StateVariableInstruments",
    "SuperTwisting",
    "VSSDirect",
}


def test_a_published_method_names_its_source():
    found = {name.split(".")[-1]: item for name, item in PUBLIC.items()}
    assert set(found) >= PUBLISHED
    for name in PUBLISHED:
        assert "Source:" in (inspect.getdoc(found[name]) or ""), name
