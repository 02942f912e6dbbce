"""A draft of a config for data files: ready to run, with every guess in a comment."""

import json
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from eoi_jax._checks import check
from eoi_jax.cli import config
from eoi_jax.cli.build import DATA_VARIABLE
from eoi_jax.cli.terminal import shell_word
from eoi_jax.data.channel import Channel
from eoi_jax.data.column_names import short_names
from eoi_jax.data.column_roles import SMOOTH, hold_of_entries
from eoi_jax.data.impulses import SINGLE_ROWS
from eoi_jax.data.inspection import USED_AS_MEASURED, Inspection, InspectionSettings
from eoi_jax.data.readers.long_form import stacked_topics
from eoi_jax.data.record import Record
from eoi_jax.data.repeats import repeat_note, without_repeats
from eoi_jax.data.resampling import low_pass
from eoi_jax.data.wrapping import JUMPS, course
from eoi_jax.models.export.names import TEXT_WORDS, identifier
from eoi_jax.models.kinds import kind_of


@dataclass(frozen=True)
class DraftSettings:
    """How a draft divides the data and fits the first guess of its parameters."""

    held_out: float = 0.3  # share of the samples, at the end
    shortest: int = 50  # samples of which a part is held out; fewer are all needed for the fit
    bandwidths: float = 4.0  # of the output, within which the first guess is fitted
    # A first-order model is chosen that explains so much of ẏ, or more of it than one of second
    # order explains of ÿ.
    first_order_share: float = 0.95
    # What is stored or dragged along, and has no inertia of its own.
    first_order_kinds: tuple[str, ...] = (
        "temperature", "level", "pressure", "concentration", "flow", "speed"
    )  # fmt: skip


_SETTINGS = DraftSettings()
_ONE_OUTPUT = (
    "The draft has one output, `{}`. {} may be outputs too: add them to the model and to "
    "`outputs`, or draft another one by `--outputs`."
)

_REPEATS = (
    "`{}` has a new value once in {:.3g} rows and repeats it in the others: these are missing "
    "samples by `empty_repeats` of the draft; without it they count as measured."
)


def draft(inspections: Sequence[Inspection], target: Path, sheet: str | None = None) -> str:
    """A commented config for data files of the same columns.

    The model is linear, of first or second order, in one output; its nominal values are a rough
    least-squares fit, from which the passes start. What turns round and round gets no spring. Of
    several files the last one is held out.

    Args:
        inspections: of `inspect`; roles and first guesses are those of the first.
        target: path of the config, to which the paths of the files are relative.
        sheet: that was chosen in Excel files.

    Returns:
        TOML that `config.load` reads.

    Raises:
        ValueError: no column that can be an output, or no valid record; a file that lacks a column
            of the first.
    """
    inspection = inspections[0]
    stacked = stacked_topics(inspection.signals, inspection.clock)
    check(not stacked, "file", "must have its rows in the order of time", inspection.path, stacked)
    outputs = _outputs(inspection)
    inputs = inspection.inputs
    output = next(channel for channel in inspection.channels if channel.name == outputs[0])
    record = _record(inspection, inputs, output)
    wraps = output.wraps
    turns = bool(wraps and wraps.usual and np.ptp(record.outputs) > wraps.period)
    order, values = _rough_fit(record, output, turns)
    _check_columns(inspections, [*inputs, outputs[0]])
    name = _plain_name(inspection.path.name.split(".")[0]) or "run"
    symbols = _symbols(output.name, inputs)
    blocks = [
        _head(inspection, name, target),
        _model_lines(inspection, inputs, output, symbols, order, values),
        _data_lines(inspections, inputs, output, outputs[1:], target, sheet),
        _option_lines(),
        *(_controller_lines(reference, symbols) for reference in inspection.references[:1]),
    ]
    return "\n".join(blocks)


def remarks(inspection: Inspection) -> list[str]:
    """Notes and advice on the file, without what the draft has done, and what it leaves out.

    Args:
        inspection: of a file with an output.
    """
    name, *further = _outputs(inspection)
    drafted = next(channel for channel in inspection.channels if channel.name == name)
    done = drafted.wraps is not None and drafted.wraps.usual
    lines = (*inspection.notes, *inspection.advice)
    sentences = [line for line in lines if not (done and JUMPS in line and f"`{name}`" in line)]
    if drafted.repeats:
        told = repeat_note(name, drafted.repeats)
        sentences = [line for line in sentences if line != told]
        sentences.append(_REPEATS.format(name, drafted.repeats))
    declared = {f"`{at.name}` is {code:.12g} " for at in inspection.channels for code in at.codes
                if at.name in (*inspection.inputs, name)}  # fmt: skip
    sentences = [
        f"{line.partition(USED_AS_MEASURED)[0]}The draft declares it."
        if USED_AS_MEASURED in line and any(map(line.startswith, declared))
        else line
        for line in sentences
    ]
    if further:
        listed = ", ".join(f"`{column}`" for column in further)
        sentences.append(_ONE_OUTPUT.format(name, listed))
    return sentences


def checked(text: str, target: Path) -> str:
    """The text of a config, after a check that it can be loaded.

    Args:
        text: of `draft`.
        target: path of the config; the check writes a file beside it and removes it.
    """
    trial = target.with_name(f".{target.name}.trial")
    try:
        trial.parent.mkdir(parents=True, exist_ok=True)
        trial.write_text(text, encoding="utf-8")
        config.load(trial)
    finally:
        trial.unlink(missing_ok=True)
    return text


def _outputs(inspection: Inspection) -> list[str]:
    """The outputs, those that a name or the caller says to be some before those that only move."""
    smooth = {channel.name for channel in inspection.channels if channel.why.startswith(SMOOTH)}
    outputs = sorted(inspection.outputs, key=lambda name: name in smooth)
    roles = [
        f"{channel.name} ({channel.role}{f', {channel.why}' * (channel.role == 'text')})"
        for channel in inspection.channels[:10]
    ]
    check(
        len(outputs) > 0,
        "path",
        "must have a column that can be an output: numbers that change",
        inspection.path,
        f"Its columns: {', '.join(roles)}.",
    )
    return outputs


def _check_columns(inspections: Sequence[Inspection], names: Sequence[str]) -> None:
    """All files must have the columns that the config reads from them."""
    first = inspections[0]
    for inspection in inspections[1:]:
        columns = [channel.name for channel in inspection.channels]
        for name in (*names, *([first.clock.column] if first.clock.column else [])):
            rule = f"must have the column `{name}`, as {first.path.name} has"
            value = f"{', '.join(columns[:10])} in {inspection.path.name}"
            check(name in columns, "file", rule, value, "Draft a config for each kind of file.")


def _record(inspection: Inspection, inputs: Sequence[str], output: Channel) -> Record:
    """The first samples, as read with the config."""
    clock, signals = inspection.clock, inspection.signals
    start, stop = inspection.parts[0]
    part = slice(start, min(stop, start + InspectionSettings.examined))
    count = len(signals[output.name][part])
    period = clock.sample_period or 1.0
    u = np.stack([signals[key][part] for key in inputs], axis=1) if inputs else np.zeros((count, 0))
    stamps = (
        clock.factor * signals[clock.column][part] if clock.column else period * np.arange(count)
    )
    y = course(signals[output.name], output.wraps)[part]
    if output.repeats:
        y = without_repeats(y[:, None], (output.name,), [output.name], [])
    hold = _entry_holds(inspection, inputs) or "auto"
    names = {"input_names": inputs, "output_names": [output.name]}
    return Record(stamps, u, y, inspection.path.name, hold=hold, **names)


def _entry_holds(inspection: Inspection, inputs: Sequence[str]) -> dict[str, str]:
    """A hold of each input where one has empty cells between its entries; else none."""
    seldom = {key: hold_of_entries(inspection.signals[key]) for key in inputs}
    if not any(seldom.values()):
        return {}
    steady = {channel.name for channel in inspection.channels if channel.noise is None}
    return {key: word or ("zero" if key in steady else "linear") for key, word in seldom.items()}


# -- a first guess of the parameters ------------------------------------------------------


def _rough_fit(
    record: Record, output: Channel, turns: bool
) -> tuple[int, Float[np.ndarray, " terms"]]:
    """Order and coefficients of y^(r) = -a_0 y - … + b u + c, by least squares on smooth signals.

    Derivatives are differences of the record after a zero-phase filter above the output's band.
    Of what turns round and round a_0 = 0, and r = 2.
    """
    record, h = record.bridged, record.sample_period
    band = _SETTINGS.bandwidths * (output.band or 0.05 / h)
    cutoff = min(2.0 * h * band, 0.8)  # of the Nyquist frequency
    segments = [(a, b) for a, b in record.segments() if b - a >= 8]
    rows, rates, accelerations = [], [], []
    for start, stop in segments:
        y = low_pass(record.outputs[start:stop], cutoff)[:, 0]
        u = low_pass(record.inputs[start:stop], cutoff)
        rate = np.gradient(y, h)
        rows.append(np.column_stack([-y, -rate, u, np.ones(len(y))])[2:-2])
        rates.append(rate[2:-2])
        accelerations.append(np.gradient(rate, h)[2:-2])
    table, rate, acceleration = (np.concatenate(parts) for parts in (rows, rates, accelerations))
    if turns:
        return 2, _least_squares(table[:, 1:], acceleration)[0]
    first_order, remainder = _least_squares(np.delete(table, 1, axis=1), rate)
    if kind_of(output.name, output.unit, 2) in _SETTINGS.first_order_kinds:
        return 1, first_order
    second_order, remainder_2 = _least_squares(table, acceleration)
    if remainder < max(1.0 - _SETTINGS.first_order_share, remainder_2) and first_order[0] > 0:
        return 1, first_order
    return 2, second_order


def _least_squares(
    table: Float[np.ndarray, "rows terms"], target: Float[np.ndarray, " rows"]
) -> tuple[Float[np.ndarray, " terms"], float]:
    """Coefficients, and the share of the power of the target that remains."""
    scale = np.sqrt(np.mean(table**2, axis=0))
    scale = np.where(scale > 0, scale, 1.0)
    coefficients = np.linalg.lstsq(table / scale, target, rcond=1e-10)[0]
    remainder = float(np.mean((target - table / scale @ coefficients) ** 2))
    return coefficients / scale, remainder / max(float(np.mean(target**2)), 1e-300)


# -- the text -----------------------------------------------------------------------------


def _head(inspection: Inspection, name: str, target: Path) -> str:
    guesses = [
        f"{channel.name}: {channel.role}, {channel.why}"
        for channel in inspection.channels
        if channel.why
    ][:20]
    is_timed = inspection.clock.sample_period is not None
    state = "ready to run" if is_timed else "insert the sample_period below, then run"
    lines = [
        f"# Drafted by `eoi init` from {_one_line(inspection.path.name)}: {state}:",
        f"#   eoi identify {_one_line(shell_word(target))}",
        "# Everything in it is a guess from the values and names of the columns:",
        *(f"#   {_one_line(line)}" for line in guesses),
        *(f"# {_one_line(line)}" for line in remarks(inspection)),
        f"name = {_text(name)}",
        "",
    ]
    return "\n".join(lines)


@dataclass(frozen=True)
class _Symbols:
    """What equations call the signals.

    Attributes:
        output, rate, inputs: of the record.
        used: all names that have a meaning.
    """

    output: str
    rate: str
    inputs: list[str]
    used: set[str]


def _symbols(output: str, inputs: Sequence[str]) -> _Symbols:
    used: set[str] = {"t", "pi"}
    output, *inputs = short_names([output, *inputs])
    y = _symbol(output, "y", used)
    rate = _symbol(f"{y}_rate", "rate", used)
    return _Symbols(y, rate, [_symbol(name, "u", used) for name in inputs], used)


def _model_lines(
    inspection: Inspection,
    inputs: Sequence[str],
    output: Channel,
    symbols: _Symbols,
    order: int,
    values: Float[np.ndarray, " terms"],
) -> str:
    """[model]: the equation of the highest derivative as text, with nominal values."""
    y, rate, drive, used = symbols.output, symbols.rate, symbols.inputs, set(symbols.used)
    names = [_symbol(name, name, used) for name in ("stiffness", "damping")]
    gains = [
        _symbol("gain" if len(drive) == 1 else f"gain_{symbol}", "gain", used) for symbol in drive
    ]
    offset = _symbol("offset", "offset", used)
    if order == 1:
        names = [_symbol("decay", "decay", used)]
    states = [y] if order == 1 else [y, rate]
    terms = len(values) - len(drive) - 1  # of what turns round and round only the damping
    names, states = names[-terms:], states[-terms:]
    parts = [f"-{name}*{state}" for name, state in zip(names, states, strict=True)]
    equation = " ".join(
        [parts[0], *(f"- {part[1:]}" for part in parts[1:])]
        + [f"+ {gain}*{symbol}" for gain, symbol in zip(gains, drive, strict=True)]
        + [f"+ {offset}"]
    )
    parameters = zip([*names, *gains, offset], values, strict=True)
    column_units = {channel.name: channel.unit for channel in inspection.channels if channel.unit}
    columns = zip([y, *drive], [output.name, *inputs], strict=True)
    units = {symbol: column_units[name] for symbol, name in columns if name in column_units}
    lines = [
        "[model]                         # put your equations here; discover finds what they lack",
        f"outputs = {_list([y])}",
        f"inputs = {_list(drive)}",
        *([f"units = {_table(units)}"] if units else []),
        "",
        "[model.derivatives]             # of each state in time; sin, sign, sqrt, … are known",
        *([f"{y} = {_text(rate)}"] if order == 2 else []),
        f"{states[-1]} = {_text(equation)}",
        "",
        "[model.parameters]              # nominal values: a rough fit",
        *(f"{key} = {_rounded(value)}" for key, value in parameters),
        "",
    ]
    return "\n".join(lines)


def _data_lines(
    inspections: Sequence[Inspection],
    inputs: Sequence[str],
    output: Channel,
    further_outputs: Sequence[str],
    target: Path,
    sheet: str | None,
) -> str:
    """[data], and [validation] with data that the fit does not use."""
    inspection = inspections[0]
    files = [_path_in(one.path, target) for one in inspections]
    units = {channel.name: channel.unit for channel in inspection.channels if channel.unit}
    units = {key: unit for key, unit in units.items() if key in (*inputs, output.name)}
    lines = [
        "[data]",
        f"files = {_list(files[:-1] or files)}",
        *([] if sheet is None else [f"sheet = {_text(sheet)}"]),
        *_time_lines(inspection),
        f"inputs = {_list(inputs)}",
        f"outputs = {_list([output.name])}",
    ]
    unused = [channel.name for channel in inspection.channels if channel.role == "other"][:20]
    if further_outputs or unused:
        names = ", ".join(_one_line(name) for name in (*further_outputs, *unused))
        drives = "; one that drives the output is an input" if not inputs else ""
        lines.append(f"# other columns: {names}{drives}")
    if units:
        lines.append(f"units = {_table(units)}")
    codes = {at.name: at.codes for at in inspection.channels if at.codes}
    codes = {key: codes[key] for key in (*inputs, output.name) if key in codes}
    lines += [f"missing = {_table(codes)}  # no values, as it seems"] if codes else []
    lines += [*_unwrap_lines(output), *_repeat_lines(output)]
    fitted, held_out = _divided(files, [inspection.parts for inspection in inspections])
    lines += [fitted] if fitted else []
    mark = "# " if held_out[1].startswith("#") else ""
    lines += [
        '# hold = "zero"                # "zero": inputs held by a converter; "linear"; "smooth";',
        '                               # or by column: { heating = "zero", outdoor = "linear" }',
        *_held_lines(inspection, inputs),
        *_impulse_lines(inspection, inputs),
        "# burn_in = 0.0                 # time at the start that is not scored [s]",
        "# mask_faults = true            # samples that leave their course alone are not scored",
        "",
        f"{mark}[validation]                    # {held_out[0]}, which the fit does not use",
        *held_out[1:],
        "",
    ]
    return "\n".join(lines)


def _unwrap_lines(output: Channel) -> list[str]:
    """The period of an output that wraps; commented out where it may be something else."""
    if output.wraps is None:
        return []
    number = output.wraps.period if output.wraps.usual else float(f"{output.wraps.period:.4g}")
    mark = "" if output.wraps.usual else "# "
    return [f"{mark}unwrap = {_table({output.name: number})}  # it {output.wraps.text}"]


def _repeat_lines(output: Channel) -> list[str]:
    """Makes the repeats of an output missing that keeps each value until the next one comes."""
    if not output.repeats:
        return []
    return [
        f"empty_repeats = {_list([output.name])}",
        f"                               # once in {output.repeats:.3g} rows a new value comes;",
        "                               # the others repeat the last one, and are no samples",
    ]


def _held_lines(inspection: Inspection, inputs: Sequence[str]) -> list[str]:
    """The hold of inputs that keep their values between changes, to be declared by who knows it."""
    channels = [channel for channel in inspection.channels if channel.name in inputs]
    if seldom := _entry_holds(inspection, inputs):
        return [
            f"hold = {_table(seldom)}",
            "                               # a guess, as not all rows have inputs: zero where",
            "                               # entries jump; empty cells have no value without it",
        ]
    holds = {channel.name: "zero" for channel in channels if channel.noise is None}
    if not holds:
        return []
    return [
        f"# hold = {_table(holds)}",
        "                               # held between changes: declare it if a converter sets it",
    ]


def _impulse_lines(inspection: Inspection, inputs: Sequence[str]) -> list[str]:
    """Inputs that may be amounts given at the instant of their row, to be declared as such."""
    notes = {channel.name: " ".join(channel.notes) for channel in inspection.channels}
    names = [name for name in inputs if SINGLE_ROWS in notes[name]]
    line = f"# impulses = {_list(names)}  # amounts given at the instant of their row, as doses?"
    return [line] if names else []


def _divided(
    files: Sequence[str], spans: Sequence[Sequence[tuple[int, int]]]
) -> tuple[str, tuple[str, ...]]:
    """Which samples [data] reads; what is held out, in words, and the lines that read it."""
    restarted = {file: ranges for file, ranges in zip(files, spans, strict=True) if len(ranges) > 1}
    if len(files) > 1:
        fitted = {file: ranges for file, ranges in restarted.items() if file != files[-1]}
        held_out = {file: ranges for file, ranges in restarted.items() if file == files[-1]}
        lines = [f"files = {_list(files[-1:])}", *([_parts(held_out)] if held_out else [])]
        return _parts(fitted) if fitted else "", ("the last file", *lines)
    if restarted:
        fitted, held_out = {files[0]: spans[0][:-1]}, {files[0]: spans[0][-1:]}
        return _parts(fitted), ("the last part of the record", _parts(held_out))
    ((start, stop),) = spans[0]
    if stop - start < _SETTINGS.shortest:
        return "", ("other data", "# files = []                     # too few samples to divide")
    cut = start + int((1.0 - _SETTINGS.held_out) * (stop - start))
    return f"slice = [{start}, {cut}]", ("the end of the record", f"slice = [{cut}, {stop}]")


def _parts(spans: dict[str, Sequence[tuple[int, int]]]) -> str:
    """Samples between restarts of the logger, a record each."""
    entries = (
        f"{_text(file)} = [{', '.join(f'[{a}, {b}]' for a, b in ranges)}]"
        for file, ranges in spans.items()
    )
    return f"parts = {{ {', '.join(entries)} }}  # records between restarts of the logger"


def _time_lines(inspection: Inspection) -> list[str]:
    clock = inspection.clock
    if clock.column is None and clock.sample_period is None:
        return ["sample_period = 1.0             # [s]; NOT KNOWN: insert the true value"]
    if clock.column is None:
        return [f"sample_period = {clock.sample_period!r}  # [s]; {_one_line(clock.why)}"]
    lines = [f"time = {_text(clock.column)}  # {_one_line(clock.why)}"]
    if clock.others:
        lines.append(f"# other candidates: {', '.join(_one_line(name) for name in clock.others)}")
    if clock.factor != 1.0:
        lines.append(f"scale = {_table({clock.column: clock.factor})}  # to seconds")
    return lines


def _option_lines() -> str:
    lines = [
        "# Gains and filter are chosen from the record; to set them:",
        "# [lowpass]",
        "# cutoff = 30.0                # [rad/s]",
        "#",
        "# [discover]",
        '# effects = ["coulomb_friction", "cubic_stiffness"]   # default: all that fit',
        "",
    ]
    return "\n".join(lines)


def _controller_lines(reference: str, symbols: _Symbols) -> str:
    """[controller], commented out: a file does not say what its law is."""
    lines = [
        f"{_text(reference)} looks like the reference of a controller. With its law, free runs",
        "of `eoi identify` and `eoi refine` have it in the loop, as an unstable plant needs:",
        "[controller]",
        'kind = "pid"',
        "proportional = 1.0             # insert the gains of the rig; they are not in the file",
        "integral = 0.0",
        "derivative = 0.0",
        f"reference = {_text(reference)}",
        f"inputs = {_text(symbols.inputs[0])}  # the input that it drives",
    ]
    return "\n".join([*(f"# {_one_line(line)}" for line in lines), ""])


def _path_in(path: Path, target: Path) -> str:
    """Path of the file in the config: relative to a folder that is searched, if it is in one."""
    absolute = path.resolve()
    variable = os.environ.get(DATA_VARIABLE)
    for root in (target.parent.resolve(), *([Path(variable).resolve()] if variable else [])):
        if absolute.is_relative_to(root):
            return absolute.relative_to(root).as_posix()
    return absolute.as_posix()


def _symbol(name: str, default: str, used: set[str]) -> str:
    """A name as a symbol of an equation, different from those in use."""
    plain = identifier(name if re.search(r"[^\W\d_]", name) else default, used, TEXT_WORDS)
    used.add(plain)
    return plain


def _plain_name(stem: str) -> str:
    return re.sub(r"[^A-Za-z0-9._-]+", "_", stem).strip("._-")


def _rounded(value: Any) -> str:
    """A number with three digits; a float in TOML has a point or an exponent."""
    text = f"{float(value):.3g}" if np.isfinite(value) else "0.0"
    return text if any(mark in text for mark in ".e") else f"{text}.0"


def _one_line(text: str) -> str:
    """Text for a comment: without line ends and control characters."""
    return "".join(character if character.isprintable() else " " for character in text)


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _list(values: Sequence[str]) -> str:
    return "[" + ", ".join(_text(value) for value in values) + "]"


def _entry(value: Any) -> str:
    """A text, a number, or a list of numbers."""
    if isinstance(value, str):
        return _text(value)
    return repr([float(number) for number in value] if isinstance(value, tuple) else float(value))


def _table(items: dict[str, Any]) -> str:
    entries = (f"{_text(key)} = {_entry(value)}" for key, value in items.items())
    return "{ " + ", ".join(entries) + " }"
