"""A config for a file that nobody has configured yet: it runs as it is, every guess is said."""

import json
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from eoi_jax._checks import check
from eoi_jax.cli import config
from eoi_jax.cli.build import DATA_VARIABLE
from eoi_jax.data.inspection import Channel, Inspection
from eoi_jax.data.record import Record
from eoi_jax.data.resampling import low_pass

_LOOKED = 1_000_000  # samples that the first guess of the parameters is made from
_HELD_OUT = 0.3  # of the samples, at the end
_WIDE = 4.0  # bands of the output that the first guess of the parameters looks at
_ONE = 0.95  # share of ẏ that a first-order model must explain to be the one that is drafted


def draft(found: Inspection, target: Path) -> str:
    """A commented config for a file.

    The model is linear, of first or second order, in one output; its nominal values are a rough
    least-squares fit, for the passes to start from.

    Args:
        found: of `inspect`.
        target: where the config will be, for the path of the file in it.

    Returns:
        TOML that `config.load` reads.

    Raises:
        ValueError: no column that can be an output, or a record that cannot be made of it.
    """
    outputs = _outputs(found)
    inputs = found.inputs
    output = next(one for one in found.channels if one.name == outputs[0])
    record = _record(found, inputs, output)
    order, values = _rough(record, output)
    name = _plain_name(found.path.name.split(".")[0]) or "run"
    blocks = [
        _head(found, name),
        _model_lines(found, inputs, output, order, values),
        _data_lines(found, inputs, output, outputs[1:], target),
        _rest_lines(),
    ]
    return "\n".join(blocks)


def checked(text: str, target: Path) -> str:
    """The text, if the config that it is can be loaded.

    Args:
        text: of `draft`.
        target: a file that does not exist yet, beside which it is tried.
    """
    trial = target.with_name(f".{target.name}.trial")
    try:
        trial.parent.mkdir(parents=True, exist_ok=True)
        trial.write_text(text, encoding="utf-8")
        config.load(trial)
    finally:
        trial.unlink(missing_ok=True)
    return text


def _outputs(found: Inspection) -> list[str]:
    outputs = list(found.outputs)
    check(
        len(outputs) > 0,
        "path",
        "must have a column that can be an output: numbers that change",
        found.path,
        f"Its columns: {', '.join(f'{one.name} ({one.role})' for one in found.channels[:10])}.",
    )
    return outputs


def _record(found: Inspection, inputs: Sequence[str], output: Channel) -> Record:
    """The first samples, as the config will read them."""
    clock, signals, part = found.clock, found.signals, slice(0, _LOOKED)
    count = min(found.samples, _LOOKED)
    period = clock.sample_period or 1.0
    u = np.stack([signals[key][part] for key in inputs], axis=1) if inputs else np.zeros((count, 0))
    stamps = (
        clock.factor * signals[clock.column][part] if clock.column else period * np.arange(count)
    )
    return Record(stamps, u, signals[output.name][part], found.path.name)


# -- a first guess of the parameters ------------------------------------------------------


def _rough(record: Record, output: Channel) -> tuple[int, Float[np.ndarray, " terms"]]:
    """Order and coefficients of y^(r) = -a_0 y - … + b u + c, by least squares on smooth signals.

    Derivatives are differences of the record after a zero-phase filter above the output's band.
    """
    h = record.sample_period
    cutoff = min(_WIDE * (output.band or 0.05 / h) * 2.0 * h, 0.8)  # of the Nyquist frequency
    segments = [(a, b) for a, b in record.segments() if b - a >= 8]
    rows, first, second = [], [], []
    for start, stop in segments:
        y = low_pass(record.outputs[start:stop], cutoff)[:, 0]
        u = low_pass(record.inputs[start:stop], cutoff)
        rate = np.gradient(y, h)
        rows.append(np.column_stack([-y, -rate, u, np.ones(len(y))])[2:-2])
        first.append(rate[2:-2])
        second.append(np.gradient(rate, h)[2:-2])
    table, rate, acceleration = np.concatenate(rows), np.concatenate(first), np.concatenate(second)
    one, left = _least_squares(np.delete(table, 1, axis=1), rate)
    if left < 1.0 - _ONE and one[0] > 0:
        return 1, one
    two, _ = _least_squares(table, acceleration)
    return 2, two


def _least_squares(
    table: Float[np.ndarray, "rows terms"], target: Float[np.ndarray, " rows"]
) -> tuple[Float[np.ndarray, " terms"], float]:
    """Coefficients, and the share of the target's power that they leave."""
    scale = np.sqrt(np.mean(table**2, axis=0))
    scale = np.where(scale > 0, scale, 1.0)
    found = np.linalg.lstsq(table / scale, target, rcond=1e-10)[0]
    left = float(np.mean((target - table / scale @ found) ** 2))
    return found / scale, left / max(float(np.mean(target**2)), 1e-300)


# -- the text -----------------------------------------------------------------------------


def _head(found: Inspection, name: str) -> str:
    guesses = [f"{one.name}: {one.role}, {one.why}" for one in found.channels if one.why][:20]
    lines = [
        f"# Drafted by `eoi init` from {_one_line(found.path.name)}: it runs as it is,",
        f"#   eoi identify {name}.toml",
        "# and everything in it is a guess, from what the columns look like:",
        *(f"#   {_one_line(line)}" for line in guesses),
        *(f"# {_one_line(line)}" for line in (*found.notes, *found.advice)),
        f"name = {_text(name)}",
        "",
    ]
    return "\n".join(lines)


def _model_lines(
    found: Inspection,
    inputs: Sequence[str],
    output: Channel,
    order: int,
    values: Float[np.ndarray, " terms"],
) -> str:
    """[model]: the equation of the highest derivative as text, with nominal values."""
    taken: set[str] = {"t", "pi"}
    y = _symbol(output.name, "y", taken)
    rate = _symbol(f"{y}_rate", "rate", taken)
    drive = [_symbol(name, "u", taken) for name in inputs]
    names = [_symbol(name, name, taken) for name in ("stiffness", "damping")]
    gains = [_symbol("gain" if len(drive) == 1 else f"gain_{one}", "gain", taken) for one in drive]
    offset = _symbol("offset", "offset", taken)
    if order == 1:
        names = [_symbol("decay", "decay", taken)]
    states = [y] if order == 1 else [y, rate]
    parts = [f"-{name}*{state}" for name, state in zip(names, states, strict=True)]
    equation = " ".join(
        [parts[0], *(f"- {part[1:]}" for part in parts[1:])]
        + [f"+ {gain}*{one}" for gain, one in zip(gains, drive, strict=True)]
        + [f"+ {offset}"]
    )
    parameters = zip([*names, *gains, offset], values, strict=True)
    known = {one.name: one.unit for one in found.channels if one.unit}
    own = zip([y, *drive], [output.name, *inputs], strict=True)
    units = {symbol: known[name] for symbol, name in own if name in known}
    lines = [
        "[model]                         # your equations go here; discover says what they lack",
        f"outputs = {_list([y])}",
        f"inputs = {_list(drive)}",
        *([f"units = {_table(units)}"] if units else []),
        "",
        "[model.derivatives]             # of each state in time; sin, sign, sqrt, … are known",
        *([f"{y} = {_text(rate)}"] if order == 2 else []),
        f"{states[-1]} = {_text(equation)}",
        "",
        "[model.parameters]              # nominal values: a rough fit to start from",
        *(f"{key} = {_rounded(value)}" for key, value in parameters),
        "",
    ]
    return "\n".join(lines)


def _data_lines(
    found: Inspection,
    inputs: Sequence[str],
    output: Channel,
    others: Sequence[str],
    target: Path,
) -> str:
    """[data], and [validation]: the end of the record, which the fit does not see."""
    cut = int((1.0 - _HELD_OUT) * found.samples)
    units = {one.name: one.unit for one in found.channels if one.unit}
    units = {key: unit for key, unit in units.items() if key in (*inputs, output.name)}
    lines = [
        "[data]",
        f"files = {_list([_path_in(found.path, target)])}",
        *_time_lines(found),
        f"inputs = {_list(inputs)}",
        f"outputs = {_list([output.name])}",
    ]
    free = [one.name for one in found.channels if one.role == "other"][:20]
    if others or free:
        listed = ", ".join(_one_line(one) for one in (*others, *free))
        lines.append(f"# other columns: {listed}")
    if units:
        lines.append(f"units = {_table(units)}")
    lines += [
        f"slice = [0, {cut}]",
        '# hold = "zero"                # "zero": a converter held the inputs; "linear"; "smooth"',
        "# burn_in = 0.0                 # not scored at the start [s]",
        "",
        "[validation]                    # the end of the record: the fit does not see it",
        f"slice = [{cut}, {found.samples}]",
        "",
    ]
    return "\n".join(lines)


def _time_lines(found: Inspection) -> list[str]:
    clock = found.clock
    if clock.column is None and clock.sample_period is None:
        return ["sample_period = 1.0             # [s]; NOT KNOWN: put the true one here"]
    if clock.column is None:
        return [f"sample_period = {clock.sample_period!r}  # [s]; {_one_line(clock.why)}"]
    lines = [f"time = {_text(clock.column)}  # {_one_line(clock.why)}"]
    if clock.others:
        lines.append(f"# it might be, too: {', '.join(_one_line(one) for one in clock.others)}")
    if clock.factor != 1.0:
        lines.append(f"scale = {_table({clock.column: clock.factor})}  # to seconds")
    return lines


def _rest_lines() -> str:
    return "\n".join(
        [
            "# Gains and filter are chosen from the record; to set them:",
            "# [lowpass]",
            "# cutoff = 30.0                # [rad/s]",
            "#",
            "# [discover]",
            '# effects = ["coulomb_friction", "cubic_stiffness"]   # left out: all that fit',
            "",
        ]
    )


def _path_in(path: Path, target: Path) -> str:
    """The file as the config names it: relative to a folder that is searched, if it is in one."""
    whole = path.resolve()
    variable = os.environ.get(DATA_VARIABLE)
    for root in (target.parent.resolve(), *([Path(variable).resolve()] if variable else [])):
        if whole.is_relative_to(root):
            return whole.relative_to(root).as_posix()
    return whole.as_posix()


def _symbol(name: str, default: str, taken: set[str]) -> str:
    """A column's name as a symbol of an equation, different from those that are taken."""
    stem = re.sub(r"[\[(].*", "", name.rsplit(".", 1)[-1].rsplit("/", 1)[-1])
    plain = re.sub(r"\W+", "_", stem, flags=re.ASCII).strip("_")
    if not plain or not plain[0].isalpha() or plain in taken:
        plain = default if default not in taken else f"{default}_{len(taken)}"
    taken.add(plain)
    return plain


def _plain_name(stem: str) -> str:
    return re.sub(r"[^A-Za-z0-9._-]+", "_", stem).strip("._-")


def _rounded(value: Any) -> str:
    """Three digits; a number in TOML has a point or an exponent."""
    text = f"{float(value):.3g}" if np.isfinite(value) else "0.0"
    return text if any(mark in text for mark in ".e") else f"{text}.0"


def _one_line(text: str) -> str:
    """What may stand in a comment: no end of line, no control character."""
    return "".join(one if one.isprintable() else " " for one in text)


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _list(values: Sequence[str]) -> str:
    return "[" + ", ".join(_text(value) for value in values) + "]"


def _table(items: dict[str, Any]) -> str:
    shown = (
        f"{_text(key)} = {_text(one) if isinstance(one, str) else repr(float(one))}"
        for key, one in items.items()
    )
    return "{ " + ", ".join(shown) + " }"
