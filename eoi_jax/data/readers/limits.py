"""Limit on the unpacked size of a file: a small file may hold, or declare, gigabytes of zeros."""

from pathlib import Path
from zipfile import ZipFile

from eoi_jax._checks import check_positive
from eoi_jax.data.resampling import Real

MAX_GIGABYTES = 4.0  # [1e9 bytes], largest unpacked size of a file
PIECE = 1 << 20  # bytes that are unpacked at a time, to be counted


class Allowance:
    """The bytes that a file may still unpack to.

    Args:
        gigabytes: limit [1e9 bytes]; infinite for no limit.

    Raises:
        ValueError: a limit that is not positive.
    """

    def __init__(self, gigabytes: Real = MAX_GIGABYTES):
        if gigabytes != float("inf"):
            check_positive("max_gigabytes", gigabytes)
        self._limit = float(gigabytes)
        self._remaining = 1e9 * self._limit

    def take(self, size: Real) -> None:
        """Count bytes that are about to be unpacked.

        Args:
            size: in bytes.

        Raises:
            ValueError: more bytes than remain.
        """
        self._remaining -= float(size)
        if self._remaining < 0:
            raise ValueError(
                f"it unpacks to more than {self._limit:g} GB; if that is right, "
                "give a larger `max_gigabytes`"
            )

    def take_archive(self, path: Path) -> None:
        """Count the declared unpacked size of a zip archive; reading never gives more.

        Args:
            path: of the archive.

        Raises:
            ValueError: more bytes than remain.
        """
        with ZipFile(path) as archive:
            for member in archive.infolist():
                self.take(member.file_size)
