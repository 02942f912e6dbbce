"""The steps of the records of one estimate, one record after the other.

Short records are prepared once; a `LongRecord` is read and prepared piece by piece in every pass,
so that memory does not grow with its length.
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


@dataclass(frozen=True)
class Choices:
    """Preparation of the records of one estimate; None where it is chosen from them.

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
class StepSource:
    """Records of one estimate, as steps for observers of one kind.

    Attributes:
        plant: the model; its parameters do not matter.
        records: one or several, or a `LongRecord`.
        choices: how the records are prepared.
        taps: length of the observers' moving average [steps].
        explicit: the observers' form.
        max_stored: number of steps up to which they are stored for the next pass.
    """

    plant: Plant
    records: Sequence[Record]
    choices: Choices
    taps: int
    explicit: bool
    max_stored: int = 1_000_000
    _first: PreparedRecords = field(init=False, repr=False)
    _counts: BlockCounts | None = field(init=False, default=None, repr=False)
    _block_counts: tuple[int, ...] | None = field(init=False, default=None, repr=False)
    _stored: list[tuple[Steps, DiscreteFilter]] | None = field(init=False, default=None, repr=False)

    def __post_init__(self) -> None:
        # Choices for a long record depend on its first piece, for others on all of their samples.
        head = self.records[:1] if isinstance(self.records, LongRecord) else self.records
        self._first = self._prepare(tuple(head), self.choices)

    @property
    def lowpass(self) -> LowPass:
        """F, as in `choices` or chosen from the records."""
        return self._first.lowpass

    @property
    def transient(self) -> float:
        """Not scored at the start of each record [s]."""
        if self.choices.transient is not None:
            return self.choices.transient
        return default_transient(self._first.records, self.lowpass, self.explicit)

    def observer(self, plant: Plant) -> AbstractObserver:
        """The default observer at the nominal parameters of a plant."""
        prepared = self._first
        return default_observer(
            plant, prepared.fine, prepared.inputs, prepared.lowpass.cutoff, prepared.substeps
        )[0]

    def __iter__(self) -> Iterator[tuple[Steps, DiscreteFilter]]:
        """Steps of each record, and F sampled at its rate."""
        if self._stored is not None:
            yield from self._stored
            return
        stored, count, counts, blocks = [], 0, BlockCounts(), []
        for steps in self._make_steps():
            count += len(steps[0].time)
            stored = [*stored, steps] if count <= self.max_stored else []
            counts, blocks = counts.plus(steps[0]), [*blocks, _blocks(steps[0])]
            yield steps
        self._stored, self._counts, self._block_counts = stored or None, counts, tuple(blocks)

    @property
    def block_counts(self) -> BlockCounts:
        """Steps and blocks of all records."""
        return self._count_blocks()[0]

    @property
    def blocks(self) -> tuple[int, ...]:
        """Number of blocks of each record, including an incomplete last one."""
        return self._count_blocks()[1]

    def _count_blocks(self) -> tuple[BlockCounts, tuple[int, ...]]:
        if self._counts is None or self._block_counts is None:
            for _ in self:
                pass
        assert self._counts is not None
        assert self._block_counts is not None
        return self._counts, self._block_counts

    def _make_steps(self) -> Iterator[tuple[Steps, DiscreteFilter]]:
        if not isinstance(self.records, LongRecord):
            duration = sum(len(record) * record.sample_period for record in self._first.fine)
            for i in range(len(self.records)):
                yield self._steps(self._first, i, duration)
            return
        first = self._first
        choices = Choices(first.lowpass, self.transient, first.substeps, first.smoothing)
        for piece in self.records:
            yield self._steps(self._prepare((piece,), choices), 0, self.records.duration)

    def _prepare(self, records: tuple[Record, ...], choices: Choices) -> PreparedRecords:
        return prepare_records(
            self.plant,
            records,
            choices.lowpass,
            choices.smoothing,
            choices.substeps,
            self.explicit,
        )

    def _steps(
        self, prepared: PreparedRecords, i: int, duration: float
    ) -> tuple[Steps, DiscreteFilter]:
        steps = prepare_steps(
            self.plant,
            prepared.fine[i : i + 1],
            prepared.inputs[i : i + 1],
            self.taps,
            self.transient,
            prepared.lowpass.memory,
            prepared.velocity_noise[i : i + 1],
            self.explicit,
            TAPER / prepared.lowpass.cutoff,
            duration,
            prepared.substeps,
        )
        period = prepared.fine[i].sample_period
        return jax.tree.map(lambda leaf: leaf[0], steps), prepared.lowpass.discretise(period)


def _blocks(steps: Steps) -> int:
    return int(np.sum(steps.block_end)) + 1
