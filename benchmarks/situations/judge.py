"""Runs a situation through the command and says whether its answer is right."""

import json
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path

import numpy as np

from benchmarks.situations.situation import Situation

ROOT = Path(__file__).resolve().parents[2]
SEED = 32
COMMAND = "from eoi_jax.cli.main import main; main()"
# A sentence that names parameters also says with one of these what is the matter with them.
_INSEPARABLE = re.compile(
    r"factor|ratio|told apart|separat|combination|identifiab|confounded|correlat|together|common",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class Answer:
    """What the command did: exit status, JSON object, text on stderr, time."""

    status: int | None  # None: stopped because it took too long
    summary: dict
    errors: str
    seconds: float  # of the processor


@dataclass(frozen=True)
class Verdict:
    """Whether a situation was served; what was got, and why it is not enough."""

    served: bool
    answer: str
    reason: str = ""


def run(situation: Situation, folder: Path) -> Answer:
    """Write the files of the situation into the folder and run the command there."""
    for name, text in situation.files(np.random.default_rng(SEED)).items():
        (folder / name).write_text(text, encoding="utf-8")
    (folder / "run.toml").write_text(
        f'name = "{situation.name}"\n' + situation.config, encoding="utf-8"
    )
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    started = time.perf_counter()
    try:
        process = subprocess.run(
            [sys.executable, "-c", COMMAND, situation.command, "run.toml", "--json"],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": path},
            capture_output=True,
            text=True,
            timeout=6 * situation.seconds,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return Answer(None, {}, "", time.perf_counter() - started)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    try:
        summary = json.loads(process.stdout)
    except json.JSONDecodeError:
        summary = {}
    return Answer(process.returncode, summary, process.stderr, used)


def trial(situation: Situation) -> tuple[Answer, Verdict]:
    """The answer to a situation in a folder of its own, and the verdict."""
    with tempfile.TemporaryDirectory() as folder:
        answer = run(situation, Path(folder))
    return answer, judged(situation, answer)


def judged(situation: Situation, answer: Answer) -> Verdict:
    """Whether the answer is what a careful expert would give."""
    if answer.status is None:
        return Verdict(False, "–", f"too slow: stopped after {answer.seconds:.0f} s")
    if "Traceback" in answer.errors or not answer.summary:
        return Verdict(False, "–", f"traceback: {_last_line(answer.errors)}")
    if situation.refusal:
        return _refusal(situation, answer)
    if answer.status != 0 and not (situation.inseparable and _says(situation, answer.summary)):
        return Verdict(False, "–", f"no answer: {_message(answer.summary)[:110]}")
    faults = [
        fault
        for check in (_values, _effects, _sentence, _held_out, _time)
        if (fault := check(situation, answer))
    ]
    return Verdict(not faults, _answer_text(situation, answer.summary), "; ".join(faults))


def question(situation: Situation) -> str:
    """What a right answer has, in a few words."""
    parts = [f"{name} {value:.4g}" for name, value in situation.truth.items()]
    if situation.effects is not None:
        parts.append(", ".join("/".join(names) for names in situation.effects) or "no effect")
    if situation.inseparable:
        parts.append(f"says that {', '.join(situation.inseparable)} are not separable")
    if situation.refusal:
        parts.append("a message with " + ", ".join(situation.refusal))
    parts += [f"held out ≤ {bound:g} noise" for bound in situation.held_out.values()]
    return "; ".join(parts)


# -- one question each ------------------------------------------------------------------------


def _values(situation: Situation, answer: Answer) -> str:
    """Parameters that are not finite, or too far from the truth."""
    parameters = answer.summary.get("parameters") or {}
    if not situation.truth:
        return ""
    faults = []
    for name, right in situation.truth.items():
        value = evaluated(name, parameters)
        if value is None or not np.isfinite(value):
            faults.append(f"{name} is not a number")
        elif abs(value - right) > situation.tolerance * abs(right):
            faults.append(f"{name} is {100 * (value / right - 1):+.3g} % off")
    return "wrong value: " + ", ".join(faults) if faults else ""


def evaluated(expression: str, parameters: Mapping[str, float | None]) -> float | None:
    """Value of a product or quotient of parameters such as ``"k/m"``; None where one lacks."""
    value = 1.0
    for sign, name in re.findall(r"(^|[*/])\s*(\w+)", expression):
        factor = parameters.get(name)
        if factor is None or (sign == "/" and factor == 0):
            return None
        value = value / factor if sign == "/" else value * factor
    return value


def _effects(situation: Situation, answer: Answer) -> str:
    if situation.effects is None:
        return ""
    named = tuple(answer.summary.get("effects") or ())
    matches = len(named) == len(situation.effects) and any(
        all(name in names for name, names in zip(order, situation.effects, strict=True))
        for order in permutations(named)
    )
    return "" if matches else f"wrong effect: {', '.join(named) or 'none'}"


def _sentence(situation: Situation, answer: Answer) -> str:
    if not situation.inseparable or _says(situation, answer.summary):
        return ""
    return f"does not say that {', '.join(situation.inseparable)} cannot be told apart"


def _held_out(situation: Situation, answer: Answer) -> str:
    faults = []
    errors = _held_out_errors(answer.summary)
    for output, bound in situation.held_out.items():
        error = errors.get(output)
        ratio = None if error is None else error / situation.level(output)
        if ratio is None or not ratio <= bound:
            text = "not finite" if ratio is None else f"{ratio:.3g} × noise"
            faults.append(f"held-out error of {output}: {text}")
    return ", ".join(faults)


def _time(situation: Situation, answer: Answer) -> str:
    return f"too slow: {answer.seconds:.0f} s" if answer.seconds > situation.seconds else ""


def _refusal(situation: Situation, answer: Answer) -> Verdict:
    text = _message(answer.summary)
    missing = [piece for piece in situation.refusal if piece.lower() not in text.lower()]
    if answer.status == 0 or missing:
        return Verdict(False, text[:80], f"not refused with {', '.join(missing) or 'a message'}")
    return Verdict(True, text[:80])


# -- reading the JSON object ------------------------------------------------------------------


def _says(situation: Situation, summary: Mapping) -> bool:
    """Whether one sentence on what is unclear names the parameters."""
    sentences = [_message(summary), *(summary.get("unclear") or ())]
    for key in ("notes", "findings"):
        sentences += summary.get(key) or ()
    return any(
        _INSEPARABLE.search(sentence)
        and all(re.search(rf"\b{name}\b", sentence) for name in situation.inseparable)
        for sentence in sentences
    )


def _held_out_errors(summary: Mapping) -> Mapping[str, float | None]:
    runs = summary.get("validation") or {}
    run = summary.get("after") or runs.get("refined") or runs
    return (run or {}).get("rmse") or {}


def _message(summary: Mapping) -> str:
    status = summary.get("status") or {}
    return str(summary.get("error") or status.get("message") or summary.get("answer") or "")


def _answer_text(situation: Situation, summary: Mapping) -> str:
    parameters = summary.get("parameters") or {}
    parts = []
    for name in situation.truth:
        value = evaluated(name, parameters)
        parts.append(f"{name} –" if value is None else f"{name} {value:.4g}")
    if situation.effects is not None:
        parts.append(", ".join(summary.get("effects") or ()) or "no effect")
    return "; ".join(parts) or _message(summary)[:80]


def _last_line(text: str) -> str:
    lines = [line for line in text.strip().splitlines() if line.strip()]
    return lines[-1][:120] if lines else "no output"
