"""Which version is installed; a module of its own, since to look it up takes long."""

from importlib.metadata import version


def installed() -> str:
    """The version of the installed package."""
    return version("eoi_jax")
