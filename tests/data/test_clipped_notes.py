"""What a fit says of an output that stays at an end of its range."""

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.data.clipping import clipped_notes

TIME = np.arange(2000) * 0.05
INPUT = np.repeat(np.random.default_rng(0).choice([0.0, 1.0, 2.0], 40), 50)


def _record(limit=np.inf):
    y = np.zeros(2000)
    for k in range(1999):
        y[k + 1] = y[k] + 0.05 * (3.0 * INPUT[k] - y[k]) / 2.0
    y += 0.01 * np.random.default_rng(1).standard_normal(2000)
    return eoi.Record(TIME, INPUT, np.minimum(y, limit), "lag", hold="zero")


def test_a_clipped_output_is_mentioned_by_the_fit():
    plant = eoi.Plant(lambda t, x, u, p: (p.K * u - x.y[0]) / p.T, {"K": 2.0, "T": 1.5})
    (note,) = [reason for reason in eoi.identify(plant, _record(4.0)).reasons if "stays" in reason]
    assert note.startswith("lag: y stays at 4, an end of its range, in ")
    share = float(note.split(" in ")[1].split(" %")[0])
    assert share == pytest.approx(100 * np.mean(_record(4.0).outputs == 4.0), rel=0.05)
    assert "leave these empty" in note
    assert note in eoi.refine(plant, _record(4.0)).notes


def test_a_discovery_says_it_once_and_points_to_it_first():
    """Damping that is not there takes less than half of what the ends of the sensor leave."""
    plant = eoi.Plant(lambda t, x, u, p: (p.K * u - x.y[0]) / p.T, {"K": 2.0, "T": 1.5})
    found = eoi.discover(plant, _record(4.0), validation=0.3, effects=["constant_offset"])
    lines = str(found).splitlines()
    assert lines[0].endswith("First look at the notes: an output stays at an end of its range, "
                             "which may be all there is.")  # fmt: skip
    assert found.diagnosis is not None
    assert any("saturates" in finding for finding in found.diagnosis.findings)
    assert not any("saturates" in line for line in lines)


def test_an_output_that_turns_or_rests_is_not():
    assert clipped_notes([_record()]) == []
    sine = eoi.Record(TIME, INPUT, np.sin(TIME), hold="zero")
    assert clipped_notes([sine]) == []


def _drive(quantum):
    """A position that stands at its start while the force is below dry friction, then moves."""
    rate, place = np.zeros(2000), np.zeros(2000)
    for k in range(1999):
        force = 8.0 * (k >= 400) - 16.0 * (k >= 1200)
        rate[k + 1] = rate[k] + 0.05 * (force - rate[k]) / 20.0
        place[k + 1] = place[k] + 0.05 * rate[k + 1]
    place = np.round(place / quantum) * quantum if quantum else place
    return eoi.Record(TIME, INPUT, place, "drive", hold="zero")


@pytest.mark.parametrize("quantum", [0.0, 1e-3])
def test_an_output_that_has_not_moved_yet_is_at_no_end_of_its_range(quantum):
    record = _drive(quantum)
    assert np.mean(record.outputs == 0.0) == pytest.approx(0.2, rel=0.03)
    assert clipped_notes([record]) == []


def test_an_output_that_begins_at_the_end_of_its_sensor_is():
    """Its noise shows as soon as it is within the range."""
    noise = 0.01 * np.random.default_rng(1).standard_normal(2000)
    cooling = np.minimum(100.0 * np.exp(-TIME / 60.0) + noise, 90.0)
    (note,) = clipped_notes([eoi.Record(TIME, INPUT, cooling, "store", hold="zero")])
    assert note.startswith("store: y stays at 90, an end of its range, in ")
