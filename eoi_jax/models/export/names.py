"""Names and comments that are safe in any file: nothing that a model is called can leave its place.

Names of channels and units are any text. Of a name only letters, digits and underscores reach a
file; a comment loses line breaks, control characters and what could end it.
"""

import keyword
import re
import unicodedata
from collections.abc import Collection, Mapping, Sequence

from eoi_jax.models.equations.expression import Symbol
from eoi_jax.models.equations.parser import RESERVED
from eoi_jax.models.export.program import Program, Variable

# C, C++ and MATLAB; of their libraries what files of this package call.
_WORDS = (
    "auto bool break case catch char class const constexpr continue default delete do double "
    "else enum explicit export extern false float for friend goto if inline int long mutable "
    "namespace new nullptr operator private protected public register restrict return short "
    "signed sizeof static struct switch template this throw true try typedef typename union "
    "unsigned using virtual void volatile while alignas alignof asm typeof thread_local "
    "static_assert main classdef elseif end function global otherwise parfor persistent spmd "
    "endfunction endif until unwind_protect end_try_catch eps inf nan Inf NaN i j ans nargin "
    "nargout zeros isargout fabs fmax fmin fmod rint pow nthroot fix mod choose root nearest "
    "states inputs rates outputs np array stack "
)
TEXT_WORDS = frozenset((*keyword.kwlist, *RESERVED))
_CODE_WORDS = TEXT_WORDS.union(_WORDS.split())


def identifier(
    name: str,
    reserved: Collection[str] = (),
    words: Collection[str] = _CODE_WORDS,
    length: int = 48,
) -> str:
    """A name that every language takes: ASCII letters, digits, underscores; no word of theirs.

    Args:
        name: any text; Greek letters are spelled out.
        reserved: names that are gone; a number is added to differ from them.
        words: of the language; an underscore is added to differ from them.
        length: characters; C99 and MATLAB tell 63 apart, and some are added.
    """
    plain = re.sub(r"[^A-Za-z0-9]+", "_", "".join(_spelled(letter) for letter in name))
    plain = plain.strip("_")[:length] or "name"
    plain = plain if plain[0].isalpha() else f"n{plain}"
    plain = f"{plain}_" if plain in words else plain
    unique, count = plain, 2
    while unique in reserved:
        unique, count = f"{plain}_{count}", count + 1
    return unique


# Letters that Unicode does not decompose.
_LETTERS = {"ß": "ss", "æ": "ae", "Æ": "Ae", "œ": "oe", "Œ": "Oe", "ø": "o", "Ø": "O", "ł": "l",
            "Ł": "L", "đ": "d", "ı": "i"}  # fmt: skip


def _spelled(letter: str) -> str:
    if letter in _LETTERS:
        return _LETTERS[letter]
    greek = re.fullmatch(r"GREEK (?:SMALL|CAPITAL) LETTER (\w+)", unicodedata.name(letter, ""))
    if greek:
        return greek[1].lower()
    parts = unicodedata.normalize("NFKD", letter)
    return "".join(part for part in parts if not unicodedata.combining(part))


def identifiers(model: Program, *, as_text: bool = False) -> dict[Symbol, str]:
    """Identifiers of all symbols of a program, all different.

    Args:
        model: its states, inputs, parameters and definitions.
        as_text: for formulas that are no code, which have fewer words of their own.
    """
    words = TEXT_WORDS if as_text else _CODE_WORDS
    named = [
        *((variable.symbol, variable.name) for variable, _ in model.parameters),
        *(
            (variable.symbol, variable.name)
            for variable in (*model.states, *model.inputs, *model.outputs)
        ),
        *((symbol, symbol.name) for symbol, _ in model.definitions),
        *((symbol, symbol.name) for symbol, _ in model.output_definitions),
    ]
    names = {symbol: symbol.name for symbol in model.arguments}
    for symbol, name in named:
        if symbol not in names:
            names[symbol] = identifier(name, names.values(), words)
    return names


def comment(text: str, length: int = 100) -> str:
    """A text that can stand in a comment of any language: one line that ends no comment.

    Args:
        text: any.
        length: characters of a line of code.
    """
    line = "".join(letter if letter.isprintable() else " " for letter in text).replace("\\", "/")
    line = re.sub(r"\*(?=/)|/(?=\*)", lambda sign: sign[0] + " ", line)
    return line if len(line) <= length else line[: length - 1] + "…"


def header(
    model: Program,
    names: Mapping[Symbol, str],
    index: Sequence[str],
    version: str,
    vectors: Sequence[str] = ("states", "inputs", "outputs"),
) -> str:
    """What a file says first, a line each, without the signs of a comment.

    Args:
        model: what it holds.
        names: of its symbols.
        index: how the first state and input are written, before and after the number, and
            that number: ``("[", "]", "0")``.
        version: of this package.
        vectors: names of those that hold states, inputs and outputs.
    """
    prefix, after, first = index
    x, u, y = vectors

    def element(vector: str, k: int, variable: Variable, note: str) -> str:
        name = f"{names[variable.symbol]}{_unit(variable.unit)}"
        return f"  {vector}{prefix}{k}{after} {name}{': ' + note if note else ''}"

    # The first two lines are ours: an encoding named there would be believed.
    lines = [
        "Right-hand side of a model: d/dt of its states at time t under inputs.",
        f"Written by eoi_jax {version}.",
        "",
        f"Model: {comment(model.name)}",
        "States:",
    ]
    for k, variable in enumerate(model.states, int(first)):
        note = comment("; ".join(filter(None, (variable.note, _start(model, variable.symbol)))))
        lines.append(element(x, k, variable, note))
    lines.append("Inputs:" if model.inputs else "Inputs: none")
    for k, variable in enumerate(model.inputs, int(first)):
        late = " + ".join(model.delays.get(variable.name, ()))
        notes = [f"its value {comment(late)} seconds ago"] if late else []
        limits = model.limits.get(variable.name, ())
        notes += [LIMITED[kind].format(comment(name)) for kind, name in limits]
        lines.append(element(u, k, variable, ", then ".join(notes)))
    if model.outputs:
        lines.append("Outputs that are functions of these, at t with the inputs from t on:")
    for k, variable in enumerate(model.outputs, int(first)):
        lines.append(element(y, k, variable, ""))
    for variable, value in model.parameters:
        kind = on_input(model).get(variable.name)
        if kind is not None:
            lines.append(f"  {names[variable.symbol]} = {value!r}{_unit(variable.unit)}: {kind}")
    for symbol in model.rough:
        lines.append(f"Dry friction: at {names[symbol]} = 0 the right-hand side is set-valued, and")
        lines.append(
            "  the state sticks while the other forces are below its level. Here sign(0) = 0."
        )
    return "\n".join(lines)


# What an input has gone through before the model, by the name of the effect.
LIMITED = {
    "rate_limit": "what moves towards it by {} in a second at most, from its first value on",
    "input_play": "what it takes along where they are half of {} apart, from its first value on",
}


def on_input(model: Program) -> dict[str, str]:
    """Parameters of what inputs go through before they reach the formulas, and what they are."""
    delays = {name: "a delay" for names in model.delays.values() for name in names}
    kinds = {"rate_limit": "a limit of the rate", "input_play": "a play"}
    limits = {name: kinds[kind] for pairs in model.limits.values() for kind, name in pairs}
    return delays | limits


def _unit(unit: str) -> str:
    return f" [{comment(unit)}]" if unit else ""


def _start(model: Program, symbol: Symbol) -> str:
    if symbol in model.measured_starts:
        return f"the first record begins at {model.measured_starts[symbol]!r}"
    if symbol in model.free_starts:
        return f"start free, set it: {model.free_starts[symbol]!r} is a guess"
    if symbol not in model.start_values:
        return ""
    start = f"starts at {model.start_values[symbol]!r}"
    return f"{start}, {_ESTIMATED}" if symbol in model.estimated_starts else start


_ESTIMATED = "or where a free run estimates it for its record"
