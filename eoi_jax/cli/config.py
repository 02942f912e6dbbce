"""The config of a run: the tables of its TOML file.

`load` reads and checks a file; `build` makes the objects that it describes. A mistake in the file
is a `ValueError` that names the field with its table, the rule and the value.
"""

import difflib
import math
import re
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from eoi_jax._checks import check, is_shallow, printable
from eoi_jax._schema import struct
from eoi_jax.cli.options import DATA_FILES
from eoi_jax.cli.terminal import shell_word
from eoi_jax.data.readers.limits import MAX_GIGABYTES
from eoi_jax.models.equations.text_model import ModelTable

Positive = Annotated[float, msgspec.Meta(gt=0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0)]
Count = Annotated[int, msgspec.Meta(ge=1)]
NotNegativeCount = Annotated[int, msgspec.Meta(ge=0)]
Share = Annotated[float, msgspec.Meta(gt=0, lt=1)]
Forgetting = Annotated[float, msgspec.Meta(gt=0, le=1)]
Gain = Positive | tuple[Positive, ...]
# The name becomes a folder in runs/: no path separators, no leading dot.
FolderName = Annotated[
    str,
    msgspec.Meta(
        pattern=r"\A[A-Za-z0-9][A-Za-z0-9._-]*\Z",
        description="the name of a folder: letters, digits, `.`, `_` and `-`, no space, the first "
        "a letter or a digit",
    ),
]


class ParameterTable(msgspec.Struct, frozen=True):
    """[parameters]: changes to the declaration of the plant.

    Attributes:
        nominal: starting values θ_0 by name; the others keep those of the plant.
        fixed: names that are not estimated.
        bounds: ``[lower, upper]`` by name.
    """

    nominal: dict[str, float] = {}
    fixed: tuple[str, ...] = ()
    bounds: dict[str, tuple[float, float]] = {}


class FirstOrderTable(msgspec.Struct, frozen=True, tag_field="kind", tag="first_order"):
    """[observer] of eq. (5): a gain for all outputs or one for each."""

    delta: Gain
    leak: Gain = 1.0
    scheme: Literal["implicit", "explicit"] = "implicit"


class SecondOrderTable(msgspec.Struct, frozen=True, tag_field="kind", tag="second_order"):
    """[observer] of eq. (9): a gain for all outputs or one for each."""

    c1: Gain
    c2: Gain
    c3: Gain
    scheme: Literal["implicit", "explicit"] = "implicit"


class SuperTwistingTable(msgspec.Struct, frozen=True, tag_field="kind", tag="super_twisting"):
    """[observer] of Davila, Fridman, Poznyak (2006): a gain for all outputs or one for each."""

    alpha: Gain
    lambda1: Gain | None = None
    scheme: Literal["implicit", "explicit"] = "implicit"


class HighOrderTable(msgspec.Struct, frozen=True, tag_field="kind", tag="high_order"):
    """[observer] of Levant (2003) for relative degree `degree`; implicit only."""

    bound: Gain
    degree: Count
    lambdas: tuple[Positive, ...] | None = None


ObserverTable = FirstOrderTable | SecondOrderTable | SuperTwistingTable | HighOrderTable


class LowPassTable(msgspec.Struct, frozen=True):
    """[lowpass] of eq. (19): cut-off [rad/s] and order."""

    cutoff: Positive
    order: Count = 2


class IdentifyTable(msgspec.Struct, frozen=True):
    """[identify]: how the passes run.

    Attributes:
        passes: largest number of passes.
        transient: not scored at the start of each record [s]; default: ten time constants of the
            filter.
        substeps: observer steps per sample; default: chosen from the filter and the sampling.
        smoothing: cut-off of the zero-phase filter of the record [rad/s], or false for none;
            default: decided from the record's noise.
        instruments: passes with instrumental variables at the end; default: decided from the noise.
        recursive: whether the parameters over time are given too, by recursive least squares.
        forgetting: factor of the recursion on past samples, with each sample; 1 forgets nothing.
    """

    passes: Count = 10
    transient: NotNegative | None = None
    substeps: Count | None = None
    smoothing: Positive | bool | None = None
    instruments: bool | None = None
    recursive: bool = False
    forgetting: Forgetting = 1.0

    def __post_init__(self) -> None:
        rule = "must be a cut-off [rad/s], or false"
        check(self.smoothing is not True, "identify.smoothing", rule, "true")
        rule = "must be true where `forgetting` is below 1"
        check(self.recursive or self.forgetting == 1.0, "identify.recursive", rule, "false")


class DiscoverTable(msgspec.Struct, frozen=True):
    """[discover]: which effects are tested, and when they are accepted.

    Of the other tables [lowpass] is used; [observer] and [identify] are chosen for every model that
    is tested, and a note of the answer says so where they are set.

    Attributes:
        effects: names of effects of the library; default: all that fit the plant.
        alpha: probability of a false alarm, over all candidates together.
        most: largest number of effects to add.
        window: length of the re-initialised free runs [s]; default: chosen from the records.
        refine: whether the answer is refined by output error, with effects only free runs show.
    """

    effects: Annotated[tuple[str, ...], msgspec.Meta(min_length=1)] | None = None
    alpha: Share = 0.01
    most: Count = 3
    window: Positive | None = None
    refine: bool = False


class RefineTable(msgspec.Struct, frozen=True):
    """[refine]: how the free runs are fitted.

    Attributes:
        window: length of each run [s]; default: whole records, or windows where these say nothing
            because the plant is unstable.
        substeps: steps of the simulation per sample; default: as many as their error asks for.
        max_steps: of the solver.
        starts: number of further starting points, drawn around the estimate of the passes, or
            around the nominal values without such an estimate; default: none.
        rounds: number of rounds of such draws; later ones are around the best point so far, and
            start again where they no longer improve it.
    """

    window: Positive | None = None
    substeps: Count | None = None
    max_steps: Count = 50
    starts: Count | None = None
    rounds: Count = 1


class RangeTable(msgspec.Struct, frozen=True):
    """Values from low to high at equal ratios, both ends included."""

    low: Positive
    high: Positive
    count: Count


class GainTable(msgspec.Struct, frozen=True):
    """[[sweep.observers]]: gain sets of one kind of observer.

    Attributes:
        kind: as of [observer].
        gains: by name: a number, a list, or a range.
        grid: every combination of them; false: the first of each, the second of each, ….
        scheme: implicit or explicit.
    """

    kind: Literal["first_order", "second_order", "super_twisting", "high_order"]
    gains: dict[str, float | tuple[float, ...] | RangeTable]
    grid: bool = True
    scheme: Literal["implicit", "explicit"] = "implicit"


class PidTable(msgspec.Struct, frozen=True, tag_field="kind", tag="pid"):
    """[controller] of `Controller.pid`; its period is that of the records.

    Attributes:
        proportional, integral, derivative, filter_time, offset, limits: of the law.
        reference: its name, or a number: a constant set point. [data] names its column.
        output: name of the output that is controlled; default: the first.
        inputs: name of the input that it drives; may be omitted where the plant has a single input.
        initial, delay, tolerance: as of `Controller`.
    """

    proportional: float
    integral: float = 0.0
    derivative: float = 0.0
    reference: str | float = "r"
    filter_time: NotNegative = 0.0
    offset: float = 0.0
    limits: tuple[float, float] = (-math.inf, math.inf)
    output: str | None = None
    inputs: str | None = None
    initial: tuple[float, ...] | None = None
    delay: NotNegativeCount = 0
    tolerance: Share = 0.02


class LawTable(msgspec.Struct, frozen=True, tag_field="kind", tag="law"):
    """[controller] with a law of one's own.

    Attributes:
        law: ``"file.py:function"`` beside the config: ``law(t, r, y, s)``, as of `Controller`.
        reference: its name or several; default: none. [data] names their columns.
        inputs: name of the input that it drives, or several; default: all.
        states, initial, delay, tolerance: as of `Controller`.
    """

    law: str
    reference: str | tuple[str, ...] = ()
    inputs: str | tuple[str, ...] | None = None
    states: NotNegativeCount = 0
    initial: tuple[float, ...] | None = None
    delay: NotNegativeCount = 0
    tolerance: Share = 0.02


class SweepTable(msgspec.Struct, frozen=True):
    """[sweep]: the lanes; defaults are the values of the other tables.

    Attributes:
        observers: gain sets; default: that of [observer].
        cutoffs: of the filter [rad/s]: a list or a range; default: that of [lowpass].
        order: of these filters.
        starts: θ_0 by name, a table each, besides the nominal values; default: only these.
        resamples: block-bootstrap resamples of each record.
        seed: of the resamples.
        precision: of the computation.
        chunk: number of lanes computed together.
    """

    observers: tuple[GainTable, ...] = ()
    cutoffs: tuple[Positive, ...] | RangeTable | None = None
    order: Count = 2
    starts: tuple[dict[str, float], ...] = ()
    resamples: NotNegativeCount = 0
    seed: int = 0
    precision: Literal["float64", "float32"] = "float64"
    chunk: Count = 4096


class SquareTable(msgspec.Struct, frozen=True, tag_field="kind", tag="square"):
    """A square wave offset ± amplitude; frequency [Hz]."""

    amplitude: float
    frequency: Positive
    offset: float = 0.0
    duty: Positive = 0.5


class PrbsTable(msgspec.Struct, frozen=True, tag_field="kind", tag="prbs"):
    """A pseudo-random binary sequence offset ± amplitude that may switch every period [s]."""

    amplitude: float
    switching_period: Positive
    seed: int = 0
    offset: float = 0.0


class ChirpTable(msgspec.Struct, frozen=True, tag_field="kind", tag="chirp"):
    """A sine whose frequency runs from start to stop [Hz] over the record."""

    amplitude: float
    start: Positive
    stop: Positive
    offset: float = 0.0


class MultisineTable(msgspec.Struct, frozen=True, tag_field="kind", tag="multisine"):
    """Cosines of equal size and random phase between two frequencies [Hz]; amplitude is the rms."""

    amplitude: float
    frequencies: tuple[Positive, Positive]
    components: Count = 20
    seed: int = 0
    offset: float = 0.0


class RandomStepsTable(msgspec.Struct, frozen=True, tag_field="kind", tag="random_steps"):
    """Levels drawn from [low, high], each held for `holding_time` [s]."""

    low: float
    high: float
    holding_time: Positive
    seed: int = 0


class StepsTable(msgspec.Struct, frozen=True, tag_field="kind", tag="steps"):
    """Levels in sequence, each held for `holding_time` [s]."""

    levels: tuple[float, ...]
    holding_time: Positive


SignalTable = SquareTable | PrbsTable | ChirpTable | MultisineTable | StepsTable | RandomStepsTable


class SimulateTable(msgspec.Struct, frozen=True):
    """[simulate]: a record simulated by the plant with other parameters.

    Attributes:
        sample_period, duration: [s].
        input: one signal for each input of the plant.
        held_out: the same for a second record, which the fit does not use.
        truth: true parameter values; the others keep the nominal value.
        increments: the same, as increments of the nominal values (Δθ of the paper).
        effects: effects of the record that the model lacks, by canonical name: the value of the
            parameter, or a table of several; at the first channel that it fits.
        initial: for each output its value, or [value, rate, …], at the start; default: what the
            model declares as known, and zero; for each internal state with a free start its value.
        noise: standard deviation of white noise for each output [its unit].
        quantisation: step of each output's sensor [its unit].
        seed: of the noise.
    """

    sample_period: Positive
    duration: Positive
    input: dict[str, SignalTable]
    held_out: dict[str, SignalTable] = {}
    truth: dict[str, float] = {}
    increments: dict[str, float] = {}
    effects: dict[str, float | dict[str, float]] = {}
    initial: dict[str, float | tuple[float, ...]] = {}
    noise: dict[str, NotNegative] = {}
    quantisation: dict[str, NotNegative] = {}
    seed: int = 0


InputHold = Literal["zero", "linear", "smooth"]
MissingCodes = float | str | tuple[float | str, ...]
HoldWord = Literal["auto", "zero", "linear", "smooth"]


class DataTable(msgspec.Struct, frozen=True):
    """[data], [validation] and [test]: measured files and how they are read.

    Attributes:
        files: a record each; relative to ``--data``, else to the config, else to $EOI_DATA.
        inputs, outputs: columns, in the order of the plant's inputs and outputs; default: those
            that are called as these are, and none for a plant without inputs.
        references: columns of the references of [controller], in their order; default: the columns
            that are called as they are. The plant does not get them.
        time: column of time [s]; omitted with `sample_period` [s].
        scale: factor by column, to convert units, or ``[factor, offset]``.
        units: unit by column, after scaling.
        unwrap: period by column, after scaling, of counters and angles that start again at the end
            of their range: ``{ encoder = 4096 }``.
        empty_repeats: columns in which a value that repeats the one before is a missing sample, as
            of a slower sensor whose last value is stored until the next one comes.
        missing: what stands for no value in the cells of inputs and outputs, before scaling:
            ``[-999, "Inp OutRange"]``, or by column ``{ outdoor = -999 }``.
        late: time by column of outputs that were logged late beside the others [s], as by a second
            logger: ``{ speed = 0.03 }``; negative: early.
        impulses: inputs whose values are amounts given at the instant of their row, as doses.
        slice: first and last (excluded) sample used.
        parts: ranges of samples by file, each a record of its own, in place of `slice`: where the
            logger was started again, as ``{ "run.csv" = [[0, 3017], [3017, 6024]] }``.
        hold: the input between samples: zero, linear, smooth, or auto; or by column, as
            ``{ heating = "zero", outdoor = "linear" }``. With a [controller] auto means zero.
        burn_in: time at the start that is not scored [s].
        mask_faults: whether samples that leave the course of an output alone are masked.
        max_gigabytes: largest unpacked size of a compressed file [1e9 bytes].
        sheet: of Excel files; default: the first that is not empty.
    """

    files: Annotated[tuple[str, ...], msgspec.Meta(min_length=1)]
    inputs: tuple[str, ...] | None = None
    outputs: tuple[str, ...] | None = None
    references: tuple[str, ...] | None = None
    time: str | None = None
    sample_period: Positive | None = None
    scale: dict[str, float | tuple[float, float]] = {}
    units: dict[str, str] = {}
    unwrap: dict[str, Positive] = {}
    empty_repeats: tuple[str, ...] = ()
    missing: MissingCodes | dict[str, MissingCodes] = ()
    late: dict[str, float] = {}
    impulses: tuple[str, ...] = ()
    slice: tuple[int, int] | None = None
    parts: dict[str, tuple[tuple[int, int], ...]] = {}
    hold: HoldWord | dict[str, InputHold] = "auto"
    burn_in: NotNegative = 0.0
    mask_faults: bool = True
    max_gigabytes: Positive = MAX_GIGABYTES
    sheet: str | None = None


class Config(msgspec.Struct, frozen=True):
    """The config of a run.

    Attributes:
        name: of the run, and of its folder.
        plant: a plant of the library by name, or ``"file.py:object"`` beside the config, where
            the object is a `Plant` or a function that returns one.
        model: the equations as text, instead of `plant`.
        observer, lowpass: default: chosen from the records.
        identify, discover, refine, sweep: options of the commands with these names.
        controller: what drove inputs of the plant while [data] was measured. Free runs of identify
            and refine have it in the loop.
        simulate, data: source of the records; exactly one of the two.
        validation: held-out files; defaults are the values of [data].
        test: files on which discover chooses nothing; the same defaults.
    """

    name: FolderName
    plant: str | None = None
    model: ModelTable | None = None
    parameters: ParameterTable = ParameterTable()
    observer: ObserverTable | None = None
    lowpass: LowPassTable | None = None
    identify: IdentifyTable = IdentifyTable()
    discover: DiscoverTable = DiscoverTable()
    refine: RefineTable = RefineTable()
    controller: PidTable | LawTable | None = None
    sweep: SweepTable = SweepTable()
    simulate: SimulateTable | None = None
    data: DataTable | None = None
    validation: DataTable | None = None
    test: DataTable | None = None


# -- from text to tables ----------------------------------------------------------------------


def _with_defaults(part: dict[str, Any], data: dict[str, Any]) -> dict[str, Any]:
    """[validation] or [test] with what [data] says; parts only of files that it names too."""
    merged = {**data, **part}
    parts, files = merged.get("parts"), merged.get("files")
    if "parts" in part:
        merged.pop("slice", None)
    elif "slice" in part:
        merged.pop("parts", None)
    elif isinstance(parts, dict) and isinstance(files, list):
        merged["parts"] = {file: parts[file] for file in parts if file in files}
    return merged


def _check_finite(value: Any, place: tuple[str, ...]) -> None:
    """TOML has inf and nan: only a bound or a limit may be infinite, meaning none."""
    if isinstance(value, dict):
        for key, part in value.items():
            if key not in ("bounds", "limits"):
                _check_finite(part, (*place, key))
    elif isinstance(value, list):
        for i, part in enumerate(value):
            _check_finite(part, (*place[:-1], f"{place[-1]}[{i}]"))
    elif isinstance(value, float):
        check(math.isfinite(value), ".".join(place), "must be a finite number", value)


def _replacement(path: Path) -> str:
    """What to give in the place of what is no config."""
    if (path / "config.toml").is_file():
        return f"Its folder has one: {shell_word(path / 'config.toml')}."
    if path.is_file() and path.suffix.lower() in DATA_FILES:
        return f"Data need a config: `eoi init {shell_word(path)}` drafts one."
    present = [] if path.exists() else sorted(path.parent.glob("*.toml"))
    close = difflib.get_close_matches(path.name, [file.name for file in present], n=1)
    return f"Did you mean {shell_word(path.parent / close[0])}?" if close else ""


def _at_place(path: Path, reason: str) -> str:
    """The line at which the parser stopped, and what is usually meant there."""
    place = re.search(r"line (\d+), column (\d+)", reason)
    if place is None:
        return ""
    number, column = (int(number) - 1 for number in place.groups())
    line = path.read_text(encoding="utf-8-sig").split("\n")[number]
    letter, ending = line[column : column + 1], line[column:].split("#")[0].strip(" ,}]")
    advice = ""
    if "\\" in line:
        advice = "Write a path with /, or in single quotes: 'C:\\data\\run.csv'."
    elif letter.isalpha() and not letter.isascii():
        advice = f'Names with other letters than A to Z stand in quotes: "{letter}" = 1.0.'
    elif not letter.strip() and "{" in line:
        advice = "Braces end on the line on which they begin. A table of its own, as "
        advice += "[model.parameters], has a line for each entry."
    elif re.search(r"\d,\d", line[:column]):
        advice = "Numbers have a decimal point."
    elif letter == ":":
        advice = "Write a = 1.0, not a: 1.0."
    elif ending in ("True", "False"):
        advice = f"Write {ending.lower()}."
    elif letter.isalpha() and "value" in reason:
        advice = f'Text stands in quotes: "{ending}".'
    return f" The line: {printable(line.strip())[:120]} {advice}".rstrip()


def load(path: Path, max_depth: int = 20) -> Config:
    """Read and check a TOML file.

    Args:
        path: of the file.
        max_depth: nested tables and lists; a valid config has five.

    Raises:
        ValueError: the file is missing or not TOML, a key is unknown (the known keys are listed),
            a value is missing, of the wrong type or out of range.
    """
    check(path.is_file(), "config", "must be a file that exists", path, _replacement(path))
    try:
        tables = tomllib.loads(
            path.read_text(encoding="utf-8-sig")
        )  # with the byte-order mark of Windows editors
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        deep = isinstance(error, RecursionError)
        reason = "nested too deeply" if deep else printable(str(error))
        advice = _replacement(path) or f"Parser: {reason}.{_at_place(path, reason)}"
        check(False, "config", "must be a TOML file", path, advice)
        raise
    rule = f"must have at most {max_depth} levels of nested tables and lists"
    check(is_shallow(tables, max_depth), "config", rule, path)
    _check_finite(tables, ())
    data = tables.get("data")
    for name in ("validation", "test"):
        part = tables.get(name)
        if isinstance(data, dict) and isinstance(part, dict):
            tables[name] = _with_defaults(part, data)
    config = struct(Config, tables)
    check(
        (config.plant is None) != (config.model is None),
        "config",
        "must have exactly one of `plant` and the table [model]",
        "none" if config.plant is None else "both",
    )
    check(
        (config.simulate is None) != (config.data is None),
        "config",
        "must have exactly one of the tables [simulate] and [data]",
        "none" if config.data is None else "both",
    )
    check(
        config.controller is None or config.data is not None,
        "controller",
        "must be that of measured records",
        "the table [simulate], whose signals drive the plant",
        "Give the files of the records in [data], or remove [controller].",
    )
    return config
