"""The sample of small faults: every module has a room, the draw is seeded, lines are found."""

from pathlib import Path

import pytest

from benchmarks.robustness import mutation_coverage, mutation_faults

ROOT = Path(__file__).resolve().parents[2]

TEXT = '''\
"""A module."""

LIMIT, WAIT = 3, 0.5
TRIES = 40


class Tank:
    """A tank."""

    level: float = 1.0

    def outflow(self, rate: float | None = 2.0, *, below=0, most=50) -> float:
        """What leaves it."""
        assert rate is not None
        for _ in range(2):
            if self.level > below:
                return -rate * (
                    self.level - WAIT
                )
        return 0.0
'''


def test_every_module_belongs_to_a_room():
    rooms = mutation_faults.modules(ROOT)
    assert set(rooms) == set(mutation_faults.ROOMS)
    count = sum(len(paths) for paths in rooms.values())
    assert count > 180
    twice = sum(len(names.split()) for names in mutation_faults.ROOMS.values())
    assert len(mutation_faults.ROOM) == twice  # no module in two rooms


@pytest.mark.parametrize(
    ("row", "inside", "rows", "names"),
    [
        (3, False, range(3, 4), {"LIMIT", "WAIT"}),
        (10, False, range(10, 11), {"Tank", "level"}),
        (12, False, range(12, 13), {"outflow"}),
        (14, True, range(14, 15), None),
        (15, True, range(15, 16), None),
        (16, True, range(16, 17), None),
        (18, True, range(17, 20), None),
    ],
)
def test_the_statement_around_a_change_is_known(row, inside, rows, names):
    """And whether it runs in a call, or on import, when whoever names it is affected."""
    got = mutation_coverage.statement(TEXT, row, row)
    assert got[:2] == (inside, rows)
    assert names is None or set(got[2]) == names


def test_faults_stand_where_they_can_matter_and_are_found_again():
    pytest.importorskip("cosmic_ray")
    found = mutation_faults._faults(TEXT, "eoi_jax/tank.py", "models")
    lines = {where.first for where in found.values()}
    # Neither annotations nor assertions, and no nudges of a constant or a default.
    assert lines == {3, 10, 12, 15, 16, 17, 18, 20}
    moved = TEXT.replace("class Tank", "\n\nclass Tank")
    for fault in found:
        changed = mutation_faults.mutated(moved, fault)
        assert changed is not None
        ((before, after),) = mutation_faults.difference(moved, changed[0])
        assert before == fault.line
        assert after != before
    gone = TEXT.replace("self.level - WAIT", "self.level")
    assert any(mutation_faults.mutated(gone, fault) is None for fault in found)


def test_the_sample_is_the_same_each_time_and_holds_every_room():
    pytest.importorskip("cosmic_ray")
    drawn = mutation_faults.sample(ROOT, 24, 3)
    assert drawn == mutation_faults.sample(ROOT, 24, 3)
    assert [fault.room for fault in drawn[:12]] == sorted(mutation_faults.ROOMS)
    assert len(set(drawn)) == 24
