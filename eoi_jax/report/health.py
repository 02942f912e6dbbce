"""Health checks of an estimate, each with its finding and advice: no numerical work."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from eoi_jax.discovery.diagnosis import Diagnosis
from eoi_jax.report import diagnosis as sentences
from eoi_jax.report.tables import quantity


@dataclass(frozen=True)
class Check:
    """One health check.

    Attributes:
        name: its subject.
        state: ``"good"``; ``"note"``, a finding that the answer accounts for; ``"attention"``.
        finding: sentences.
        advice: what to do next; "" if nothing.
    """

    name: str
    state: str
    finding: str
    advice: str

    @property
    def good(self) -> bool:
        """Whether there is no finding."""
        return self.state == "good"


@dataclass(frozen=True)
class _CheckRule:
    """The subject of a check, the functions that find problems, and the advice for them."""

    name: str
    finders: tuple[Callable[[Diagnosis], Iterable[str]], ...]
    advice: str


_EXCITATION = _CheckRule(
    "Excitation",
    (sentences.confounding, sentences.windows),
    "Record a motion with more frequencies and amplitudes, or fix a parameter that is known.",
)
_SLIDING = _CheckRule(
    "Sliding",
    (sentences.sliding,),
    "Give the observer larger gains in [observer], or omit that table: the gains are then chosen "
    "from the records.",
)
_RESIDUAL = _CheckRule(
    "Residual",
    (sentences.residual, sentences.colour),
    "Run `eoi discover` on these records: it identifies what the model lacks.",
)
_NOISE = _CheckRule(
    "Noise",
    (sentences.lines, sentences.quantisation),
    "Use a finer sensor, shield it from hum, or record a slower and larger motion; a cut-off of "
    "the low-pass filter below a spectral line removes it.",
)
_SATURATION = _CheckRule(
    "Saturation",
    (sentences.saturation,),
    "Mask the samples of an output at the limit, or put the limit into the model. An input at its "
    "limit stays as it is, unless its sensor ends there; an actuator that ends below its command "
    "is the effect `input_saturation`.",
)
_TIMING = _CheckRule(
    "Delay and feedback",
    (sentences.delays, sentences.feedback),
    "Check the time stamps and how the input is held between samples (`hold`), or let "
    "`eoi discover` try `input_delay` and `actuator_lag`. Under feedback compare with "
    "`eoi refine`, whose simulated regressors contain no noise.",
)
_RULES = (_EXCITATION, _SLIDING, _RESIDUAL, _NOISE, _SATURATION, _TIMING)


@dataclass(frozen=True)
class _Verdict:
    """What the answer of a discovery says about a residual that is more than white noise."""

    state: str
    finding: str
    advice: str = ""


_VERDICTS = {
    "complete": _Verdict(
        "note",
        "The answer stands: the added effects explain {:.3g} % of what the declared model left. "
        "This is about the rest.",
        "Compare the free-run error with the noise of the sensor: at its level the rest does not "
        "matter.",
    ),
    "nothing_missing": _Verdict(
        "note",
        "The answer stands: what exceeds the noise is too small a share of the signal to matter, "
        "or does not show in free runs.",
    ),
    "partial": _Verdict(
        "attention",
        "As the answer says, more than noise is left after the added effects.",
        "The maps of the residual show what the rest depends on; they may suggest a term of your "
        "own.",
    ),
    "unexplained": _Verdict(
        "attention",
        "As the answer says, none of the tested effects explains this.",
        "The maps of the residual may suggest a term of your own; `eoi refine` fits the free run "
        "itself.",
    ),
}
_TIMING_AFTER_SEARCH = (
    "Check the time stamps and how the input is held between samples (`hold`); the table of other "
    "candidates shows what `input_delay` and `actuator_lag` explain. Under feedback compare with "
    "`eoi refine`, whose simulated regressors contain no noise."
)


def health(
    diagnosis: Diagnosis, *, searched: str = "", explained: float = 0.0
) -> tuple[Check, ...]:
    """Every check, in the order of the report, worded so that it agrees with the answer.

    Args:
        diagnosis: of `diagnose`.
        searched: status of the discovery that has searched the library of effects; "" if none has.
        explained: share of the residual that its effects explain, 0 … 1.

    Returns:
        One for each subject, with or without a problem.
    """
    checks = []
    for rule in _RULES:
        problems = " ".join(line for finder in rule.finders for line in finder(diagnosis))
        if not problems:
            checks.append(Check(rule.name, "good", _passed(diagnosis, rule), ""))
            continue
        state, advice = "attention", rule.advice
        if rule is _RESIDUAL and searched in _VERDICTS:
            verdict = _VERDICTS[searched]
            state, advice = verdict.state, verdict.advice
            problems = f"{verdict.finding.format(100 * explained)} {problems}"
        elif rule is _TIMING and searched:
            advice = _TIMING_AFTER_SEARCH
        checks.append(Check(rule.name, state, problems, advice))
    return tuple(checks)


def _passed(diagnosis: Diagnosis, rule: _CheckRule) -> str:
    """The finding of a check without a problem."""
    if rule is _EXCITATION:
        return "The records determine every parameter separately."
    if rule is _SLIDING:
        share = f"{float(np.min(diagnosis.sliding_fraction)):.0%}"
        return f"The observer is in sliding mode in {share} of the steps."
    if rule is _RESIDUAL:
        return (
            "The residual is within what the noise of the records and the discretisation explain."
        )
    if rule is _NOISE:
        sizes = [
            f"{output} {quantity(noise, diagnosis.units.get(output, ''))}"
            for output, noise in zip(diagnosis.outputs, diagnosis.noise, strict=True)
        ]
        return f"Noise of the outputs, at most: {', '.join(sizes)}; quantisation is not visible."
    if rule is _SATURATION:
        return "No input or output stops at a limit."
    return "No input acts with a delay, and none is computed from an output."
