"""Tables and the confusion matrix of `undeclared_effects`, made from its lines of JSON."""

import json
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median

import numpy as np

from benchmarks.common import percent, table

WRITTEN = 120  # misses that the report lists; all of them are in the lines


@dataclass(frozen=True)
class Answer:
    """What one method says about one case.

    Attributes:
        named: the effects.
        top: the first three distinct names of its ranking.
        status: how it ended; "error: …" if it raised.
        ambiguous_with: names that it says it cannot tell from `named`.
        before, after: rms error of the free run on held-out data against the output without noise,
            of the declared model and with what was named [unit of y]; infinite if it diverged.
        seconds: that it took.
        chances: of each effect that was added its name, and its probability where one was said.
    """

    named: tuple[str, ...]
    top: tuple[str, ...]
    status: str
    ambiguous_with: tuple[str, ...]
    before: float
    after: float
    seconds: float
    chances: tuple[tuple[str, float], ...] = ()


def failed(error: Exception, seconds: float) -> Answer:
    """The answer of a method that raised."""
    status = f"error: {type(error).__name__}: {str(error)[:200]}"
    return Answer((), (), status, (), math.inf, math.inf, seconds)


_CURVES = {"curve", "input_curve"}


@dataclass(frozen=True)
class Row:
    """One case and the answers to it.

    Attributes:
        kind: "none", "single", "pair" or "outside".
        plant, declared: plant, and the model of it that was given.
        truth, equivalent: what is hidden; another exact description of it, or ().
        loop, noise, seed, samples: as in `effect_cases`.
        strength: of each effect.
        noise_rms: of the held-out record [unit of y].
        commit: at which it was measured.
        first: whether its kernels may have been compiled for it.
        ours, rival: the answers; no rival if it was left out.
    """

    kind: str
    plant: str
    declared: str
    truth: tuple[str, ...]
    equivalent: tuple[str, ...]
    loop: str
    noise: float
    seed: int
    samples: int
    strength: tuple[float, ...]
    noise_rms: float
    commit: str
    first: bool
    ours: Answer
    rival: Answer | None

    def right(self, answer: Answer) -> bool:
        """Exactly the truth or its equivalent; nothing, said to be "unexplained", if outside.

        An equivalent of what is outside must also predict as well as an effect of the library. A
        curve, which is no law, says no more than that.
        """
        if answer.status.startswith("error"):
            return False
        if self.kind == "outside":
            silent = not answer.named and answer.status == "unexplained"
            curves = bool(answer.named) and {*answer.named} <= _CURVES
            return silent or curves or (self._equivalent(answer.named) and self.within(answer))
        return same(answer.named, self.truth) or self._equivalent(answer.named)

    def is_said_rightly(self, name: str) -> bool:
        """Whether one effect that was added is hidden, or belongs to another exact description."""
        hidden = self.truth if self.kind != "outside" else ()
        return name in {*hidden, *self.equivalent}

    def in_top(self, answer: Answer) -> bool:
        """Whether all that is hidden stands among the first three."""
        meant = [self.truth, *([self.equivalent] if self.equivalent else [])]
        return any(set(one) <= set(answer.top) for one in meant)

    def admitted(self, answer: Answer) -> bool:
        """Right, or all that is hidden is in `named` and the names it calls as good."""
        known = {*answer.named, *answer.ambiguous_with}
        meant = [self.truth, *([self.equivalent] if self.equivalent else [])]
        said = bool(answer.named) and any(set(one) <= known for one in meant)
        return self.right(answer) or said

    def limit(self, answer: Answer) -> float:
        """Error that the issue allows after adding: 2 % of before, or three times the noise."""
        return max(0.02 * answer.before, 3.0 * self.noise_rms)

    def within(self, answer: Answer) -> bool:
        """Whether the error stays below it."""
        return math.isfinite(answer.after) and answer.after <= self.limit(answer)

    def _equivalent(self, named: tuple[str, ...]) -> bool:
        return bool(self.equivalent) and same(named, self.equivalent)


def same(one: Iterable[str], other: Iterable[str]) -> bool:
    """Equality of sets of names."""
    return set(one) == set(other)


# -- lines ------------------------------------------------------------------------------------


def line(row: Row) -> str:
    """A row as JSON; an infinite error is null."""
    values = asdict(row)
    for answer in (values["ours"], values["rival"]):
        if answer is not None:
            for key in ("before", "after"):
                answer[key] = answer[key] if math.isfinite(answer[key]) else None
    return json.dumps(values, allow_nan=False)


def read(path: Path) -> list[Row]:
    """The rows of a file of lines; none if there is no file. A line cut short is left out."""
    if not path.exists():
        return []
    rows = []
    for text in path.read_text(encoding="utf-8").splitlines():
        try:
            rows.append(_row(json.loads(text)))
        except json.JSONDecodeError:
            continue
    return rows


def _row(values: dict) -> Row:
    for name in ("ours", "rival"):
        answer = values[name]
        if answer is None:
            continue
        for key in ("named", "top", "ambiguous_with"):
            answer[key] = tuple(answer[key])
        for key in ("before", "after"):
            answer[key] = math.inf if answer[key] is None else answer[key]
        answer["chances"] = tuple((name, chance) for name, chance in answer.get("chances", ()))
        values[name] = Answer(**answer)
    for name in ("truth", "equivalent", "strength"):
        values[name] = tuple(values[name])
    return Row(**values)


# -- tables -----------------------------------------------------------------------------------


def sections(rows: Sequence[Row]) -> list[str]:
    """The whole report below its head."""
    # Groups end in the order in which workers are done with them: reports do not depend on it.
    rows = sorted(rows, key=lambda one: (one.plant, one.truth, one.loop, one.noise, one.seed))
    parts = [_INTRODUCTION, "## Targets", targets(rows), "## Single effects", by_noise(rows)]
    parts += [by_plant(rows), "By effect, both loops and all seeds:", by_effect(rows)]
    if _of(rows, "none"):
        parts += ["## Nothing hidden", clean(rows)]
    if _of(rows, "pair"):
        parts += ["## Pairs", pairs(rows)]
    if _of(rows, "outside"):
        parts += ["## Effects that the library does not have", outside(rows)]
    parts += ["## How sure", certainty(rows)]
    parts += ["## Free run on held-out data", errors(rows), "## Time", times(rows)]
    commits = [one.commit for one in rows]
    counts = ", ".join(f"{one} ({commits.count(one)} cases)" for one in dict.fromkeys(commits))
    return [*parts, "## Misses", misses(rows), f"Commits at which cases were measured: {counts}."]


_INTRODUCTION = (
    "A case is right if the names are exactly those of what is hidden, or of another description "
    "of the same function (Coulomb friction and an offset for asymmetric friction, …). *Top 3*: "
    "they are among the first three names of the ranking. *Or said to be ambiguous*: the answer "
    "names them as supported equally well. Noise is relative to rms(y) about its mean. Errors of "
    "free runs are against the held-out output without noise, from sample 50 on. The rival is "
    "PySINDy in weak form with a library made by hand, on the same arrays; where it names nothing "
    "for an effect that no library has, that counts as right."
)


def targets(rows: Sequence[Row]) -> str:
    """What was asked beside what came out."""
    low, single = [one for one in rows if one.noise <= 1e-3], _of(rows, "single")
    table_rows = [
        [f"exact name, single effects, noise {label}", asked, *_both(some, _right)]
        for label, asked, some in (
            ("≤ 1e-3", "≥ 99 %, ahead of the rival", _of(low, "single")),
            ("1e-2", "≥ 98 %", _at(single, 1e-2)),
            ("5e-2", "≥ 85 %", _at(single, 5e-2)),
        )
    ]
    table_rows += [
        [f"false alarms, noise {label}", "≤ 1 %", *_both(some, _alarm)]
        for label, some in (
            ("≤ 1e-3 (≥ 300 cases)", _of(low, "none")),
            ("1e-2", _at(_of(rows, "none"), 1e-2)),
            ("5e-2", _at(_of(rows, "none"), 5e-2)),
        )
    ]
    table_rows += [
        ["pairs, noise ≤ 1e-3: both, nothing else", "≥ 90 %", *_both(_of(low, "pair"), _right)],
        ["outside the library: \"unexplained\"", "≥ 95 %", *_both(_of(rows, "outside"), _right)],
        ["outside the library: a wrong name", "none", *_both(_of(rows, "outside"), _misnamed)],
        ["free run after over allowed (2 % of before, 3 × noise), median, singles, ≤ 1e-3",
         "≤ 1", *(_median(_of(low, "single"), who, _over_limit) for who in _WHO)],
        ["time a case, median, kernels compiled", "≤ 1 s (two cores)",
         *(_median([one for one in rows if not one.first], who, _seconds, " s") for who in _WHO)],
    ]  # fmt: skip
    return table(["", "asked", "reached", "rival"], table_rows)


def by_noise(rows: Sequence[Row]) -> str:
    """Rates of single effects at each level of noise."""
    single = _of(rows, "single")
    header = ["noise", "exact", "or said to be ambiguous", "top 3", "rival, exact"]
    return table(
        header,
        [
            [
                f"{noise:g}", _rate(some, "ours", _right), _rate(some, "ours", _admitted),
                _rate(some, "ours", _top), _rate(some, "rival", _right),
            ]
            for noise in _noises(single)
            for some in [_at(single, noise)]
        ],
    )  # fmt: skip


def by_plant(rows: Sequence[Row]) -> str:
    """Exact names and top 3 by plant and loop, at each level of noise."""
    single = _of(rows, "single")
    noises = _noises(single)
    out = []
    for plant, loop in dict.fromkeys((one.plant, one.loop) for one in single):
        some = [one for one in single if (one.plant, one.loop) == (plant, loop)]
        for label, who, told in (
            ("exact", "ours", _right), ("top 3", "ours", _top), ("rival, exact", "rival", _right)
        ):  # fmt: skip
            out.append([plant, loop, label, *(_rate(_at(some, n), who, told) for n in noises)])
    return table(["plant", "loop", "", *(f"noise {noise:g}" for noise in noises)], out)


def by_effect(rows: Sequence[Row]) -> str:
    """Exact names of each effect."""
    single, out = _of(rows, "single"), []
    for truth in sorted({one.truth for one in single}):
        some = [one for one in single if one.truth == truth]
        low = [one for one in some if one.noise <= 1e-3]
        cells = [_rate(low, "ours", _right), _rate(low, "rival", _right)]
        for noise in (1e-2, 5e-2):
            cells += [_rate(_at(some, noise), who, _right) for who in _WHO]
        out.append(["+".join(truth), *cells])
    header = [f"{who}{noise}" for noise in ("≤ 1e-3", "1e-2", "5e-2") for who in ("", "rival, ")]
    return table(["effect", *header], out)


def clean(rows: Sequence[Row]) -> str:
    """False alarms where nothing is hidden."""
    none, out = _of(rows, "none"), []
    for plant in dict.fromkeys(one.plant for one in none):
        for noise in _noises(none):
            some = [one for one in _at(none, noise) if one.plant == plant]
            out.append([plant, f"{noise:g}", *_both(some, _alarm), _statuses(some)])
    return table(["plant", "noise", "false alarms", "rival", "how it ended"], out)


def pairs(rows: Sequence[Row]) -> str:
    """Each pair: right, one of the two, and both with more."""
    pair, out = _of(rows, "pair"), []
    for plant, truth in dict.fromkeys((one.plant, one.truth) for one in pair):
        some = [one for one in pair if (one.plant, one.truth) == (plant, truth)]
        out.append([plant, " + ".join(truth), *_both(some, _right), _rate(some, "ours", _top)])
    out.append(["all", "", *_both(pair, _right), _rate(pair, "ours", _top)])
    return table(["plant", "pair", "exact", "rival, exact", "top 3"], out)


def outside(rows: Sequence[Row]) -> str:
    """Effects without a name: how it ended, and what was named all the same."""
    strange, out = _of(rows, "outside"), []
    for truth in sorted({one.truth for one in strange}):
        some = [one for one in strange if one.truth == truth]
        wrong = sorted({"+".join(one.ours.named) for one in some if one.ours.named})
        out.append([
            truth[0].removeprefix("outside:"), _rate(some, "ours", _right), _statuses(some),
            ", ".join(wrong) or "-", _rate(some, "rival", _named),
        ])  # fmt: skip
    header = ["effect", "unexplained", "how it ended", "named", "rival names something"]
    return table(header, out)


def certainty(rows: Sequence[Row]) -> str:
    """Effects that were added, by the probability that was said of each, and how many are right."""
    said = [
        (chance, one.is_said_rightly(name)) for one in rows for name, chance in one.ours.chances
    ]
    out = []
    for words, low, high in (
        ("≥ 0.9", 0.9, math.inf), ("0.5 to 0.9", 0.5, 0.9), ("< 0.5", 0.0, 0.5)
    ):  # fmt: skip
        some = np.array([pair for pair in said if low <= pair[0] < high], dtype=float)
        if len(some):
            mean, share = np.mean(some, axis=0)
            right = int(np.sum(some[:, 1]))
            out.append([words, len(some), right, percent(share), percent(mean)])
    header = ["probability", "effects added", "right", "share", "mean probability"]
    return table(header, out) if out else "No probabilities were said."


def errors(rows: Sequence[Row]) -> str:
    """Error after over before, and the share within what is allowed."""
    out = []
    for kind in ("single", "pair"):
        some = _of(rows, kind)
        for noise in _noises(some):
            at = _at(some, noise)
            for who in _WHO:
                ratios = [_ratio(answer) for _, answer in _answers(at, who)]
                if not ratios:
                    continue
                out.append([
                    kind, f"{noise:g}", {"ours": "ours", "rival": "rival"}[who],
                    f"{median(ratios):.2g}", f"{_quantile(ratios, 0.9):.2g}",
                    _median(at, who, _over_limit), _rate(at, who, _within),
                ])  # fmt: skip
    header = ["cases", "noise", "", "after / before, median", "90 % below",
              "after / allowed, median", "within allowed"]  # fmt: skip
    return table(header, out)


def times(rows: Sequence[Row]) -> str:
    """Seconds a case, without the first of each kind in each process."""
    warm, out = [one for one in rows if not one.first], []
    for kind in dict.fromkeys(one.kind for one in warm):
        for plant in dict.fromkeys(one.plant for one in warm):
            some = [one for one in warm if (one.kind, one.plant) == (kind, plant)]
            seconds = [_seconds(one, one.ours) for one in some]
            if seconds:
                out.append([
                    kind, plant, len(some), f"{median(seconds):.2f} s",
                    f"{_quantile(seconds, 0.9):.2f} s", _median(some, "rival", _seconds, " s"),
                ])  # fmt: skip
    return table(["cases", "plant", "number", "median", "90 % below", "rival, median"], out)


def misses(rows: Sequence[Row]) -> str:
    """Every case that was not right, with what was named instead."""
    wrong = [one for one in rows if not one.right(one.ours)]
    if not wrong:
        return "None."
    header = ["declared", "hidden", "loop", "noise", "seed", "strength", "named", "ended as",
              "ambiguous with", "after / before", "rival"]  # fmt: skip
    out = [
        [
            one.declared, "+".join(one.truth) or "-", one.loop, f"{one.noise:g}", one.seed,
            " ".join(percent(value) for value in one.strength), "+".join(one.ours.named) or "-",
            one.ours.status, ", ".join(one.ours.ambiguous_with) or "-",
            f"{_ratio(one.ours):.2g}", _instead(one),
        ]
        for one in wrong
    ]  # fmt: skip
    head = f"{len(wrong)} of {len(rows)} cases."
    if len(wrong) > WRITTEN:
        head += f" The first {WRITTEN}; the others are in the lines of JSON."
    return head + "\n\n" + table(header, out[:WRITTEN])


def _instead(row: Row) -> str:
    if row.rival is None:
        return "-"
    return "right" if row.right(row.rival) else "+".join(row.rival.named) or row.rival.status


# -- parts of tables --------------------------------------------------------------------------

_WHO = ("ours", "rival")


def _of(rows: Sequence[Row], kind: str) -> list[Row]:
    return [one for one in rows if one.kind == kind]


def _at(rows: Sequence[Row], noise: float) -> list[Row]:
    return [one for one in rows if one.noise == noise]


def _noises(rows: Sequence[Row]) -> list[float]:
    return sorted({one.noise for one in rows})


def _answers(rows: Sequence[Row], who: str) -> list[tuple[Row, Answer]]:
    return [(one, answer) for one in rows if (answer := getattr(one, who)) is not None]


def _right(row: Row, answer: Answer) -> bool:
    # The rival has no word for it: naming nothing is all that it can do right outside.
    if row.kind == "outside" and answer.status == "nothing_named":
        return True
    return row.right(answer)


def _admitted(row: Row, answer: Answer) -> bool:
    return row.admitted(answer)


def _top(row: Row, answer: Answer) -> bool:
    return row.in_top(answer)


def _within(row: Row, answer: Answer) -> bool:
    return row.within(answer)


def _named(row: Row, answer: Answer) -> bool:
    del row
    return bool(answer.named)


_alarm = _named


def _misnamed(row: Row, answer: Answer) -> bool:
    return bool(answer.named) and not row.right(answer)


def _seconds(row: Row, answer: Answer) -> float:
    del row
    return answer.seconds


def _ratio(answer: Answer) -> float:
    if not math.isfinite(answer.after):
        return math.inf
    return answer.after / answer.before if answer.before > 0 else math.inf


def _over_limit(row: Row, answer: Answer) -> float:
    limit = row.limit(answer)
    return answer.after / limit if math.isfinite(answer.after) and limit > 0 else math.inf


def _rate(rows: Sequence[Row], who: str, told: Callable[[Row, Answer], bool]) -> str:
    answers = _answers(rows, who)
    if not answers:
        return "-"
    count = sum(told(row, answer) for row, answer in answers)
    return f"{count} of {len(answers)}, {percent(count / len(answers))}"


def _both(rows: Sequence[Row], told: Callable[[Row, Answer], bool]) -> list[str]:
    return [_rate(rows, who, told) for who in _WHO]


def _median(
    rows: Sequence[Row], who: str, value: Callable[[Row, Answer], float], unit: str = ""
) -> str:
    values = [value(row, answer) for row, answer in _answers(rows, who)]
    return f"{median(values):.2g}{unit}" if values else "-"


def _quantile(values: Sequence[float], share: float) -> float:
    """The smallest value that is not exceeded in this share; infinite ones are allowed."""
    return sorted(values)[math.ceil(share * len(values)) - 1]


def _statuses(rows: Sequence[Row]) -> str:
    codes = [one.ours.status.split(":")[0] for one in rows]
    return ", ".join(f"{codes.count(code)} {code}" for code in sorted(set(codes)))


# -- figure -----------------------------------------------------------------------------------

_ELSE = ("several", "unexplained", "nothing missing", "no answer")


def confusion(rows: Sequence[Row]) -> tuple[list[str], list[str], np.ndarray]:
    """Shares of what was named (columns) for what is hidden (rows); each row adds up to one."""
    chosen = [one for one in rows if one.kind != "pair"]
    singles = sorted({one.truth[0] for one in chosen if one.kind == "single"})
    truths = [*singles, *(
        label for kind, label in (("none", "nothing"), ("outside", "outside the library"))
        if _of(chosen, kind)
    )]  # fmt: skip
    named = {one.ours.named[0] for one in chosen if len(one.ours.named) == 1}
    columns = [*sorted({*singles, *named}), *_ELSE]
    counts = np.zeros((len(truths), len(columns)))
    for one in chosen:
        other = {"none": "nothing", "outside": "outside the library"}
        label = other.get(one.kind) or one.truth[0]
        counts[truths.index(label), columns.index(_column(one))] += 1
    return truths, columns, counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)


def _column(row: Row) -> str:
    answer = row.ours
    if row.kind == "single" and row.right(answer):
        return row.truth[0]
    if len(answer.named) == 1:
        return answer.named[0]
    if answer.named:
        return "several"
    codes = {"unexplained": "unexplained", "nothing_missing": "nothing missing"}
    return codes.get(answer.status, "no answer")


def figure(rows: Sequence[Row], path: Path) -> None:
    """Confusion matrices at little and at much noise, as PNG."""
    from matplotlib.figure import Figure

    panels = [
        ("noise ≤ 1e-3", [one for one in rows if one.noise <= 1e-3]),
        ("noise 5e-2", _at(rows, 5e-2)),
    ]
    panels = [(label, some) for label, some in panels if some]
    drawing = Figure(figsize=(9.0 * len(panels), 9.5), layout="constrained")
    for axis, (label, some) in zip(
        drawing.subplots(1, len(panels), squeeze=False)[0], panels, strict=True
    ):
        truths, columns, shares = confusion(some)
        axis.imshow(shares, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
        axis.set_xticks(range(len(columns)), [_shown(one) for one in columns], rotation=90)
        axis.set_yticks(range(len(truths)), [_shown(one) for one in truths])
        axis.set(title=f"{label}, {len(some)} cases", xlabel="named", ylabel="hidden")
        for i, j in zip(*np.nonzero(shares), strict=True):
            color = "white" if shares[i, j] > 0.6 else "black"
            axis.text(j, i, f"{100 * shares[i, j]:.0f}", ha="center", va="center", color=color,
                      fontsize=7)  # fmt: skip
    drawing.suptitle("What was named for what is hidden, in percent of each row")
    path.parent.mkdir(exist_ok=True)
    drawing.savefig(path, dpi=110)


def _shown(name: str) -> str:
    return name.replace("_", " ")
