"""What `diagnose` returns: the tests of a residual, its maps, and what the records excite."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from eoi_jax._display import Result
from eoi_jax.data.clipping import Saturation

PerOutput = Float[np.ndarray, " ny"]


@dataclass(frozen=True)
class Cross:
    """The residual of one output against one input, both whitened.

    Attributes:
        output, input: names.
        lags: in steps of the thinning [s]; positive if the residual follows the input.
        correlation: at each lag; ± 1.96 / √samples is its 95 % band without a relation.
        p_value: of the largest correlation at lags ≥ 0, corrected for the number of lags.
        lag: lag of the largest correlation [s].
        future_p_value: the same for lags < 0, where the input follows the residual.
        delay: apparent delay of the input [s]; NaN without evidence.
        feedback: whether the input seems to be computed from the output.
    """

    output: str
    input: str
    lags: Float[np.ndarray, " lag"]
    correlation: Float[np.ndarray, " lag"]
    p_value: float
    lag: float
    future_p_value: float
    delay: float
    feedback: bool


@dataclass(frozen=True)
class Map:
    """The residual of one output in bins of equal count of one variable.

    The variable is filtered by F like the residual, so both refer to the same instant.

    Attributes:
        output: name of the output of the residual [unit of y^(r)].
        variable: a name, with ′ for each derivative, or ``"time"``.
        centre: mean of the variable in each bin.
        mean: mean of the residual in each bin.
        band: half width of its 95 % band, for coloured residuals.
        statistic: Wald statistic over its degrees of freedom; about one if all bins are equal.
        p_value: of the hypothesis that all bins are equal.
        explained: share of the residual's power that the means of the bins explain.
    """

    output: str
    variable: str
    centre: Float[np.ndarray, " bin"]
    mean: Float[np.ndarray, " bin"]
    band: Float[np.ndarray, " bin"]
    statistic: float
    p_value: float
    explained: float


@dataclass(frozen=True)
class Window:
    """The information of one stretch of a record about the parameters.

    Attributes:
        record: name. start, stop: [s].
        excitation: smallest eigenvalue of the information per sample, for parameters scaled so
            that each alone has one over all records; 0 without scored samples.
        poor: whether all regressors together have less than a hundredth of their mean power. (A
            chirp, with one frequency at a time, excites little in each window but is not poor.)
    """

    record: str
    start: float
    stop: float
    excitation: float
    poor: bool


@dataclass(frozen=True)
class Confounded:
    """Two parameters whose estimates the data hardly distinguish."""

    first: str
    second: str
    correlation: float


@dataclass(frozen=True)
class Line:
    """A line in the spectrum of an output that no input causes: hum, vibration.

    Attributes:
        output, record: names.
        frequency: frequency of the line [rad/s].
        rms: rms of the line [unit of y].
        share: share of the residual's power.
    """

    output: str
    record: str
    frequency: float
    rms: float
    share: float


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Result):
    """The analysis of the residual of an estimate.

    `plot` shows maps, correlations and excitation.

    Attributes:
        findings: the results in sentences, the most important first.
        outputs, inputs: names; `units` by name, `degrees` r of each output.
        level: level of significance of every test.
        residual_rms: [unit of y^(r)]; NaN where nothing was scored.
        noise_floor: rms of the residual due to measurement noise.
        method_floor: largest rms of the residual due to the discretisation.
        more_than_noise: whether the residual is above both.
        whiteness: p-value of the Ljung-Box test of the thinned and whitened residual.
        white: whether that is above `level`, or no test was possible.
        autocorrelation: of the thinned and whitened residual, at lags 1, 2, …
        thinning: samples of each record per thinned sample.
        offset, offset_error: mean of the residual and its standard error.
        cross: one entry for each output and input.
        maps: for each output against y, its derivatives, u and time.
        strongest: for each output, the significant map that explains most of the residual's power,
            or None.
        excitation: smallest eigenvalue over all records, as in `Window`.
        windows: the stretches of the records.
        confounded: pairs of parameters.
        worst_combination: of parameters, in words; "" if all are about equally certain.
        sliding_fraction: share of scored steps in sliding mode.
        saturation: saturations of inputs and outputs.
        noise, quantum: of each output, the largest over the records [unit of y].
        lines: lines that no input causes and that have a large share of the residual.
    """

    findings: tuple[str, ...]
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    units: dict[str, str]
    degrees: tuple[int, ...]
    level: float
    residual_rms: PerOutput
    noise_floor: PerOutput
    method_floor: PerOutput
    more_than_noise: Bool[np.ndarray, " ny"]
    whiteness: PerOutput
    white: Bool[np.ndarray, " ny"]
    autocorrelation: Float[np.ndarray, "ny lag"]
    thinning: tuple[int, ...]
    offset: PerOutput
    offset_error: PerOutput
    cross: tuple[Cross, ...]
    maps: tuple[Map, ...]
    strongest: tuple[Map | None, ...]
    excitation: float
    windows: tuple[Window, ...]
    confounded: tuple[Confounded, ...]
    worst_combination: str
    sliding_fraction: PerOutput
    saturation: tuple[Saturation, ...]
    noise: PerOutput
    quantum: PerOutput
    lines: tuple[Line, ...] = ()
