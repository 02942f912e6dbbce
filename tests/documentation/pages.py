"""Pages of the documentation as programs: their blocks run in order, in one namespace.

A block of Python runs; a block of text that follows it shows what it printed, where a line `...`
stands for lines left out. `<!-- skip: next -->` before a block leaves it out.

    python tests/documentation/pages.py docs/tutorial.md FOLDER

runs a page in that folder, where its pictures remain, and writes what was printed into the page.
"""

import contextlib
import io
import os
import re
import sys
import warnings
from dataclasses import dataclass, field
from pathlib import Path

import matplotlib as mpl
from sybil import Document, Example
from sybil.evaluators.python import PythonEvaluator
from sybil.parsers.markdown import CodeBlockParser, SkipParser

_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_LEFT_OUT = "..."
# What follows the second digit of an error or a statistic may differ between processors.
_SHARE, _CANCELLED = 0.05, 1e-12


@dataclass
class Page:
    """One run of a page.

    Attributes:
        path: of the page.
        update: whether text blocks take what is printed, rather than being compared with it.
        printed: by the last block of Python.
        new: text blocks as (start, end, text), where the page is updated.
    """

    path: Path
    update: bool = False
    printed: str = ""
    new: list[tuple[int, int, str]] = field(default_factory=list)

    def run(self) -> int:
        """Run all blocks in the current folder; how many there were."""
        parsers = (
            CodeBlockParser("python", self._python),
            CodeBlockParser("text", self._text),
            SkipParser(),
        )
        document = Document.parse(str(self.path), *parsers)
        count = 0
        with mpl.rc_context():
            for example in document.examples():
                example.evaluate()
                count += 1
        return count

    def _python(self, example: Example) -> None:
        out = io.StringIO()
        with warnings.catch_warnings(), contextlib.redirect_stdout(out):
            # `configure` says that JAX runs already, which it does under pytest only.
            warnings.simplefilter("ignore", RuntimeWarning)
            PythonEvaluator()(example)
        self.printed = out.getvalue()

    def _text(self, example: Example) -> None:
        shown = str(example.parsed)
        if not self.update:
            shows(shown, self.printed)
        elif _LEFT_OUT not in shown.splitlines():
            lines = "\n".join(line.rstrip() for line in self.printed.rstrip().splitlines())
            start, end = example.region.start, example.region.end
            self.new.append((start, end, f"```text\n{lines}\n```"))


def shows(page: str, printed: str) -> None:
    """Assert that a page shows what was printed: the same words, and numbers to two digits."""
    lines = printed.rstrip().splitlines()
    parts = [part.strip("\n").splitlines() for part in re.split(r"(?m)^\.\.\.$", page.rstrip())]
    whole = f"printed:\n{printed}\nshown:\n{page}"
    start = 0
    for number, part in enumerate(parts):
        first, last = number == 0, number == len(parts) - 1
        end = len(lines) - len(part)  # the latest that it may begin
        places = [start] if first else [end] if last and part else range(start, end + 1)
        at = next((i for i in places if start <= i <= end and _same(lines[i:], part)), None)
        assert at is not None, f"{part[:1]} is not printed there\n{whole}"
        start = at + len(part)
    assert start == len(lines) or not parts[-1], whole


def _same(lines: list[str], shown: list[str]) -> bool:
    return all(map(_same_line, lines, shown))


def _same_line(line: str, shown: str) -> bool:
    words, wanted = ([one.split() for one in _NUMBER.split(text)] for text in (line, shown))
    numbers = zip(_NUMBER.findall(line), _NUMBER.findall(shown), strict=False)
    return words == wanted and all(_near(number, want) for number, want in numbers)


def _near(number: str, shown: str) -> bool:
    """To five per cent, or one unit of the last digit; sums that cancel are zero and rounding."""
    mantissa, _, exponent = shown.lower().partition("e")
    unit = 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))
    apart = abs(float(number) - float(shown))
    return apart <= max(1.01 * unit, _SHARE * abs(float(shown)), _CANCELLED)


def main(page: str, folder: str) -> None:
    """Run a page in a folder, and write what it prints into it."""
    path = Path(page).resolve()
    Path(folder).mkdir(parents=True, exist_ok=True)
    os.chdir(folder)
    one = Page(path, update=True)
    one.run()
    text = path.read_text()
    for start, end, block in reversed(one.new):
        text = text[:start] + block + text[end:]
    path.write_text(text)


if __name__ == "__main__":
    main(*sys.argv[1:])
