"""Health checks of an estimate in plain words, each with what to do next: no numerical work."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from eoi_jax.discovery.diagnosis import Diagnosis
from eoi_jax.report import diagnosis as said
from eoi_jax.report.tables import quantity


@dataclass(frozen=True)
class Check:
    """One thing that was looked at.

    Attributes:
        name: what.
        good: whether nothing needs attention.
        finding: sentences.
        advice: what to do next, "" where there is nothing to do.
    """

    name: str
    good: bool
    finding: str
    advice: str


@dataclass(frozen=True)
class _Look:
    """What is looked at, who says what is wrong with it, and what to do then."""

    name: str
    parts: tuple[Callable[[Diagnosis], Iterable[str]], ...]
    advice: str


_EXCITATION = _Look(
    "Excitation",
    (said.confounding, said.windows),
    "Record a motion with more frequencies and amplitudes, or fix a parameter that is known.",
)
_SLIDING = _Look(
    "Sliding",
    (said.sliding,),
    "Give the observer larger gains in [observer], or leave that table out: gains are then chosen "
    "from the records.",
)
_RESIDUAL = _Look(
    "Residual",
    (said.residual, said.colour),
    "Run `eoi discover` on these records: it names what the model lacks.",
)
_NOISE = _Look(
    "Noise",
    (said.lines, said.quantisation),
    "Use a finer sensor, shield it from hum, or record a slower and larger motion; a cut-off of "
    "the low-pass filter below a line keeps it out.",
)
_SATURATION = _Look(
    "Saturation",
    (said.saturation,),
    "Mask the samples at the limit, or put the limit into the model (effect `input_saturation` "
    "for an input).",
)
_TIMING = _Look(
    "Delay and feedback",
    (said.delays, said.feedback),
    "Check the time stamps and how the input is held between samples (`hold`); else let "
    "`eoi discover` try `input_delay` and `actuator_lag`. Under feedback compare with "
    "`eoi refine`, whose simulated regressors hold no noise.",
)
_LOOKS = (_EXCITATION, _SLIDING, _RESIDUAL, _NOISE, _SATURATION, _TIMING)


_SEARCHED = (
    "No effect of the library explains what is left. Its maps, if it has any shape, are leads to "
    "a term of your own; `eoi refine` fits the free run itself."
)


def health(diagnosis: Diagnosis, *, searched: bool = False) -> tuple[Check, ...]:
    """Every check, in the order of the report.

    Args:
        diagnosis: of `diagnose`.
        searched: whether the effects that the model may lack were tried already.

    Returns:
        One for each thing that was looked at, also where nothing was found.
    """
    checks = []
    for look in _LOOKS:
        found = " ".join(line for part in look.parts for line in part(diagnosis))
        advice = _SEARCHED if searched and look is _RESIDUAL else look.advice
        finding, advice = (found, advice) if found else (_fine(diagnosis, look), "")
        checks.append(Check(look.name, not found, finding, advice))
    return tuple(checks)


def _fine(diagnosis: Diagnosis, look: _Look) -> str:
    """What is said where nothing is wrong."""
    if look is _EXCITATION:
        return "Every parameter leaves a trace of its own in the records."
    if look is _SLIDING:
        share = f"{float(np.min(diagnosis.sliding_fraction)):.0%}"
        return f"The observer slides in {share} of the steps: its injection is the model's error."
    if look is _RESIDUAL:
        return "What is left is no more than the noise of the records and discretisation explain."
    if look is _NOISE:
        sizes = [
            f"{output} {quantity(noise, diagnosis.units.get(output, ''))}"
            for output, noise in zip(diagnosis.outputs, diagnosis.noise, strict=True)
        ]
        return f"Noise of the outputs: {', '.join(sizes)}; steps of the converters do not show."
    if look is _SATURATION:
        return "No input or output stops at a limit."
    return "No input acts late, and none is computed from an output."
