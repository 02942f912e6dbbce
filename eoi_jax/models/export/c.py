"""A model as C functions (C99, `math.h` and nothing else): its right-hand side, and its step."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from eoi_jax.models.equations.printer import ATOM, LOGIC, Infix, Notation, code_notation
from eoi_jax.models.export.listing import Listing
from eoi_jax.models.export.names import comment
from eoi_jax.models.export.program import Program


@dataclass(frozen=True)
class FloatingType:
    """A floating type of C, with the ending of its literals and of its functions in `math.h`.

    Attributes:
        name: of the type.
        ending: of ``1.0``, ``sqrt``, …
    """

    name: str
    ending: str

    def number(self, value: float) -> str:
        """A literal.

        Args:
            value: finite.
        """
        return repr(value) + self.ending

    def function(self, name: str) -> str:
        """What a function of `math.h` is called.

        Args:
            name: of that for double.
        """
        return name + self.ending

    @property
    def notation(self) -> Notation:
        """How formulas are written."""
        templates = {key: form.replace("~", self.ending) for key, form in _FUNCTIONS.items()}
        shared = code_notation(
            power=Infix(f"{self.function('pow')}({{}}, {{}})".format, LOGIC, LOGIC, ATOM),
            comparisons={"≤": "<=", "≥": ">=", "=": "==", "≠": "!="},
            logic={"and": "({0} && {1})", "or": "({0} || {1})", "not": "!({0})"},
            functions=templates,
        )
        return replace(shared, number=self.number, head=self.function)


DOUBLE, SINGLE = FloatingType("double", ""), FloatingType("float", "f")

# ~ is the ending of the type.
_FUNCTIONS = {
    "abs": "fabs~({0})",
    "max": "fmax~({0}, {1})",
    "min": "fmin~({0}, {1})",
    "clip": "fmin~(fmax~({0}, {1}), {2})",
    "rem": "fmod~({0}, {1})",
    "round": "rint~({0})",
    "where": "({0} ? {1} : {2})",
    "plain_root": "sqrt~({0})",
    "sqrt": "guarded_root({0})",
    "sign": "sign_of({0})",
}
# {0} is the type, {1} its ending.
_HELPERS = {
    "sign": "static {0} sign_of({0} x) "
    "{{ return x > 0.0{1} ? 1.0{1} : x < 0.0{1} ? -1.0{1} : x; }}",
    "sqrt": "static {0} guarded_root({0} x) {{ return x > 0.0{1} ? sqrt{1}(x) : 0.0{1}; }}",
}


# What the step of a file does, and how its inputs are given.
_STEP_REMARK = """
/*
 * {name}_step moves the states on by one sample period h [s], from time t, as the simulation of
 * eoi_jax does: classical Runge-Kutta steps of fourth order, `substeps` of them, each cut where
 * dry friction brings a state to rest, which then sticks until the other forces exceed it.
 * Inputs go in a straight line from `inputs` at t to `next_inputs` at t + h; give the same values
 * twice for inputs that are held. Nothing is allocated, and every call does the same operations.
 */
"""
_STEP = """
{head};

{head}
{{
    int i;
    for (i = 0; i < substeps; i++) {{
{drive}        {name}_substep(t + i*h/substeps, h/substeps, states, {stages});
    }}
}}
"""
_DRIVE = """\
        double stages[{size}]; /* inputs at the start, the middle and the end */
        int k;
        for (k = 0; k < {size}; k++) {{
            const double fraction = (i + 0.5*(k / {count}))/substeps;
            const double first = inputs[k % {count}];
            stages[k] = first + fraction*(next_inputs[k % {count}] - first);
        }}
"""


def c_text(
    model: Program, name: str, version: str, step: Program | None = None, reason: str = ""
) -> str:
    """The file: ``void name(double t, const double *states, const double *inputs, double *rates)``.

    Outputs that are functions of the states have a second function, ``name_outputs``, with
    ``double *outputs`` as its last argument. ``void name_step(double t, double h, int substeps,
    double *states, const double *inputs, const double *next_inputs)`` moves the states on by a
    sample.

    Args:
        model: what to write.
        name: of the function, an identifier.
        version: of this package.
        step: states at the end of a step, with the inputs at its start, middle and end.
        reason: why there is none.
    """
    listing = c_listing(model)
    top = "\n".join(listing.top(" *", ("[", "]", "0"), version))
    arguments = "double t, const double *states, const double *inputs, double *"
    functions = [_function(listing, f"void {name}({arguments}rates)", "rates")]
    called = set(listing.called)
    if model.outputs:
        of_outputs = c_listing(model.of_outputs)
        head = f"void {name}_outputs({arguments}outputs)"
        functions.append(_function(of_outputs, head, "outputs"))
        called |= of_outputs.called
    if step is not None:
        of_step = c_listing(step)
        functions.append(_step(of_step, name, len(model.inputs)))
        called |= of_step.called
    elif reason:
        top += f"\n * No function for a step: {comment(reason, 400)}"
    return f"/*\n{top}\n */\n#include <math.h>\n\n{helper_functions(called)}" + "\n".join(functions)


def helper_functions(called: Collection[str], real: FloatingType = DOUBLE) -> str:
    """Functions of ours that formulas call.

    Args:
        called: names of all functions that they call.
        real: type of their arguments.
    """
    forms = (form for key, form in _HELPERS.items() if key in called)
    return "".join(f"{form.format(real.name, real.ending)}\n\n" for form in forms)


def c_listing(model: Program, real: FloatingType = DOUBLE) -> Listing:
    """A model in C.

    Args:
        model: what to write.
        real: type of its variables.
    """
    line = f"const {real.name} {{}} = {{}};"
    return Listing(model, real.notation, line, " /* {} */", "const int {} = {};")


def _step(listing: Listing, name: str, count: int) -> str:
    """A Runge-Kutta step, and the function that does as many as a sample needs."""
    inner = f"static void {name}_substep(double t, double h, double *states, const double *inputs)"
    outer = (
        f"void {name}_step(double t, double h, int substeps, double *states, "
        "const double *inputs,\n    const double *next_inputs)"
    )
    drive = _DRIVE.format(size=3 * count, count=count) if count else ""
    body = _STEP.format(head=outer, drive=drive, name=name, stages="stages" if count else "inputs")
    if not count:
        body = body.replace("    int i;\n", "    int i;\n    (void)next_inputs;\n")
    remark = _STEP_REMARK.format(name=name)
    return _function(listing, inner, "states") + remark.rstrip("\n") + body


def _function(listing: Listing, head: str, result: str) -> str:
    """A function with its declaration; `result` is the argument that it fills."""
    rates = listing.model.rates
    unread = [*_unread(listing, result), *([] if rates else [result])]
    body = [
        *listing.parameters(),
        *listing.elements(lambda vector, k: f"{vector}[{k}]"),
        *(f"(void){argument};" for argument in unread),
        *listing.definitions(),
        *(f"{result}[{k}] = {listing.code(tree)};" for k, tree in enumerate(rates)),
    ]
    lines = "\n".join(f"    {line}" for line in body)
    return f"{head};\n\n{head}\n{{\n{lines}\n}}\n"


def _unread(listing: Listing, result: str) -> Sequence[str]:
    """Arguments of the function of which compilers would say that nothing reads them."""
    model, used = listing.model, listing.used
    vectors = {"states": model.states, "inputs": model.inputs}
    names = [
        vector
        for vector, variables in vectors.items()
        if vector != result and not any(variable.symbol in used for variable in variables)
    ]
    return [*names, *(listing.names[symbol] for symbol in model.arguments if symbol not in used)]
