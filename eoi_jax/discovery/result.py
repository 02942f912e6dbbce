"""The result of `discover`."""

from dataclasses import dataclass, field

from eoi_jax._display import Result
from eoi_jax._status import EngineUsed, Status
from eoi_jax._types import WHERE_SET
from eoi_jax.data.record import Record
from eoi_jax.discovery.diagnosis import Diagnosis
from eoi_jax.discovery.rules import RULES
from eoi_jax.estimation.common_factors import CommonFactor
from eoi_jax.estimation.identify import Identification
from eoi_jax.models.effects.effect import AbstractEffect, labelled
from eoi_jax.models.equations.display import equation_latex, equation_text
from eoi_jax.models.placements import position_text
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.validation import Validation


@dataclass(frozen=True)
class Evidence:
    """One candidate and the evidence for it.

    Attributes:
        effect: canonical name.
        output: the output (or the input, for an input effect) that it acts on.
        parameters: estimates of its gains and shapes.
        explained: share of the residual's power that it explains when only it is added.
        score: twice the gain in log-likelihood minus the penalty; above zero it is evidence. For an
            added effect: together with the others; for any other candidate: alone.
        remark: why it was excluded, or "".
        against: for an effect between two outputs, the reference of its displacement; or "".
        through: the input together with which it acts on everything this drives; or "".
        form: which of the effects of this name it is, as `above` of an end stop; or "".
        reason: kind of the remark (`remarks.Reason`), or "".
    """

    effect: str
    output: str
    parameters: dict[str, float]
    explained: float
    score: float
    remark: str
    against: str = ""
    through: str = ""
    form: str = field(default="", metadata=WHERE_SET)
    reason: str = field(default="", metadata=WHERE_SET)

    @property
    def label(self) -> str:
        """Name and form: ``end_stop (above)``."""
        return labelled(self.effect, self.form)

    @property
    def position(self) -> str:
        """Where it acts, in words."""
        return position_text(self.output, self.against, self.through)


@dataclass(frozen=True)
class Rival:
    """An effect that may stand in the place of one that was added.

    Attributes:
        effect: canonical name.
        form: which of the effects of this name it is, as `above` of an end stop; or "".
        position: where it acts, in words.
        probability: that it is this one, 0 … 1.
    """

    effect: str
    form: str
    position: str
    probability: float

    @property
    def label(self) -> str:
        """Name and form: ``end_stop (above)``."""
        return labelled(self.effect, self.form)


@dataclass(frozen=True)
class Added:
    """One effect that was added.

    Attributes:
        effect: the effect, which gives the term of the equation.
        output: the output, or the input, that it acts on.
        parameters: estimates by name in `Discovery.plant`.
        standard_errors: by name.
        sentence: completes "the model lacks …".
        against: for an effect between two outputs, the reference of its displacement; or "".
        through: the input together with which it acts on everything this drives; or "".
        probability: that it is this effect and no other one of those that were tried, 0 … 1
            (`probability.py`); None where nothing was compared, as for a curve.
        rivals: the others, as far as they have a hundredth of it, the most probable first.
    """

    effect: AbstractEffect
    output: str
    parameters: dict[str, float]
    standard_errors: dict[str, float]
    sentence: str
    against: str = ""
    through: str = ""
    probability: float | None = None
    rivals: tuple[Rival, ...] = ()

    @property
    def label(self) -> str:
        """Name and form of the effect."""
        return labelled(self.effect.name, self.effect.form)

    @property
    def position(self) -> str:
        """Where it acts, in words."""
        return position_text(self.output, self.against, self.through)

    @property
    def is_doubtful(self) -> bool:
        """Whether it is less probable than not."""
        return self.probability is not None and self.probability < RULES.probability.likely

    @property
    def alternatives(self) -> tuple[Rival, ...]:
        """Rivals that are named beside it: a tenth or more, or more probable than the effect."""
        limit, likelier = RULES.probability.alternative, self.likelier
        return tuple(
            rival for rival in self.rivals if rival.probability >= limit or rival in likelier
        )

    @property
    def likelier(self) -> tuple[Rival, ...]:
        """Rivals that are more probable than it, the most probable first."""
        if self.probability is None:
            return ()
        return tuple(rival for rival in self.rivals if rival.probability > self.probability)


@dataclass(frozen=True)
class PartialExplanation:
    """The best set of effects that explains too little to be an answer, but improves free runs.

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
    """Texts of a discovery that need its model; they are stored in its file without the model.

    Attributes:
        added, lead: each effect with its parameters, of the answer and of the lead.
        equation, values: the augmented equation, with names and with values.
        latex: the equation with names, in LaTeX.
        at_input: strengths of effects in the unit of the input, a line each.
    """

    added: tuple[str, ...]
    lead: tuple[str, ...]
    equation: str
    values: str
    latex: str
    at_input: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False, repr=False)
class Discovery(Result):
    """What a model lacks, and how much the model improves by adding it.

    `plot` shows the residual before and after, the effect in it, and the free run.

    Attributes:
        effects: canonical names of the added effects, the strongest first; empty if none is
            justified, or if none explains the residual.
        added: the same effects with parameters.
        ranking: every candidate with its evidence, best first.
        ambiguous_with: names that the records support equally well, instead of one of `effects`.
        advice: which experiment would distinguish them.
        explained: share of the residual's power above the noise that `effects` explain, 0 … 1;
            of effects that free runs have shown, the share of the power of their errors.
        before, after: free-run errors of the declared model (`plant_before`) and of the augmented
            one, on records that were not used for the fit (`in_sample` tells whether there were
            none).
        windows_before, windows_after: the same on re-initialised windows; None where the records
            are too short.
        declared, found: the fits of the declared and of the augmented model.
        plant: the augmented model with its estimate.
        status: ``"complete"``; ``"partial"``: effects that free runs on held-out records confirm,
            with more than noise left; ``"nothing_missing"``; ``"unexplained"``; or that of the
            declared fit if it failed.
        notes: limitations of the answer.
        in_sample: whether the free-run errors are on the records of the fit.
        held_out: the records of the free runs.
        diagnosis: of the declared model's residual where no effect explains it; else None.
        lead: where no effect explains it, the set that comes nearest, if it improves free runs;
            else None. It may represent an effect that the library does not contain.
        texts: of a loaded discovery, the texts when it was saved; else None.
        common_factors: parameters that no record tells apart; one of each was held.
        denied: names of a set that explains the records of the fit, and that only the held-out
            records refuse.
        test_before, test_after: as `before` and `after`, on test records, which chose nothing: the
            errors that may be published. None without such records.
        test_windows_before, test_windows_after: the same on re-initialised windows.
        base: the declared model refined by the error of its free runs, where effects were searched
            in these; else None.
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
    common_factors: tuple[CommonFactor, ...] = ()
    denied: tuple[str, ...] = field(default=(), metadata=WHERE_SET)
    test_before: Validation | None = None
    test_after: Validation | None = None
    test_windows_before: Validation | None = None
    test_windows_after: Validation | None = None
    base: Plant | None = field(default=None, metadata=WHERE_SET)

    @property
    def plant_before(self) -> Plant:
        """The declared model whose free-run errors are those before: refined, or as it was fitted.

        A result of an earlier version does not hold the refined one, though `before` may be of it.
        """
        return self.declared.plant if self.base is None else self.base

    @property
    def records(self) -> tuple[Record, ...]:
        """The records of the fit, as it used them."""
        return self.found.records

    @property
    def engine(self) -> EngineUsed:
        """The engine of the iterations of `found`, and the reason if it was not the fast one."""
        return self.found.engine

    @property
    def changed(self) -> bool:
        """Whether the final model differs from the declared fit: by effects, or refined."""
        return bool(self.added) or self.found.parameters != self.declared.parameters

    @property
    def declared_part(self) -> Plant:
        """The declared model with its parameters as estimated together with the effects."""
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
