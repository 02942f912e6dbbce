"""Status of a run (what happened, the likely cause, what to try), notes, and its engine."""

from dataclasses import dataclass

# Codes of a fit in which every free parameter has an estimate.
ANSWERED = (
    "converged", "passes_exhausted", "stalled", "undersampled", "undetermined", "start_kept"
)  # fmt: skip


@dataclass(frozen=True)
class Status:
    """How a run ended.

    Attributes:
        code: for programs: ``"converged"``, ``"passes_exhausted"``,
            ``"stalled"``, ``"undersampled"`` (the estimate has a mode faster than the sampling),
            ``"start_kept"`` (a refinement makes held-out free runs worse than its start),
            ``"unidentifiable"``, ``"diverged"``, ``"no_data"``; of `eoi identify`
            ``"undetermined"`` (all errors exceed the values); of a discovery ``"complete"``,
            ``"partial"`` (effects are added, more than noise is left), ``"nothing_missing"``,
            ``"unexplained"``; of a method in a comparison
            ``"not_applicable"``, ``"failed"``.
        message: what happened, the likely cause, what to try.
    """

    code: str
    message: str

    @property
    def ok(self) -> bool:
        """Whether the fit has an estimate of every free parameter."""
        return self.code in ANSWERED

    @property
    def fits(self) -> bool:
        """Whether there is a fit, even if some parameters stay open in it."""
        return self.ok or self.code == "unidentifiable"

    def __str__(self) -> str:
        return f"{self.code}: {self.message}"


class FitNote(str):
    """A sentence on a fitted model: another fit has its own."""

    __slots__ = ()


@dataclass(frozen=True)
class EngineUsed:
    """Which engine ran the recursion behind a result.

    Attributes:
        name: ``"native"`` for machine code of this processor, ``"scan"`` for `jax.lax.scan`,
            ``"one_kernel"`` for a kernel of a GPU; ``"not recorded"`` in a file of an older
            version.
        reason: why the fast engine, ``"native"``, was not used; empty if it was, or if another
            engine was requested.
    """

    name: str
    reason: str = ""

    @property
    def notes(self) -> tuple[str, ...]:
        """Line for a report if the fast engine was not used."""
        line = (
            "slower than usual, with the same numbers: not computed by machine code but by the "
            f"{self.name} engine ({self.reason})"
        )
        return (line,) if self.reason else ()


NATIVE = EngineUsed("native")
NOT_RECORDED = EngineUsed("not recorded")
