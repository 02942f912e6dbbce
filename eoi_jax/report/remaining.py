"""What is left of a refined model's error, as a figure."""

from typing import Any

import numpy as np

from eoi_jax.refinement.remaining import Remaining
from eoi_jax.report.style import (
    AFTER,
    WIDTH,
    finished,
    ink,
    legend_above,
    new,
    series,
    shortened,
    styled,
)

_SINGLE, _PAIRS = 8, 4  # candidates that are drawn
_FAINT = 0.35  # opacity of what may be chance


@styled()
def remaining_figure(result: Remaining) -> Any:
    """Share of the free run's error that each effect, and each pair, explains.

    Args:
        result: of `remaining`.

    Returns:
        A `matplotlib.figure.Figure`; save it with ``figure.savefig(path)``.
    """
    shown = [*result.ranking[:_SINGLE], *result.pairs[:_PAIRS]]
    figure = new(WIDTH, 1.1 + 0.26 * len(shown))
    axes = figure.add_subplot()
    for sure in (True, False):
        rows = [i for i, one in enumerate(shown) if (one.significance < result.level) == sure]
        axes.barh(
            rows,
            [100.0 * shown[i].share for i in rows],
            height=0.65,
            color=series(AFTER) if sure else ink(),
            alpha=1.0 if sure else _FAINT,
            label="significant" if sure else "may be chance",
        )
    names = [" + ".join(one.names).replace("_", " ") for one in shown]
    axes.set_yticks(np.arange(len(shown)), [shortened(name) for name in names])
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    axes.set_xlabel("share of the free run's squared error [%]")
    legend_above(axes)
    return finished(figure)


def remaining_text(result: Remaining) -> str:
    """The first ones of the ranking, and of the pairs; what held-out records say."""
    rows = [f"{'effect':<42} {'share':>8} {'by chance':>10}  values"]
    for one in (*result.ranking[:8], *result.pairs[:4]):
        values = ", ".join(f"{name} {value:.4g}" for name, value in one.values.items())
        label = " + ".join(one.names)
        rows.append(f"{label:<42} {100 * one.share:>6.1f} % {one.significance:>10.2g}  {values}")
    if result.held_out is not None:
        before = _numbers(result.held_out.rmse)
        rows += [
            f"held out with {' + '.join(one.candidate.names)}: {before} before, "
            f"{_numbers(one.held_out.rmse)} after"
            for one in result.trials
        ]
    if result.best is None:
        refused = "None of them lowers the error on held-out records."
        return "\n".join([*rows, refused if result.trials else "None of them is significant."])
    lacks = " and ".join(one.effect.sentence for one in result.best.placed)
    return "\n".join([*rows, f"The model lacks {lacks}."])


def _numbers(values: np.ndarray) -> str:
    return ", ".join(f"{value:.4g}" for value in values)
