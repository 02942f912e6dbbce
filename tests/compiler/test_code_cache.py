"""Machine code on disk is believed only if it is what it says; no damage reaches a processor."""

import os
import subprocess
import sys

import pytest

from eoi_jax.compiler import code_cache

RUN = """
import sys, warnings
import numpy as np
import eoi_jax as eoi
from eoi_jax.compiler import jit as compiled
eoi.configure()
made = []
translate = compiled._compile
compiled._compile = lambda *given: made.append(1) or translate(*given)

def oscillator(t, x, u, p):
    position, rate = x.y
    return -p.a * position - p.b * rate + u

plant = eoi.Plant(oscillator, {"a": 20.0, "b": 1.0}, relative_degree=2)
time = 0.01 * np.arange(500)
record = eoi.simulate(plant.with_parameters({"a": 25.0, "b": 1.5}), time, np.sign(np.sin(3 * time)))
found = eoi.refine(eoi.identify(plant, record), record)
print(len(made), found.engine.name, *(value.hex() for value in found.parameters.values()))
"""


def run(folder):
    """Files compiled, engine, estimates to the last digit; and what was said."""
    done = subprocess.run(
        [sys.executable, "-c", RUN], capture_output=True, text=True, timeout=300, check=False,
        env=os.environ | {"EOI_CACHE": str(folder), "JAX_PLATFORMS": "cpu"},
    )  # fmt: skip
    assert done.returncode == 0, (done.returncode, done.stderr)
    made, *answer = done.stdout.split()
    return int(made), answer, done.stderr


@pytest.mark.slow
@pytest.mark.long
def test_damaged_files_are_compiled_again_and_replaced(tmp_path):
    fresh, answer, _ = run(tmp_path)
    files = sorted((tmp_path / "native").glob("*.o"))
    assert fresh == len(files) == 3
    whole = {path: path.read_bytes() for path in files}
    first, second, _ = files
    flipped = bytearray(whole[first])
    flipped[len(flipped) // 2] ^= 4
    # All kinds on the first file, one run each; the second one is swapped for the first at the end.
    damages = [b"", whole[first][: len(whole[first]) // 2], bytes(flipped), b"\x7fELF" + b"?" * 900]
    for damage in damages:
        first.write_bytes(damage)
        made, again, _ = run(tmp_path)
        assert (made, again) == (1, answer)
        assert first.read_bytes()[:40] == whole[first][:40]
    first.write_bytes(whole[second])
    second.unlink()
    second.mkdir()
    made, again, _ = run(tmp_path)
    assert (made, again) == (2, answer)
    assert code_cache.read(first) is not None
    assert run(tmp_path)[0] == 1  # the folder in its place stays, and is no harm


def test_what_is_kept_is_read_again(tmp_path):
    path = tmp_path / "native" / "name.o"
    assert code_cache.usable(path.parent)
    code_cache.keep(path, b"code")
    assert code_cache.read(path) == b"code"
    path.rename(path.with_name("other.o"))
    assert code_cache.read(path.with_name("other.o")) is None
    assert code_cache.read(path) is None
    assert [one.name for one in path.parent.iterdir()] == ["other.o"]


@pytest.mark.parametrize("mode", [0o770, 0o707, 0o1777])
def test_a_folder_that_others_can_write_to_is_not_used(tmp_path, mode):
    folder = tmp_path / "native"
    folder.mkdir()
    folder.chmod(mode)
    with pytest.warns(RuntimeWarning, match=r"not kept on disk: others can write.*`EOI_CACHE`"):
        assert not code_cache.usable(folder)


def test_a_folder_of_somebody_else_is_not_used(tmp_path, monkeypatch):
    (tmp_path / "native").mkdir(mode=0o700)
    monkeypatch.setattr(os, "geteuid", lambda: 4711)
    with pytest.warns(RuntimeWarning, match="belongs to another user"):
        assert not code_cache.usable(tmp_path / "native")


def test_a_folder_that_cannot_be_made_is_not_used(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.warns(RuntimeWarning, match=r"cannot be made .*Every process compiles anew"):
        assert not code_cache.usable(tmp_path / "file" / "native")
    with pytest.warns(RuntimeWarning, match="cannot be made"):
        assert not code_cache.usable(tmp_path / "file")


def test_a_new_folder_is_its_owners_alone(tmp_path):
    assert code_cache.usable(tmp_path / "cache" / "native")
    assert (tmp_path / "cache" / "native").stat().st_mode & 0o077 == 0


def test_the_folder_does_not_grow_without_end(tmp_path):
    for i in range(20):
        path = tmp_path / f"{i}.o"
        code_cache.keep(path, bytes([i]), max_files=6)
        os.utime(path, (i, i))
    left = {int(path.stem) for path in tmp_path.glob("*.o")}
    assert len(left) <= 6
    assert 19 in left
    assert 0 not in left
