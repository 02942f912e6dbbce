"""The plan of a sweep: its dimensions, their labels, and its chunks.

Dimensions, in this order: record × lowpass × observer × start × resample. A lane is one point of
this grid: one estimate. A chunk holds lanes of one record and one filter.
"""

import hashlib
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import NoneType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from eoi_jax._checks import check, check_choice, check_count, check_kind
from eoi_jax.compiler.jax_private import jaxprs_within
from eoi_jax.data.long_record import LongRecord
from eoi_jax.data.record import Record
from eoi_jax.estimation.lowpass import LowPass
from eoi_jax.estimation.observers.gain_sets import GainSets, gain_sets
from eoi_jax.estimation.preparation import check_observer, check_preparation, starting_points
from eoi_jax.estimation.sweep.source import Choices
from eoi_jax.models.check_records import check_records
from eoi_jax.models.free_starts import check_known_starts
from eoi_jax.models.plant import Plant, State

DIMENSIONS = ("record", "lowpass", "observer", "start", "resample")
PRECISIONS = ("float64", "float32")


@dataclass(frozen=True)
class Group:
    """Records of one estimate.

    Attributes:
        name: label.
        records: one or several, or a `LongRecord`.
    """

    name: str
    records: Sequence[Record]

    @cached_property
    def data_hash(self) -> str:
        """Hash of all values (of a long record: of its length and some of its values)."""
        if isinstance(self.records, LongRecord):
            return self.records.data_hash
        return "-".join(record.data_hash for record in self.records)

    @cached_property
    def content_hash(self) -> str:
        """Hash of everything that an estimate reads: also input hold, burn-in and noise."""
        if isinstance(self.records, LongRecord):
            return self.records.content_hash
        return "-".join(record.content_hash for record in self.records)


@dataclass(frozen=True)
class Settings:
    """Settings of all lanes of a sweep.

    Attributes:
        resamples: bootstrap resamples along ``resample``, after the data as measured (number 0).
        passes: largest number of iterations.
        precision: of the loop.
        seed: of the resamples.
        chunk: largest number of lanes that run at a time.
    """

    resamples: int
    passes: int
    precision: str
    seed: int
    chunk: int


@dataclass(frozen=True)
class Plan:
    """All lanes of a sweep.

    Attributes:
        plant: the model.
        groups: along ``record``.
        choices: along ``lowpass``.
        observers: along ``observer``, in groups that stack; None: one, chosen for each record.
        starts: θ_0, shape (starts, np).
        settings: of all lanes.
    """

    plant: Plant
    groups: tuple[Group, ...]
    choices: tuple[Choices, ...]
    observers: tuple[GainSets, ...] | None
    starts: Float[np.ndarray, "starts np"]
    settings: Settings

    @property
    def shape(self) -> tuple[int, ...]:
        """Length of each of `DIMENSIONS`."""
        return (
            len(self.groups),
            len(self.choices),
            1 if self.observers is None else sum(len(group) for group in self.observers),
            len(self.starts),
            1 + self.settings.resamples,
        )

    @property
    def lanes(self) -> int:
        """Number of estimates."""
        return int(np.prod(self.shape))

    @cached_property
    def steps(self) -> tuple[int, ...]:
        """Length of a chunk along each of `DIMENSIONS`."""
        room, sizes = self.settings.chunk, []
        for length in self.shape[:1:-1]:
            sizes.append(max(min(length, room), 1))
            room //= sizes[-1]
        return (1, 1, *sizes[::-1])

    @property
    def grid(self) -> tuple[int, ...]:
        """Number of chunks along each of `DIMENSIONS`."""
        return tuple(-(-n // step) for n, step in zip(self.shape, self.steps, strict=True))

    def chunks(self) -> Iterator[tuple[int, ...]]:
        """Places of the chunks in `grid`."""
        return itertools.product(*(range(n) for n in self.grid))

    def region(self, place: tuple[int, ...]) -> tuple[slice, ...]:
        """Range of a chunk along each dimension."""
        return tuple(
            slice(i * step, min((i + 1) * step, n))
            for i, step, n in zip(place, self.steps, self.shape, strict=True)
        )

    def part_at(self, place: tuple[int, ...]) -> "Part":
        """The part of the plan that a worker needs for one chunk."""
        region = self.region(place)
        return Part(
            self.plant,
            place[0],
            self.groups[place[0]],
            self.choices[place[1]],
            None if self.observers is None else self._observers(region[2]),
            self.starts[region[3]],
            region[4],
            self.settings,
        )

    def _observers(self, span: slice) -> tuple[GainSets, ...]:
        assert self.observers is not None
        parts, first = [], 0
        for group in self.observers:
            members = group[max(span.start - first, 0) : max(span.stop - first, 0)]
            parts += [members] if len(members) else []
            first += len(group)
        return tuple(parts)

    @cached_property
    def fingerprint(self) -> str:
        """Sixteen digits of a hash of everything that affects a number of the result."""
        digest = hashlib.sha256()
        for part in (
            _equation(self.plant),
            [(entry.name, entry.content_hash) for entry in self.groups],
            [
                (entry.lowpass, entry.transient, entry.substeps, entry.smoothing)
                for entry in self.choices
            ],
            (self.starts.tolist(), self.settings),
        ):
            digest.update(repr(part).encode())
        for group in self.observers or ():
            digest.update(str(jax.tree.structure(group.observer)).encode())
            for leaf in jax.tree.leaves(group.observer):
                digest.update(np.ascontiguousarray(leaf).tobytes())
        return digest.hexdigest()[:16]


@dataclass(frozen=True)
class Part:
    """One chunk of a plan, small enough to be sent to another machine.

    Attributes:
        plant, settings: of the plan.
        number: of the group.
        group: the records.
        choices: filter and preparation.
        observers: in groups that stack; None: chosen for the record.
        starts: θ_0, shape (starts, np).
        resamples: range of numbers; 0 is the data as measured.
    """

    plant: Plant
    number: int
    group: Group
    choices: Choices
    observers: tuple[GainSets, ...] | None
    starts: Float[np.ndarray, "starts np"]
    resamples: slice
    settings: Settings

    def sample(self, sets: int, precision: str) -> "Part":
        """The first gain sets at the first start, on the data as measured."""
        observers = None if self.observers is None else (self.observers[0][:sets],)
        settings = replace(self.settings, precision=precision)
        starts, measured = self.starts[:1], slice(0, 1)
        return replace(
            self, observers=observers, starts=starts, resamples=measured, settings=settings
        )


def make_plan(
    plant: Plant,
    records: Any,
    observers: Any,
    lowpass: Any,
    starts: Any,
    choices: Choices,
    settings: Settings,
) -> Plan:
    """A checked plan from the arguments of `sweep`.

    Raises:
        ValueError: invalid arguments.
    """
    minima = {"passes": 1, "resamples": 0, "chunk": 1, "seed": 0}
    counts = {
        key: check_count(key, getattr(settings, key), minimum) for key, minimum in minima.items()
    }
    settings = replace(settings, **counts)
    check_choice("precision", settings.precision, PRECISIONS)
    check_preparation(choices.transient, choices.substeps, choices.smoothing)
    filters = _filters(lowpass)
    groups = None if observers is None else gain_sets(observers, len(plant.outputs))
    for group in groups or ():
        check_observer(plant, jax.tree.map(lambda leaf: leaf[0], group.observer))
    record_groups = _groups(plant, records)
    check_known_starts(plant)
    return Plan(
        plant,
        record_groups,
        tuple(replace(choices, lowpass=lowpass_choice) for lowpass_choice in filters),
        groups,
        starting_points(plant, starts),
        settings,
    )


def _groups(plant: Plant, records: Any) -> tuple[Group, ...]:
    if isinstance(records, Record | LongRecord):
        records = [records]
    check(bool(records), "records", "must hold at least one record", "none: that is no lane")
    if isinstance(records, Mapping):
        named = [(str(name), item) for name, item in records.items()]
    else:
        named = [(getattr(item, "name", ""), item) for item in records]
    groups = []
    for i, (name, item) in enumerate(named):
        if isinstance(item, LongRecord):
            check_records(plant, item[0])
            groups.append(Group(name or f"record {i}", item))
        else:
            checked = check_records(plant, item)
            groups.append(Group(name or "+".join(part.name for part in checked), checked))
    names = [item.name for item in groups]
    if len(set(names)) < len(names):  # labels must be unique
        groups = [Group(f"{item.name} ({i})", item.records) for i, item in enumerate(groups)]
    return tuple(groups)


_FILTERS = "filters `LowPass(cutoff, order)`, or None"


def _filters(lowpass: Any) -> tuple[LowPass | None, ...]:
    filters = (lowpass,) if lowpass is None or isinstance(lowpass, LowPass) else lowpass
    check_kind("lowpass", filters, Iterable, _FILTERS)
    filters = tuple(filters)
    check(len(filters) > 0, "lowpass", "must hold at least one filter", "none: that is no lane")
    for entry in filters:
        check_kind("lowpass", entry, (LowPass, NoneType), _FILTERS)
    return filters


def _equation(plant: Plant) -> str:
    """The model as text that changes with its mathematics: its traced program, not its name."""
    theta = jnp.asarray(plant.theta)
    z = plant.internal_start(theta)
    y = jnp.ones((plant.rows, len(plant.outputs)))
    u = jnp.ones(len(plant.inputs))

    def equations(t: Any, y: Any, z: Any, u: Any, theta: Any) -> Any:
        x = State(y, z)
        rate = () if plant.internal is None else plant.internal_rate(t, x, u, theta)
        start = plant.internal_start(theta)
        return plant.derivative(t, x, u, theta), rate, start

    line = jnp.arange(3.0), jnp.ones((3, len(plant.inputs)))  # an actuator reads a whole record
    traced = _traced(equations, 0.0, y, z, u, theta), _traced(plant.driven, *line, theta)
    limits = (plant.theta, plant.lower, plant.upper)
    structure = (plant.names, plant.inputs, plant.outputs, plant.fixed, plant.degrees)
    numbers = [np.asarray(limit).tolist() for limit in limits]
    return repr((structure, numbers, traced))


def _traced(function: Callable, *arguments: Any) -> tuple[str, str]:
    """A function's jaxpr as text, and a digest of its constant arrays, which the text lacks."""
    closed = jax.make_jaxpr(function)(*arguments)
    digest = hashlib.sha256()
    for array in _captured(closed):
        digest.update(np.asarray(array).tobytes())
    return str(closed), digest.hexdigest()


def _captured(jaxpr: Any) -> Iterator[Any]:
    """Constant arrays of a jaxpr, and of the jaxprs inside it."""
    yield from getattr(jaxpr, "consts", ())
    for equation in jaxpr.eqns:
        for part in jaxprs_within(equation):
            yield from _captured(part)
