"""How much a file may unpack to: a small one can hold gigabytes of zeros, or say that it does."""

from pathlib import Path
from zipfile import ZipFile

from eoi_jax._checks import check_positive
from eoi_jax.data.resampling import Real

MAX_GIGABYTES = 4.0
_GIGABYTE = 1e9


class Allowance:
    """The bytes that a file may still unpack to.

    Args:
        gigabytes: in all, of 1e9 bytes; infinite for no limit.

    Raises:
        ValueError: no positive number.
    """

    def __init__(self, gigabytes: Real = MAX_GIGABYTES):
        if gigabytes != float("inf"):
            check_positive("max_gigabytes", gigabytes)
        self._limit = float(gigabytes)
        self._left = float(gigabytes) * _GIGABYTE

    @property
    def left(self) -> float:
        """Bytes that are left, possibly infinite."""
        return self._left

    def take(self, size: Real) -> None:
        """Count what is about to be unpacked.

        Args:
            size: in bytes.

        Raises:
            ValueError: it is more than what is left.
        """
        self._left -= float(size)
        if self._left < 0:
            raise ValueError(
                f"it unpacks to more than {self._limit:g} GB; if that is right, "
                "give a larger `max_gigabytes`"
            )

    def take_archive(self, path: Path) -> None:
        """Count what a zip archive says that it unpacks to; reading it never gives more.

        Args:
            path: of the archive.

        Raises:
            ValueError: it is more than what is left.
        """
        with ZipFile(path) as archive:
            for member in archive.infolist():
                self.take(member.file_size)
