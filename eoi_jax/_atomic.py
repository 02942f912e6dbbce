"""Atomic writing of files and folders: complete or not at all, however the process ends.

New content is written to a draft next to its goal, ``.<name>-<random>.draft/``, which holds

* ``lock``: locked by the writing process. The system releases the lock when that process ends, by
  whatever signal, so a draft that can be locked is a leftover.
* ``new``: the new content.
* ``old``: the former content of the goal, where the system cannot exchange two paths atomically.

A file is put in its place by a rename, a folder by a rename or, if there is one already, by an
exchange: at every moment the goal is the complete old or the complete new one. Where the system has
no exchange there is a moment between two renames; a process that is killed then leaves the old
folder in its draft, and the next process restores it.
"""

import ctypes
import errno
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows: leftovers stay, as they cannot be told from drafts in use
    fcntl = None

_SUFFIX = ".draft"
_LEFTOVER = re.compile(r"\.(.+)-[a-z0-9_]{8}\.draft")
_PARTS = {"lock", "new", "old"}


def make_draft(goal: Path) -> Path:
    """Make an empty folder next to a file or folder that is to be written.

    Args:
        goal: path to be written; its parent folder exists.

    Returns:
        The folder; the caller removes it.

    Raises:
        OSError: the folder cannot be made.
    """
    return Path(tempfile.mkdtemp(suffix=_SUFFIX, prefix=f".{goal.name}-", dir=goal.parent))


def write_folder(
    goal: Path,
    fill: Callable[[Path], None],
    former: Callable[[Path], Iterable[str]] = lambda _: (),
    keep: bool = False,
) -> None:
    """Write a folder atomically; files that nobody wrote here stay in it.

    Args:
        goal: the folder, or a link to it; missing parent folders are made.
        fill: function that writes into the empty folder that is its argument.
        former: function of the folder as it stands: names in it that are replaced or removed. All
            others stand in the new folder, too.
        keep: keep a folder that is not empty and that another process made meanwhile.

    Raises:
        OSError: it cannot be written; `FileExistsError`: it is a file, or a file in it that is not
            a former one has the name of a new one.
    """
    goal = goal.resolve() if goal.is_symlink() else goal
    missing = [folder for folder in goal.parents if not folder.exists()]
    goal.parent.mkdir(parents=True, exist_ok=True)
    with tidied(lambda: _remove_empty(missing)), _drafted(goal) as draft:
        new = draft / "new"
        new.mkdir()
        fill(new)
        for path in new.rglob("*"):
            fsync(path)
        if goal.exists() and not keep:
            if not goal.is_dir():
                raise FileExistsError(errno.EEXIST, "a file where a folder is to be written", goal)
            replaced = set(former(goal))
            for path in goal.iterdir():
                if path.name not in replaced:
                    link(path, new / path.name)
        fsync(new)
        if keep:
            with suppress(FileExistsError):
                _move_into_place(new, goal)
        elif goal.exists() and not _exchange(new, goal):
            goal.rename(draft / "old")
            new.rename(goal)
        elif not goal.exists():
            new.rename(goal)
        fsync(goal.parent)


def link(source: Path, target: Path) -> None:
    """Give a file, or all files of a folder, a second name; a copy where the system has no links.

    Args:
        source: a file, a folder or a symbolic link, which stays one.
        target: its second path.

    Raises:
        FileExistsError: there is something.
    """
    if target.exists() or target.is_symlink():
        raise FileExistsError(errno.EEXIST, "a file that another one would replace", target)
    if source.is_symlink():
        target.symlink_to(os.readlink(source), target_is_directory=source.is_dir())
    elif source.is_dir():
        shutil.copytree(source, target, symlinks=True, copy_function=_link_file)
    else:
        _link_file(source, target)


def _link_file(source: str | Path, target: str | Path) -> None:
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)
        fsync(Path(target))


def _remove_empty(folders: list[Path]) -> None:
    for folder in folders:
        with suppress(OSError):
            folder.rmdir()


def write_file(goal: Path, fill: Callable[[Path], None]) -> None:
    """Write a file atomically.

    Args:
        goal: the file; its folder exists.
        fill: function that writes the file at the path that is its argument.

    Raises:
        OSError: the file cannot be written.
    """
    with _drafted(goal) as draft:
        new = draft / "new"
        fill(new)
        fsync(new)
        new.replace(goal)
        fsync(goal.parent)


def write_files(folder: Path, last: str, fill: Callable[[Path], None]) -> None:
    """Write files into a folder that holds others, each of them atomically.

    Args:
        folder: made if it does not exist.
        last: name of the file that is put in its place after all others.
        fill: function that writes into the empty folder that is its argument.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with _drafted(folder / last) as draft:
        new = draft / "new"
        new.mkdir()
        fill(new)
        for path in sorted(new.iterdir(), key=lambda file: file.name == last):
            fsync(path)
            path.replace(folder / path.name)
        fsync(folder)


def sweep_up(folder: Path) -> None:
    """Remove the drafts of processes that have ended, and restore what they moved away.

    Args:
        folder: that may contain drafts; those of running processes are kept.
    """
    with suppress(OSError):
        for path in list(folder.iterdir()):
            match = _LEFTOVER.fullmatch(path.name)
            if match and path.is_dir() and not path.is_symlink():
                with suppress(OSError):
                    _remove_leftover(path, folder / match[1])


def _remove_leftover(draft: Path, goal: Path) -> None:
    try:
        lock = _lock(draft / "lock", os.O_RDWR)
    except FileNotFoundError:
        draft.rmdir()  # no lock yet; fails if the folder is not empty, which is then no draft
        return
    if lock is None:
        return
    try:
        if {path.name for path in draft.iterdir()} <= _PARTS:
            _undo(draft, goal)
    finally:
        os.close(lock)


def _undo(draft: Path, goal: Path) -> None:
    """Remove a draft; the old folder in it is restored unless the new one is in place."""
    old = draft / "old"
    if old.exists() and not goal.exists():
        old.rename(goal)
    shutil.rmtree(draft, ignore_errors=True)


@contextmanager
def _drafted(goal: Path) -> Iterator[Path]:
    """A locked draft, removed at the end; leftovers next to it are removed first."""
    sweep_up(goal.parent)
    draft, lock = _locked_draft(goal)
    try:
        with tidied(lambda: _undo(draft, goal)):
            yield draft
    finally:
        if lock is not None:
            os.close(lock)


def _locked_draft(goal: Path) -> tuple[Path, int | None]:
    """A draft and its lock; repeated if another process removes the draft before it is locked."""
    while True:
        draft = make_draft(goal)
        path = draft / "lock"
        with suppress(FileNotFoundError):
            lock = _lock(path, os.O_RDWR | os.O_CREAT)
            if fcntl is None or lock is None or os.path.samestat(os.stat(path), os.fstat(lock)):
                return draft, lock


def _lock(path: Path, flags: int) -> int | None:
    """A file descriptor that holds the lock; None if another process has it or without locks."""
    descriptor = os.open(path, flags, 0o600)
    try:
        if fcntl is not None:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return descriptor
    except OSError as error:
        if error.errno not in (errno.EAGAIN, errno.EACCES, errno.ENOLCK, errno.EOPNOTSUPP):
            raise
    os.close(descriptor)
    return None


def _exchange(first: Path, second: Path) -> bool:
    """Exchange two paths atomically; False where the system has no such call or it fails."""
    if os.name != "posix":
        return False
    library = ctypes.CDLL(None, use_errno=True)
    names = os.fsencode(first), os.fsencode(second)
    if sys.platform == "darwin":  # RENAME_SWAP
        call, arguments = "renamex_np", (*names, 2)
    else:  # AT_FDCWD, RENAME_EXCHANGE
        call, arguments = "renameat2", (-100, names[0], -100, names[1], 2)
    exchange = getattr(library, call, None)
    return exchange is not None and exchange(*arguments) == 0


def _move_into_place(new: Path, goal: Path) -> None:
    """Rename a folder; `FileExistsError` if the goal is anything but an empty folder."""
    try:
        new.rename(goal)
    except OSError:
        if goal.is_dir():  # systems name this error in several ways
            raise FileExistsError(goal) from None
        raise


def fsync(path: Path) -> None:
    """Write a file or folder to the disk, where the system supports it."""
    with suppress(OSError):
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


# -- clean-up where the process ends at once -----------------------------------------------------

_UNDO: list[Callable[[], None]] = []


@contextmanager
def tidied(undo: Callable[[], None]) -> Iterator[None]:
    """Context that calls `undo` at its end, also when the process is interrupted before.

    Args:
        undo: removes unfinished files; may be called twice.
    """
    _UNDO.append(undo)
    try:
        yield
    finally:
        undo()
        _UNDO.remove(undo)


def tidy() -> None:
    """Call all pending `undo` functions, for a process that ends at once."""
    for undo in reversed(_UNDO):
        undo()
