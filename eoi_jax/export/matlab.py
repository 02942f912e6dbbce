"""A model as a function file of MATLAB and of GNU Octave."""

from eoi_jax.equations.expression import Expression
from eoi_jax.export.code import Language, functions_of, symbols_of, written
from eoi_jax.export.names import comment, header, identifiers
from eoi_jax.export.program import Program

_MATLAB = Language(
    power="{0}^{1}",
    power_is_call=False,
    functions={
        "trunc": "fix({0})",
        "cbrt": "nthroot({0}, 3)",
        "round": "nearest_even({0})",
        "where": "choose({0}, {1}, {2})",
        "plain_root": "sqrt({0})",
        "sqrt": "sqrt(max({0}, 0))",
    },
    signs={"≤": "<=", "≥": ">=", "=": "==", "≠": "~="},
    logic={"and": "({0} && {1})", "or": "({0} || {1})", "not": "~({0})"},
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

    Args:
        model: what to write.
        name: of the function, an identifier; MATLAB finds it by the name of the file.
        version: of this package.
    """
    names = identifiers(model)

    def code(one: Expression) -> str:
        return written(one, names, _MATLAB)

    trees = [tree for _, tree in model.definitions] + list(model.rates)
    called = set().union(*map(functions_of, trees))
    used = set().union(*map(symbols_of, trees))
    top = [
        f"% {line}".rstrip() for line in header(model, names, ("(", ")", "1"), version).splitlines()
    ]
    body = [
        f"{names[one.symbol]} = {value!r};" + (f"  % {comment(one.unit)}" if one.unit else "")
        for one, value in model.parameters
        if one.symbol in used
    ]
    for vector, variables in (("states", model.states), ("inputs", model.inputs)):
        body += [f"{names[one.symbol]} = {vector}({k});"
                 for k, one in enumerate(variables, 1) if one.symbol in used]  # fmt: skip
    body += [f"{names[symbol]} = {code(tree)};" for symbol, tree in model.definitions]
    body.append(f"rates = zeros({len(model.states)}, 1);")
    body += [f"rates({k}) = {code(tree)};" for k, tree in enumerate(model.rates, 1)]
    helpers = "".join(text for key, text in _HELPERS.items() if key in called)
    lines = "\n".join([f"function rates = {name}(t, states, inputs)", *top, *body, "end"])
    return f"{lines}\n{helpers}"
