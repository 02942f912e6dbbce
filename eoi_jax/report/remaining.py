"""The remaining error of a refined model as text and as a figure."""

from typing import Any

import numpy as np

from eoi_jax.models.placements import place_text, placed_label
from eoi_jax.refinement.remaining import Remaining
from eoi_jax.refinement.score_test import Candidate
from eoi_jax.report.style import (
    ACCENT,
    WIDTH,
    fix_theme,
    legend_above,
    new_figure,
    series,
    shortened,
    text_colour,
    themed,
)


@themed()
def remaining_figure(result: Remaining, opacity: float = 0.35) -> Any:
    """Share of the free-run error that each effect, and each pair, explains.

    Args:
        result: of `remaining`.
        opacity: of candidates that are not significant.

    Returns:
        A `matplotlib.figure.Figure`; save it with ``figure.savefig(path)``.
    """
    candidates = _first_candidates(result)
    figure = new_figure(WIDTH, 1.1 + 0.26 * len(candidates))
    axes = figure.add_subplot()
    for significant in (True, False):
        rows = [
            i
            for i, candidate in enumerate(candidates)
            if (candidate.significance < result.level) == significant
        ]
        axes.barh(
            rows,
            [100.0 * candidates[i].share for i in rows],
            height=0.65,
            color=series(ACCENT) if significant else text_colour(),
            alpha=1.0 if significant else opacity,
            label="significant" if significant else "not significant",
        )
    names = [
        " + ".join(at.effect.words + place_text(result.plant, at) for at in candidate.placed)
        for candidate in candidates
    ]
    axes.set_yticks(np.arange(len(candidates)), [shortened(name) for name in names])
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    axes.set_xlabel("share of the squared free-run error [%]")
    legend_above(axes)
    return fix_theme(figure)


def _first_candidates(result: Remaining, effects: int = 8, pairs: int = 4) -> list[Candidate]:
    """The first effects and pairs of the ranking: as many as a table shows at a glance."""
    return [*result.ranking[:effects], *result.pairs[:pairs]]


def remaining_text(result: Remaining) -> str:
    """The first effects and pairs of the ranking, and the errors on held-out records."""
    candidates = _first_candidates(result)
    width = max([42, *(len(_label(result, candidate)) for candidate in candidates)])
    rows = [f"{'effect':<{width}} {'share':>8} {'by chance':>10}  values"]
    for candidate in candidates:
        values = ", ".join(f"{name} {value:.4g}" for name, value in candidate.values.items())
        label = _label(result, candidate)
        share, significance = 100 * candidate.share, candidate.significance
        rows.append(f"{label:<{width}} {share:>6.1f} % {significance:>10.2g}  {values}")
    if result.held_out is not None:
        rmse = _numbers(result.held_out.rmse)
        rows += [
            f"held out with {_label(result, trial.candidate)}: {rmse} before, "
            f"{_numbers(trial.held_out.rmse)} after"
            for trial in result.trials
        ]
    if result.best is None:
        refused = "None of them reduces the error on held-out records."
        return "\n".join([*rows, refused if result.trials else "None of them is significant."])
    lacks = [
        f"{placed.effect.sentence}{place_text(result.plant, placed)}"
        for placed in result.best.placed
    ]
    return "\n".join([*rows, f"The model lacks {' and '.join(lacks)}."])


def _label(result: Remaining, candidate: Candidate) -> str:
    """The effects of a candidate, each with what tells it apart from the others."""
    return " + ".join(placed_label(result.plant, placed) for placed in candidate.placed)


def _numbers(values: np.ndarray) -> str:
    return ", ".join(f"{value:.4g}" for value in values)
