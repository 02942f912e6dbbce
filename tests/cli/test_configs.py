"""Every shipped config gives an answer, on a shortened record."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from eoi_jax.cli import build, config
from eoi_jax.cli.actions import config_file
from eoi_jax.estimation.identify import identify

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
SAMPLES = 12_000


@pytest.mark.slow
@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.toml")), ids=lambda path: path.stem)
def test_every_shipped_config_gives_an_answer(path: Path, request: pytest.FixtureRequest):
    settings = config.load(path)
    model = build.plant(settings, path.parent)
    if settings.simulate is None:
        data = request.getfixturevalue("data_directory")
        records = [record[:SAMPLES] for record in build.records(settings, model, path.parent, data)]
    else:
        # The experiment at full length, its samples fewer.
        period = max(settings.simulate.sample_period, settings.simulate.duration / SAMPLES)
        coarse = msgspec.structs.replace(settings.simulate, sample_period=period)
        settings = msgspec.structs.replace(settings, simulate=coarse)
        records = build.records(settings, model, path.parent)
    table = settings.identify
    result = identify(
        model,
        records,
        build.observer(settings),
        build.lowpass(settings),
        table.passes,
        transient=table.transient,
        substeps=table.substeps,
        smoothing=table.smoothing,
    )
    assert result.status.ok, result.status
    assert np.all(result.index[result.best_pass] < result.index[0])
    assert np.all(result.sliding_fraction > 0.99)
    # What a hidden effect does to the declared parameters is the subject of `discover`.
    if settings.simulate is not None and not settings.simulate.effects:
        truth = build._truth(settings.simulate, model)
        for name, value in result.parameters.items():
            # Noise of the twins, whose samples are few here, and the coarse step.
            allowed = 5.0 * result.standard_errors[name] + 0.01 * abs(model.parameters[name])
            assert value == pytest.approx(truth[name], abs=allowed)


def test_a_shipped_config_goes_by_its_name(tmp_path, monkeypatch):
    """A file of that name comes first; where there is neither, the built-in ones are listed."""
    monkeypatch.chdir(tmp_path)
    assert config_file(Path("level_tank")) == CONFIGS / "level_tank.toml"
    assert config_file(Path("level_tank.toml")) == Path("level_tank.toml")
    with pytest.raises(ValueError, match=r"or a built-in config: .*level_tank, .*got leveltank"):
        config_file(Path("leveltank"))
    Path("level_tank").touch()
    assert config_file(Path("level_tank")) == Path("level_tank")
