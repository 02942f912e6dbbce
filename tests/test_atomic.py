"""Files and folders appear whole or not at all, whenever the process that writes them is killed."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from eoi_jax import _atomic
from eoi_jax._atomic import make_draft, sweep_up, write_file, write_files, write_folder


def put(text: str):
    """Fill a folder with one file of it."""
    return lambda folder: (folder / "content").write_text(text)


def write(text: str):
    return lambda path: path.write_text(text)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def killed(folder: Path, patch: str, act: str) -> None:
    """Run `act` in a process that `patch` has end itself by SIGKILL on the way."""
    code = (
        "import os, signal, sys\nfrom pathlib import Path\nfrom eoi_jax import _atomic as drafts\n"
        "def kill(*_, **__): os.kill(os.getpid(), signal.SIGKILL)\n"
        f"folder = Path(sys.argv[1])\n{patch}\n{act}\n"
    )
    done = subprocess.run([sys.executable, "-c", code, str(folder)], capture_output=True, text=True)
    assert done.returncode == -signal.SIGKILL, done.stderr


REPLACE = (
    "fill = lambda new: (new / 'content').write_text('new')\n"
    "drafts.write_folder(folder / 'run', fill, lambda folder: ['content'])"
)
# Where a process dies, and what stands then: at no moment nothing.
MOMENTS = {
    "while it fills": ("drafts.fsync = kill", "old"),
    "before the exchange": ("drafts._exchange = kill", "old"),
    "after the exchange": (
        "true = drafts._exchange; drafts._exchange = lambda *x: (true(*x), kill())", "new",
    ),
    "before it is tidied up": ("drafts.shutil.rmtree = kill", "new"),
}  # fmt: skip


@pytest.mark.parametrize("moment", MOMENTS)
def test_a_folder_that_is_replaced_stands_at_every_moment(tmp_path: Path, moment: str):
    patch, standing = MOMENTS[moment]
    (tmp_path / "run").mkdir()
    put("old")(tmp_path / "run")
    (tmp_path / "run" / "mine").write_text("mine")
    killed(tmp_path, patch, REPLACE)
    assert (tmp_path / "run" / "content").read_text() == standing
    assert len(names(tmp_path)) == 2
    write_folder(tmp_path / "next", put("next"))
    assert names(tmp_path) == ["next", "run"]
    assert (tmp_path / "run" / "content").read_text() == standing
    assert (tmp_path / "run" / "mine").read_text() == "mine"


def test_without_an_exchange_the_next_run_puts_back_what_was_moved_away(tmp_path: Path):
    (tmp_path / "run").mkdir()
    put("old")(tmp_path / "run")
    patch = (
        "drafts._exchange = lambda *_: False\n"
        "true = Path.rename; Path.rename = lambda *x: (true(*x), kill())"
    )
    killed(tmp_path, patch, REPLACE)
    assert not (tmp_path / "run").exists()
    sweep_up(tmp_path)
    assert names(tmp_path) == ["run"]
    assert (tmp_path / "run" / "content").read_text() == "old"


def test_two_paths_are_exchanged_or_neither_is_touched(tmp_path: Path):
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
        put(name)(tmp_path / name)
    swapped = _atomic._exchange(tmp_path / "one", tmp_path / "other")
    assert (tmp_path / "one" / "content").read_text() == ("other" if swapped else "one")
    assert not _atomic._exchange(tmp_path / "one", tmp_path / "absent")
    assert names(tmp_path) == ["one", "other"]


def test_a_file_is_whole_or_as_it_was(tmp_path: Path):
    goal = tmp_path / "model.c"
    goal.write_text("old")
    act = "drafts.write_file(folder / 'model.c', lambda new: new.write_text('new'))"
    killed(tmp_path, "drafts.fsync = kill", act)
    assert goal.read_text() == "old"
    write_file(goal, write("newer"))
    assert goal.read_text() == "newer"
    assert names(tmp_path) == ["model.c"]


def test_files_beside_others_come_one_by_one_and_the_last_one_last(tmp_path: Path):
    (tmp_path / "store").write_text("kept")
    fill = "lambda new: [(new / name).write_text(name) for name in ('z', 'last', 'a')]"
    patch = (
        "true = Path.replace; Path.replace = "
        "lambda self, goal: kill() if self.name == 'last' else true(self, goal)"
    )
    killed(tmp_path, patch, f"drafts.write_files(folder, 'last', {fill})")
    assert names(tmp_path)[1:] == ["a", "store", "z"]
    write_files(tmp_path, "last", lambda new: (new / "last").touch())
    assert names(tmp_path) == ["a", "last", "store", "z"]


def test_what_a_living_process_writes_is_left_alone(tmp_path: Path):
    code = (
        "import sys, time\nfrom pathlib import Path\nfrom eoi_jax._atomic import write_file\n"
        "def fill(new):\n    new.write_text('x')\n    print('writes', flush=True)\n    input()\n"
        "write_file(Path(sys.argv[1]), fill)"
    )
    goal = tmp_path / "file"
    other = subprocess.Popen(
        [sys.executable, "-c", code, str(goal)], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        text=True,
    )  # fmt: skip
    assert other.stdout is not None
    assert other.stdout.readline() == "writes\n"
    before = names(tmp_path)
    sweep_up(tmp_path)
    assert names(tmp_path) == before
    write_file(goal, write("mine"))
    assert other.communicate("\n", timeout=60)[0] == ""
    assert goal.read_text() == "x"
    assert names(tmp_path) == ["file"]


def test_what_is_of_others_is_left_alone(tmp_path: Path):
    (tmp_path / ".notes-abcdefgh.draft").mkdir()
    (tmp_path / ".notes-abcdefgh.draft" / "mine").write_text("")
    (tmp_path / ".other-abcdefgh.draft").mkdir()
    for part in ("lock", "new", "mine"):
        (tmp_path / ".other-abcdefgh.draft" / part).write_text("")
    (tmp_path / ".rig-2024").mkdir()
    (tmp_path / ".link-abcdefgh.draft").symlink_to(tmp_path / ".rig-2024")
    before = names(tmp_path)
    sweep_up(tmp_path)
    sweep_up(tmp_path / "absent")
    assert names(tmp_path) == before


def test_an_empty_draft_that_another_process_removed_is_made_again(tmp_path: Path, monkeypatch):
    made = []

    def lose_the_first(goal: Path) -> Path:
        made.append(make_draft(goal))
        if len(made) == 1:
            sweep_up(tmp_path)
            assert not made[0].exists()
        return made[-1]

    monkeypatch.setattr(_atomic, "make_draft", lose_the_first)
    write_file(tmp_path / "file", write("x"))
    assert len(made) == 2
    assert names(tmp_path) == ["file"]


def test_nothing_waits_where_locks_are_unknown(tmp_path: Path, monkeypatch):
    """Some shared file systems have none: then leftovers stay, and nothing else changes."""
    assert _atomic.fcntl is not None

    def refuse(*_):
        raise OSError(_atomic.errno.ENOLCK, "No locks available")

    monkeypatch.setattr(_atomic.fcntl, "flock", refuse)
    write_file(tmp_path / "file", write("x"))
    (tmp_path / ".run-abcdefgh.draft").mkdir()
    (tmp_path / ".run-abcdefgh.draft" / "lock").write_text("")
    sweep_up(tmp_path)
    assert names(tmp_path) == [".run-abcdefgh.draft", "file"]


def test_a_folder_that_is_not_filled_leaves_none_above_it(tmp_path: Path):
    def fail(_: Path) -> None:
        raise ValueError("no figure")

    with pytest.raises(ValueError, match="no figure"):
        write_folder(tmp_path / "a" / "b" / "run", fail)
    assert names(tmp_path) == []
    write_folder(tmp_path / "a" / "b" / "run", put("x"))
    assert names(tmp_path / "a" / "b") == ["run"]


@pytest.mark.parametrize("linked", [True, False])
def test_what_is_not_of_a_former_run_stays_in_a_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, linked: bool
):
    def refuse(*_: object) -> None:
        raise OSError("no hard links")

    if not linked:
        monkeypatch.setattr(os, "link", refuse)
    run = tmp_path / "run"
    (run / "records").mkdir(parents=True)
    (run / "records" / "one.csv").write_text("1")
    (run / "two.csv").write_text("2")
    (run / "latest").symlink_to("two.csv")
    (run / "former").touch()
    write_folder(run, put("new"), lambda folder: ["former", "content"])
    assert names(run) == ["content", "latest", "records", "two.csv"]
    assert (run / "records" / "one.csv").read_text() == "1"
    assert (run / "latest").is_symlink()
    assert (run / "latest").read_text() == "2"
    assert names(tmp_path) == ["run"]


def test_a_folder_takes_the_place_of_no_file(tmp_path: Path):
    put("mine")(tmp_path)
    with pytest.raises(FileExistsError, match="a file where a folder is to be written"):
        write_folder(tmp_path / "content", put("new"))
    with pytest.raises(FileExistsError, match="a file that another one would replace"):
        write_folder(tmp_path, put("new"))
    assert names(tmp_path) == ["content"]
    assert (tmp_path / "content").read_text() == "mine"


def test_a_link_to_a_folder_stays_one(tmp_path: Path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "run").symlink_to("disk")
    write_folder(tmp_path / "run", put("new"))
    assert (tmp_path / "run").is_symlink()
    assert names(tmp_path / "disk") == ["content"]
