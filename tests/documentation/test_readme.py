"""What the README shows is what happens."""

import contextlib
import io
import re
import subprocess
import warnings
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text()


_SIMULATED, _MEASURED, _PARAMETERS = 0, 1, 2  # the examples, in their order


def _block(language: str, number: int) -> str:
    found = re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)
    assert len(found) > number, f"README has {len(found)} {language} blocks"
    return found[number]


def _printed(number: int) -> str:
    """What an example prints."""
    printed = io.StringIO()
    with warnings.catch_warnings(), contextlib.redirect_stdout(printed):
        # `configure` says that JAX runs already, which it does under pytest only.
        warnings.simplefilter("ignore", RuntimeWarning)
        exec(compile(_block("python", number), "README.md", "exec"), {})
    return printed.getvalue()


def _same_table(shown: list[str], got: list[str]) -> None:
    """The sentence, and the rows of the table of parameters."""
    assert got[0] == shown[0]
    names = tuple(f"{line.split()[0]} " for line in shown[3:])
    table = [line for line in got[2:] if line.startswith(names)]
    for line, want in zip(table[: len(names)], shown[3:], strict=True):
        assert line.split()[0] == want.split()[0]
        # Six digits are printed; the last ones may differ between processors.
        for number, wanted in zip(line.split()[1:4], want.split()[1:4], strict=True):
            assert number == wanted or float(number) == pytest.approx(float(wanted), rel=1e-3)


@pytest.mark.slow
def test_the_first_example_prints_what_the_readme_shows(tmp_path, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "agg")
    monkeypatch.chdir(tmp_path)
    got = _printed(_SIMULATED).splitlines()
    _same_table(_block("text", _SIMULATED).splitlines(), got)
    assert (tmp_path / "cart.png").stat().st_size > 50_000


@pytest.mark.slow
@pytest.mark.long
def test_the_measured_example_prints_what_the_readme_shows(data_directory, monkeypatch):
    folder = data_directory / "emps"
    if not folder.is_dir():
        pytest.skip(f"the record is absent ({folder}); set EOI_DATA to the folder of the records")
    monkeypatch.chdir(folder)
    got = _printed(_MEASURED).splitlines()
    _same_table(_block("text", _MEASURED).splitlines(), got)


def _parameters(text: str) -> dict[str, tuple[float, float]]:
    """Nominal value and estimate by name, from the rows that end in a change in per cent."""
    rows = re.findall(r"^(\w+) +(\S+) +(\S+) +\S+ +[+-][\d.]+ %", text, re.MULTILINE)
    return {name: (float(nominal), float(estimate)) for name, nominal, estimate in rows}


@pytest.mark.slow
def test_the_example_prints_what_the_readme_shows():
    printed = _printed(_PARAMETERS)
    shown, got = _parameters(_block("text", _PARAMETERS)), _parameters(printed)
    assert set(shown) == {"a", "b", "c", "d"}
    for name, (nominal, estimate) in shown.items():
        assert got[name][0] == nominal
        # Six digits are printed; the last may differ between processors.
        assert got[name][1] == pytest.approx(estimate, rel=5e-6)
    assert printed.splitlines()[0] == _block("text", _PARAMETERS).splitlines()[0]


@pytest.mark.parametrize("number", [_SIMULATED, _MEASURED, _PARAMETERS])
def test_the_examples_are_short(number):
    lines = [line for line in _block("python", number).splitlines() if line.strip()]
    assert len(lines) <= 20


def test_every_link_of_the_readme_leads_somewhere():
    links = re.findall(r"\]\((?!https?://)([^)#]+)\)", README)
    assert len(links) > 10
    missing = [link for link in links if not (ROOT / link).exists()]
    assert not missing


def test_ci_runs_the_second_command_of_the_readme():
    script = (ROOT / ".ci" / "run").read_text()
    pattern = re.search(r"grep -m 1 -E '([^']+)' README.md", script)
    assert pattern
    found = subprocess.run(
        ["grep", "-m", "1", "-E", pattern.group(1), str(ROOT / "README.md")],
        capture_output=True,
        text=True,
        check=True,
    ).stdout.strip()
    commands = re.findall(r"^python3 -m venv .*$", README, re.MULTILINE)
    assert len(commands) == 2
    assert found == commands[1]
