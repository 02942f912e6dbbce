r"""Close the loop: find the residual, trace it to an effect that the model lacks, add it.

1. `identify` the declared model; what is left of the injection is what it lacks.
2. Every effect of the library, at every point of its shape grid, becomes columns of a regression
   on the modes of y^(r) - f (`modes`, `candidates`).
3. `search` finds the set of effects that the residual justifies, all declared parameters free.
4. An effect that makes the held-out error worse is refused.
5. The set is added (`augment`), and everything is fitted again by the estimator; then the search
   starts once more from there, until nothing is justified.
6. Free runs on records that the fit did not see, before and after.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from eoi_jax.augment import Placed, augmented, place
from eoi_jax.candidates import Atom, atoms, candidates, seen_at
from eoi_jax.checks import check, check_choice
from eoi_jax.data.record import Record
from eoi_jax.discovery import Added, Discovery, Evidence
from eoi_jax.effects import AsymmetricFriction, ConstantOffset, CoulombFriction, standard
from eoi_jax.effects.effect import AbstractEffect
from eoi_jax.fit import Base, Fit, fitted, system
from eoi_jax.identify import Identification, identify
from eoi_jax.lowpass import LowPass
from eoi_jax.modes import Stretch, model_rows, stretch
from eoi_jax.noise_model import fitted_power, known_power, local_power
from eoi_jax.plants.plant import Plant
from eoi_jax.prepare import check_records
from eoi_jax.results import Status
from eoi_jax.search import Search
from eoi_jax.validate import Validation, validate

_BAND = 2.0  # of the modes over the cut-off of F
_PEAKS = 6  # frequencies at which a sinusoid is tried
_AMBIGUOUS = 10.0  # twice the log-likelihood by which sets are told apart
_EQUAL = 1.5  # ratio of friction levels up to which they are read as one level and an offset
_ROUNDS = 3
_WINDOW, _INITIAL = 0.1, 50  # of a record; samples that start a free run
_NOISE_LIKE = 1.3  # mean square of a residual over its predicted power
_EXPLAINED = 0.9  # share of the residual's power from which on a set is an answer
_MEDIAN = 0.455  # of the square of a normal variable
_MATERIAL = 0.01  # residual over y^(r), both rms, below which nothing is missing


def discover(
    plant: Plant,
    records: Record | Sequence[Record],
    validation: Record | Sequence[Record] | None = None,
    effects: Sequence[AbstractEffect | str] | None = None,
    *,
    lowpass: LowPass | None = None,
    alpha: float = 0.01,
    most: int = 3,
    window: float | None = None,
) -> Discovery:
    """Find what a model lacks, and add it.

    Args:
        plant: the declared model, with nominal parameters.
        records: to fit and to search; all of them together.
        validation: records that the fit does not see, for the errors before and after; without
            them the errors are those on `records`, and the answer says so.
        effects: to try, as names or objects; all of `eoi_jax.effects.standard()` by default.
        lowpass: F of the fits; chosen from the records if left out.
        alpha: level of false alarms: the chance that a model which lacks nothing gets an effect.
        most: effects that one round of the search may add at most.
        window: length of re-initialised free runs [s]; by default a tenth of a record.

    Returns:
        The effects, the augmented plant, evidence for every candidate, errors before and after.

    Raises:
        ValueError: arguments or records that do not fit; the message says which and what to do.
    """
    several = check_records(plant, records)
    held = _held_out(plant, several, validation)
    tried = _effects(effects)
    check(0.0 < alpha < 1.0, "alpha", "must lie in (0, 1)", alpha, "0.01 is a common choice.")
    check(isinstance(most, int) and most >= 1, "most", "must be an integer ≥ 1", most)
    declared = identify(plant, several, lowpass=lowpass)
    if declared.status.code in ("no_data", "diverged"):
        return _failed(declared, held, several)
    return _Task(plant, several, held, tried, declared, alpha, most, window).run()


@dataclass(frozen=True)
class _Task:
    """One discovery: what is fixed during it."""

    plant: Plant
    records: tuple[Record, ...]
    held: tuple[Record, ...]
    effects: tuple[AbstractEffect, ...]
    declared: Identification
    alpha: float
    most: int
    window: float | None

    def run(self) -> Discovery:
        """Rounds of search and refit, then the free runs."""
        model, placed, rounds, steps = self.declared.plant, [], [], []
        for _ in range(_ROUNDS):
            one = _Round(self, model, placed)
            one.search(rounds[0].lacking if rounds else one.lacking)
            rounds.append(one)
            if not one.chosen.atoms:
                break
            added = _read_friction(model, one.chosen)
            placed += list(added)
            model = one.augmented(added)
            steps.append((model, tuple(placed), tuple(rounds)))
            if one.exhausted:
                break
        return _answer(self, steps, rounds)

    @property
    def band(self) -> float:
        """Highest frequency of the modes [rad/s]."""
        return _BAND * self.declared.lowpass.cutoff

    def refitted(self, model: Plant, notes: list[str]) -> Identification:
        """Everything fitted again by the estimator, from where the search ended.

        Its passes average over a step what the modes treat to fourth order, and smooth the inputs
        with the outputs where noise asks for it, which an input effect does not commute with. So
        the better of both in short free runs on the records of the fit is kept.
        """
        found = identify(model, self.records, lowpass=self.declared.lowpass)
        window = self._window(self.records)
        if window is None or np.any(model.theta < model.lower) or np.any(model.theta > model.upper):
            return found
        ours, theirs = (
            float(np.sum(np.log(validate(one, self.records, window=window).rmse + 1e-300)))
            for one in (model, found.plant)
        )
        if not ours < theirs:
            return found
        notes.append("parameters are those of the search: in free runs better than the refit's")
        return replace(found, plant=model, parameters=model.parameters)

    def _window(self, records: Sequence[Record]) -> float | None:
        """Length of short free runs [s]; None where the records are too short."""
        if self.window is not None:
            return self.window
        shortest = min(len(one) for one in records)
        samples = max(round(_WINDOW * shortest), 2 * _INITIAL)
        return None if samples > shortest // 2 else samples * records[0].sample_period

    def free_runs(self, plant: Plant) -> tuple[Validation, Validation | None]:
        """On the held-out records, whole and in windows."""
        records = self.held or self.records
        window = self._window(records)
        whole = validate(plant, records)
        return whole, None if window is None else validate(plant, records, window=window)


class _Round:
    """One search from one model."""

    def __init__(self, task: _Task, model: Plant, placed: Sequence[Placed]):
        self.task, self.model, self.placed = task, model, tuple(placed)
        self.stretches = [stretch(model, one, task.band) for one in task.records]
        self.held = [stretch(model, one, task.band) for one in task.held]
        self.base = base_of(model, self.stretches)
        self.refused: dict[Placed, str] = {}

    @property
    def lacking(self) -> float:
        """Power of what the model leaves."""
        residual = fitted(self.base, [], np.ones_like(self.base.target)).residual
        return self.base.signal_power(residual)

    def search(self, lacking: float) -> None:
        """Find the best set that the held-out records do not refuse.

        Args:
            lacking: power that the declared model left, the measure of what matters.
        """
        task, model = self.task, self.model
        present = {(one.effect, one.channel) for one in self.placed}
        self.candidates = [
            one
            for one in candidates(model, task.effects)
            if (one.effect, one.channel) not in present
        ]
        peaks = self._peaks()
        cutoff = task.declared.lowpass.cutoff
        grid = []
        for one in self.candidates:
            seen = seen_at(model, one, self.stretches, cutoff, peaks)
            grid += atoms(model, one, one.effect.grid(seen), self.stretches)
        names = len({one.effect.name for one in self.candidates})
        self.found = Search(
            self.base, grid, self._make, task.alpha, task.most, max(names, 1), lacking
        )
        self.sets = self.found.run()
        self.chosen = self._first_accepted()

    @property
    def exhausted(self) -> bool:
        """Whether the chosen set leaves no more than noise."""
        power = known_power(self.base.noise, self.base.local)
        return float(np.mean(self.chosen.residual**2 / power)) < _NOISE_LIKE

    def augmented(self, added: dict[Placed, tuple[float, ...]]) -> Plant:
        """The model with the chosen set, at its fitted values.

        Args:
            added: the effects as they are read, with their parameters.
        """
        fit = self.chosen
        theta = np.array(self.model.theta)
        theta[self.base.free] += fit.theta[: len(self.base.free)]
        theta = np.clip(theta, self.model.lower, self.model.upper)
        values = {
            name: value
            for one, numbers in added.items()
            for name, value in zip(one.names, numbers, strict=True)
        }
        return augmented(self.model.with_parameters(theta), list(added), values)

    def _make(self, placed: Placed, shapes: Float[np.ndarray, "grid shapes"]) -> list[Atom]:
        return atoms(self.model, placed, shapes, self.stretches)

    def _peaks(self) -> Float[np.ndarray, " peaks"]:
        """Frequencies at which the residual of the declared model stands out."""
        base, (one, *_) = self.base, self.stretches
        residual = fitted(base, [], np.ones_like(base.target)).residual[: len(one.omega)]
        power = fitted_power(residual, base.noise[: len(residual)], base.local[: len(residual)],
                             np.zeros(len(residual), int))  # fmt: skip
        ratio = residual**2 / power
        ratio = ratio[:-1] + ratio[1:]  # a frequency between two modes shows in both
        inner = (ratio[1:-1] >= ratio[:-2]) & (ratio[1:-1] >= ratio[2:])
        where = 1 + np.flatnonzero(inner)
        best = where[np.argsort(ratio[where])[::-1][:_PEAKS]]
        return 0.5 * (one.omega[best] + one.omega[best + 1])

    def _first_accepted(self) -> Fit:
        for fit in self.sets:
            if not fit.atoms:
                return fit
            if fit.physical and self.found.material(fit) and self._better(fit):
                return fit
        return self.found.fit([])

    def _better(self, fit: Fit) -> bool:
        """Each effect must lower the held-out error beside the others."""
        if not self.held:
            return True
        base = base_of(self.model, self.held)
        residual = self._held_residual(base, fit)
        power = fitted_power(residual, base.noise, base.local, base.output)
        for one in fit.atoms:
            rest = self.found.fit([other for other in fit.atoms if other is not one])
            without = self._held_residual(base, rest)
            if float(np.sum(without**2 / power)) <= float(np.sum(residual**2 / power)):
                self.refused[one.placed] = "held-out error grows"
                return False
        return True

    def _held_residual(self, base: Base, fit: Fit) -> Float[np.ndarray, " rows"]:
        """What the set leaves on the held-out records, at the parameters of the fit."""
        made = [
            atoms(self.model, one.placed, np.reshape(one.shape, (1, -1)), self.held)[0]
            for one in fit.atoms
        ]
        target, columns = system(base, made)
        return target - columns @ fit.theta


def base_of(model: Plant, stretches: Sequence[Stretch]) -> Base:
    """The declared model along the records, as modes."""
    error, slopes = model_rows(model, stretches)
    free = np.flatnonzero(model.free)
    parts, noise, output = [], [], []
    for one in stretches:
        for j in range(len(model.outputs)):
            parts.append(local_power(one.rows(one.highest[j])))
            noise.append(one.noise[:, j])
            output.append(np.full(len(one.omega), j))
    return Base(
        error[0],
        slopes[0][:, free],
        free,
        np.concatenate(noise),
        np.concatenate(parts),
        np.concatenate(output),
    )


def values_of(fit: Fit) -> dict[Placed, tuple[float, ...]]:
    """Parameters of each effect of a set, gains first."""
    return {
        one.placed: (*(float(gain) for gain in gains), *one.shape)
        for one, gains in zip(fit.atoms, fit.gains, strict=True)
    }


def _read_friction(plant: Plant, fit: Fit) -> dict[Placed, tuple[float, ...]]:
    """The set, with asymmetric dry friction read as it is commonly meant.

    Two levels c₊, c₋ and one level (c₊ + c₋)/2 beside an offset (c₋ - c₊)/2 are the same function.
    Nearly equal levels are called Coulomb friction and an offset, very different ones asymmetric.
    """
    added = {}
    for placed, values in values_of(fit).items():
        if isinstance(placed.effect, AsymmetricFriction) and max(values) < _EQUAL * min(values):
            forward, backward = values
            level = place(plant, CoulombFriction(), placed.channel)
            offset = place(plant, ConstantOffset(), placed.channel)
            added[level] = (0.5 * (forward + backward),)
            added[offset] = (0.5 * (backward - forward),)
        else:
            added[placed] = values
    return added


def _held_out(
    plant: Plant, records: tuple[Record, ...], validation: Record | Sequence[Record] | None
) -> tuple[Record, ...]:
    if validation is None or (not isinstance(validation, Record) and len(validation) == 0):
        return ()
    try:
        held = check_records(plant, validation)
    except ValueError as error:
        raise ValueError(str(error).replace("`records", "`validation", 1)) from error
    hashes = {one.data_hash for one in records}
    for one in held:
        check(
            one.data_hash not in hashes,
            f"validation[{one.name}]",
            "must not be one of the records of the fit",
            "the same data",
            "Leave `validation` out, or split a record: record.split(0.7).",
        )
    return held


def _effects(effects: Sequence[AbstractEffect | str] | None) -> tuple[AbstractEffect, ...]:
    library = standard()
    if effects is None:
        return library
    check(len(effects) > 0, "effects", "must name at least one effect", "none")
    chosen: list[AbstractEffect] = []
    names = sorted({one.name for one in library})
    for one in effects:
        if isinstance(one, str):
            check_choice("effects", one, names)
            chosen += [other for other in library if other.name == one]
        else:
            check(
                isinstance(one, AbstractEffect),
                "effects",
                "must be names or effects",
                type(one).__name__,
            )
            chosen.append(one)
    return tuple(chosen)


# -- the answer -------------------------------------------------------------------------------


def _answer(
    task: _Task,
    steps: Sequence[tuple[Plant, tuple[Placed, ...], tuple[_Round, ...]]],
    rounds: Sequence[_Round],
) -> Discovery:
    """From the rounds of the search to what the user reads; a last step may be refused."""
    before = task.free_runs(task.declared.plant)
    notes = _notes(task)
    placed: tuple[Placed, ...] = steps[-1][1] if steps else ()
    share, left, quiet = _explained(rounds)
    status = _judged(placed, share, left, quiet)
    found, after = task.declared, before
    for model, placed, done in reversed(steps):
        share, left, quiet = _explained(rounds if placed is steps[-1][1] else done)
        verdict = _judged(placed, share, left, quiet)
        if verdict.code != "explained":
            break
        refit = task.refitted(model, notes)
        if not refit.status.ok:
            notes.append(f"the refit of the augmented model ended as {refit.status}")
        runs = task.free_runs(refit.plant)
        if _holds(before, runs):
            status, found, after = verdict, refit, runs
            break
        notes.append(_REFUSED.format(" and ".join(_names(placed))))
        status = Status("unexplained", _WORSE)
    kept = placed if found is not task.declared else ()
    others = _ambiguous(rounds[0], _names(kept)) if kept else ()
    return Discovery(
        effects=_names(kept),
        added=tuple(_added(task.plant, found, one) for one in kept),
        ranking=_ranking(task.plant, rounds, kept),
        ambiguous_with=others,
        advice=_advice(rounds[0], others),
        explained=share if kept else 0.0,
        before=before[0],
        after=after[0],
        windows_before=before[1],
        windows_after=after[1],
        declared=task.declared,
        found=found,
        plant=found.plant,
        status=status,
        notes=tuple(notes),
        in_sample=not task.held,
        held_out=task.held or task.records,
    )


def _explained(rounds: Sequence[_Round]) -> tuple[float, float, bool]:
    """Share of the residual's power above the noise that is gone; what is left over y^(r), rms.

    And whether that is noise: white as predicted, or less than the noise is.
    """
    first, last = rounds[0], rounds[-1]
    before = first.found.fit([]).residual
    after = last.found.fit([]).residual if not last.chosen.atoms else last.chosen.residual
    noise = _noise_scale(last.base, after) * first.base.noise_power
    excess = first.base.signal_power(before) - noise
    rest = max(first.base.signal_power(after) - noise, 0.0)
    whole = first.base.signal_power(np.sqrt(first.base.local)) - noise
    if not (excess > 0.0 and whole > 0.0 and np.isfinite(rest)):
        return 0.0, 0.0 if np.isfinite(rest) else np.inf, last.exhausted
    share = float(np.clip(1.0 - rest / excess, 0.0, 1.0))
    return share, float(np.sqrt(rest / whole)), last.exhausted or rest <= noise


def _noise_scale(base: Base, residual: Float[np.ndarray, " rows"]) -> float:
    """How much of the predicted noise is there: a record's noise estimate is an upper bound."""
    ratio = residual**2 / np.maximum(base.noise, 1e-300)
    return float(min(1.0, np.median(ratio) / _MEDIAN))


def _judged(placed: Sequence[Placed], share: float, left: float, noise_like: bool) -> Status:
    good = noise_like or left <= _MATERIAL
    if not placed:
        if good:
            return Status("nothing_missing", _NOTHING.format(left))
        return Status("unexplained", _UNKNOWN.format(left))
    if share >= _EXPLAINED or good:
        return Status("explained", _FOUND.format(share, left))
    return Status("unexplained", _PARTLY.format(" and ".join(_names(placed)), share, left))


_NOTHING = "what is left is {:.2g} of the highest derivative (rms): nothing that the data can name"
_UNKNOWN = (
    "what is left is {:.2g} of the highest derivative (rms), more than noise, and no effect of the "
    "library explains it. Look at the residual's maps; more records with other inputs may tell"
)
_FOUND = (
    "the effects take {:.1%} of the residual's power; what is left is {:.2g} of the highest "
    "derivative (rms)"
)
_PARTLY = (
    "the best that the library has, {}, takes only {:.0%} of the residual's power and leaves "
    "{:.2g} of the highest derivative (rms): not the whole story, so nothing was added"
)
_WORSE = "the effects that fit the records make the free run on other data worse"
_REFUSED = "refused: {} makes the free run worse or diverge on the records of `validation`"


def _names(placed: Sequence[Placed]) -> tuple[str, ...]:
    """Each name once, in the order in which the effects came."""
    return tuple(dict.fromkeys(one.effect.name for one in placed))


def _notes(task: _Task) -> list[str]:
    notes = []
    if not task.held:
        notes.append(
            "no held-out record: errors are in-sample, and no effect was refused for being worse "
            "on other data. Give `validation`, or split a record: record.split(0.7)"
        )
    return notes


def _holds(
    before: tuple[Validation, Validation | None], after: tuple[Validation, Validation | None]
) -> bool:
    """Whether the free run is better, whole or in windows: one lightly damped drifts in phase."""
    short = after[0] if after[1] is None else after[1]
    if np.all(short.nrmse > 1.0):
        return False  # a constant would predict better
    pairs = [(old, new) for old, new in zip(before, after, strict=True) if old and new]
    better = [
        float(np.sum(np.log(np.maximum(new.rmse, 1e-300) / np.maximum(old.rmse, 1e-300))))
        for old, new in pairs
        if np.all(np.isfinite(old.rmse)) or np.all(np.isfinite(new.rmse))
    ]
    return not better or min(better) < 0.0


def _added(plant: Plant, found: Identification, one: Placed) -> Added:
    channels = plant.inputs if one.on_input else plant.outputs
    return Added(
        one.effect,
        channels[one.channel],
        {name: found.parameters[name] for name in one.names},
        {name: found.standard_errors[name] for name in one.names},
        one.effect.sentence,
    )


def _ranking(
    plant: Plant, rounds: Sequence[_Round], kept: Sequence[Placed]
) -> tuple[Evidence, ...]:
    """What was added, then every other candidate alone, by score."""
    first = rounds[0]
    search, empty = first.found, first.found.fit([])
    power = float(np.sum(empty.residual**2))
    rows: dict[Placed, Evidence] = {}
    alone = {fit.atoms[0].placed: fit for fit in search.extended(empty)}
    refined = {next(iter(fit.keys)): fit for fit in first.sets if len(fit.atoms) == 1}
    worth = {
        one.placed: search.value(search.fit([other for other in fit.atoms if other is not one]))
        - search.value(fit)
        for fit in [first.chosen]
        for one in fit.atoms
    }
    for placed in first.candidates:
        fit = refined.get(placed, alone.get(placed))
        channels = plant.inputs if placed.on_input else plant.outputs
        remark, parameters, score, taken = "", {}, -np.inf, 0.0
        if fit is None or search.known(placed):
            remark = "already in the model" if search.known(placed) else "not to be evaluated"
        else:
            parameters = dict(zip(placed.names, values_of(fit)[placed], strict=True))
            score = worth.get(placed, empty.cost - fit.cost - search.penalty(fit.atoms))
            taken = 1.0 - float(np.sum(fit.residual**2)) / power
            remark = "" if fit.physical else "wrong sign"
            remark = first.refused.get(placed, remark)
        name, channel = placed.effect.name, channels[placed.channel]
        rows[placed] = Evidence(name, channel, parameters, max(taken, 0.0), float(score), remark)
    chosen = set(kept) | set(worth)
    order = sorted(rows, key=lambda one: (one not in chosen, rows[one].remark != "",
                                          -rows[one].score))  # fmt: skip
    return tuple(rows[one] for one in order)


def _ambiguous(first: _Round, kept: Sequence[str]) -> tuple[str, ...]:
    """Names in sets no larger than the chosen one that the records support nearly as well."""
    search, chosen, own = first.found, first.chosen, set(kept)
    names: list[str] = []
    for fit in first.sets:
        theirs = {one.placed.effect.name for one in fit.atoms}
        contained = {name for one in fit.atoms for name in one.placed.effect.contains}
        if not fit.physical or own <= theirs | contained or len(fit.atoms) > len(chosen.atoms):
            continue
        if search.value(fit) - search.value(chosen) < _AMBIGUOUS:
            names += [name for name in sorted(theirs - own) if name not in names]
    level_and_offset = ["coulomb_friction", "constant_offset"]
    if "asymmetric_friction" in own:
        names += [name for name in level_and_offset if name not in own]
    elif own.issuperset(level_and_offset):
        names.append("asymmetric_friction")
    return tuple(dict.fromkeys(name for name in names if name not in own))


def _advice(first: _Round, others: Sequence[str]) -> str:
    """Which experiment tells the candidates apart, by what they depend on."""
    if not others:
        return ""
    library = {one.placed.effect.name: one.placed.effect for one in first.found.grid}
    kinds = {one.placed.effect.depends_on for one in first.chosen.atoms}
    kinds |= {library[name].depends_on for name in others if name in library}
    return " ".join(_EXPERIMENT[kind] for kind in sorted(kinds))


_EXPERIMENT = {
    "y": "Record the same input at two and at half the amplitude: then springs part.",
    "v": "Record slow and fast motion of one amplitude: friction laws then part.",
    "u": "Record the same motion with larger and smaller inputs, and both signs of them.",
    "t": "Record steps and fast changes of the input, and the same input at another time.",
}


def _failed(
    declared: Identification, held: tuple[Record, ...], records: tuple[Record, ...]
) -> Discovery:
    """The declared model could not be fitted: its status is the answer."""
    nothing = (None, None)
    return Discovery(
        (), (), (), (), "", 0.0, *nothing, *nothing, declared, declared, declared.plant,
        declared.status, (), not held, held or records,
    )  # fmt: skip
