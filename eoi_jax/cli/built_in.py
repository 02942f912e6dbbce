"""Built-in configs, which go by their names; without imports that completion would wait for."""

from pathlib import Path


def built_in(name: str) -> Path:
    """The file of a built-in config.

    Args:
        name: of the config.
    """
    return _folder() / f"{name}.toml"


def built_in_names() -> list[str]:
    """Names of the built-in configs."""
    return sorted(path.stem for path in _folder().glob("*.toml"))


def _folder() -> Path:
    """Inside an installed package; beside the package in a source tree."""
    package = Path(__file__).parents[1]
    folders = [package / "configs", package.parent / "configs"]
    return next((folder for folder in folders if folder.is_dir()), folders[0])
