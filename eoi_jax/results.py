"""How a run can end, in words: what happened, the likely cause, what to try."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Status:
    """The end of a run.

    Attributes:
        code: one word for programs: ``"converged"``, ``"passes_exhausted"``,
            ``"stalled"``, ``"unidentifiable"``, ``"diverged"``, ``"no_data"``; of a discovery
            ``"explained"``, ``"nothing_missing"``, ``"unexplained"``.
        message: what happened, the likely cause, what to try.
    """

    code: str
    message: str

    @property
    def ok(self) -> bool:
        """Whether a fit has an answer for every free parameter."""
        return self.code in ("converged", "passes_exhausted", "stalled")

    def __str__(self) -> str:
        return f"{self.code}: {self.message}"
