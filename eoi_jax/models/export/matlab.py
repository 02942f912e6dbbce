"""A model as a function file of MATLAB and of GNU Octave."""

from collections.abc import Sequence

from eoi_jax.models.equations.expression import Expression
from eoi_jax.models.equations.printer import code_notation, power_operator
from eoi_jax.models.export.listing import Listing
from eoi_jax.models.export.program import Program

_MATLAB = code_notation(
    power=power_operator("^"),
    comparisons={"≤": "<=", "≥": ">=", "=": "==", "≠": "~="},
    logic={"and": "({0} && {1})", "or": "({0} || {1})", "not": "~({0})"},
    functions={
        "clip": "min(max({0}, {1}), {2})",
        "trunc": "fix({0})",
        "cbrt": "nthroot({0}, 3)",
        "round": "nearest_even({0})",
        "where": "choose({0}, {1}, {2})",
        "plain_root": "sqrt({0})",
        "sqrt": "sqrt(max({0}, 0))",
    },
)
_HELPERS = {
    "where": """
function value = choose(condition, a, b)
if condition
    value = a;
else
    value = b;
end
end
""",
    "round": """
function value = nearest_even(a)
value = round(a);
if abs(a - fix(a)) == 0.5
    value = 2*round(a/2);
end
end
""",
}


def matlab_text(model: Program, name: str, version: str) -> str:
    """The file: ``rates = name(t, states, inputs)``, of columns, as `ode45` calls it.

    Outputs that are functions of the states are a second result, ``[rates, outputs] = name(…)``.

    Args:
        model: what to write.
        name: of the function, an identifier; MATLAB finds it by the name of the file.
        version: of this package.
    """
    listing = listing_of(model.of_both)
    body = [
        *listing.top("%", ("(", ")", "1"), version),
        *listing.parameters(),
        *listing.elements(lambda vector, k: f"{vector}({k + 1})"),
        *listing.definitions(),
        *filled(listing, "rates", model.rates),
        *(filled(listing, "outputs", model.output_formulas) if model.outputs else []),
    ]
    results = "[rates, outputs]" if model.outputs else "rates"
    lines = "\n".join([f"function {results} = {name}(t, states, inputs)", *body, "end"])
    return f"{lines}\n{helpers(listing)}"


def listing_of(model: Program) -> Listing:
    """A model in MATLAB's language.

    Args:
        model: what is written.
    """
    return Listing(model, _MATLAB, "{} = {};", "  % {}")


def helpers(listing: Listing) -> str:
    """Functions at the end of a file that its formulas call.

    Args:
        listing: of these formulas.
    """
    return "".join(text for key, text in _HELPERS.items() if key in listing.called)


def filled(listing: Listing, vector: str, trees: Sequence[Expression]) -> list[str]:
    """Lines of a column and its elements.

    Args:
        listing: of the model.
        vector: name of the column.
        trees: its elements.
    """
    elements = (f"{vector}({k}) = {listing.code(tree)};" for k, tree in enumerate(trees, 1))
    return [f"{vector} = zeros({len(trees)}, 1);", *elements]
