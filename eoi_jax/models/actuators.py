"""What is known of an actuator, a function of the inputs of a plant along a record."""

from typing import Any


def keeps_steps(actuator: Any, count: int) -> tuple[bool, ...]:
    """Which of `count` inputs come out of an actuator held if they were; None keeps them all."""
    query = getattr(actuator, "keeps_steps", None)
    return (actuator is None,) * count if query is None else query(count)


def are_linear(actuator: Any, count: int) -> tuple[bool, ...]:
    """In which of `count` inputs an actuator is linear; one of the user's is taken to be."""
    query = getattr(actuator, "are_linear", None)
    return (True,) * count if query is None else query(count)


def have_past(actuator: Any, count: int) -> tuple[bool, ...]:
    """Which of `count` inputs may act later than they came; with one of the user's all may."""
    query = getattr(actuator, "have_past", None)
    return (actuator is not None,) * count if query is None else query(count)


def changed_inputs(actuator: Any, count: int) -> tuple[int, ...]:
    """Numbers of those of `count` inputs that an actuator changes; one of the user's may all."""
    query = getattr(actuator, "changed_inputs", None)
    everything = () if actuator is None else tuple(range(count))
    return everything if query is None else query(count)
