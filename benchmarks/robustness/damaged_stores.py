"""Stores of sweeps, damaged in every way and killed at random moments: is a later sweep the same?

python benchmarks/robustness/damaged_stores.py [--quick] [--write]
"""

import atexit
import functools
import random
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
import eoi_jax as eoi
from benchmarks.common import ROOT, Report, arguments, table
from eoi_jax.estimation.observers import SecondOrder, gains

LANES = ("parameters", "standard_error", "index", "common_index", "sliding_fraction", "status",
         "blocks", "best_pass", "passes")  # fmt: skip
CHUNKS = 4
KILLS = 20
PLANT = eoi.plants.mass_spring_damper()


def swept(store: Path | None, chunks: int = CHUNKS, strongest: float = 2.0) -> Any:
    """A small sweep of two lanes a chunk, up to the strongest injection."""
    t = 4e-3 * np.arange(1000)
    u = np.sign(np.sin(2.0 * t) + 0.3 * np.sin(5.1 * t))
    y = 0.02 * np.sin(2.0 * t) + 0.01 * np.sin(5.1 * t + 0.4)
    data = eoi.Record(t, u, y, "rig", hold="smooth")
    sets = gains(
        SecondOrder,
        {"c1": 60.0, "c2": 2e3, "c3": np.linspace(0.5 * strongest, strongest, 2 * chunks)},
    )
    return eoi.sweep(PLANT, data, sets, eoi.LowPass(20.0), passes=2, substeps=1,
                     smoothing=False, transient=0.5, chunk=2, store=store)  # fmt: skip


# -- damage -----------------------------------------------------------------------------------

Damage = Callable[[Path, Path, random.Random], object]  # of a store, with another sweep's at hand


def chunk_of(store: Path, name: str, rng: random.Random) -> Path:
    """The file of one of the chunks of an array."""
    files = sorted(one for one in (store / name / "c").rglob("*") if one.is_file())
    return rng.choice(files)


def missing(file: Path, _other: Path, _rng: random.Random) -> None:
    """It is gone."""
    file.unlink()


def empty(file: Path, _other: Path, _rng: random.Random) -> None:
    """It has no bytes."""
    file.write_bytes(b"")


def truncated(file: Path, _other: Path, rng: random.Random) -> None:
    """Its end is lost."""
    file.write_bytes(file.read_bytes()[: rng.randrange(file.stat().st_size)])


def flipped(file: Path, _other: Path, rng: random.Random) -> None:
    """One bit is the other."""
    content = bytearray(file.read_bytes())
    content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    file.write_bytes(content)


def garbled(file: Path, _other: Path, rng: random.Random) -> None:
    """Any bytes of the same number."""
    file.write_bytes(rng.randbytes(file.stat().st_size))


def exchanged(file: Path, other: Path, _rng: random.Random) -> None:
    """The file of another sweep, whole as it is."""
    shutil.copyfile(other, file)


def folder_instead(file: Path, _other: Path, _rng: random.Random) -> None:
    """A folder in its place."""
    file.unlink()
    (file / "inside").mkdir(parents=True)


FILES = (missing, empty, truncated, flipped, garbled, exchanged, folder_instead)


def damages() -> Iterator[tuple[str, Damage]]:
    """Every kind by name."""
    for name in (*LANES, "done", "theta_0"):
        for change in FILES:

            def chunk(store: Path, other: Path, rng: random.Random, name=name, change=change):
                file = chunk_of(store, name, rng)
                change(file, other / file.relative_to(store), rng)

            yield f"chunk of `{name}` {change.__name__}", chunk
    for name in (".", "done", "parameters", "status", "theta_0"):
        for change in FILES:

            def metadata(store: Path, other: Path, rng: random.Random, name=name, change=change):
                change(store / name / "zarr.json", other / name / "zarr.json", rng)

            yield f"metadata of `{name}` {change.__name__}", metadata
    yield from WHOLE.items()


def emptied(store: Path, _other: Path, _rng: random.Random) -> None:
    """The attributes of the group."""
    import zarr

    zarr.open_group(str(store), mode="r+").attrs.clear()


def short(store: Path, _other: Path, _rng: random.Random) -> None:
    """Marks of fewer chunks than there are."""
    import zarr

    root: Any = zarr.open_group(str(store), mode="r+")
    root["done"].resize((1, 1, CHUNKS - 1, 1, 1))


def swapped(store: Path, _other: Path, rng: random.Random) -> None:
    """Two chunks of one array."""
    files = sorted(one for one in (store / "parameters" / "c").rglob("*") if one.is_file())
    a, b = rng.sample(files, 2)
    first, second = a.read_bytes(), b.read_bytes()
    a.write_bytes(second)
    b.write_bytes(first)


def file_for_array(store: Path, _other: Path, _rng: random.Random) -> None:
    """A file in the place of an array's folder."""
    shutil.rmtree(store / "index")
    (store / "index").write_text("notes")


def file_for_chunks(store: Path, _other: Path, _rng: random.Random) -> None:
    """A file in the place of the folder of an array's chunks."""
    shutil.rmtree(store / "status" / "c")
    (store / "status" / "c").write_text("notes")


def leftovers(store: Path, _other: Path, rng: random.Random) -> None:
    """What a killed process leaves: the beginning of a file, without the mark."""
    mark = chunk_of(store, "done", rng)
    mark.with_suffix(f".{rng.randbytes(16).hex()}.partial").write_bytes(b"begun")
    mark.unlink()


WHOLE: dict[str, Damage] = {
    "attributes emptied": emptied,
    "`done` too short": short,
    "two chunks exchanged": swapped,
    "file in place of an array": file_for_array,
    "file in place of all chunks": file_for_chunks,
    "leftovers of a killed process": leftovers,
    "folder of `done` missing": lambda store, *_: shutil.rmtree(store / "done"),
    "folder of `parameters` missing": lambda store, *_: shutil.rmtree(store / "parameters"),
    "all arrays missing": lambda store, *_: [shutil.rmtree(store / one) for one in LANES],
    "all metadata missing": lambda store, *_: [one.unlink() for one in store.rglob("zarr.json")],
    "whole other sweep": lambda store, other, _: (
        shutil.rmtree(store),
        shutil.copytree(other, store),
    ),
    "empty folder": lambda store, *_: (shutil.rmtree(store), store.mkdir()),
    "file in place of the store": lambda store, *_: (shutil.rmtree(store), store.write_text("")),
}


# -- what comes of it -------------------------------------------------------------------------


def alike(one: Any, other: Any) -> bool:
    """Two sweeps, number by number."""
    return all(np.array_equal(one[key], other[key], equal_nan=True) for key in other.data_vars)


def files(folder: Path) -> set[Path]:
    """What is in a folder, by name."""
    return {one.relative_to(folder) for one in folder.rglob("*")}


@functools.cache
def stores() -> Path:
    """A folder with two sound stores, of sweeps that differ in their gains."""
    folder = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    swept(folder / "a")
    swept(folder / "b", strongest=1.5)
    return folder


def outcome(name: str, seed: int) -> str:
    """What a damaged store gives to who reads it, and to a sweep that goes on from it.

    Returns:
        ``"computed again"``, ``"written anew"``, ``"refused"``, ``"nothing to do"``, or what is
        wrong, beginning with ``"WRONG"``.
    """
    with tempfile.TemporaryDirectory() as place:
        store, other = Path(place) / "a" / "store", Path(place) / "b" / "store"
        sound = stores()
        shutil.copytree(sound / "a", store)
        shutil.copytree(sound / "b", other)
        wholes = [eoi.open_sweep(sound / one).load() for one in ("a", "b")]
        before = files(store.parent)
        dict(damages())[name](store, other, random.Random(seed))
        try:
            return judged(store, wholes, before)
        except Exception as error:  # a traceback: what this looks for
            return f"WRONG: {type(error).__name__}: {error}"


def judged(store: Path, wholes: list[Any], before: set[Path]) -> str:
    """The same of a store that is damaged already; `wholes`: its sweep, and the other."""
    whole = wholes[0]
    with warnings.catch_warnings(record=True):
        warnings.simplefilter("always")
        try:
            read = eoi.open_sweep(store).load()
        except ValueError as error:
            if not str(error).startswith("`store` must"):
                raise
        else:
            own = [one for one in wholes if one.attrs["sweep"] == read.attrs["sweep"]]
            known = read["status"] != 0
            if read.sizes == whole.sizes and not (
                own and alike(read.where(known), own[0].where(known))
            ):
                return "WRONG: numbers that are none of the sweep's that it says it is"
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            again = swept(store).load()
        except ValueError as error:
            if not str(error).startswith("`store` must"):
                raise
            return "refused"
    words = " ".join(str(one.message) for one in said)
    if not alike(again, whole):
        return "WRONG: other numbers after the resume"
    if files(store.parent) != before:
        return f"WRONG: files {files(store.parent) ^ before}"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        if not alike(swept(store).load(), whole):
            return "WRONG: other numbers after a second resume"
    found = [one for one in ("computed again", "written anew") if one in words]
    return " and ".join(found) or "nothing said"


def killed(seed: int) -> str:
    """A sweep that is killed at a random moment, and the next one."""
    with tempfile.TemporaryDirectory() as place:
        store, clean = Path(place) / "a" / "store", Path(place) / "b" / "store"
        code = (
            f"import sys; sys.path.insert(0, {str(ROOT)!r}); from pathlib import Path;"
            " from benchmarks.robustness import damaged_stores as campaign;"
            " campaign.eoi.configure(); campaign.swept(None, 1);"
            f" print('ready', flush=True); campaign.swept(Path({str(store)!r}), 12)"
        )
        process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(random.Random(seed).uniform(0.0, 1.5))
        process.kill()
        process.communicate()
        marks = len([one for one in store.glob("done/c/**/*") if one.is_file()])
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # a kill is no damage
            again = swept(store, 12).load()
        if not alike(again, swept(clean, 12).load()):
            return "WRONG: other numbers"
        if files(store.parent) != files(clean.parent):
            return f"WRONG: left {files(store.parent) ^ files(clean.parent)}"
        return "before the first chunk" if marks == 0 else "amid" if marks < 12 else "at the end"


def set_up() -> None:
    """Of a worker."""
    eoi.configure()


def in_worker(function: Callable[..., str], *iterables: Any) -> Iterator[str]:
    """Results of calls in a process that a signal may end; it is then started anew."""
    calls = list(zip(*iterables, strict=True))
    while calls:
        with ProcessPoolExecutor(1, get_context("spawn"), initializer=set_up) as pool:
            while calls:
                try:
                    yield pool.submit(function, *calls.pop(0)).result()
                except BrokenProcessPool:
                    yield "WRONG: ended by a signal"
                    break


def main() -> None:
    """The whole campaign."""
    options = arguments(__doc__)
    report = Report("Stores of sweeps that are damaged or killed")
    names = [name for name, _ in damages()][:: 12 if options.quick else 1]
    seeds = list(range(len(names)))
    with ThreadPoolExecutor(2) as threads:
        first = threads.submit(list, in_worker(outcome, names, seeds))
        second = threads.submit(list, in_worker(killed, range(2 if options.quick else KILLS)))
        kills = second.result()
        found = dict(zip(names, first.result(), strict=True))
    wrong = {name: one for name, one in found.items() if one.startswith("WRONG")}
    report.add(
        f"{len(found)} kinds of damage, each on a store of {CHUNKS} chunks. Each is read, the sweep"
        " goes on from it, and once more: same numbers, same files, and nothing left to say.",
        f"**{len(wrong)} wrong.**",
        table(["damage", "what came of it"], list(found.items())),
    )
    rows = [(one, kills.count(one)) for one in sorted(set(kills))]
    report.add(
        f"{len(kills)} sweeps of 12 chunks ended by SIGKILL at a random moment of 1.5 s; then the"
        " same sweep again: same numbers and no other files than of one that was never killed.",
        table(["killed", "times"], rows),
    )
    report.close(__file__, options.write)
    sys.exit(bool(wrong) or any(one.startswith("WRONG") for one in kills))


if __name__ == "__main__":
    main()
