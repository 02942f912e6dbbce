"""`python -m eoi_jax.cli`: the command ``eoi``, where it is not on the path."""

from eoi_jax.cli.main import main

if __name__ == "__main__":
    main()
