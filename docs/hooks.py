"""What the site needs beside its pages."""

from pathlib import Path
from typing import Any

import ziamath
from mkdocs.structure.files import File, Files


def on_files(files: Files, config: Any) -> Files:
    """A font for formulas (STIX Two Math): without one of its kind, browsers set MathML badly."""
    font = Path(ziamath.__file__).parent / "fonts" / "STIXTwoMath-Regular.ttf"
    files.append(File.generated(config, "assets/math.ttf", abs_src_path=str(font)))
    return files
