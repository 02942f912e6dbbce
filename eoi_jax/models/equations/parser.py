"""What an equation may say: arithmetic on declared names, read without running anything.

The text is cut into numbers, names and signs; what is none of them is refused before Python's own
parser sees it, and so are texts too long or too deep for it. Its tree (`ast`) is then translated
node by node: what is not on the list does not exist. No text is ever compiled or evaluated.
"""

import ast
import difflib
import keyword
import re
import unicodedata
from collections.abc import Mapping, Sequence

import numpy as np

from eoi_jax._checks import misplaced
from eoi_jax.models.equations.expression import (
    FUNCTIONS,
    Call,
    Expression,
    Number,
    Operation,
    Symbol,
    is_flag,
    value_of,
)

MOST_CHARACTERS = 4000
MOST_TOKENS = 1500
MOST_BRACKETS = 50
DEEPEST = 100  # levels of the tree
LARGEST = 1e100  # of a number
LARGEST_POWER = 64

# Names that mean something in every equation.
RESERVED = ("t", "pi", *FUNCTIONS)

_TOKEN = re.compile(
    r"(?P<space>\s+)"
    r"|(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)"
    r"|(?P<name>[^\W\d]\w*)"
    r"|(?P<sign>\*\*|<=|>=|==|!=|[-+*/(),<>])"
    r"|(?P<wrong>.)",
    re.DOTALL,
)
# Words of other tools, and how an equation says the same.
_WORDS_ELSEWHERE = {
    "ln": "Write log(x), the natural logarithm.",
    "log10": "Write log(x)/log(10).",
    "sgn": "Write sign(x).",
    "heaviside": "Write where(x > 0, 1, 0).",
    "deg": "Write x*180/pi.",
    "degrees": "Write x*180/pi.",
    "rad": "Write x*pi/180.",
    "radians": "Write x*pi/180.",
    "sec": "Write 1/cos(x).",
    "mod": "Write rem(x, y).",
    "pow": "Write x**y.",
    "e": "Write exp(x) for powers of it, exp(1) for the number.",
    "delay": "An input has its delay in [model.input_delay].",
    "diff": "A state has its rate in [model.derivatives]; that of an input is not known.",
    "der": "A state has its rate in [model.derivatives]; that of an input is not known.",
    "time": "Write t.",
    "π": "Write pi.",
}
_WORDS = ("and", "or", "not", "if", "else")
_POWERS = "Write powers with **."
_PRODUCTS = "Write products with *."
_SINGLE_EXPRESSION = "An equation holds one expression."
_ADVICE = {
    "^": _POWERS,
    "²": _POWERS,
    "³": _POWERS,
    "·": _PRODUCTS,
    "×": _PRODUCTS,
    "−": "Write a plain minus, -.",
    "√": "Write roots as sqrt(x).",
    "|": "Write abs(x).",
    "%": "Write the remainder as rem(x, y).",
    "=": "Write the right-hand side only; == compares.",
    "'": (
        'No quotes; a derivative has a name of its own, as in angle = "rate". That of an input is '
        "not known: an equation that needs one cannot be written."
    ),
    ".": "Names are used as they are, without a dot.",
    "[": "Each signal has a name of its own; there are no indices.",
    "&": "Write `and`.",
    "?": "Write a if condition else b.",
    "#": "Comments stand behind the closing quote.",
    "!": "Write `not`.",
    ";": _SINGLE_EXPRESSION,
    ":": _SINGLE_EXPRESSION,
}
_SIGNS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "^"}
_COMPARED = {
    ast.Lt: "<",
    ast.LtE: "≤",
    ast.Gt: ">",
    ast.GtE: "≥",
    ast.Eq: "=",
    ast.NotEq: "≠",
}


def parse(text: str, names: Mapping[str, Expression], field: str) -> Expression:
    """The tree of an equation's right-hand side.

    Args:
        text: numbers, declared names, ``t`` (time), ``pi``, ``+ - * / **``, comparisons, ``and or
            not``, ``a if condition else b``, brackets, and the functions of `FUNCTIONS`.
        names: what each declared name stands for.
        field: what to call the text in messages.

    Returns:
        Its tree; what is constant in it is worked out.

    Raises:
        ValueError: anything else, with the text and the column marked.
    """
    # As long as the text, so that columns agree; a line break would end the expression.
    line = re.sub(r"\s", " ", text)
    _Scanner(line, field).scan()
    return _Reader(line, names, field).number(_tree(line, field), 0)


def words(text: str) -> set[str]:
    """The names that a text uses, functions and all.

    Args:
        text: of an equation, right or wrong.
    """
    return {token.group() for token in _TOKEN.finditer(text) if token.lastgroup == "name"}


def good_name(name: str) -> bool:
    """Whether an equation can use a name: an identifier, and no word that means something."""
    return _is_word(name) and not name.startswith("_") and name not in RESERVED


def _is_word(name: str) -> bool:
    # Python reads identifiers in their normal form: another form would not be found again.
    normal = unicodedata.normalize("NFKC", name) == name
    return name.isidentifier() and normal and not keyword.iskeyword(name)


class _Scanner:
    """Refuses what is no arithmetic by its characters, its length or its nesting."""

    def __init__(self, line: str, field: str):
        self.line, self.field = line, field

    def check(self, good: bool, column: int, rule: str, advice: str = "") -> None:
        if not good:
            raise misplaced(self.field, rule, self.line, column, advice)

    def scan(self) -> None:
        size, named = len(self.line), "Give parts of it names under `definitions`."
        self.check(
            size <= MOST_CHARACTERS, 0, f"must have at most {MOST_CHARACTERS} characters", named
        )
        self.check(not self.line.isspace() and size > 0, 0, "must hold an expression")
        count, opened = 0, []
        for token in _TOKEN.finditer(self.line):
            kind, part, column = str(token.lastgroup), token.group(), token.start()
            count += kind != "space"
            self.token(kind, part, column)
            if part == "(":
                opened.append(column)
                rule = f"must nest at most {MOST_BRACKETS} brackets"
                self.check(len(opened) <= MOST_BRACKETS, column, rule, named)
            elif part == ")":
                self.check(bool(opened), column, "must open each bracket that it closes")
                opened.pop()
        self.check(not opened, opened[-1] if opened else 0, "must close each bracket")
        self.check(count <= MOST_TOKENS, 0, f"must have at most {MOST_TOKENS} parts", named)

    def token(self, kind: str, part: str, column: int) -> None:
        if kind == "wrong" or (kind == "name" and not _is_word(part) and part not in _WORDS):
            printed = part if part.isprintable() else f"the character {ord(part[0]):#06x}"
            self.check(False, column, f"must not hold {printed}", _ADVICE.get(part, ""))
        if kind == "number":
            end = column + len(part)
            after = self.line[end : end + 1]
            separated = not after or after.isspace() or after in "+-*/),<>=!"
            rule = "must have a sign between a number and what follows"
            self.check(separated, end, rule, "Write products with *, as in 2*a.")
            self.check(float(part) <= LARGEST, column, f"must hold numbers up to {LARGEST:g}")


def _tree(line: str, field: str) -> ast.expr:
    """Python's tree of a text; it is read only, never compiled."""
    indent = len(line) - len(line.lstrip())
    try:
        tree = ast.parse(line.strip(), "<equation>", "eval").body
    except SyntaxError as error:
        # Without an offset it is the end that came too early.
        column = indent + error.offset - 1 if error.offset else len(line.rstrip())
        rule = "must be one expression, such as -a*x + b*u"
    except (RecursionError, MemoryError, ValueError):
        column, rule = 0, "must be less deeply nested"
    else:
        return tree
    raise misplaced(field, rule, line, column)


class _Reader:
    """Translates Python's tree, node by node."""

    def __init__(self, line: str, names: Mapping[str, Expression], field: str):
        self.line, self.names, self.field = line, names, field
        self.indent = len(line) - len(line.lstrip())
        self.bytes = line.lstrip().encode()

    def wrong(self, node: ast.expr, rule: str, advice: str = "") -> ValueError:
        prefix = self.bytes[: node.col_offset].decode(errors="ignore")
        return misplaced(self.field, rule, self.line, self.indent + len(prefix), advice)

    def check_depth(self, node: ast.expr, depth: int) -> None:
        if depth > DEEPEST:
            rule = f"must nest at most {DEEPEST} operations"
            raise self.wrong(node, rule, "Give parts of it names under `definitions`.")

    def number(self, node: ast.expr, depth: int) -> Expression:
        """A number; what is true or false counts as 1 or 0."""
        expression = self.read(node, depth)
        return (
            Call("where", (expression, Number(1.0), Number(0.0)))
            if is_flag(expression)
            else expression
        )

    def flag(self, node: ast.expr, depth: int) -> Expression:
        expression = self.read(node, depth)
        if not is_flag(expression):
            raise self.wrong(node, "must have a condition here, such as x > 0")
        return expression

    def read(self, node: ast.expr, depth: int) -> Expression:
        self.check_depth(node, depth)
        inner = depth + 1
        match node:
            case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
                return Number(float(value))
            case ast.Name(id=name):
                return self.named(node, name)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return self.folded(node, Operation("-", Number(0.0), self.number(operand, inner)))
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return self.number(operand, inner)
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return Call("not", (self.flag(operand, inner),))
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _SIGNS:
                sides = self.number(left, inner), self.number(right, inner)
                return self.operation(node, _SIGNS[type(op)], *sides)
            case ast.BoolOp(op=op, values=values):
                sign = "and" if isinstance(op, ast.And) else "or"
                return self.joined(node, sign, [self.flag(value, inner) for value in values], depth)
            case ast.Compare():
                return self.comparison(node, inner)
            case ast.IfExp(test=test, body=body, orelse=alternative):
                return self.call(node, "where", [test, body, alternative], inner)
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
                return self.call(node, name, arguments, inner)
            case ast.Tuple():
                advice = "Write decimals with a point."
                raise self.wrong(node, "must be one expression, with a comma in calls only", advice)
        raise self.wrong(node, "must be arithmetic: + - * / **, comparisons, functions")

    def named(self, node: ast.expr, name: str) -> Expression:
        if name == "t":
            return Symbol("t")
        if name == "pi":
            return Number(float(np.pi))
        if name not in self.names:
            if name in FUNCTIONS:
                raise self.wrong(node, f"must call the function {name}", f"Write {name}(…).")
            raise self.unknown(node, "declared names", name, tuple(self.names))
        return self.names[name]

    def unknown(
        self,
        node: ast.expr,
        kind: str,
        name: str,
        names: Sequence[str],
        max_names: int = 30,
        max_length: int = 40,
    ) -> ValueError:
        """The error at a name that is not known; lists so many names, and so many characters."""
        in_capitals = [word for word in (*names, "pi") if word.lower() == name.lower()]
        close = in_capitals or difflib.get_close_matches(name, names, n=1)
        hint = f"Did you mean {close[0]}? " if close else ""
        if name.lower() in _WORDS_ELSEWHERE and not in_capitals:
            hint = f"{_WORDS_ELSEWHERE[name.lower()]} "
        listed = ", ".join(names[:max_names]) + (", …" if len(names) > max_names else "")
        shortened = name if len(name) <= max_length else name[:max_length] + "…"
        return self.wrong(
            node, f"must use {kind}, got {shortened}", f"{hint}Known: {listed or 'none'}."
        )

    def operation(self, node: ast.expr, sign: str, lhs: Expression, rhs: Expression) -> Expression:
        if sign == "^" and isinstance(rhs, Number) and abs(rhs.value) > LARGEST_POWER:
            rule = f"must have powers between -{LARGEST_POWER} and {LARGEST_POWER}"
            raise self.wrong(node, rule)
        return self.folded(node, Operation(sign, lhs, rhs))

    def comparison(self, node: ast.Compare, depth: int) -> Expression:
        """a < b < c as a < b and b < c."""
        sides = [self.number(side, depth) for side in (node.left, *node.comparators)]
        links = []
        for op, lhs, rhs in zip(node.ops, sides[:-1], sides[1:], strict=True):
            if type(op) not in _COMPARED:
                raise self.wrong(node, "must compare by < <= > >= == !=")
            if isinstance(lhs, Number) and isinstance(rhs, Number):
                raise self.wrong(node, "must not compare two constants")
            links.append(Operation(_COMPARED[type(op)], lhs, rhs))
        return self.joined(node, "and", links, depth)

    def joined(
        self, node: ast.expr, sign: str, flags: Sequence[Expression], depth: int
    ) -> Expression:
        self.check_depth(node, depth + len(flags))
        joined = flags[0]
        for flag in flags[1:]:
            joined = Operation(sign, joined, flag)
        return joined

    def call(
        self, node: ast.expr, name: str, arguments: Sequence[ast.expr], depth: int
    ) -> Expression:
        if name not in FUNCTIONS:
            if name in self.names:
                raise self.wrong(node, f"must have a sign between {name} and a bracket", _PRODUCTS)
            raise self.unknown(node, "known functions", name, tuple(FUNCTIONS))
        minimum, maximum = FUNCTIONS[name].min_arguments, FUNCTIONS[name].max_arguments
        if not minimum <= len(arguments) <= maximum:
            counts = str(minimum) if minimum == maximum else f"{minimum} to {maximum}"
            noun = "argument" if maximum == 1 else "arguments"
            raise self.wrong(node, f"must give {name} {counts} {noun}, got {len(arguments)}")
        first = self.flag if name == "where" else self.number
        values = (
            first(arguments[0], depth),
            *(self.number(argument, depth) for argument in arguments[1:]),
        )
        return self.folded(node, Call(name, values))

    def folded(self, node: ast.expr, folded: Operation | Call) -> Expression:
        """The node, or its value where all of it is constant."""
        parts = (folded.lhs, folded.rhs) if isinstance(folded, Operation) else folded.arguments
        if not all(isinstance(argument, Number) for argument in parts):
            return folded
        try:
            with np.errstate(all="ignore"):
                value = float(value_of(folded, {}, np))
        except ArithmeticError:
            value = float("inf")
        if not abs(value) <= LARGEST:
            raise self.wrong(node, f"must have constants that are real and at most {LARGEST:g}")
        return Number(value)
