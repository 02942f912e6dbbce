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

    Args:
        model: what to write.
        name: of the function, an identifier.
        version: of this package.
    """
    listing = Listing(model, _C, "const double {} = {};", " /* {} */")
    top = "\n".join(listing.top(" *", ("[", "]", "0"), version))
    body = [
        *listing.parameters(),
        *listing.elements(lambda vector, k: f"{vector}[{k}]"),
        *(f"(void){name};" for name in _unread(listing)),
        *listing.definitions(),
        *(f"rates[{k}] = {listing.code(tree)};" for k, tree in enumerate(model.rates)),
    ]
    helpers = "".join(f"{text}\n\n" for key, text in _HELPERS.items() if key in listing.called)
    head = f"void {name}(double t, const double *states, const double *inputs, double *rates)"
    lines = "\n".join(f"    {line}" for line in body)
    return f"/*\n{top}\n */\n#include <math.h>\n\n{helpers}{head};\n\n{head}\n{{\n{lines}\n}}\n"


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
