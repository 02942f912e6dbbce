"""Everything of JAX that is not part of its stable interface, in one place.

JAX renames such parts without notice. No other module of the package may import them, or read the
parameters of an equation of a jaxpr that are not those of an elementary operation; the tests of
this module run on every version that the README names.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import jax
import numpy as np
from jax.core import Tracer as Tracer
from jax.extend.core import ClosedJaxpr as ClosedJaxpr
from jax.extend.core import Literal as Literal
from jax.extend.core import Primitive as Primitive
from jax.extend.core import jaxpr_as_fun as jaxpr_as_fun
from jax.interpreters import ad, batching, mlir
from jax.interpreters.partial_eval import dce_jaxpr

try:
    from jax._src.core import trace_state_clean as _trace_state_clean
except ImportError:  # then the arguments alone tell

    def _trace_state_clean() -> bool:
        return True


def version() -> tuple[int, ...]:
    """Of JAX, as numbers: (0, 10, 2)."""
    return jax.__version_info__


def backend_runs() -> bool:
    """Whether JAX's backend has started, so that options of XLA come too late.

    No public question exists for this; where the private one is gone, the answer is no.
    """
    try:
        from jax._src.xla_bridge import backends_are_initialized
    except ImportError:
        return False
    return backends_are_initialized()


def forget_lowered() -> None:
    """Let go of what compiled programs were lowered to; the programs stay, and run as before.

    JAX keeps the StableHLO module of each program, and of each operation that runs by itself, as
    long as the function is traced: with its context a megabyte each up to JAX 0.10, four times what
    the compiled operation takes. It would serve to compile the same again. Where the caches have
    other names, nothing is let go.
    """
    for room, name in (("pjit", "_pjit_lower"), ("interpreters.pxla", "_cached_lowering_to_hlo")):
        try:
            cache = getattr(import_module(f"jax._src.{room}"), name)
            cache.cache_clear()
        except (ImportError, AttributeError):
            continue


def inputs_read(closed: ClosedJaxpr) -> list[bool]:
    """Which inputs of a traced function its results depend on.

    Args:
        closed: of `jax.make_jaxpr`.

    Returns:
        One flag for each input.
    """
    jaxpr = closed.jaxpr
    return list(dce_jaxpr(jaxpr, [True] * len(jaxpr.outvars))[1])


def closed_jaxpr(jaxpr: Any) -> ClosedJaxpr:
    """A jaxpr with its constants; one that has none is closed as it is."""
    return jaxpr if isinstance(jaxpr, ClosedJaxpr) else ClosedJaxpr(jaxpr, [])


def jaxprs_within(equation: Any) -> list[Any]:
    """The jaxprs among the parameters of an equation: bodies of loops, branches, calls."""
    jaxprs = []
    for value in equation.params.values():
        parts = value if isinstance(value, tuple | list) else (value,)
        jaxprs += [part for part in parts if hasattr(part, "eqns")]
    return jaxprs


def operations_of(jaxpr: Any) -> set[str]:
    """Names of all operations of a traced function, those that call others included."""
    names = {equation.primitive.name for equation in jaxpr.eqns}
    inner = (part for equation in jaxpr.eqns for part in jaxprs_within(equation))
    return names.union(*(operations_of(getattr(part, "jaxpr", part)) for part in inner))


_CALLS = {
    "jit": "jaxpr",
    "pjit": "jaxpr",
    "closed_call": "call_jaxpr",
    "core_call": "call_jaxpr",
    "remat": "jaxpr",
    "remat2": "jaxpr",
    "checkpoint": "jaxpr",
    "custom_jvp_call": "call_jaxpr",
    "custom_vjp_call": "call_jaxpr",
    "custom_vjp_call_jaxpr": "fun_jaxpr",
}


CALLS = frozenset(_CALLS)  # names of equations that call a function


# Of these, calls of functions whose author gave the derivative.
RULED = frozenset(name for name in _CALLS if name.startswith("custom_"))


def called(equation: Any) -> ClosedJaxpr | None:
    """The function that an equation merely calls; None if it does something else."""
    if equation.primitive.name == "call_hi_primitive":  # from JAX 0.12 on, as in `jnp.searchsorted`
        shapes = [jax.ShapeDtypeStruct(var.aval.shape, var.aval.dtype) for var in equation.invars]
        return jax.make_jaxpr(equation.params["_prim"].expand)(*shapes)
    key = _CALLS.get(equation.primitive.name)
    return None if key is None else closed_jaxpr(equation.params[key])


@dataclass(frozen=True)
class ScanParts:
    """What `lax.scan` became in a jaxpr.

    Attributes:
        body: one turn; takes constants, carries and a row, gives carries and what is stacked.
        length: turns.
        reverse: whether the last row comes first.
        constants, carries: how many of the operands come first, and next.
    """

    body: ClosedJaxpr
    length: int
    reverse: bool
    constants: int
    carries: int


def scan_parts(params: dict[str, Any]) -> ScanParts:
    """The parts of an equation of `lax.scan`."""
    if "num_consts" in params:  # up to JAX 0.11
        constants, carries = params["num_consts"], params["num_carry"]
    else:
        constants, carries, _ = (len(part) for part in params["ft_in"].unpack())
    body = closed_jaxpr(params["jaxpr"])
    return ScanParts(body, params["length"], params["reverse"], constants, carries)


def solving_part(params: dict[str, Any], operands: Sequence[Any]) -> tuple[ClosedJaxpr, list[Any]]:
    """What solves in an equation of `lax.custom_linear_solve`, and its own ones of the operands."""
    counts, function = params["const_lengths"], params["jaxprs"].solve
    first = counts.matvec + counts.vecmat
    concerned = [*operands[first : first + counts.solve], *operands[sum(counts) :]]
    return closed_jaxpr(function), concerned


def product_part(params: dict[str, Any], operands: Sequence[Any]) -> tuple[ClosedJaxpr, list, list]:
    """What multiplies by the matrix in such an equation, its own operands, and the right side."""
    counts = params["const_lengths"]
    concerned, right = operands[: counts.matvec], operands[sum(counts) :]
    return closed_jaxpr(params["jaxprs"].matvec), list(concerned), list(right)


def results_of(equation: Any, operands: Sequence[Any]) -> list[Any]:
    """What an equation gives for operands; also while JAX traces."""
    bound = equation.primitive.get_bind_params(equation.params)
    functions, params = bound if isinstance(bound, tuple) else ((), bound)  # before JAX 0.10
    results = equation.primitive.bind(*functions, *operands, **params)
    return list(results) if equation.primitive.multiple_results else [results]


def branches_of(params: dict[str, Any]) -> Sequence[ClosedJaxpr]:
    """The branches of an equation of `lax.cond` or `lax.switch`."""
    return [closed_jaxpr(branch) for branch in params["branches"]]


def tracing() -> bool:
    """Whether a function is being traced in this thread, also where no argument shows it."""
    return not _trace_state_clean()


def elementwise(name: str, function: Callable, *tangents: Callable) -> Primitive:
    """A primitive that works number by number, with derivatives of its own.

    Args:
        name: in a jaxpr.
        function: its values; of arrays of one shape and type.
        tangents: for each operand, of its tangent and all operands, the tangent of the result.
    """
    primitive = Primitive(name)
    primitive.def_impl(function)

    @primitive.def_abstract_eval
    def _shape(*operands: Any) -> Any:
        return operands[0].update(weak_type=all(aval.weak_type for aval in operands))

    ad.defjvp(primitive, *tangents)
    vectorize = batching.defvectorized if len(tangents) == 1 else batching.defbroadcasting
    vectorize(primitive)
    mlir.register_lowering(primitive, mlir.lower_fun(function, multiple_results=False))
    return primitive


def with_primitives(jaxpr: Any, primitives: Mapping[str, Primitive]) -> Any:
    """A jaxpr with other primitives in place of some operations on real numbers.

    Args:
        jaxpr: closed or not; so is the result.
        primitives: by name of the operation. Functions whose author gave the derivative keep it.
    """
    if getattr(jaxpr, "jaxpr", jaxpr) is not jaxpr:  # closed, before JAX 0.12 made both one
        return ClosedJaxpr(with_primitives(jaxpr.jaxpr, primitives), jaxpr.consts)

    def changed(value: Any) -> Any:
        if type(value) in (tuple, list):
            return type(value)(changed(part) for part in value)
        return with_primitives(value, primitives) if hasattr(value, "eqns") else value

    if operations_of(jaxpr).isdisjoint(primitives):
        return jaxpr
    equations = []
    for equation in jaxpr.eqns:
        name, params = equation.primitive.name, equation.params
        if name in primitives and all(atom.aval.dtype.kind == "f" for atom in equation.invars):
            equation = equation.replace(primitive=primitives[name], params={})
        elif jaxprs_within(equation) and not name.startswith("custom_"):
            params = {key: changed(value) for key, value in params.items()}
            equation = equation.replace(params=params)
        equations.append(equation)
    return jaxpr.replace(eqns=equations)


def with_own_constants(closed: ClosedJaxpr) -> ClosedJaxpr:
    """A traced function that does not share memory with arrays of NumPy that it read.

    Args:
        closed: of `jax.make_jaxpr`.
    """

    def inner(value: Any) -> Any:
        if type(value) in (tuple, list):
            return type(value)(inner(part) for part in value)
        return with_own_constants(value) if isinstance(value, ClosedJaxpr) else value

    def copied(array: Any) -> Any:
        is_numeric = hasattr(array, "dtype") and not isinstance(array, Tracer)
        is_numeric = is_numeric and not jax.dtypes.issubdtype(array.dtype, jax.dtypes.extended)
        return np.array(array) if is_numeric else array

    equations = [
        equation.replace(params={key: inner(value) for key, value in equation.params.items()})
        if jaxprs_within(equation)
        else equation
        for equation in closed.jaxpr.eqns
    ]
    constants = [copied(constant) for constant in closed.consts]
    if closed.jaxpr is closed:  # from JAX 0.12 on
        anew: Any = closed.replace
        return anew(eqns=equations, consts=constants)
    return ClosedJaxpr(closed.jaxpr.replace(eqns=equations), constants)
