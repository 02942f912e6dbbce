"""`eoi sweep`: what it prints, writes and returns; how it goes on after an interrupt."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import eoi_jax as eoi
from eoi_jax.cli import build
from eoi_jax.cli import config as configs
from eoi_jax.cli.commands import app
from eoi_jax.cli.run_files import files_beside_run
from eoi_jax.compiler import jax_setup
from eoi_jax.estimation import sweep as sweeps
from eoi_jax.estimation.engines import Scan
from eoi_jax.estimation.sweep.sweep import sweep
from eoi_jax.report.sweep import sweep_figure

SMALL = """
name = "small"
plant = "mass_spring_damper"

[sweep]
cutoffs = [10.0, 20.0]
starts = [{ alpha = 30.0 }]
resamples = 2
chunk = 12

[[sweep.observers]]
kind = "second_order"
[sweep.observers.gains]
c1 = 60.0
c2 = [1e3, 2e3]
c3 = { low = 1.0, high = 100.0, count = 3 }

[[sweep.observers]]
kind = "super_twisting"
gains = { alpha = 300.0 }

[identify]
passes = 2
substeps = 1
smoothing = false

[simulate]
sample_period = 0.004
duration = 8.0
increments = { alpha = -20.0, beta = -2.0, rho = -0.2 }
noise = { position = 1e-5 }

[simulate.input.voltage]
kind = "random_steps"
low = -3.0
high = 3.0
holding_time = 0.5
"""
FILES = {"sweep.json", "report.txt", "figure.png", "config.toml", "sweep.zarr"}


@pytest.fixture(autouse=True)
def configured(monkeypatch: pytest.MonkeyPatch):
    """JAX runs already in this process, set up by conftest."""
    monkeypatch.setattr(jax_setup, "configure", lambda: None)


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "small.toml"
    path.write_text(SMALL)
    return path


def run(*words: object):
    return CliRunner().invoke(app, ["sweep", *map(str, words)])


def test_a_config_stands_for_the_same_call(config: Path):
    settings = configs.load(config)
    model = build.plant(settings, config.parent)
    given = build.sweep(settings, model)
    first, second = given["observers"]
    assert (first.kind, len(first)) == ("SecondOrder", 6)
    np.testing.assert_allclose(np.unique(first.labels["c3"]), [1.0, 10.0, 100.0])
    assert (second.kind, len(second)) == ("SuperTwisting", 1)
    assert [one.cutoff for one in given["lowpass"]] == [10.0, 20.0]
    assert [one["alpha"] for one in given["starts"]] == [model.parameters["alpha"], 30.0]
    assert given["resamples"] == 2


@pytest.mark.slow
@pytest.mark.long
def test_the_command_writes_a_store_and_goes_on_from_it(config: Path, tmp_path: Path, monkeypatch):
    calls = iter(range(100))
    whole = sweeps.sweep.sweep

    def interrupted(*args, **options):
        class Once(Scan):
            def run(self, *inner):
                if next(calls) == 9:
                    raise KeyboardInterrupt
                return super().run(*inner)

        return whole(*args, **options, engine=Once())

    monkeypatch.setattr(sweeps.sweep, "sweep", interrupted)
    first = run(config, "--output", tmp_path)
    assert first.exit_code == 130
    assert "the same command continues" in first.stderr
    monkeypatch.setattr(sweeps.sweep, "sweep", whole)
    second = run(config, "--output", tmp_path, "--json")
    assert second.exit_code == 0, second.stderr
    summary = json.loads(second.stdout)
    assert summary["finished"]
    assert summary["lanes"] == 2 * 7 * 2 * 3
    assert sum(summary["statuses"].values()) == summary["lanes"]
    assert summary["best"]["observer"]["kind"] in ("SecondOrder", "SuperTwisting")
    assert {one.name for one in (tmp_path / "small").iterdir()} == FILES
    assert files_beside_run(tmp_path / "small") == []
    stored = eoi.open_sweep(tmp_path / "small" / "sweep.zarr")
    assert stored.sizes["observer"] == 7
    assert "eoi sweep" in (tmp_path / "small" / "config.toml").read_text()
    third = run(config, "--output", tmp_path)
    assert third.exit_code == 0
    assert "over the resamples" in third.stdout
    figure = sweep_figure(stored)
    assert [one.get_xlabel() for one in figure.axes[:3]] == ["c2", "c3", "cut-off [rad/s]"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("c1 = 60.0", "c9 = 60.0", r"sweep.observers\[0\].gains.*c9"),
        ("c2 = [1e3, 2e3]", "c2 = []", r"sweep.observers\[0\].gains.*at least one value"),
        ("high = 100.0, count = 3", "high = 100.0", r"sweep.observers\[0\].gains.c3.count"),
        ("cutoffs = [10.0, 20.0]", "cutoffs = [10.0, -20.0]", r"sweep.cutoffs\[1\].*> 0"),
        ("cutoffs = [10.0, 20.0]", 'cutoffs = "low"', "sweep.cutoffs"),
        ("resamples = 2", "resamples = -2", "sweep.resamples"),
        ("chunk = 12", "chunks = 12", "Did you mean `chunk`"),
        ('kind = "super_twisting"', 'kind = "twisting"', r"sweep.observers\[1\].kind"),
        ("starts = [{ alpha = 30.0 }]", "starts = [{ gamma = 30.0 }]", "gamma"),
        ("starts = [{ alpha = 30.0 }]", "starts = 3", "sweep.starts` must be a list of tables"),
        ("gains = { alpha = 300.0 }", "gains = { alpha = true }", r"sweep.observers\[1\].gains"),
    ],
)
def test_a_wrong_config_is_named(config: Path, tmp_path: Path, old: str, new: str, message: str):
    assert old in SMALL
    config.write_text(SMALL.replace(old, new))
    done = run(config, "--output", tmp_path / "runs")
    assert done.exit_code == 2
    assert re.search(message, done.stderr), done.stderr
    assert not (tmp_path / "runs").exists()


def test_a_wrong_part_is_named(config: Path, tmp_path: Path):
    for part in ("3", "a/b", "3/3"):
        done = run(config, "--output", tmp_path, "--part", part)
        assert done.exit_code == 2
        assert "part" in done.stderr


def test_a_store_of_another_config_is_not_touched(config: Path, tmp_path: Path):
    settings = configs.load(config)
    model = build.plant(settings, config.parent)
    records = build.records(settings, model, config.parent)
    sweep(model, records, passes=1, store=tmp_path / "small" / "sweep.zarr")
    done = run(config, "--output", tmp_path)
    assert done.exit_code == 2
    assert "this very sweep" in done.stderr


@pytest.mark.slow
@pytest.mark.long
def test_the_installed_command_sweeps_the_built_in_pendulum(tmp_path: Path):
    environment = {**os.environ, "EOI_CACHE": str(tmp_path / "cache")}
    done = subprocess.run(
        [sys.executable, "-c", "from eoi_jax.cli.main import main; main()", "sweep"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / "runs" / "pendulum_sweep" / "sweep.json").read_text())
    assert summary["lanes"] == 1200
    (best,) = summary["best"]["records"].values()
    for name, truth in {"a": 81.0, "b": 1.7, "c": 0.3}.items():
        assert best["parameters"][name] == pytest.approx(truth, rel=0.01)
    assert done.stderr == ""
