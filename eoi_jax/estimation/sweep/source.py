"""The steps of the records of one estimate, one record after the other.

Short records are made ready once; those of a `LongRecord` are read, made ready and dropped piece by
piece in every pass, so that memory does not grow with the record.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import jax
import numpy as np

from eoi_jax.data.long_record import LongRecord
from eoi_jax.data.record import Record
from eoi_jax.estimation.defaults import default_observer, default_transient
from eoi_jax.estimation.iteration import BlockCounts
from eoi_jax.estimation.kernel import Steps
from eoi_jax.estimation.lowpass import DiscreteFilter, LowPass
from eoi_jax.estimation.observers.observer import AbstractObserver
from eoi_jax.estimation.preparation import TAPER, PreparedRecords, prepare_records, prepare_steps
from eoi_jax.models.plant import Plant

# Steps of a source that are kept for the next pass; above it they are made again each time.
_KEPT = 1_000_000


@dataclass(frozen=True)
class Choices:
    """How records are made ready, the same for all of one estimate; None where it is chosen.

    Attributes:
        lowpass: F.
        transient: not scored at the start of each record [s].
        substeps: per sample.
        smoothing: cut-off of the zero-phase filter [rad/s], False for none.
    """

    lowpass: LowPass | None = None
    transient: float | None = None
    substeps: int | None = None
    smoothing: float | bool | None = None


@dataclass
class Source:
    """Records of one estimate, as steps for observers of one kind.

    Attributes:
        plant: the model; its parameters do not matter.
        records: one or several, or a `LongRecord`.
        choices: how they are made ready.
        taps: length of the observers' moving average [steps].
        explicit: the observers' form.
    """

    plant: Plant
    records: Sequence[Record]
    choices: Choices
    taps: int
    explicit: bool
    _first: PreparedRecords = field(init=False, repr=False)
    _tally: BlockCounts | None = field(init=False, default=None, repr=False)
    _blocks_of: tuple[int, ...] | None = field(init=False, default=None, repr=False)
    _kept: list[tuple[Steps, DiscreteFilter]] | None = field(init=False, default=None, repr=False)

    def __post_init__(self) -> None:
        # A long record is judged by its first piece, others by all that they hold.
        head = self.records[:1] if isinstance(self.records, LongRecord) else self.records
        self._first = self._ready(tuple(head), self.choices)

    @property
    def lowpass(self) -> LowPass:
        """F, as given or chosen."""
        return self._first.lowpass

    @property
    def transient(self) -> float:
        """Not scored at the start of each record [s]."""
        if self.choices.transient is not None:
            return self.choices.transient
        return default_transient(self._first.records, self.lowpass, self.explicit)

    def observer(self, plant: Plant) -> AbstractObserver:
        """The observer that would be chosen, with the plant's own parameters."""
        one = self._first
        return default_observer(plant, one.fine, one.inputs, one.lowpass.cutoff, one.substeps)[0]

    def __iter__(self) -> Iterator[tuple[Steps, DiscreteFilter]]:
        """Steps of each record, and F sampled at its rate."""
        if self._kept is not None:
            yield from self._kept
            return
        kept, count, tally, blocks = [], 0, BlockCounts(), []
        for steps in self._made():
            count += len(steps[0].time)
            kept = [*kept, steps] if count <= _KEPT else []
            tally, blocks = tally.plus(steps[0]), [*blocks, _blocks(steps[0])]
            yield steps
        self._kept, self._tally, self._blocks_of = kept or None, tally, tuple(blocks)

    @property
    def tally(self) -> BlockCounts:
        """Steps and blocks of all records."""
        return self._counted()[0]

    @property
    def blocks(self) -> tuple[int, ...]:
        """Blocks of each record, an incomplete last one counted."""
        return self._counted()[1]

    def _counted(self) -> tuple[BlockCounts, tuple[int, ...]]:
        if self._tally is None or self._blocks_of is None:
            for _ in self:
                pass
        assert self._tally is not None
        assert self._blocks_of is not None
        return self._tally, self._blocks_of

    def _made(self) -> Iterator[tuple[Steps, DiscreteFilter]]:
        if not isinstance(self.records, LongRecord):
            duration = sum(len(one) * one.sample_period for one in self._first.fine)
            for i in range(len(self.records)):
                yield self._steps(self._first, i, duration)
            return
        first = self._first
        settled = Choices(first.lowpass, self.transient, first.substeps, first.smoothing)
        for piece in self.records:
            yield self._steps(self._ready((piece,), settled), 0, self.records.duration)

    def _ready(self, records: tuple[Record, ...], choices: Choices) -> PreparedRecords:
        return prepare_records(
            self.plant,
            records,
            choices.lowpass,
            choices.smoothing,
            choices.substeps,
            self.explicit,
        )

    def _steps(self, one: PreparedRecords, i: int, duration: float) -> tuple[Steps, DiscreteFilter]:
        steps = prepare_steps(
            self.plant,
            one.fine[i : i + 1],
            one.inputs[i : i + 1],
            self.taps,
            self.transient,
            one.lowpass.memory,
            one.velocity_noise[i : i + 1],
            self.explicit,
            TAPER / one.lowpass.cutoff,
            duration,
        )
        period = one.fine[i].sample_period
        return jax.tree.map(lambda leaf: leaf[0], steps), one.lowpass.discretise(period)


def _blocks(steps: Steps) -> int:
    return int(np.sum(steps.block_end)) + 1
