"""Writing of an exported file: complete or not at all, with a sentence where it cannot be."""

from pathlib import Path

from eoi_jax._atomic import write_file
from eoi_jax._checks import check


def write_content(path: Path, content: bytes, mark: bytes = b"eoi_jax", head: int = 4000) -> None:
    """Write a file, or replace it, but no file of somebody else by one that has a mark.

    Args:
        path: of the file.
        content: its bytes.
        mark: in such files that were written here.
        head: bytes at the start in which it stands.

    Raises:
        ValueError: a folder that does not exist or cannot be written, or content with the mark in
            place of a file without it.
    """
    if mark in content[:head] and path.is_file():
        with path.open("rb") as file:
            is_generated = mark in file.read(head)
        rule = "must not be a file that eoi_jax did not write"
        check(is_generated, "path", rule, path, "Give another name, or remove it.")

    def fill(draft: Path) -> None:
        draft.write_bytes(content)

    try:
        write_file(path, fill)
    except OSError as error:
        check(False, "path", f"must be writable ({error.strerror})", path)
