"""Equations as MathML, which browsers set themselves; what was added is marked."""

import re
from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree

_OUTER = re.compile(r"^<math[^>]*>(.*)</math>$", re.DOTALL)
# `\mathrm{mass}` comes as a letter each, which a screen reader would spell.
_LETTERS = re.compile(r'(?:<mi mathvariant="normal">[^<]*</mi>)+')
_WITH_SIGNS = re.compile(r"\\text\{[^}]*\\")
_PRIMES = {"\u02d9": "′", "\u00a8": "″"}
_ELEMENTS = frozenset(
    ("mrow", "mi", "mn", "mo", "mtext", "mspace", "mfrac", "msqrt", "msub", "msup", "msubsup",
     "mover", "munder", "mstyle", "mpadded")
)  # fmt: skip


def equation_mathml(lines: Sequence[Sequence[Any]], changes: Sequence[str]) -> str | None:
    """Equations below each other, aligned at the sign of equality.

    Args:
        lines: left side, declared right side or "", and the terms that were added with their
            signs, all in LaTeX; of `equation_lines`.
        changes: LaTeX of what happens to inputs on their way into the model.

    Returns:
        One ``<math>`` element; terms that were added have the class ``added``. None where a name
        makes a formula that cannot be converted.
    """
    try:
        body = "".join(f"<mtr>{row}</mtr>" for row in _rows(lines, changes))
    except _UnreadableError:
        return None
    return f'<math display="block"><mtable displaystyle="true">{body}</mtable></math>'


class _UnreadableError(Exception):
    """A formula that is none: a name holds more than letters and digits."""


def _rows(lines: Sequence[Sequence[Any]], changes: Sequence[str]) -> list[str]:
    rows = []
    for left, declared, added in lines:
        right = _converted(declared) if declared else ""
        terms = [_converted(term) for term in added]
        right += "".join(_marked(_infix(term) if declared else term) for term in terms)
        cells = (_converted(left), "<mo>=</mo>", f"<mrow>{right}</mrow>")
        rows.append("".join(f"<mtd>{cell}</mtd>" for cell in cells))
    for change in changes:
        rows.append(
            f"<mtd><mtext>with</mtext></mtd><mtd></mtd><mtd>{_marked(_converted(change))}</mtd>"
        )
    return rows


def _marked(formula: str) -> str:
    return f'<mrow class="added">{formula}</mrow>'


def _infix(term: str) -> str:
    """The sign at the start of a term stands between two, not before a number."""
    return re.sub(r"^((?:<mrow>)*)<mo>", r'\g<1><mo form="infix">', term)


def _converted(latex: str) -> str:
    from latex2mathml.converter import convert

    if _WITH_SIGNS.search(latex):  # of which the converter makes letters and commands
        raise _UnreadableError
    try:
        found = _OUTER.match(convert(latex))
        inner = _LETTERS.sub(_whole, found[1]) if found else ""
        tree = ElementTree.fromstring(f"<mrow>{inner}</mrow>")
    except Exception as error:  # the converter raises what it likes
        raise _UnreadableError from error
    # Names come from the user: nothing but formulas goes into the page.
    if any(one.tag not in _ELEMENTS for one in tree.iter()):
        raise _UnreadableError
    for one in tree.iter("mover"):
        _primed(one)
    return ElementTree.tostring(tree, encoding="unicode")


def _primed(accented: ElementTree.Element) -> None:
    """A word takes primes: a dot above it would stand over whichever letter is in its middle."""
    base, accent = accented
    if (accent.text or "") in _PRIMES and len("".join(base.itertext())) > 1:
        accented.tag = "mrow"
        accent.attrib.update(lspace="0", rspace="0", form="postfix")
        accent.text = _PRIMES[accent.text or ""]


def _whole(letters: re.Match[str]) -> str:
    word = "".join(re.findall(r">([^<]*)<", letters[0]))
    return f'<mi mathvariant="normal">{word}</mi>'
