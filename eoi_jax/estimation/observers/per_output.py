"""One observer for each output: for plants whose outputs differ in relative degree."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp

from eoi_jax._checks import check
from eoi_jax._types import Output, Rates, Scalar
from eoi_jax.estimation.observers.observer import AbstractObserver, Observation


class PerOutput(AbstractObserver):
    """Observers side by side, one an output.

    Args:
        observers: one for each output of the plant, in its order; all of one scheme.

    Raises:
        ValueError: observers of different schemes.
    """

    observers: tuple[AbstractObserver, ...]
    scheme: str = eqx.field(static=True)

    def __init__(self, observers: tuple[AbstractObserver, ...]):
        self.observers = tuple(observers)
        schemes = {one.scheme for one in self.observers}
        check(len(schemes) == 1, "observers", "must share one scheme", sorted(schemes))
        self.scheme = schemes.pop()

    @property
    def relative_degree(self) -> tuple[int, ...]:
        """That of each output."""
        return tuple(int(one.relative_degree) for one in self.observers)  # type: ignore[arg-type]

    @property
    def kernel(self) -> tuple[tuple[float, ...], ...]:
        """That of each output, padded with zeros to one length."""
        length = max(len(one.kernel) for one in self.observers)
        return tuple(one.kernel + (0.0,) * (length - len(one.kernel)) for one in self.observers)

    def init(self, y: Output, rates: Rates) -> tuple[Any, ...]:
        """Each on its own output."""
        return tuple(
            one.init(y[j : j + 1], rates[: self.relative_degree[j] - 1, j : j + 1])
            for j, one in enumerate(self.observers)
        )

    def rates(self, state: tuple[Any, ...]) -> Rates:
        """Rows that an output does not own are zero."""
        return self._columns(
            [one.rates(own) for one, own in zip(self.observers, state, strict=True)]
        )

    def step(
        self,
        state: tuple[Any, ...],
        y: Output,
        y_next: Output,
        drift: Output,
        sample_period: Scalar,
    ) -> tuple[tuple[Any, ...], Observation]:
        """Each takes its step."""
        pairs = [
            one.step(state[j], y[j : j + 1], y_next[j : j + 1], drift[j : j + 1], sample_period)
            for j, one in enumerate(self.observers)
        ]
        shown = [observation for _, observation in pairs]
        joined = Observation(
            jnp.concatenate([one.injection for one in shown]),
            jnp.concatenate([one.observed for one in shown]),
            self._columns([one.rates for one in shown]),
            jnp.concatenate([one.sliding for one in shown]),
        )
        return tuple(new for new, _ in pairs), joined

    def _columns(self, rates: list[Any]) -> Rates:
        rows = max(self.relative_degree) - 1
        padded = [jnp.pad(one, ((0, rows - one.shape[0]), (0, 0))) for one in rates]
        return jnp.concatenate(padded, axis=1)
