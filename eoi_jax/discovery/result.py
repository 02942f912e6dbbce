"""What `discover` answers."""

from dataclasses import dataclass

from eoi_jax._display import Result
from eoi_jax._status import EngineUsed, Status
from eoi_jax.data.record import Record
from eoi_jax.discovery.diagnosis import Diagnosis
from eoi_jax.estimation.identify import Identification
from eoi_jax.models.effects.effect import AbstractEffect
from eoi_jax.models.equations.display import equation_latex, equation_text
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.validate import Validation


@dataclass(frozen=True)
class Evidence:
    """One candidate and what speaks for it.

    Attributes:
        effect: canonical name.
        output: the output (or the input, for an input effect) that it acts on.
        parameters: estimate of its own parameters, gains and shapes.
        explained: share of the residual's power that it takes away when it alone is added.
        score: twice the log-likelihood gained less the penalty; above zero it is evidence. Of an
            effect that was added: beside the others; of another one: alone.
        remark: why it is out, or "".
        against: the output that its displacement is counted from, of an effect between two; or "".
        through: the input beside which it acts on all that this pushes; or "".
    """

    effect: str
    output: str
    parameters: dict[str, float]
    explained: float
    score: float
    remark: str
    against: str = ""
    through: str = ""


@dataclass(frozen=True)
class Added:
    """One effect that was added.

    Attributes:
        effect: what; it gives the equation's term.
        output: the output, or the input, that it acts on.
        parameters: estimates by name in `Discovery.plant`.
        standard_errors: by name.
        sentence: completes "the model lacks …".
        against: the output that its displacement is counted from, of an effect between two; or "".
        through: the input beside which it acts on all that this pushes; or "".
    """

    effect: AbstractEffect
    output: str
    parameters: dict[str, float]
    standard_errors: dict[str, float]
    sentence: str
    against: str = ""
    through: str = ""


@dataclass(frozen=True)
class PartialExplanation:
    """The best set of effects that is no answer: it leaves too much, but free runs get better.

    Attributes:
        added: the effects, strongest first.
        explained: share of the residual's power above the noise that they explain, 0 … 1.
        found: the fit with them; `found.plant` is the plant with them.
        after, windows_after: its free-run errors, on the records of `Discovery.before`.
    """

    added: tuple[Added, ...]
    explained: float
    found: Identification
    after: Validation | None
    windows_after: Validation | None


@dataclass(frozen=True)
class Texts:
    """What a discovery says that takes its model to work out: kept in its file, without the model.

    Attributes:
        added, lead: each effect with its parameters, as the answer and the lead name them.
        equation, values: the augmented equation, with names and with values.
        latex: the one with names, in LaTeX.
    """

    added: tuple[str, ...]
    lead: tuple[str, ...]
    equation: str
    values: str
    latex: str


@dataclass(frozen=True)
class Discovery(Result):
    """What a model lacks, and what adding it is worth.

    `plot` shows residual before and after, the effect in it, the free run.

    Attributes:
        effects: canonical names of what was added, the strongest first; empty if nothing is
            justified, or if nothing explains the residual.
        added: the same with parameters.
        ranking: every candidate with its evidence, best first.
        ambiguous_with: names that the records support as well, instead of one of `effects`.
        advice: which experiment would tell them apart.
        explained: share of the residual's power above the noise that `effects` explain, 0 … 1.
        before, after: free-run errors of the declared and of the augmented model, on records that
            were not used for the fit (`in_sample` says where there were none).
        windows_before, windows_after: the same on re-initialised windows; None where the records
            are too short.
        declared, found: the fits.
        plant: the augmented model with its estimate.
        status: ``"explained"``, ``"nothing_missing"``, ``"unexplained"``, or that of the declared
            fit if it failed.
        notes: what limits the answer.
        in_sample: whether the free-run errors are on the records of the fit.
        held_out: the records that the free runs are on.
        diagnosis: of the declared model's residual where no effect explains it; else None.
        lead: where no effect explains it, the set that comes nearest, if free runs get better by
            it; else None. It may stand for something that the library does not have.
        texts: of one that was loaded: as they were when it was saved; else None.
    """

    effects: tuple[str, ...]
    added: tuple[Added, ...]
    ranking: tuple[Evidence, ...]
    ambiguous_with: tuple[str, ...]
    advice: str
    explained: float
    before: Validation | None
    after: Validation | None
    windows_before: Validation | None
    windows_after: Validation | None
    declared: Identification
    found: Identification
    plant: Plant
    status: Status
    notes: tuple[str, ...]
    in_sample: bool
    held_out: tuple[Record, ...]
    diagnosis: Diagnosis | None = None
    lead: PartialExplanation | None = None
    texts: Texts | None = None

    @property
    def engine(self) -> EngineUsed:
        """That ran the passes of `found`, and why where it was not the fast one."""
        return self.found.engine

    @property
    def declared_part(self) -> Plant:
        """The declared model with its parameters as they are beside the effects."""
        model = self.declared.nominal
        return model.with_parameters({name: self.plant.parameters[name] for name in model.names})

    @property
    def equation(self) -> str:
        """The augmented equation as text."""
        if self.texts is not None:
            return self.texts.equation
        return equation_text(self.declared.nominal, self.added)

    @property
    def latex(self) -> str:
        """The augmented equation in LaTeX."""
        if self.texts is not None:
            return self.texts.latex
        return equation_latex(self.declared.nominal, self.added)
