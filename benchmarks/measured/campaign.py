"""Measured sets that were fitted by hand first: what discovery answers with nothing set.

    python benchmarks/measured/campaign.py [--found | --aside] [--only NAME …] [--write]

The sets stand in `campaign_cases.py`, public ones in `found_cases.py`: `--found` runs those that
are not set aside, `--aside` those that are. Discovery sees the estimation records and, as
`validation`, the held-out ones; the untouched ones chose nothing, and count. Needs the folder of
measured records (EOI_DATA, by default ../shared/data beside the repository), or of found sets
(EOI_SETS, by default ../sets); a set that is absent is skipped, and the report says so.
"""

import argparse
import math
import sys
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
import eoi_jax as eoi
from benchmarks.common import Report, data_directory, table
from benchmarks.measured.campaign_cases import RIGS, Errors, Rig
from benchmarks.measured.found_cases import FOUND
from benchmarks.measured.found_sets import sets_directory

_START = 50  # samples that give the initial state, not scored; a third of shorter runs
_SERVED = 1.15  # of the expert's error, geometric mean of whole runs and windows
_CERTAIN = 0.9  # probability from which on an effect counts as certain
_WRONG = 1.1  # of the declared model's error, effects having been added


@dataclass(frozen=True)
class Answer:
    """What a discovery said of a set, with its errors on the part that counts, by output.

    `chances` are the probabilities that were said of the effects.
    """

    rig: Rig
    status: str
    effects: tuple[str, ...]
    before: tuple[Errors, ...]
    after: tuple[Errors, ...]
    seconds: float
    chances: tuple[float | None, ...] = ()

    @property
    def certain(self) -> list[tuple[str, bool]]:
        """Effects of a probability of 0.9 and more; whether the hand fit calls each certain."""
        certain = {name for names in self.rig.added for name in names.split("|")}
        return [
            (name, name in certain)
            for name, chance in zip(self.effects, self.chances, strict=True)
            if chance is not None and chance >= _CERTAIN
        ]

    @property
    def over_expert(self) -> float:
        """Geometric mean over outputs, whole runs and windows; not finite where a run diverges."""
        return _over(self.after, tuple(self.rig.expert.values()))

    @property
    def over_declared(self) -> float:
        return _over(self.after, tuple(self.rig.declared.values()))

    @property
    def verdict(self) -> str:
        if self.effects and not self.over_declared <= _WRONG:
            return "wrong"
        return "served" if self.over_expert <= _SERVED else "not served"


def main() -> None:
    """Every set that is there, one after another."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--found", action="store_true", help="public sets that are not set aside")
    which.add_argument("--aside", action="store_true", help="public sets that are set aside")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="these sets of the list")
    parser.add_argument("--write", action="store_true", help="update the file in results/")
    options = parser.parse_args()
    eoi.configure()
    warnings.simplefilter("ignore", eoi.RecordWarning)
    report = Report("Measured sets fitted by hand first")
    script = Path(__file__)
    if options.found or options.aside:
        script = script.with_stem("campaign_aside" if options.aside else "campaign_found")
        cases = {name: case for name, case in FOUND.items() if case.aside == options.aside}
        rigs = {name: case.rig for name, case in cases.items()}
        sources = {name: case.source for name, case in cases.items()}
        report.add(*_answers(rigs, sets_directory(), "EOI_SETS", options.only, sources))
    else:
        report.add(*_answers(RIGS, data_directory(), "EOI_DATA", options.only))
    report.close(str(script), options.write)


def _answers(
    rigs: Mapping[str, Callable[[Path], Rig]],
    folder: Path,
    variable: str,
    only: Sequence[str] | None,
    sources: Mapping[str, str] | None = None,
) -> list[str]:
    """One set after another; what is absent, and the table of the others."""
    absent, answers = [], {}
    for name in only or rigs:
        place = folder / name.split(",")[0]
        if not place.is_dir():
            source = f" Its source: {sources[name]}." if sources else ""
            absent.append(f"{name} is skipped: no folder {place.name}; set {variable}.{source}")
            continue
        answers[name] = answered(rigs[name](folder))
        print(_line(name, answers[name]), flush=True)
    return [*absent, *_tables(answers)]


def answered(rig: Rig, refine: bool = False) -> Answer:
    """Discover once with nothing set, and score the declared and the final model."""
    started = time.perf_counter()
    found = eoi.discover(rig.plant, rig.estimation, validation=rig.held_out, refine=refine)
    seconds = time.perf_counter() - started
    records = rig.untouched or rig.held_out
    return Answer(
        rig,
        found.status.code,
        tuple(added.effect.name for added in found.added),
        errors(found.declared, records, rig.scale, rig.windows),
        errors(found, records, rig.scale, rig.windows),
        seconds,
        tuple(added.probability for added in found.added),
    )


def errors(
    model: eoi.Identification | eoi.Discovery,
    records: Sequence[eoi.Record],
    scale: float,
    windows: int = 10,
) -> tuple[Errors, ...]:
    """Root mean squares by output: whole free runs; `windows` runs a record."""

    def pooled(runs: int) -> np.ndarray:
        squares, counts = 0.0, 0
        for record in records:
            count = len(record) // runs
            window = count * record.sample_period if runs > 1 else np.inf
            step = float(np.max(record.output_periods)) / record.sample_period
            head = round(step * min(_START, int(count / step) // 3))
            run = eoi.validate(model, record, initial_samples=head, window=window)
            squares = squares + np.asarray(run.rmse) ** 2 * run.scored
            counts += run.scored
        return scale * np.sqrt(squares / counts)

    return tuple(zip(pooled(1).tolist(), pooled(windows).tolist(), strict=True))


def _over(reached: Sequence[Errors], best: Sequence[Errors]) -> float:
    ratios = np.asarray(reached) / np.asarray(best)
    return float(np.exp(np.mean(np.log(ratios)))) if np.all(np.isfinite(ratios)) else math.inf


def _shown(pairs: Sequence[Errors]) -> str:
    return "; ".join(" / ".join(f"{value:.3g}" for value in pair) for pair in pairs)


def _line(name: str, answer: Answer) -> str:
    return (
        f"{name}: {answer.status}, {'+'.join(_sure(answer)) or '-'}, {_shown(answer.before)} -> "
        f"{_shown(answer.after)} {answer.rig.unit} "
        f"(expert {_shown(tuple(answer.rig.expert.values()))}), "
        f"{answer.over_expert:.2f}, {answer.verdict}, {answer.seconds:.1f} s"
    )


def _tables(answers: dict[str, Answer]) -> list[str]:
    rows = [
        [
            f"{name} [{answer.rig.unit}]",
            answer.status,
            ", ".join(_sure(answer)) or "–",
            ", ".join(answer.rig.added) or "–",
            _shown(tuple(answer.rig.declared.values())),
            _shown(answer.before),
            _shown(answer.after),
            _shown(tuple(answer.rig.expert.values())),
            f"{answer.over_expert:.2f}",
            answer.verdict,
            f"{answer.seconds:.1f}",
        ]
        for name, answer in answers.items()
    ]
    head = ["set", "status", "added, probability [%]", "certain, by hand", "declared, by hand",
            "before", "after", "expert", "after over expert", "verdict", "s"]  # fmt: skip
    counts = {
        word: sum(answer.verdict == word for answer in answers.values())
        for word in ("served", "not served", "wrong")
    }
    legend = (
        "Errors: whole free run / windows, on the untouched part (held-out where there is none). "
        f"*Served*: at most {_SERVED} of the expert's, geometric mean; *wrong*: effects added and "
        f"more than {_WRONG} of the declared model's."
    )
    return [
        legend,
        ", ".join(f"{word}: {count}" for word, count in counts.items()) + f", of {len(answers)}.",
        _calibration(answers),
        table(head, rows),
    ]


def _sure(answer: Answer) -> list[str]:
    """Effects with their probabilities."""
    return [
        name if chance is None else f"{name} {100 * chance:.3g}"
        for name, chance in zip(answer.effects, answer.chances, strict=True)
    ]


def _calibration(answers: Mapping[str, Answer]) -> str:
    """How many of the effects that were said to be certain the hand fits call certain too."""
    said = [(name, pair) for name, answer in answers.items() for pair in answer.certain]
    agreed = sum(right for _, (_, right) in said)
    others = ", ".join(f"{effect} ({name})" for name, (effect, right) in said if not right)
    text = f"Effects of a probability of {_CERTAIN} and more: {len(said)}, of which the hand fits "
    return text + f"call {agreed} certain" + (f"; not {others}." if others else ".")


if __name__ == "__main__":
    main()
