"""Programs that XLA has compiled: shared by all that compute the same, and let go when many.

`jax.jit` keeps a compiled program as long as the function lives, and one for each value of its
static arguments. A plant is such an argument, by the identity of the functions that it is made of:
a process that meets a new plant at every call, over many rigs or in a service, keeps programs
without end, until Linux refuses another mapping of memory and ends it.

`jit` here keys a program by what it computes: the operations of the traced function, the shapes and
types of its arguments and the constants in it. Two plants of the same equations share it. The least
recently used program goes beyond a limit (`configure(programs=…)`), with its memory.
"""

import ctypes
import hashlib
import inspect
import sys
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import lru_cache, wraps
from typing import Any, NamedTuple

import jax
import numpy as np

from eoi_jax._checks import check_count
from eoi_jax.compiler.jax_private import RULED, Literal, Tracer, forget_lowered, tracing

_PART, _END = b"\0|", b"\0]"  # between the parts of a traced function, and at its end


@dataclass(frozen=True)
class MemorySettings:
    """What compiled programs may keep in memory; `configure` sets the number of programs."""

    programs: int = 128  # of two to five megabytes each, and ten to forty mappings of memory
    nested: int = 4  # functions inside others, whose traces take ten megabytes each
    calls: int = 8  # of each program, remembered by the identity of their arguments
    release_interval: int = 10  # programs after which memory of compilation is given back


_SETTINGS = MemorySettings()

_ARRAYS = (np.ndarray, np.generic, jax.Array)
_NUMBERS = (*_ARRAYS, bool, int, float, complex)


def jit(function: Callable | None = None, *, static: tuple[str, ...] | None = None) -> Any:
    """Compile a function with XLA, as `jax.jit` does, into a program that others may share.

    Inside another traced function it is traced into that one.

    Args:
        function: of trees of arrays; also a decorator without it.
        static: names of arguments that are no arrays; all others then hold arrays and numbers
            alone. By default whatever is no array is static, wherever it stands.

    Returns:
        The same function, compiled at its first call for each shape and static value.
    """
    if function is None:
        return lambda decorated: jit(decorated, static=static)
    names, kinds = static or (), _ARRAYS if static is None else _NUMBERS
    signature = inspect.signature(function)

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        static_arguments: tuple[tuple[str, Any], ...] = ()
        if names:
            kwargs = dict(signature.bind(*args, **kwargs).arguments)
            args, static_arguments = (
                (),
                tuple((name, kwargs.pop(name)) for name in names if name in kwargs),
            )
        leaves, structure = jax.tree.flatten((args, kwargs))
        split = _Split(*_parted(leaves, kinds), structure, static_arguments)
        if tracing() or any(_is_kind(type(array), Tracer) for array in split.arrays):
            return _combined(_nested(function, split)(split.arrays))
        return _run(function, split)

    return call


def limit(programs: int) -> None:
    """Keep so many programs at most; those that are too many go at once.

    Args:
        programs: at least one.

    Raises:
        ValueError: fewer.
    """
    global _limit
    _limit = check_count("programs", programs)
    with _lock:
        _trim()


def count() -> int:
    """How many programs are kept."""
    return len(_programs)


class _Split(NamedTuple):
    """Arguments: the arrays, and all else as a key."""

    arrays: list[Any]
    fixed: tuple[Hashable, ...]
    structure: Any
    static_arguments: tuple[tuple[str, Hashable], ...]

    @property
    def key(self) -> "_Key":
        """Without the arrays."""
        # 1, 1.0 and True are equal, but not the same to a program.
        kinds = (
            tuple(map(type, self.fixed)),
            tuple(type(value) for _, value in self.static_arguments),
        )
        return _Key(
            self.structure,
            self.fixed,
            kinds,
            self.static_arguments,
            jax.dtypes.canonicalize_dtype(float),
        )

    def arguments(self, arrays: list[Any]) -> tuple[tuple, dict[str, Any]]:
        """Of the function, with these arrays."""
        args, kwargs = _joined(self.structure, self.fixed, arrays)
        return args, {**kwargs, **dict(self.static_arguments)}


class _Key:
    """What a program is found by, as it is when it is made: a class may read other values later."""

    def __init__(self, *parts: Hashable):
        self._parts, self._hash = parts, hash(parts)

    def __hash__(self) -> int:
        return self._hash

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Key) and self._hash == other._hash and self._parts == other._parts


class _Marker:
    """Stands where an array was."""


_ARRAY = _Marker()


def _parted(leaves: list[Any], kinds: tuple) -> tuple[list[Any], tuple[Hashable, ...]]:
    """The arrays among the leaves of a tree, and all others with a mark where an array was."""
    arrays, fixed, kinds = [], [], (*kinds, Tracer)
    for leaf in leaves:
        dynamic = _is_kind(type(leaf), kinds)
        (arrays if dynamic else fixed).append(leaf)
        if dynamic:
            fixed.append(_ARRAY)
    return arrays, tuple(fixed)


@lru_cache(maxsize=1000)
def _is_kind(kind: type, kinds: type | tuple[type, ...]) -> bool:
    """As `issubclass`, which takes longer of JAX's own."""
    return issubclass(kind, kinds)


def _joined(structure: Any, fixed: tuple, arrays: list[Any]) -> Any:
    """The tree of both."""
    remaining_arrays = iter(arrays)
    return jax.tree.unflatten(
        structure, [next(remaining_arrays) if leaf is _ARRAY else leaf for leaf in fixed]
    )


@jax.tree_util.register_pytree_node_class
class _Static:
    """What a function returned that is no array; it belongs to the structure of the result."""

    def __init__(self, value: Any):
        self.value = value

    def tree_flatten(self) -> tuple[tuple, Any]:
        return (), self.value

    @classmethod
    def tree_unflatten(cls, value: Any, children: Any) -> "_Static":
        del children
        return cls(value)


@dataclass(frozen=True)
class _Program:
    """A compiled program.

    Attributes:
        run: takes a list of arrays.
        traced: what it was compiled from, with what that refers to by identity.
        calls: keys of the calls that it serves.
    """

    run: Callable
    traced: Any
    calls: "OrderedDict[Hashable, None]"


@dataclass(frozen=True)
class _Call:
    """What a call with known arguments needs: its program, and the structure of its result."""

    program: str
    result: Any


_limit = _SETTINGS.programs
_compiled_count = 0  # programs since memory was given back
_lock = threading.RLock()
_programs: OrderedDict[str, _Program] = OrderedDict()
_calls: dict[Hashable, _Call] = {}
_inner: OrderedDict[Hashable, Callable] = OrderedDict()


def _run(function: Callable, split: _Split) -> Any:
    key = (function, split.key, tuple(map(_kind, split.arrays)))
    with _lock:
        call = _calls.get(key)
        if call is not None:
            _programs.move_to_end(call.program)
            _programs[call.program].calls.move_to_end(key)
            run = _programs[call.program].run
    if call is None:
        call, run = _traced(function, split, key)
    leaves = jax.tree.leaves(run(split.arrays))
    return _combined(jax.tree.unflatten(call.result, leaves))


def _traced(function: Callable, split: _Split, key: Hashable) -> tuple[_Call, Callable]:
    """Trace a function; if what it computes is known its program serves."""
    global _compiled_count
    run = _jitted(function, split)
    traced = run.trace(split.arrays)
    name = fingerprint(traced.jaxpr)
    result = jax.tree.structure(traced.out_info)
    with _lock:
        program = _programs.get(name)
        if program is None:
            program = _programs[name] = _Program(run, traced.jaxpr, OrderedDict())
            _compiled_count += 1
        _programs.move_to_end(name)
        if len(program.calls) >= _SETTINGS.calls:
            _calls.pop(program.calls.popitem(last=False)[0], None)
        program.calls[key] = None
        _calls[key] = _Call(name, result)
        _trim()
        if _compiled_count >= _SETTINGS.release_interval:
            _compiled_count = 0
            _give_back()
        return _calls[key], program.run


def _trim() -> None:
    while len(_programs) > _limit:
        _, program = _programs.popitem(last=False)
        for key in program.calls:
            _calls.pop(key, None)


def _give_back() -> None:
    """Memory that compilation needed and nothing needs any more goes back to the system."""
    forget_lowered()
    # What is freed between blocks in use glibc keeps, hundreds of megabytes, until it is asked.
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # other C libraries have none
        if trim is not None:
            trim(0)


def _nested(function: Callable, split: _Split) -> Callable:
    """As `jax.jit`, for use in a function that is traced: it is traced once, however often used."""
    key = (function, split.key)
    with _lock:
        if key not in _inner:
            _inner[key] = _jitted(function, split)
            if len(_inner) > _SETTINGS.nested:
                _inner.popitem(last=False)
        _inner.move_to_end(key)
        return _inner[key]


def _jitted(function: Callable, split: _Split) -> Callable:
    """A function of the arrays alone, new for each key: what JAX keeps for it goes with it."""
    frame = _Split([], split.fixed, split.structure, split.static_arguments)

    def of_arrays(arrays: list[Any]) -> Any:
        args, kwargs = frame.arguments(arrays)
        leaves, structure = jax.tree.flatten(function(*args, **kwargs))
        returned, fixed = _parted(leaves, _NUMBERS)
        return returned, _Static((structure, fixed))

    of_arrays.__name__ = getattr(function, "__name__", "function")
    return jax.jit(of_arrays)


def _combined(result: Any) -> Any:
    arrays, static_part = result
    structure, fixed = static_part.value
    return _joined(structure, fixed, arrays)


def _kind(array: Any) -> Hashable:
    """What decides how an argument is compiled."""
    kind = type(array)
    if _is_kind(kind, (np.ndarray, np.generic)):
        return array.shape, array.dtype
    return (array.shape, array.dtype, array.weak_type) if _is_kind(kind, jax.Array) else kind


def fingerprint(closed: Any) -> str:
    """Digest of what a traced function computes.

    Args:
        closed: of `jax.make_jaxpr`.

    Returns:
        The same text for functions of the same operations on the same shapes with the same
        constants; names of functions and variables have no part in it.
    """
    digest = hashlib.sha256()
    _digest(closed, digest.update)
    return digest.hexdigest()


def _digest(closed: Any, add: Callable[[bytes], None]) -> None:
    jaxpr = getattr(closed, "jaxpr", closed)
    numbers: dict[Any, int] = {}

    def number(variable: Any) -> str:
        return f"{numbers.setdefault(variable, len(numbers))}:{variable.aval}"

    for array in getattr(closed, "consts", ()):
        _digest_value(array, add)
    add(_PART)
    for variable in (*jaxpr.constvars, *jaxpr.invars):
        add(number(variable).encode())
    for equation in jaxpr.eqns:
        add(_PART + equation.primitive.name.encode() + _PART)
        _digest_atoms(equation.invars, number, add)
        params = sorted(equation.params.items())
        if (
            equation.primitive.name in RULED
        ):  # a rule for derivatives has no part in what it computes
            params = [(name, value) for name, value in params if hasattr(value, "eqns")]
        for name, value in params:
            add(_PART + name.encode())
            _digest_value(value, add)
        add(_PART)
        _digest_atoms(equation.outvars, number, add)
    add(_PART)
    _digest_atoms(jaxpr.outvars, number, add)
    add(_END)


def _digest_atoms(atoms: Any, number: Callable[[Any], str], add: Callable[[bytes], None]) -> None:
    for atom in atoms:
        if isinstance(atom, Literal):
            _digest_value(atom.val, add)
            add(str(atom.aval).encode())
        else:
            add(number(atom).encode())


def _digest_value(value: Any, add: Callable[[bytes], None]) -> None:
    """A constant, or a parameter of an operation, which may hold functions: jaxprs, or Python's.

    The latter, and numbers that JAX traces, are told apart by their address; a program that is kept
    keeps them.
    """
    if hasattr(value, "eqns") or hasattr(value, "jaxpr"):
        _digest(value, add)
    elif isinstance(value, Tracer):  # that a rule for derivatives keeps of the function around it
        add(f"{value.aval} {id(value)};".encode())
    elif hasattr(value, "__array__"):  # JAX 0.8 has arrays that are neither NumPy's nor its own
        array = np.asarray(value)
        add(f"{array.shape}{array.dtype}".encode())
        add(array.tobytes())
    elif isinstance(value, tuple | list):
        add(f"{len(value)}(".encode())
        for part in value:
            _digest_value(part, add)
    else:
        add(f"{type(value).__name__} {value!r};".encode())
