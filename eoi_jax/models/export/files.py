"""Writing of an exported file: complete or not at all, with a sentence where it cannot be."""

from pathlib import Path

from eoi_jax._atomic import write_file
from eoi_jax._checks import check

_MARK, _HEAD = b"eoi_jax", 4000  # what the first bytes of generated code say


def write_content(path: Path, content: bytes) -> None:
    """Write a file, or replace it; generated code does not replace a file of somebody else.

    Args:
        path: of the file.
        content: its bytes.

    Raises:
        ValueError: a folder that does not exist or cannot be written, or code in place of a file
            that does not say that it was written here.
    """
    if _MARK in content[:_HEAD] and path.is_file():
        with path.open("rb") as file:
            is_generated = _MARK in file.read(_HEAD)
        rule = "must not be a file that eoi_jax did not write"
        check(is_generated, "path", rule, path, "Give another name, or remove it.")

    def fill(draft: Path) -> None:
        draft.write_bytes(content)

    try:
        write_file(path, fill)
    except OSError as error:
        check(False, "path", f"must be writable ({error.strerror})", path)
