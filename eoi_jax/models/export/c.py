"""A model as a C function (C99, `math.h` and nothing else)."""

from eoi_jax.models.equations.expression import Symbol
from eoi_jax.models.equations.printer import ATOM, LOGIC, Infix, code_notation
from eoi_jax.models.export.listing import Listing
from eoi_jax.models.export.program import Program

_C = code_notation(
    power=Infix("pow({}, {})".format, LOGIC, LOGIC, ATOM),
    comparisons={"≤": "<=", "≥": ">=", "=": "==", "≠": "!="},
    logic={"and": "({0} && {1})", "or": "({0} || {1})", "not": "!({0})"},
    functions={
        "abs": "fabs({0})",
        "max": "fmax({0}, {1})",
        "min": "fmin({0}, {1})",
        "clip": "fmin(fmax({0}, {1}), {2})",
        "rem": "fmod({0}, {1})",
        "round": "rint({0})",
        "where": "({0} ? {1} : {2})",
        "plain_root": "sqrt({0})",
        "sqrt": "guarded_root({0})",
        "sign": "sign_of({0})",
    },
)
_HELPERS = {
    "sign": "static double sign_of(double x) { return x > 0.0 ? 1.0 : x < 0.0 ? -1.0 : x; }",
    "sqrt": "static double guarded_root(double x) { return x > 0.0 ? sqrt(x) : 0.0; }",
}


def c_text(model: Program, name: str, version: str) -> str:
    """The file: ``void name(double t, const double *states, const double *inputs, double *rates)``.

    Outputs that are functions of the states have a second function, ``name_outputs``, with
    ``double *outputs`` as its last argument.

    Args:
        model: what to write.
        name: of the function, an identifier.
        version: of this package.
    """
    listing = _listing(model)
    top = "\n".join(listing.top(" *", ("[", "]", "0"), version))
    functions, called = [_function(listing, name, "rates")], set(listing.called)
    if model.outputs:
        of_outputs = _listing(model.of_outputs)
        functions.append(_function(of_outputs, f"{name}_outputs", "outputs"))
        called |= of_outputs.called
    helpers = "".join(f"{text}\n\n" for key, text in _HELPERS.items() if key in called)
    return f"/*\n{top}\n */\n#include <math.h>\n\n{helpers}" + "\n".join(functions)


def _listing(model: Program) -> Listing:
    return Listing(model, _C, "const double {} = {};", " /* {} */")


def _function(listing: Listing, name: str, result: str) -> str:
    """A function with its declaration; `result` is its last argument, which it fills."""
    rates = listing.model.rates
    unread = [*_unread(listing), *([] if rates else [result])]
    body = [
        *listing.parameters(),
        *listing.elements(lambda vector, k: f"{vector}[{k}]"),
        *(f"(void){argument};" for argument in unread),
        *listing.definitions(),
        *(f"{result}[{k}] = {listing.code(tree)};" for k, tree in enumerate(rates)),
    ]
    head = f"void {name}(double t, const double *states, const double *inputs, double *{result})"
    lines = "\n".join(f"    {line}" for line in body)
    return f"{head};\n\n{head}\n{{\n{lines}\n}}\n"


def _unread(listing: Listing) -> list[str]:
    """Arguments of the function of which compilers would say that nothing reads them."""
    model, used = listing.model, listing.used
    vectors = {"states": model.states, "inputs": model.inputs}
    names = [
        vector
        for vector, variables in vectors.items()
        if not any(variable.symbol in used for variable in variables)
    ]
    return names if Symbol("t") in used else [*names, "t"]
