"""One observer for each output: for plants whose outputs differ in relative degree."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp

from eoi_jax._checks import check
from eoi_jax._types import Output, Rates, Scalar
from eoi_jax.estimation.observers.observer import AbstractObserver, Observation


class PerOutput(AbstractObserver):
    """One observer for each output.

    Args:
        observers: in the order of the plant's outputs; all of one scheme.

    Raises:
        ValueError: observers of different schemes.
    """

    observers: tuple[AbstractObserver, ...]
    scheme: str = eqx.field(static=True)

    def __init__(self, observers: tuple[AbstractObserver, ...]):
        self.observers = tuple(observers)
        schemes = {observer.scheme for observer in self.observers}
        check(len(schemes) == 1, "observers", "must share one scheme", sorted(schemes))
        self.scheme = schemes.pop()

    @property
    def relative_degree(self) -> tuple[int, ...]:
        """Relative degree of each output."""
        return tuple(int(observer.relative_degree) for observer in self.observers)  # type: ignore[arg-type]

    @property
    def kernel(self) -> tuple[tuple[float, ...], ...]:
        """Weights of each output, padded with zeros to one length."""
        length = max(len(observer.kernel) for observer in self.observers)
        return tuple(
            observer.kernel + (0.0,) * (length - len(observer.kernel))
            for observer in self.observers
        )

    def init(self, y: Output, rates: Rates) -> tuple[Any, ...]:
        """States of all observers."""
        return tuple(
            observer.init(y[j : j + 1], rates[: max(self.relative_degree[j] - 1, 0), j : j + 1])
            for j, observer in enumerate(self.observers)
        )

    def rates(self, state: tuple[Any, ...]) -> Rates:
        """Rates of all outputs; rows beyond the relative degree of an output are zero."""
        return self._columns(
            [
                observer.rates(observer_state)
                for observer, observer_state in zip(self.observers, state, strict=True)
            ]
        )

    def step(
        self,
        state: tuple[Any, ...],
        y: Output,
        y_next: Output,
        drift: Output,
        sample_period: Scalar,
    ) -> tuple[tuple[Any, ...], Observation]:
        """One step of every observer."""
        pairs = [
            observer.step(
                state[j], y[j : j + 1], y_next[j : j + 1], drift[j : j + 1], sample_period
            )
            for j, observer in enumerate(self.observers)
        ]
        observations = [observation for _, observation in pairs]
        joined = Observation(
            jnp.concatenate([observation.injection for observation in observations]),
            jnp.concatenate([observation.observed for observation in observations]),
            self._columns([observation.rates for observation in observations]),
            jnp.concatenate([observation.sliding for observation in observations]),
        )
        return tuple(new for new, _ in pairs), joined

    def _columns(self, rates: list[Any]) -> Rates:
        rows = max(*self.relative_degree, 1) - 1
        padded = [
            jnp.pad(rows_of_output, ((0, rows - rows_of_output.shape[0]), (0, 0)))
            for rows_of_output in rates
        ]
        return jnp.concatenate(padded, axis=1)
