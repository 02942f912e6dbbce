"""Writing of an exported file: complete or not at all, with a sentence where it cannot be."""

from pathlib import Path

from eoi_jax._atomic import write_file
from eoi_jax._checks import check


def write_content(path: Path, content: bytes) -> None:
    """Write a file, or replace it.

    Args:
        path: of the file.
        content: its bytes.

    Raises:
        ValueError: a folder that does not exist or cannot be written.
    """

    def fill(draft: Path) -> None:
        draft.write_bytes(content)

    try:
        write_file(path, fill)
    except OSError as error:
        check(False, "path", f"must be writable ({error.strerror})", path)
