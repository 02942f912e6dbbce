"""Equations from hostile hands: nothing runs, nothing hangs, nothing but a ValueError comes out.

python benchmarks/robustness/fuzz_equations.py [--quick] [--write]
"""

import faulthandler
import importlib.util
import random
import string
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from benchmarks.common import Report, arguments, table
from eoi_jax.models.equations.expression import FUNCTIONS, Symbol, value_of
from eoi_jax.models.equations.parser import parse
from eoi_jax.models.equations.system import Equations

NAMES = ("angle", "rate", "voltage", "a", "b", "c", "d", "x1", "α")
SYMBOLS = {name: Symbol(name) for name in NAMES}
VALUES = {**{one: 0.1 + 0.3 * i for i, one in enumerate(SYMBOLS.values())}, Symbol("t"): 0.7}
VALID = (
    "-a*sin(angle) - b*rate - c*sign(rate) + d*voltage",
    "(voltage - a*rate - b*sign(rate) - c)/d",
    "-a*sqrt(2*9.81*x1) + b*voltage",
    "where(angle > 0.5 and rate < 0, a, b) + clip(voltage, -c, c)",
    "a if 0 <= angle < 1 else b*exp(-(rate/c)**2)",
    "min(a, b, c) + max(angle, 0) - atan2(rate, 1) + 1.5e-3*t + pi",
    "α*tanh(x1)**3 - abs(rate)*rate/(1 + d**-2)",
)
HOSTILE = (
    "__import__('os').system('true')", "().__class__.__bases__[0].__subclasses__()", "eval('1')",
    "exec('x=1')", "open('/etc/passwd')", "lambda: 0", "[a for a in (1,)]", "(a := 1)", "f'{a}'",
    "9**9**9**9", "1e999", "0x" + "f" * 400, "9" * 3000, "a.__class__", "a[0]", "*a", "**a",
    "await a", "(yield a)", "print(a)", "globals()", "getattr(a, b)", "sin.__globals__",
    "\\u0065val(a)", "ﬁ", "𝑎", "a\0b", "\u202ea", "a;b", "a\nb", "#", "'''", '"', "`a`", "@a",
    "a@b", "~a", "a<<9", "a//b", "a%b", "True", "None", "...", "1j", "sin(a=1)", "sin(*a)", "not",
    "a if", "(" * 40, ")" * 40, "-" * 500, "not " * 200, "a<" * 300 + "a", "a+" * 500 + "a",
    "a**" * 90 + "a", "sin(" * 49 + "a" + ")" * 49, "where(a<b," * 45 + "a" + ",a)" * 45,
    "1if 1else 1", "0_0", "1__0", "07", "1.e", ".", "1..2", "\f",
)  # fmt: skip
TOKENS = (
    *NAMES, *FUNCTIONS, *HOSTILE, "t", "pi", "0", "1", "2.5", "1e-9", "1e99", "+", "-", "*", "/",
    "**", "(", ")", ",", "<", "<=", ">", ">=", "==", "!=", " and ", " or ", " not ", " if ",
    " else ", " ", "^", ".", "=", ":", "'", "\n",
)  # fmt: skip


# -- inputs -----------------------------------------------------------------------------------


def grammatical(draw: random.Random) -> str:
    """A formula by the grammar, mostly right, sometimes too deep or with a wrong name."""
    return _formula(draw, draw.randrange(7))


def _formula(draw: random.Random, depth: int) -> str:
    if depth == 0:
        return draw.choice((*NAMES, "t", "pi", "1", "0", "2.5", "3e2", "missing"))
    kind, inner = draw.randrange(7), depth - 1
    one = _formula(draw, inner)
    if kind == 0:
        name = draw.choice(tuple(FUNCTIONS))
        count = draw.randrange(FUNCTIONS[name].min_arguments, FUNCTIONS[name].min_arguments + 2)
        rest = [_formula(draw, draw.randrange(2)) for _ in range(count - 1)]
        first = f"{one} < a" if name == "where" else one
        return f"{name}({', '.join([first, *rest])})"
    if kind == 1:
        return f"({one})"
    if kind == 2:
        return f"-{one}"
    other = _formula(draw, draw.randrange(depth))
    if kind == 3:
        return f"{one} if {other} > b else {draw.choice(NAMES)}"
    sign = draw.choice(("+", "-", "*", "/", "**", " < ", " == ", " and "))
    return f"{one}{sign}{other}"


def mutated(draw: random.Random) -> str:
    """A right equation with some changes."""
    text = draw.choice(VALID)
    for _ in range(draw.randrange(1, 6)):
        at, end = sorted((draw.randrange(len(text) + 1), draw.randrange(len(text) + 1)))
        change = draw.randrange(6)
        if change == 0:
            text = text[:at] + text[at + 1 :]
        elif change == 1:
            text = text[:at] + draw.choice(TOKENS) + text[at:]
        elif change == 2:
            text = text[:at] + text[end:]
        elif change == 3:
            text = text[:end] + text[at:]
        elif change == 4:
            text = text[:at] + chr(draw.randrange(32, 127)) + text[at + 1 :]
        else:
            text = text[:at] + draw.choice(VALID)[end:]
    return text


def scattered(draw: random.Random) -> str:
    """Tokens in any order, right and hostile ones."""
    return "".join(draw.choices(TOKENS, k=draw.randrange(1, 15)))


def characters(draw: random.Random) -> str:
    """Characters of any kind."""
    size = draw.randrange(60)
    if draw.random() < 0.4:
        return draw.randbytes(size).decode("latin-1")
    if draw.random() < 0.5:
        return draw.randbytes(size).decode("utf-8", errors="replace")
    if draw.random() < 0.5:
        return "".join(draw.choices(string.printable, k=size))
    return "".join(chr(draw.randrange(0x110000)) for _ in range(size))


def repeated(draw: random.Random) -> str:
    """One part many times: deep, long, or both."""
    part = draw.choice(TOKENS)
    ends = draw.choice(TOKENS), draw.choice(TOKENS)
    return part * draw.randrange(1, 2 + 5000 // max(len(part), 1)) + "".join(ends)


def whole(draw: random.Random) -> str:
    """Five texts for the places of a model, some of which use its definitions."""
    parts = [mutated(draw) if draw.random() < 0.1 else _formula(draw, 2) for _ in range(5)]
    defined = "w1", "w2", "x1", "a"
    return "|".join(one.replace("missing", draw.choice(defined)).replace("|", " ") for one in parts)


# -- what is done with each -------------------------------------------------------------------


def formula(text: str) -> None:
    """Read, and worked out where it is an equation."""
    value_of(parse(text, SYMBOLS, "equation"), VALUES, np)


def system(text: str) -> None:
    """Texts in all the places of a whole model."""
    highest, internal, first, second, start = text.split("|")
    Equations(
        (("angle", "rate"), ("rate", f"{highest} + a*b*c*d*α*w1*w2"), ("x1", internal)),
        (("w1", first), ("w2", second)),
        (("x1", start),),
        ("angle",),
        ("voltage",),
        ("a", "b", "c", "d", "α"),
    ).check()


SOURCES: dict[str, tuple[Callable[[random.Random], str], Callable[[str], None], int]] = {
    "by the grammar": (grammatical, formula, 100_000),
    "right ones, changed": (mutated, formula, 200_000),
    "tokens in any order": (scattered, formula, 200_000),
    "characters": (characters, formula, 450_000),
    "one part repeated": (repeated, formula, 5_000),
    "in whole models": (whole, system, 10_000),
}
GUIDED = 100_000
SLOW = 0.05  # [s] from here on an input is timed again: a collection of garbage may have come in
HANGING = 0.5  # [s]

# Beginnings of what the interpreter reports when something is run, read, written or looked up.
FORBIDDEN = (
    "exec", "compile", "import", "open", "os.", "subprocess", "socket", "shutil", "ctypes",
    "code.", "builtins", "marshal", "pickle", "object.__", "sys.", "tempfile", "glob", "urllib",
    "webbrowser",
)  # fmt: skip


@dataclass
class Watch:
    """What happened while it was armed.

    Attributes:
        events: forbidden ones, by name.
        armed: whether it looks.
    """

    events: Counter = field(default_factory=Counter)
    armed: bool = False

    def __call__(self, event: str, details: tuple) -> None:
        """Seen by the interpreter's audit."""
        if self.armed and event.startswith(FORBIDDEN):
            # The parser alone reports itself as "compile"; running what came of it would be "exec".
            if event == "compile" and details[1] == "<equation>":
                return
            self.events[event] += 1


@dataclass
class Seen:
    """What one source of inputs showed.

    Attributes:
        count, accepted: inputs, and those without a mistake.
        seconds: of all, without making them.
        slowest: of one [s], and its text.
        wrong: what came out besides `ValueError`, with a text.
    """

    count: int = 0
    accepted: int = 0
    seconds: float = 0.0
    slowest: tuple[float, str] = (0.0, "")
    wrong: list[str] = field(default_factory=list)


def tried(texts: Iterator[str], use: Callable[[str], None], watch: Watch) -> Seen:
    """Use every text, watched."""
    seen = Seen()
    for text in texts:
        if seen.count % 1000 == 0:
            # What hangs for good is shown, and ends the run.
            faulthandler.dump_traceback_later(60, exit=True)
        watch.armed = True
        spent, outcome = _once(use, text)
        for _ in range(3 if spent > SLOW else 0):
            spent = min(spent, _once(use, text)[0])
        watch.armed = False
        seen.count += 1
        seen.accepted += outcome == ""
        seen.seconds += spent
        seen.slowest = max(seen.slowest, (spent, text))
        if outcome not in ("", "ValueError"):
            seen.wrong.append(f"{outcome}: {text!r}")
    faulthandler.cancel_dump_traceback_later()
    return seen


def _once(use: Callable[[str], None], text: str) -> tuple[float, str]:
    # Time of this process alone: other work on the machine is no fault of the text. What waits for
    # good is found by the wall clock of `tried`.
    start = time.process_time()
    try:
        use(text)
        outcome = ""
    except ValueError:
        outcome = "ValueError"
    except Exception as error:  # what must not happen is counted, not raised
        outcome = type(error).__name__
    return time.process_time() - start, outcome


def guided(count: int) -> None:
    """Inputs that coverage leads to, by atheris, in this process, which it ends."""
    import atheris

    watch = Watch()
    sys.addaudithook(watch)
    np.seterr(all="ignore")

    def one(data: bytes) -> None:
        text = data.decode("utf-8", errors="replace")
        watch.armed = True
        spent, outcome = _once(formula, text)
        watch.armed = False
        if outcome not in ("", "ValueError") or spent > HANGING or watch.events:
            raise RuntimeError(f"{outcome or 'accepted'}, {spent:.2g} s, {watch.events}: {text!r}")

    atheris.instrument_func(parse)  # pyright: ignore[reportAttributeAccessIssue]
    for name in ("_Scanner", "_Reader"):
        kind = sys.modules[parse.__module__].__dict__[name]
        for key, member in list(vars(kind).items()):
            if callable(member):
                traced = atheris.instrument_func(member)  # pyright: ignore[reportAttributeAccessIssue]
                setattr(kind, key, traced)
    atheris.Setup([sys.argv[0], f"-runs={count}", "-max_len=200", "-seed=1", "-verbosity=0"], one)
    atheris.Fuzz()


def main() -> int:
    """Every source of inputs; the exit status says whether all was well."""
    if sys.argv[1:2] == ["--guided"]:
        guided(int(sys.argv[2]))
    options = arguments(__doc__)
    share = 100 if options.quick else 1
    np.seterr(all="ignore")
    watch = Watch()
    sys.addaudithook(watch)
    report = Report("Equations from hostile hands")
    rows, good, total = [], True, 0
    for i, (name, (make, use, full)) in enumerate(SOURCES.items()):
        draw = random.Random(i)
        texts = (make(draw) for _ in range(full // share))
        seen = tried(texts, use, watch)
        slow, text = seen.slowest
        rows.append([name, seen.count, f"{100 * seen.accepted / seen.count:.1f} %",
                     f"{seen.count / seen.seconds:,.0f}", f"{1e3 * slow:.2g}",
                     len(seen.wrong), sum(watch.events.values())])  # fmt: skip
        total += seen.count
        print(name, seen.count, f"{time.process_time():.0f} s", file=sys.stderr, flush=True)
        if seen.wrong or watch.events or slow > HANGING:
            good = False
            report.add(
                "\n".join([f"{name}:", *seen.wrong[:5], str(dict(watch.events)), text[:100]])
            )
        watch.events.clear()
    report.add(
        "Every input is read as an equation (or as parts of a whole model) and, where it is one, "
        "worked out. *Events*: what Python's audit reports of running, importing, opening; its own "
        "parser, which reads and runs nothing, apart. Inputs a second, and the slowest, are of "
        "processor time.",
        table(("inputs", "count", "accepted", "inputs/s", "slowest [ms]", "not a ValueError",
               "events"), rows),
    )  # fmt: skip
    if importlib.util.find_spec("atheris"):
        count = GUIDED // share
        command = [sys.executable, __file__, "--guided", str(count)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300)
        fine = done.returncode == 0
        good, total = good and fine, total + count
        found = "nothing found" if fine else done.stderr[-1500:]
        report.add(f"Led by coverage (atheris): {count:,} inputs, {found}.")
    else:
        report.add("atheris is not installed: no inputs led by coverage.")
    report.add(f"{total:,} inputs: {'all was well' if good else 'NOT all was well'}.")
    report.close(__file__, options.write)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
