"""A model with what is connected in series to it: copies of it, and sensors behind its outputs."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from eoi_jax.models.effects.effect import AbstractCascade
from eoi_jax.models.plant import State


@dataclass(frozen=True)
class Stage:
    """An effect of a cascade at its place, with its parameters.

    Attributes:
        effect: the effect.
        output: index of the output that it is in series with.
        degree: relative degree of the output.
        streams: indices of the inputs that carry the stream.
        states: its internal states among all of them.
        shape: values of its shape parameters.
    """

    effect: AbstractCascade
    output: int
    degree: int
    streams: tuple[int, ...]
    states: slice
    shape: list[Any]

    def column(self, x: State) -> Any:
        """The output with its derivatives."""
        return x.y[: self.degree, self.output]

    def with_column(self, x: State, column: Any) -> State:
        """The state with the output and its derivatives replaced."""
        return State(x.y.at[: self.degree, self.output].set(column), x.z)

    def model_state(self, x: State) -> State:
        """The state of the model in front of it."""
        if not self.effect.behind_output:
            return x
        column = self.effect.model_output(self.column(x), x.z[self.states], self.shape)
        return self.with_column(x, column)


@dataclass(frozen=True)
class Cascade:
    """A model with its stages.

    Attributes:
        derivative: highest derivatives of the model's outputs, of state and inputs.
        stages: of copies first, then of sensors.
    """

    derivative: Callable[[State, Any], Any]
    stages: tuple[Stage, ...]

    @classmethod
    def of(cls, derivative: Callable[[State, Any], Any], stages: list[Stage]) -> "Cascade":
        """With sensors behind everything else."""
        return cls(derivative, tuple(sorted(stages, key=lambda stage: stage.effect.behind_output)))

    def model_state(self, x: State) -> State:
        """The state in front of all sensors: of the model and of all other effects."""
        for stage in reversed(self.stages):
            x = stage.model_state(x)
        return x

    def slopes(self, x: State, u: Any) -> Any:
        """Highest derivatives of the measured outputs, shape (ny,)."""
        return self._slopes(len(self.stages), x, u)

    def slopes_inside(self, x: State, u: Any) -> Any:
        """The same in front of all sensors, at a state there."""
        return self._slopes(sum(not stage.effect.behind_output for stage in self.stages), x, u)

    def with_rates(self, rates: Any, x: State, u: Any) -> Any:
        """Rates of all internal states, with those of the stages in their places."""
        for number in reversed(range(len(self.stages))):
            stage = self.stages[number]
            stage_rates = self._of_stage(stage.effect.rates, number, x, u)
            rates = rates.at[stage.states].set(stage_rates)
            x = stage.model_state(x)
        return rates

    def _slopes(self, count: int, x: State, u: Any) -> Any:
        """Behind so many stages."""
        if count == 0:
            return self.derivative(x, u)
        stage = self.stages[count - 1]
        slope = self._of_stage(stage.effect.slope, count - 1, x, u)
        if x.y.shape[1] == 1:
            return slope[None]
        return self._slopes(count - 1, stage.model_state(x), u).at[stage.output].set(slope)

    def _of_stage(self, function: Callable[..., Any], number: int, x: State, u: Any) -> Any:
        """What a method of a stage's effect gives at a state behind it."""
        stage = self.stages[number]
        standing = u.at[np.asarray(stage.streams, dtype=int)].set(0.0)

        def model(column: Any, flowing: bool) -> Any:
            inputs = u if flowing else standing
            return self._slopes(number, stage.with_column(x, column), inputs)[stage.output]

        return function(model, stage.column(x), x.z[stage.states], stage.shape)
