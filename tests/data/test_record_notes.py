"""What was masked in records, in few sentences."""

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.data.record_notes import record_notes, same_record_notes

TIME = 0.1 * np.arange(100)


def record(name, gaps=0, repeated=False):
    """With gaps in the output, and the second stamp twice."""
    y = np.sin(TIME)
    y[10 : 10 + gaps] = np.nan
    rows = np.repeat(np.arange(100), 1 + (np.arange(100) == 1) * repeated)
    if not gaps and not repeated:
        return eoi.Record(TIME, np.cos(TIME), y, name)
    with pytest.warns(eoi.RecordWarning):
        return eoi.Record(TIME[rows], np.cos(TIME)[rows], y[rows], name)


def test_records_without_a_fault_have_no_note_and_their_holds_are_not_repeated():
    plain = record("run 1")
    assert plain.notes[0].startswith("Hold taken as linear")
    assert record_notes([plain]) == []


def test_a_note_has_the_name_of_its_record_and_is_not_repeated_for_more():
    (note,) = record_notes([record("run 1", 3)])
    assert note == "run 1: 3 of 100 samples are not finite (`y` 3): masked"
    three = [record(f"run {number}", 2 + number) for number in (1, 2, 3)]
    assert record_notes([record("run 0"), *three]) == [f"{note}; alike in run 2 and run 3"]
    many = [*three, *(record(f"run {number}", 2) for number in range(4, 30))]
    assert record_notes(many)[0] == f"{note}; alike in 28 other records"


def test_a_record_that_is_there_twice_is_named_wherever_errors_are_estimated():
    plant = eoi.Plant(lambda t, x, u, p: p.b * u[0] - p.c * x.y[0], {"b": 1.0, "c": 1.0}, 1)
    first, other = (eoi.simulate(plant, TIME, np.sin(k * TIME), name=f"run {k}") for k in (1, 2))
    note = "records 1, 3 (run 1) are the same data, counted 2 times: the ± are too small. Leave"
    (sentence,) = same_record_notes([first, other, first])
    assert sentence == f"{note} out all but one"
    assert same_record_notes([first, other]) == []
    for answer in (eoi.identify, eoi.refine):
        assert sentence in [str(one) for one in answer(plant, [first, other, first]).notes]


def test_notes_on_different_things_are_sentences_of_their_own():
    notes = record_notes([record("run 1", 3), record("run 2", 4, repeated=True)])
    assert len(notes) == 2
    assert notes[0].endswith("masked; alike in run 2")
    assert notes[1].startswith("run 2: Stamps that repeat the previous stamp")
