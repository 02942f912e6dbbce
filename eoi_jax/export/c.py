"""A model as a C function (C99, `math.h` and nothing else)."""

from eoi_jax.equations.expression import Expression, Symbol
from eoi_jax.export.code import Language, functions_of, symbols_of, written
from eoi_jax.export.names import comment, header, identifiers
from eoi_jax.export.program import Program

_C = Language(
    power="pow({0}, {1})",
    power_is_call=True,
    functions={
        "abs": "fabs({0})",
        "max": "fmax({0}, {1})",
        "min": "fmin({0}, {1})",
        "rem": "fmod({0}, {1})",
        "round": "rint({0})",
        "where": "({0} ? {1} : {2})",
        "plain_root": "sqrt({0})",
        "sqrt": "guarded_root({0})",
        "sign": "sign_of({0})",
    },
    signs={"≤": "<=", "≥": ">=", "=": "==", "≠": "!="},
    logic={"and": "({0} && {1})", "or": "({0} || {1})", "not": "!({0})"},
)
_HELPERS = {
    "sign": "static double sign_of(double x) { return x > 0.0 ? 1.0 : x < 0.0 ? -1.0 : x; }",
    "sqrt": "static double guarded_root(double x) { return x > 0.0 ? sqrt(x) : 0.0; }",
}


def c_text(model: Program, name: str, version: str) -> str:
    """The file: ``void name(double t, const double *states, const double *inputs, double *rates)``.

    Args:
        model: what to write.
        name: of the function, an identifier.
        version: of this package.
    """
    names = identifiers(model)

    def code(one: Expression) -> str:
        return written(one, names, _C)

    trees = [tree for _, tree in model.definitions] + list(model.rates)
    called = set().union(*map(functions_of, trees))
    used = set().union(*map(symbols_of, trees))
    top = "\n".join(
        f" * {line}".rstrip()
        for line in header(model, names, ("[", "]", "0"), version).splitlines()
    )
    body = [f"    const double {names[one.symbol]} = {value!r};{_unit(one.unit)}"
            for one, value in model.parameters if one.symbol in used]  # fmt: skip
    for vector, variables in (("states", model.states), ("inputs", model.inputs)):
        body += [f"    const double {names[one.symbol]} = {vector}[{k}];"
                 for k, one in enumerate(variables) if one.symbol in used]  # fmt: skip
        if not any(one.symbol in used for one in variables):
            body.append(f"    (void){vector};")
    if Symbol("t") not in used:
        body.append("    (void)t;")
    body += [
        f"    const double {names[symbol]} = {code(tree)};" for symbol, tree in model.definitions
    ]
    body += [f"    rates[{k}] = {code(tree)};" for k, tree in enumerate(model.rates)]
    helpers = "".join(f"{text}\n\n" for key, text in _HELPERS.items() if key in called)
    head = f"void {name}(double t, const double *states, const double *inputs, double *rates)"
    lines = "\n".join(body)
    return f"/*\n{top}\n */\n#include <math.h>\n\n{helpers}{head};\n\n{head}\n{{\n{lines}\n}}\n"


def _unit(unit: str) -> str:
    return f" /* {comment(unit)} */" if unit else ""
