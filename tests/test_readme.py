"""What the README shows is what happens."""

import contextlib
import io
import re
import subprocess
import warnings
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text()


def _block(language: str) -> str:
    found = re.search(rf"```{language}\n(.*?)```", README, re.DOTALL)
    assert found, f"README has no {language} block"
    return found.group(1)


def _parameters(text: str) -> dict[str, tuple[float, float]]:
    """Nominal value and estimate by name, from the rows that end in a change in per cent."""
    rows = re.findall(r"^(\w+) +(\S+) +(\S+) +\S+ +[+-][\d.]+ %", text, re.MULTILINE)
    return {name: (float(nominal), float(estimate)) for name, nominal, estimate in rows}


def test_the_example_prints_what_the_readme_shows():
    source, printed = _block("python"), io.StringIO()
    with warnings.catch_warnings(), contextlib.redirect_stdout(printed):
        # `configure` says that JAX runs already, which it does under pytest only.
        warnings.simplefilter("ignore", RuntimeWarning)
        exec(compile(source, "README.md", "exec"), {})
    shown, got = _parameters(_block("text")), _parameters(printed.getvalue())
    assert set(shown) == {"a", "b", "c", "d"}
    for name, (nominal, estimate) in shown.items():
        assert got[name][0] == nominal
        # Six digits are printed; the last may differ between processors.
        assert got[name][1] == pytest.approx(estimate, rel=5e-6)
    assert printed.getvalue().splitlines()[0] == _block("text").splitlines()[0]


def test_the_example_is_short():
    lines = [line for line in _block("python").splitlines() if line.strip()]
    assert len(lines) <= 15


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
