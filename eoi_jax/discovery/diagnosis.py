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
        lags: [s]; positive where the residual follows the input, in steps of the thinning.
        correlation: at each lag; ± 1.96 / √samples is its 95 % band without a relation.
        p_value: that the largest at lags ≥ 0 is chance, corrected for the number of lags.
        lag: at which it is largest [s].
        future_p_value: the same for lags < 0: inputs that follow the residual.
        delay: by which the input seems to act late [s]; NaN without evidence.
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

    The variable went through the filter F as the residual did, so both belong to one instant.

    Attributes:
        output: whose residual [unit of y^(r)].
        variable: a name; with ′ for each derivative, or ``"time"``.
        centre: mean of the variable in each bin.
        mean: of the residual.
        band: half width of its 95 % band, for coloured residuals.
        statistic: Wald statistic over its degrees of freedom: one if all bins are alike.
        p_value: that all bins are alike.
        explained: share of the residual's power that the bins' means hold.
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
    """What one stretch of a record says about the parameters.

    Attributes:
        record: name. start, stop: [s].
        excitation: smallest eigenvalue of the information per sample, for parameters scaled so
            that each alone has one over all records; 0 without scored samples.
        poor: whether all regressors together have below a hundredth of their mean power. (One
            frequency at a time, as in a chirp, is little excitation in each window, and is not.)
    """

    record: str
    start: float
    stop: float
    excitation: float
    poor: bool


@dataclass(frozen=True)
class Confounded:
    """Two parameters whose estimates the data hardly tell apart."""

    first: str
    second: str
    correlation: float


@dataclass(frozen=True)
class Line:
    """A line in the spectrum of an output that comes from elsewhere: hum, vibration.

    Attributes:
        output, record: names.
        frequency: [rad/s].
        rms: of the line [unit of y].
        share: of the residual's power.
    """

    output: str
    record: str
    frequency: float
    rms: float
    share: float


@dataclass(frozen=True)
class Diagnosis(Result):
    """What the residual of an estimate tells.

    `plot` shows maps, correlations and excitation.

    Attributes:
        findings: sentences, the most important first.
        outputs, inputs: names; `units` by name, `degrees` r of each output.
        level: of significance of every test.
        residual_rms: [unit of y^(r)]; NaN where nothing was scored.
        noise_floor: rms that the record's noise leaves in a residual.
        method_floor: rms that the discretisation may leave.
        more_than_noise: whether the residual is above both.
        whiteness: p-value of the Ljung-Box test of the thinned and whitened residual.
        white: whether that is above `level`, or no test was possible.
        autocorrelation: of the thinned and whitened residual, at lags 1, 2, …
        thinning: samples of each record per thinned sample.
        offset, offset_error: mean of the residual and its standard error.
        cross: one for each output and input.
        maps: for each output against y, its derivatives, u and time.
        strongest: for each output the map that explains most of the residual's power among those
            that are significant, or None.
        excitation: smallest eigenvalue over all records, as in `Window`.
        windows: the records in stretches.
        confounded: pairs of parameters.
        worst_combination: of parameters, in words; "" if all are about equally certain.
        sliding_fraction: share of scored steps in sliding.
        saturation: of inputs and outputs.
        noise, quantum: of each output, the largest over the records [unit of y].
        lines: of outputs that no input drives and that hold much of the residual.
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
