"""How a run can end, in words: what happened, the likely cause, what to try; and what ran it."""

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


@dataclass(frozen=True)
class EngineUsed:
    """Which engine ran the recursion behind a result.

    Attributes:
        name: ``"native"`` for machine code of this processor, ``"scan"`` for `jax.lax.scan`,
            ``"one_kernel"`` for a kernel of a GPU; ``"not recorded"`` in a file of an older
            version.
        reason: why it was not the fast one, ``"native"``; empty where it was, or where another one
            was asked for.
    """

    name: str
    reason: str = ""

    @property
    def notes(self) -> tuple[str, ...]:
        """What a report says of it: a line where it was not the fast one."""
        line = f"computed by the {self.name} engine, slower than machine code: {self.reason}"
        return (line,) if self.reason else ()


NATIVE = EngineUsed("native")
NOT_RECORDED = EngineUsed("not recorded")
