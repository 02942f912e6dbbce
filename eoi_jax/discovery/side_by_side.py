"""Evaluations of a plant in several threads, where XLA lets them.

XLA runs a batched factorisation or Fourier transform in its thread pool, and one thread of the pool
waits for the result. If every thread waits, none can do the work: two simultaneous evaluations of a
plant with `jnp.linalg.solve` deadlock on two cores (jaxlib 0.10.2).
Such plants are evaluated one after the other.
"""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, TypeVar

import jax
import jax.numpy as jnp

from eoi_jax.compiler.trace import is_arithmetic
from eoi_jax.models.plant import Plant, State

_WAITS = ("custom_call", "stablehlo.fft")  # in the program of a plant, as JAX hands it to XLA

Item = TypeVar("Item")
Result = TypeVar("Result")


def waits(plant: Plant) -> bool:
    """Whether XLA waits for threads of its own where it evaluates a plant."""

    def rates(y: Any, u: Any) -> Any:
        theta = jnp.asarray(plant.theta)
        x, t = State(y, plant.internal_start(theta)), jnp.zeros(())
        return plant.derivative(t, x, u, theta), plant.internal_rate(t, x, u, theta)

    def shapes(*lanes: int) -> list[Any]:
        single = (plant.rows, len(plant.outputs)), (len(plant.inputs),)
        return [jax.ShapeDtypeStruct((*lanes, *shape), jnp.result_type(float)) for shape in single]

    if is_arithmetic(jax.make_jaxpr(rates)(*shapes())):
        return False  # as of most plants, whose program need not be made for that
    text = jax.jit(jax.vmap(rates)).lower(*shapes(2)).as_text()
    return any(operation in text for operation in _WAITS)


def map_in_threads(
    threads: int, function: Callable[[Item], Result], items: Iterable[Item]
) -> list[Result]:
    """Apply a function to each item in `threads` threads; with 0 threads, sequentially."""
    if not threads:
        return [function(item) for item in items]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(function, items))


@contextmanager
def concurrently(threads: int, call: Callable[[], Result]) -> Iterator[Callable[[], Result]]:
    """Run a call in a thread while the block runs; with 0 threads, before the block."""
    if not threads:
        result = call()
        yield lambda: result
        return
    with ThreadPoolExecutor(1) as pool:
        yield pool.submit(call).result
