"""The installed version; a separate module because `importlib.metadata` is slow to import."""

from importlib.metadata import version


def installed() -> str:
    """The version of the installed package."""
    return version("eoi_jax")
