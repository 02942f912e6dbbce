"""How a run can end, in words: what happened, the likely cause, what to try."""

from dataclasses import dataclass

# Ends of a fit that give every free parameter a value.
ANSWERED = ("converged", "passes_exhausted", "stalled")


@dataclass(frozen=True)
class Status:
    """The end of a run.

    Attributes:
        code: one word for programs: ``"converged"``, ``"passes_exhausted"``,
            ``"stalled"``, ``"unidentifiable"``, ``"diverged"``, ``"no_data"``; of a discovery
            ``"explained"``, ``"nothing_missing"``, ``"unexplained"``; of a
            method in a comparison ``"not_applicable"``, ``"failed"``.
        message: what happened, the likely cause, what to try.
    """

    code: str
    message: str

    @property
    def ok(self) -> bool:
        """Whether a fit has an answer for every free parameter."""
        return self.code in ANSWERED

    def __str__(self) -> str:
        return f"{self.code}: {self.message}"
