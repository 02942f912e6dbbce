"""Equations as MathML, which browsers render; terms that were added are marked."""

import re
from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree

_OUTER = re.compile(r"^<math[^>]*>(.*)</math>$", re.DOTALL)
# `\mathrm{mass}` is converted letter by letter, which a screen reader would spell out.
_LETTERS = re.compile(r'(?:<mi mathvariant="normal">[^<]*</mi>)+')
_WITH_SIGNS = re.compile(r"\\text\{[^}]*\\")
_PRIMES = {"\u02d9": "′", "\u00a8": "″"}
_ELEMENTS = frozenset(
    ("mrow", "mi", "mn", "mo", "mtext", "mspace", "mfrac", "msqrt", "msub", "msup", "msubsup",
     "mover", "munder", "mstyle", "mpadded", "mtable", "mtr", "mtd")
)  # fmt: skip


def equation_mathml(lines: Sequence[Sequence[Any]], changes: Sequence[str]) -> str | None:
    """Equations one below the other, aligned at the equals sign.

    Args:
        lines: left side, declared right side or "", and the added terms with their signs, all in
            LaTeX; from `equation_lines`.
        changes: LaTeX of the definitions of modified inputs.

    Returns:
        One ``<math>`` element; added terms have the class ``added``. None where a name
        gives a formula that cannot be converted.
    """
    try:
        body = "".join(f"<mtr>{row}</mtr>" for row in _rows(lines, changes))
    except _UnreadableError:
        return None
    return f'<math display="block"><mtable displaystyle="true">{body}</mtable></math>'


class _UnreadableError(Exception):
    """A formula that cannot be converted: a name contains more than letters and digits."""


def _rows(lines: Sequence[Sequence[Any]], changes: Sequence[str]) -> list[str]:
    rows = []
    for left_side, declared, added in lines:
        right_side = _convert(declared) if declared else ""
        terms = [_convert(term) for term in added]
        right_side += "".join(_mark(_infix_sign(term) if declared else term) for term in terms)
        cells = (_convert(left_side), "<mo>=</mo>", f"<mrow>{right_side}</mrow>")
        rows.append("".join(f"<mtd>{cell}</mtd>" for cell in cells))
    for change in changes:
        rows.append(
            f"<mtd><mtext>with</mtext></mtd><mtd></mtd><mtd>{_mark(_convert(change))}</mtd>"
        )
    return rows


def _mark(formula: str) -> str:
    return f'<mrow class="added">{formula}</mrow>'


def _infix_sign(term: str) -> str:
    """Mark the sign at the start of a term as a binary operator."""
    return re.sub(r"^((?:<mrow>)*)<mo>", r'\g<1><mo form="infix">', term)


def _convert(latex: str) -> str:
    from latex2mathml.converter import convert

    if _WITH_SIGNS.search(latex):  # which the converter mistakes for commands
        raise _UnreadableError
    try:
        match = _OUTER.match(convert(latex))
        content = _LETTERS.sub(_join_letters, match[1]) if match else ""
        tree = ElementTree.fromstring(f"<mrow>{content}</mrow>")
    except Exception as error:  # the converter raises errors of any kind
        raise _UnreadableError from error
    # Names come from the user: only elements of formulas may enter the page.
    if any(element.tag not in _ELEMENTS for element in tree.iter()):
        raise _UnreadableError
    for accented in tree.iter("mover"):
        _use_primes(accented)
    return ElementTree.tostring(tree, encoding="unicode")


def _use_primes(accented: ElementTree.Element) -> None:
    """Mark the derivative of a word with primes: a dot would stand above its middle letter."""
    base, accent = accented
    if (accent.text or "") in _PRIMES and len("".join(base.itertext())) > 1:
        accented.tag = "mrow"
        accent.attrib.update(lspace="0", rspace="0", form="postfix")
        accent.text = _PRIMES[accent.text or ""]


def _join_letters(letters: re.Match[str]) -> str:
    word = "".join(re.findall(r">([^<]*)<", letters[0]))
    return f'<mi mathvariant="normal">{word}</mi>'
