"""Evaluations of a plant in several threads, where XLA lets them.

XLA hands a batched factorisation or Fourier transform to its threads and waits in one of them until
they are done. As many such waits at once as there are threads, and none is left to do the work: two
evaluations of a plant with `jnp.linalg.solve` in it hang on two cores for ever (jaxlib 0.10.2).
Such plants are evaluated one after the other.
"""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, TypeVar

import jax
import jax.numpy as jnp

from eoi_jax.models.plant import Plant, State

_WAITS = ("custom_call", "stablehlo.fft")  # in the program of a plant, as JAX hands it to XLA

Item = TypeVar("Item")
Result = TypeVar("Result")


def waits(plant: Plant) -> bool:
    """Whether XLA waits for threads of its own where it evaluates a plant."""

    def both(y: Any, u: Any) -> Any:
        theta = jnp.asarray(plant.theta)
        x, t = State(y, plant.internal_start(theta)), jnp.zeros(())
        return plant.derivative(t, x, u, theta), plant.internal_rate(t, x, u, theta)

    y, u = (plant.relative_degree, len(plant.outputs)), (len(plant.inputs),)
    shapes = (jax.ShapeDtypeStruct((2, *one), jnp.result_type(float)) for one in (y, u))
    text = jax.jit(jax.vmap(both)).lower(*shapes).as_text()
    return any(one in text for one in _WAITS)


def each(threads: int, function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """A function of several items, in so many threads; without any one after the other."""
    if not threads:
        return [function(one) for one in items]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(function, items))


@contextmanager
def aside(threads: int, call: Callable[[], Result]) -> Iterator[Callable[[], Result]]:
    """The result of a call that goes on beside the block; without threads it is made before."""
    if not threads:
        result = call()
        yield lambda: result
        return
    with ThreadPoolExecutor(1) as pool:
        yield pool.submit(call).result
