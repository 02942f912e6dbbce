"""Folders of runs, as the command writes them, without running it."""

import dataclasses
from pathlib import Path

import numpy as np
from found import DECLARED, HELD_OUT, discovery, record

import eoi_jax as eoi
from eoi_jax._atomic import write_folder
from eoi_jax.cli import config, html_report, run_folder
from eoi_jax.cli import summary as summaries

CONFIG = Path(__file__).resolve().parents[1] / "configs" / "hidden_friction.toml"
HOSTILE = "<script>hacked=1</script>"


def job(model: eoi.Plant, records, held_out=()) -> run_folder.Job:
    return run_folder.Job(config.load(CONFIG), model, list(records), list(held_out))


def discovered(folder: Path, result: eoi.Discovery) -> Path:
    given = job(DECLARED, [record(1)], [HELD_OUT])
    summary = summaries.discovery_summary(given, result)
    text = "# eoi discover mine.toml\n" + CONFIG.read_text()
    write_folder(folder, lambda draft: run_folder.write_discovery(draft, result, summary, text))
    html_report.write_report(folder)
    return folder


def unexplained(found: eoi.Discovery) -> eoi.Discovery:
    status = eoi.Status("unexplained", "No effect tried is justified.")
    return dataclasses.replace(
        found, effects=(), added=(), ambiguous_with=(), found=found.declared,
        plant=found.declared.plant, after=found.before, windows_after=found.windows_before,
        status=status, diagnosis=eoi.diagnose(found.declared),
    )  # fmt: skip


def two_outputs(t, x, u, p):
    (first, second), (rate, other) = x.y
    pull = p.coupling * (second - first)
    return np_stack(pull - p.damping * rate + u, -pull - p.damping * other)


def np_stack(*parts):
    import jax.numpy as jnp

    return jnp.stack([jnp.squeeze(one) for one in parts])


def hostile_run(folder: Path) -> Path:
    """An identification whose every name is an attack; its numbers are ordinary."""
    names = (HOSTILE, "a & b_{$}")
    units = {
        names[0]: '"><img src=x onerror="hacked=2">',
        "u": "</svg></style>",
        "damping": HOSTILE,
    }
    plant = eoi.Plant(
        two_outputs, {"coupling": 40.0, "damping": 1.0}, 2, inputs=("u",), outputs=names,
        units=units, name="</title><script>hacked=3</script>",
    )  # fmt: skip
    time = 2e-3 * np.arange(3000)
    drive = eoi.excitation.chirp(time, 1.0, 0.2, 3.0)
    clean = eoi.simulate(plant.with_parameters({"coupling": 50.0, "damping": 0.8}), time, drive)
    measured = eoi.Record(
        time, clean.inputs, clean.outputs, name="</text><script>hacked=4</script>",
        input_names=("u",), output_names=names, hold="linear",
    )  # fmt: skip
    result = eoi.identify(plant, measured, passes=2)
    validation = eoi.validate(result.plant, measured)
    given = job(plant, [measured], [measured])
    summary = summaries.identification_summary(given, result, validation)
    text = "# eoi identify </code></pre><script>hacked=5</script>\n</pre><script>hacked=6</script>"
    write_folder(
        folder,
        lambda draft: run_folder.write_identification(draft, result, validation, summary, text),
    )
    html_report.write_report(folder)
    return folder


def explained() -> eoi.Discovery:
    return discovery()
