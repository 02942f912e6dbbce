"""Files and folders that appear whole or not at all, whatever ends the process that writes them.

What is written goes into a draft beside its goal, ``.<name>-<random>.draft/``, which holds

* ``lock``: locked by the process that writes. The system lets go of it when that process ends, by
  whatever signal, so a draft that can be locked is a leftover.
* ``new``: what is written.
* ``old``: what stood at the goal, where the system cannot exchange two paths in one step.

A file takes its place by a rename, a folder by a rename or, where there is one already, by an
exchange: at every moment the goal is the old one or the new one, whole. Where the system has no
exchange there is a moment between two renames; a process that is killed there leaves the old one
in its draft, and the next one puts it back.
"""

import ctypes
import errno
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows: leftovers stay, for nobody knows whether they are
    fcntl = None

_SUFFIX = ".draft"
_LEFTOVER = re.compile(r"\.(.+)-[a-z0-9_]{8}\.draft")
_PARTS = {"lock", "new", "old"}


def make_draft(goal: Path) -> Path:
    """An empty folder beside a file or folder that is to be written.

    Args:
        goal: what is to be written; its folder exists.

    Returns:
        The folder; the caller removes it.

    Raises:
        OSError: it cannot be made.
    """
    return Path(tempfile.mkdtemp(suffix=_SUFFIX, prefix=f".{goal.name}-", dir=goal.parent))


def write_folder(goal: Path, fill: Callable[[Path], None], keep: bool = False) -> None:
    """Make a folder, all or nothing; one that is there is replaced at the very end.

    Args:
        goal: the folder; that above it is made where it is missing.
        fill: writes into the empty folder that it is given.
        keep: leave alone a folder with something in it that another process made meanwhile.
    """
    above = [one for one in goal.parents if not one.exists()]
    goal.parent.mkdir(parents=True, exist_ok=True)
    with tidied(lambda: _remove_empty(above)), _drafted(goal) as draft:
        new = draft / "new"
        new.mkdir()
        fill(new)
        for path in new.rglob("*"):
            settle(path)
        settle(new)
        if keep:
            with suppress(FileExistsError):
                _placed(new, goal)
        elif goal.exists() and not _exchanged(new, goal):
            goal.rename(draft / "old")
            new.rename(goal)
        elif not goal.exists():
            new.rename(goal)
        settle(goal.parent)


def _remove_empty(folders: list[Path]) -> None:
    for one in folders:
        with suppress(OSError):
            one.rmdir()


def write_file(goal: Path, fill: Callable[[Path], None]) -> None:
    """Write a file, all or nothing.

    Args:
        goal: the file; its folder exists.
        fill: writes the file whose path it is given.

    Raises:
        OSError: it cannot be written.
    """
    with _drafted(goal) as draft:
        new = draft / "new"
        fill(new)
        settle(new)
        new.replace(goal)
        settle(goal.parent)


def write_files(folder: Path, last: str, fill: Callable[[Path], None]) -> None:
    """Write files into a folder that holds others, each of them all or nothing.

    Args:
        folder: made where it is missing.
        last: name of the file that is placed after all others.
        fill: writes into the empty folder that it is given.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with _drafted(folder / last) as draft:
        new = draft / "new"
        new.mkdir()
        fill(new)
        for path in sorted(new.iterdir(), key=lambda one: one.name == last):
            settle(path)
            path.replace(folder / path.name)
        settle(folder)


def sweep_up(folder: Path) -> None:
    """Remove what processes that have ended left half-written, and put back what they moved away.

    Args:
        folder: that drafts may lie in; that of a process which still writes is left alone.
    """
    with suppress(OSError):
        for path in list(folder.iterdir()):
            found = _LEFTOVER.fullmatch(path.name)
            if found and path.is_dir() and not path.is_symlink():
                with suppress(OSError):
                    _remove_leftover(path, folder / found[1])


def _remove_leftover(draft: Path, goal: Path) -> None:
    try:
        lock = _lock(draft / "lock", os.O_RDWR)
    except FileNotFoundError:
        draft.rmdir()  # begun and no more; fails where it holds anything, which is none of ours
        return
    if lock is None:
        return
    try:
        if {one.name for one in draft.iterdir()} <= _PARTS:
            _undo(draft, goal)
    finally:
        os.close(lock)


def _undo(draft: Path, goal: Path) -> None:
    """Take away a draft; what it replaced returns, unless the new one stands already."""
    old = draft / "old"
    if old.exists() and not goal.exists():
        old.rename(goal)
    shutil.rmtree(draft, ignore_errors=True)


@contextmanager
def _drafted(goal: Path) -> Iterator[Path]:
    """A locked draft, removed at the end; leftovers beside it go first."""
    sweep_up(goal.parent)
    draft, lock = _begun(goal)
    try:
        with tidied(lambda: _undo(draft, goal)):
            yield draft
    finally:
        if lock is not None:
            os.close(lock)


def _begun(goal: Path) -> tuple[Path, int | None]:
    """A draft and its lock; another process may take an empty draft for a leftover: then again."""
    while True:
        draft = make_draft(goal)
        path = draft / "lock"
        with suppress(FileNotFoundError):
            lock = _lock(path, os.O_RDWR | os.O_CREAT)
            if fcntl is None or lock is None or os.path.samestat(os.stat(path), os.fstat(lock)):
                return draft, lock


def _lock(path: Path, flags: int) -> int | None:
    """A file descriptor that holds the lock; None where another has it, or where there are none."""
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


def _exchanged(one: Path, other: Path) -> bool:
    """Whether two paths were exchanged, in one step; the system may have no such call."""
    if os.name != "posix":
        return False
    library = ctypes.CDLL(None, use_errno=True)
    names = os.fsencode(one), os.fsencode(other)
    if sys.platform == "darwin":  # RENAME_SWAP
        call, arguments = "renamex_np", (*names, 2)
    else:  # AT_FDCWD, RENAME_EXCHANGE
        call, arguments = "renameat2", (-100, names[0], -100, names[1], 2)
    exchange = getattr(library, call, None)
    return exchange is not None and exchange(*arguments) == 0


def _placed(new: Path, goal: Path) -> None:
    """Rename a folder; `FileExistsError` where something is there that is not an empty folder."""
    try:
        new.rename(goal)
    except OSError:
        if goal.is_dir():  # systems name this error in several ways
            raise FileExistsError(goal) from None
        raise


def settle(path: Path) -> None:
    """Have the system write it to the disk, as far as it can."""
    with suppress(OSError):
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


# -- where the process ends at once: what has to be undone then ----------------------------------

_UNDO: list[Callable[[], None]] = []


@contextmanager
def tidied(undo: Callable[[], None]) -> Iterator[None]:
    """Call `undo` at the end, whether that is reached or the process is interrupted before.

    Args:
        undo: takes away what is half written; may be called twice.
    """
    _UNDO.append(undo)
    try:
        yield
    finally:
        undo()
        _UNDO.remove(undo)


def tidy() -> None:
    """Undo all that is half written, for a process that ends without going back to it."""
    for undo in reversed(_UNDO):
        undo()
