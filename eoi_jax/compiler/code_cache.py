"""Machine code on disk, between processes: ``native/`` beside the programs that JAX keeps.

A file holds the code of one loop behind a header: a digest of its name and of the code, and the
length of the code. The name is itself a digest of all that the code depends on (the source, the
processor, the version of LLVM). What does not fit its header, a file that was cut short, garbled,
or another one's, is compiled again and replaced: code that runs is never taken on trust.

The folder is used only where nobody else can write to it, and nothing in it is ever needed: it may
be removed at any time.
"""

import functools
import hashlib
import os
import stat
import warnings
from contextlib import suppress
from pathlib import Path

from eoi_jax._atomic import sweep_up, write_file

_MAGIC = b"eoi_jax machine code 1\n"
_DIGEST = hashlib.sha256().digest_size
_LENGTH = 8  # bytes of the header that hold the length of the code


def read(path: Path) -> bytes | None:
    """The code in a file; None if it is not there, or not what its header says.

    Args:
        path: in a folder of `usable`.
    """
    try:
        content = path.read_bytes()
    except OSError:  # a folder in its place, too
        return None
    head = len(_MAGIC) + _DIGEST + _LENGTH
    code = content[head:]
    return code if content[:head] == _header(path.name, code) else None


def keep(path: Path, code: bytes, max_files: int = 2000) -> None:
    """Write code, whole or not at all; that it cannot be written is no error.

    Args:
        path: in a folder of `usable`.
        code: of one loop.
        max_files: in the folder, of some ten kilobytes each; beyond, the older half goes.
    """

    def fill(draft: Path) -> None:
        draft.write_bytes(_header(path.name, code) + code)

    with suppress(OSError):
        write_file(path, fill)
        _prune(path.parent, max_files)


def _header(name: str, code: bytes) -> bytes:
    digest = hashlib.sha256(name.encode() + b"\0" + code).digest()
    return _MAGIC + digest + len(code).to_bytes(_LENGTH, "little")


@functools.lru_cache(maxsize=16)
def usable(folder: Path) -> bool:
    """Whether code may be kept in a folder, which is made if need be; asked once in a process.

    Warns:
        RuntimeWarning: somebody else owns it or can write to it, or it cannot be made.
    """
    fault = _fault(folder)
    if fault is None:
        sweep_up(folder)
        return True
    warnings.warn(
        f"Compiled code is not kept on disk: {fault}. Every process compiles anew. Let `EOI_CACHE` "
        f"name a folder of your own.",
        RuntimeWarning,
        stacklevel=2,
    )
    return False


def _fault(folder: Path) -> str | None:
    """Why a folder cannot be used; None if it can."""
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.stat()
    except OSError as error:
        return f"{folder} cannot be made ({error.strerror})"
    if not hasattr(os, "geteuid"):  # Windows keeps a user's folders by other means
        return None
    if status.st_uid != os.geteuid():
        return f"{folder} belongs to another user"
    if stat.S_IMODE(status.st_mode) & (stat.S_IWGRP | stat.S_IWOTH):
        return f"others can write to {folder} (`chmod go-w` would end that)"
    return None if os.access(folder, os.W_OK) else f"{folder} cannot be written to"


def _prune(folder: Path, max_files: int) -> None:
    files = list(folder.glob("*.o"))
    if len(files) > max_files:
        files.sort(key=lambda file: file.stat().st_mtime)
        for path in files[: len(files) // 2]:
            path.unlink(missing_ok=True)
