"""The command ``eoi``: what may be asked, and how the answer is shown.

A package of its own, for importing any part of `eoi_jax` imports JAX, and neither help nor a shell
that completes a word should wait for that. What a command does is in `eoi_jax.cli`.
"""

import sys

_INTERRUPTED = 130


def main() -> None:
    """The entry point of the ``eoi`` command."""
    try:
        from eoi_command.commands import app

        app(prog_name="eoi")
    except KeyboardInterrupt:  # before a command has begun
        sys.stderr.write("eoi: interrupted; nothing half-written is left\n")
        sys.exit(_INTERRUPTED)
