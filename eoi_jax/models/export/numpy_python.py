"""A model as a Python function that needs NumPy alone."""

from eoi_jax.models.equations.printer import code_notation, power_operator
from eoi_jax.models.export.listing import Listing
from eoi_jax.models.export.program import Program

_SAME_NAME = (
    *("sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "expm1", "log", "log1p", "cbrt"),
    *("abs", "sign", "floor", "ceil", "trunc"),
)
_INVERSE = ("sin", "cos", "tan", "sinh", "cosh", "tanh")
_NUMPY = code_notation(
    power=power_operator("**"),
    comparisons={"≤": "<=", "≥": ">=", "=": "==", "≠": "!="},
    logic={
        "and": "np.logical_and({0}, {1})",
        "or": "np.logical_or({0}, {1})",
        "not": "np.logical_not({0})",
    },
    functions={
        **{name: f"np.{name}({{0}})" for name in _SAME_NAME},
        **{f"a{name}": f"np.arc{name}({{0}})" for name in _INVERSE},
        "atan2": "np.arctan2({0}, {1})",
        "max": "np.maximum({0}, {1})",
        "min": "np.minimum({0}, {1})",
        "clip": "np.minimum(np.maximum({0}, {1}), {2})",
        "rem": "np.fmod({0}, {1})",
        "round": "np.rint({0})",
        "where": "np.where({0}, {1}, {2})",
        "plain_root": "np.sqrt({0})",
        "sqrt": "np.sqrt(np.maximum({0}, 0.0))",
    },
)


def python_text(model: Program, name: str, version: str) -> str:
    """The file: ``name(t, states, inputs)`` gives the rates; arrays of shape (n,), or (n, m).

    Outputs that are functions of the states have a second function, ``name_outputs``.

    Args:
        model: what to write.
        name: of the function, an identifier.
        version: of this package.
    """
    listing = _listing(model)
    remark = "d/dt of the states, an array like the states."
    lines = [
        *listing.top("#", ("[", "]", "0"), version),
        "import numpy as np",
        *_function(listing, name, "rates", remark),
    ]
    if model.outputs:
        remark = "Outputs that are functions of the states, of the inputs that hold from t on."
        lines += _function(_listing(model.of_outputs), f"{name}_outputs", "outputs", remark)
    return "\n".join(lines) + "\n"


def _listing(model: Program) -> Listing:
    return Listing(model, _NUMPY, "{} = {}", "  # {}")


def _function(listing: Listing, name: str, result: str, remark: str) -> list[str]:
    """Lines of a function that returns the formulas of the listing as an array."""
    model = listing.model
    body = [*listing.parameters(), *listing.elements(lambda vector, k: f"{vector}[{k}]")]
    inner = [
        *listing.definitions(),
        f"{result} = [",
        *(f"    {listing.code(tree)}," for tree in model.rates),
        "]",
    ]
    like = "states[0]" if model.states else "inputs[0]" if model.inputs else "t"
    stacked = f"np.stack(np.broadcast_arrays({like}, *{result})[1:])"
    returned = stacked if model.rates else f"np.zeros((0, *np.shape({like})))"
    return [
        "",
        "",
        f"def {name}(t, states, inputs):",
        f'    """{remark}"""',
        *(f"    {line}" for line in body),
        # Branches that are not taken are worked out as well, and may not be finite.
        '    with np.errstate(all="ignore"):',
        *(f"        {line}" for line in inner),
        f"    return {returned}",
    ]
