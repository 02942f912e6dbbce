"""The numbers that decide an answer of `discover`, stage by stage.

None is an argument of `discover`: an answer must not depend on a threshold that its reader did not
see. Where a number was set with data in view its class says so; `benchmarks/defaults.md` has the
details. What only bounds time or rounding stands in the module that uses it.
"""

from dataclasses import dataclass, field


@dataclass(frozen=True)
class ModeRules:
    """The cosine modes of a record (`cosine_modes.py`).

    Times are in units of 1/band. Set with development seeds of `undeclared_effects` in view.

    Attributes:
        band: highest frequency of the modes over the cut-off of F.
        widest: largest increase of that band where fast modes are informative: far beyond F a rig
            has further dynamics.
        power: share of the power of y^(r) below half of the band, above which faster modes are
            informative.
        low: number of the lowest modes that are used: a sinusoid appears in two of them.
        high: number of higher ones, an even selection: as informative as all, and cheaper.
        sharp: rise time of the weights next to excluded samples, for small noise.
        soft: the same for large noise: the noise that leaks into low modes falls with its square.
        ends: rise time at the ends of a record.
        shortest_rest: shortest rest that is excluded under large noise.
        leak: noise that the edges may add, relative to y^(r), rms.
        quiet: cut-off of the smoothing over the frequency where noise hides a state.
        lost: share of a state above the noise that smoothing may remove.
        slope: exponent of its gain 1 - (ω/cut-off)^slope.
        least_end: shortest rise at the ends, as a share of the record.
        most_lost: largest share of the weight of all samples that moments of rest may remove.
    """

    band: float = 2.0
    widest: float = 2.0
    power: float = 0.99
    low: int = 1000
    high: int = 500
    sharp: float = 3.0
    soft: float = 10.0
    ends: float = 20.0
    shortest_rest: float = 6.0
    leak: float = 2e-3
    quiet: float = 1.5
    lost: float = 2e-3
    slope: int = 8
    least_end: float = 0.01
    most_lost: float = 0.5


@dataclass(frozen=True)
class NoiseRules:
    """The power S of a residual (`noise_spectrum.py`).

    Attributes:
        floor: ε, errors in proportion to the signal of a mode and its neighbours.
        flat: δ, errors in proportion to the signal of all modes.
        reach: modes on each side over which the signal is averaged.
    """

    floor: float = 2e-3
    flat: float = 1e-4
    reach: int = 12


@dataclass(frozen=True)
class LagRules:
    """Lags at which the residual follows an input (`lags.py`).

    Attributes:
        threshold: standard deviations of a correlation of noise from which on it is a peak.
        longest: share of a record.
        peaks: number of lags.
    """

    threshold: float = 6.0
    longest: float = 0.25
    peaks: int = 2


@dataclass(frozen=True)
class WavenumberRules:
    """Wavenumbers at which the residual repeats along the position (`wavenumbers.py`).

    Attributes:
        threshold: standard deviations of a spectrum of noise from which on it is a peak.
        fewest: periods over the range up to which the grid of ripples has them.
        most: the same, above which none is sought.
        noise: length of the shortest wave over the noise of the position.
        peaks: number of wavenumbers.
    """

    threshold: float = 6.0
    fewest: int = 25
    most: int = 20_000
    noise: float = 20.0
    peaks: int = 2


@dataclass(frozen=True)
class SearchRules:
    """The search over sets of effects (`search.py`).

    Set with development seeds of `undeclared_effects` in view.

    Attributes:
        beam: sets of one size that are refined.
        last: sets that are refined once more under the residual power of the answer, at most.
        last_margin: their largest distance in value from the best set.
        pairs: pairs of columns that are evaluated.
        pair_tries: points of the grid at which a pair may turn out unphysical.
        exact: effects that are fitted exactly after the quick ranking.
        rounds: of power and set.
        material: share of the declared model's residual that an effect must explain.
        remainder: the same of what the others leave above the noise, where that is less.
        half: the same of all that they leave.
        trace: share of y^(r) that an effect must explain in any case.
        nested: as `material`, for an effect beside a simpler one that it contains.
        forms: power that a set leaves over that of the best one, up to which the dependences in it
            are tried in all forms of their laws. No data were in view.
    """

    beam: int = 5
    last: int = 3
    last_margin: float = 50.0
    pairs: int = 400
    pair_tries: int = 3
    exact: int = 8
    rounds: int = 4
    material: float = 0.015
    remainder: float = 0.9
    half: float = 0.5
    trace: float = 1e-8
    nested: float = 5e-4
    forms: float = 10.0


@dataclass(frozen=True)
class RoundRules:
    """A round: the candidates, and the tests of the sets (`round.py`).

    Set with development seeds of `undeclared_effects` in view.

    Attributes:
        peaks: frequencies at which a sinusoid is tried.
        periodic: autocorrelation from which on a motion is periodic.
        harmonics: of it that are tested.
        product: share of a set's residual power above which a product of signals refutes it.
        notable: the same of the power that the model lacks.
        extensions: of a set that are evaluated.
        similar_levels: largest ratio of friction levels that are read as a level and an offset.
        told_apart: difference of twice the log-likelihood above which sets are distinguished.
        noise_like: mean square of a residual over its predicted power up to which it is noise.
    """

    peaks: int = 6
    periodic: float = 0.95
    harmonics: int = 4
    product: float = 0.5
    notable: float = 0.005
    extensions: int = 3
    similar_levels: float = 1.5
    told_apart: float = 10.0
    noise_like: float = 1.3


@dataclass(frozen=True)
class AnswerRules:
    """Which set is an answer (`acceptance.py`, `confirm.py`, `parsimony.py`, `rivals.py`).

    Set with development seeds of `undeclared_effects`, and with emps and the tanks in view.

    Attributes:
        passes: of the declared model at most: the search starts from its converged fit.
        rounds: of the search, at most.
        explained: share of the residual's power from which on a set is an answer.
        half: share that is enough if no other effect explains nearly as much power alone as the
            main one, and free runs on held-out data confirm the set.
        rival: share of the power that the main effect explains alone, from which on another effect
            comes near.
        rare_share: least share explained by a set with a rare effect.
        rare_most: effects in such a set, at most; one for each output where these are more.
        negligible: residual over y^(r), both rms, below which nothing is missing.
        confirmed: largest ratio of the errors after and before, in every free run, that confirms.
        noise: error of short free runs over the noise of a sensor, above which it is not noise. Of
            right answers it is at most 1.2 in `undeclared_effects`, 1.7 with a load that is not
            measured, whose start is told by few samples; of two of `other_rigs` it is 2.1 and 2.7.
        bounded_noise: the same where samples are so far apart that differences show the motion,
            and the noise is only known from above.
        by_chance: probability with which noise that is read off few samples explains an error.
        as_good: largest ratio of the errors of a simpler and a wider law at which it is preferred.
        offset_errors: standard errors within which an offset beside dry friction is negligible.
        offset_share: share of the friction level below which it is.
        known: standard error over the value, up to which the size of a parameter is known.
        extra: share of an effect above which an addition by one that contains it is ambiguous.
        end: distance from an end of what was searched that counts as none, over its range.
    """

    passes: int = 30
    rounds: int = 3
    explained: float = 0.9
    half: float = 0.5
    rival: float = 0.2
    rare_share: float = 0.95
    rare_most: int = 2
    negligible: float = 0.01
    confirmed: float = 2.0 / 3.0
    noise: float = 2.0
    bounded_noise: float = 1.5
    by_chance: float = 0.99
    as_good: float = 1.01
    offset_errors: float = 2.0
    offset_share: float = 1e-2
    known: float = 0.5
    extra: float = 0.5
    end: float = 1e-3


@dataclass(frozen=True)
class ProbabilityRules:
    """What is said of rivals (`probability.py`); no data were in view.

    Attributes:
        told: probability from which on a rival is listed.
        alternative: probability from which on it is named beside the effect.
        likely: probability of an effect below which the answer tells it as possible: even odds.
        sure: probability of an effect of the injection, below which it goes where free runs find
            others beside it and do not need it. Set with a valve in view that has a dead zone.
        implausible: difference of twice the log-likelihood above which a set has no weight.
        largest_odds: of a rival in free runs: a few blocks can say no more.
    """

    told: float = 0.01
    alternative: float = 0.1
    likely: float = 0.5
    sure: float = 0.9
    implausible: float = 25.0
    largest_odds: float = 1e6


@dataclass(frozen=True)
class RefinementRules:
    """The refinement on request, and of passes that are biased (`refined.py`).

    Attributes:
        additions: of effects that only free runs show, at most.
        negligible: relative change of an error that counts as none.
        first_steps: of the solver, in which a fit from passes without bias has converged. More of
            them take time where passes are right, fewer let what follows take it. Set with an
            oscillator of van der Pol, circuits and doses in view.
        hint: probability by chance, for all tries together, below which what free runs alone show
            is told where nothing is missing.
        hint_samples: of the records at most, where that is asked: it takes as long as the search.
    """

    additions: int = 3
    negligible: float = 0.01
    first_steps: int = 5
    hint: float = 1e-4
    hint_samples: int = 2000


@dataclass(frozen=True)
class JudgeRules:
    """What decides between models; errors are natural logarithms of root mean squares."""

    # Fall of the mean error from which on an effect stays, and below which it is left out again;
    # for each further parameter of a law that contains a simpler one, and each unit of rarity.
    # Set with the sets of `benchmarks/measured/campaign_cases.py` in view; it was not varied.
    min_fall: float = 0.03
    min_deviations: float = 2.0  # of the paired difference over blocks, in its standard errors
    # The same of the records of the fit and of those that judge, as the sum of two standard normal
    # variables over √2. Both are set with the sets of `found_mixed_cases.py` in view.
    min_joint_deviations: float = 2.5
    # Fall of the errors on one of these kinds over that on the other, at least. Set with
    # dye_reactor in view, where an offset lowers them by 0.06 and 1.37.
    least_share: float = 0.1
    same_error: float = 0.01  # difference of mean errors that counts as none
    noise_known: float = 0.03  # error of the square of the noise that samples show, over it
    blocks: int = 10  # of each record, whose errors are compared in pairs
    # Windows of a record: as many as leave motion in them. Set with car_coast_down in view.
    windows: tuple[int, ...] = (10, 5, 3)
    motion: float = 3.0  # spread of an output in a window over its noise, at least
    # Samples that give the state of a run, at most; a third of a short run, and of a whole one no
    # more than a block for each derivative. Set with torsion_rig in view.
    start: int = 50
    min_window: int = 12  # samples, for each unknown of the start of an output
    fewest: int = 8  # samples of a record that judges, in whole runs alone where that is so short
    # Error of a whole run over the spread, from which on it says nothing of a plant in which errors
    # of a start grow. Set with dfki_simple_pendulum in view.
    misled: float = 0.1
    largest_error: float = 1e3  # over the standard deviation of the output: of what diverges
    # Steps of a simulation of all records, at most: some seconds. A curve as steep as dry friction
    # would take more than all else. Set with throttle_valve in view.
    steps: int = 2_000_000


@dataclass(frozen=True)
class FreeRunRules:
    """What is tried in the search."""

    # Samples, of all outputs together, in which effects are searched: a score test of 40 000 takes
    # some seconds. Models are refined on all records in the end.
    samples: int = 40_000
    # Steps of these times states, and their derivatives by parameters and starts: of a plant of
    # second order with three parameters and one output 52 000 samples. Set with qube and
    # dfki_double_pendulum in view, of which a search took a quarter of an hour and more.
    work: int = 2_500_000
    # Set with the sets of `benchmarks/measured/campaign_cases.py` in view, as are `tried` and
    # `same_cost`; none of these was varied.
    most: int = 4  # effects or pairs that are added one after another
    tried: int = 6  # candidates that are refined with in each round
    of_a_kind: int = 2  # of these or besides, of each kind: on inputs or not, with a memory or not
    dependences: int = 2  # with a parameter that depends on a signal, besides; with steam_exchanger
    # in view, whose cells such a one had displaced
    products: int = 3  # of these with a product of signals, which names no cause
    shapes: int = 2  # effects at other maxima of the score test; with throttle_valve in view
    # Share of the power of the errors, in the score test, from which on a candidate is tried beside
    # what explains the injection. A fall of the errors by a third takes 0.56 of their power; the
    # rest is room for what a linear test does not see. Set with levitator_coil in view.
    share: float = 0.45
    # Power of the errors that a candidate may leave in the score test, over that which the best one
    # leaves: one that is missing alone takes 98 % and more. Set with `beyond_library` in view.
    remainder: float = 5.0
    # Power of a declared term that an effect takes in its place, along the free runs, from which on
    # it is tried there: of a swing of one amplitude friction takes 0.81 of a viscous term.
    likeness: float = 0.5
    replacing: int = 2  # effects that are tried in place of a term
    # Steps of the solver in a fit, at most, where records are short: valleys are narrow where two
    # parameters do nearly the same, and what ends in one depends on where it began. Set with
    # ccd_cooler and mash_tun in view, whose lags were at half of their values after twenty.
    steps: int = 100
    fewest_steps: int = 20  # the same of long records
    stepped: int = 200_000  # samples times steps between the two
    slow: float = 5.0  # time constants in the longest record, of a leak that a fit begins with
    same_cost: float = 0.06  # fall of the fit's cost, Σ log rms², that does not tell holds apart


@dataclass(frozen=True)
class QuestionRules:
    """Which answers that explain the injection are questioned. Set with `levitator_coil` in view.

    Attributes:
        motion: error over the noise that is read off a record, below which that is motion as well.
        small: error over the spread of the output that is not worth a search.
        negligible: the same of an answer that explains the injection: sensors show no less.
        wide: the same of an answer of the injection from which on the search begins anew. Set with
            the saturating uptake of `beyond_library` in view.
        contradicted: index of an answer of free runs, over that of one that the injection
            justifies, from which on it does not take its place. Set with emps in view.
        useless: the same of a model that a constant is better than, whatever the noise. Set with
            indomethacin in view.
        poor: the same of an answer that nothing is missing, from which on it says so.
        follows: the same of free runs that tell of the influence of inputs, at most.
        no_influence: ratio by which they miss more with the mean of an input in its place, below
            which it has next to none.
        scored: share of the samples of whole runs that windows score, at least, to tell more.
        silent: error over the noise up to which a declared model lacks nothing that held-out
            records show, whatever the injection leaves. Set with circuits that are sampled at half
            to one time constant in view.
        own_share: part of each record that is held out at its end where no others were given.
    """

    motion: float = 0.7
    small: float = 0.01
    negligible: float = 1e-4
    wide: float = 0.05
    contradicted: float = 2.0
    useless: float = 1.25
    poor: float = 0.8
    follows: float = 0.5
    no_influence: float = 1.1
    silent: float = 1.2
    scored: float = 0.5
    own_share: float = 0.3


@dataclass(frozen=True)
class CurveRules:
    """How curves are tried.

    Attributes:
        knots: of a curve, at most. fewest: at least. samples: of a record, for each knot.
        trials: curves of each model, at most.
        share: of the power of the errors that a curve must take in the score test to be tried.
        linear: factor of an error within which the score test says what a fit will come to.
        sure: share that is enough in any case: where errors are large a linear test says little.
        remainder: power that it may leave there, over that of the best one.
        several: effects, an offset apart, in whose place a curve comes that is as good.
        finer: factor of their error within which a curve must be for points in between to be tried.
        as_good: difference of mean logarithms of errors that counts as none.
        likeness: share of a curve that a law must give to be named beside it.
        tie: difference of such shares at which the law with fewest parameters is named.
        points: of the signal, at which they are compared.
    """

    knots: int = 14
    fewest: int = 5
    samples: int = 50
    trials: int = 3
    share: float = 0.3
    linear: float = 2.0
    sure: float = 0.6
    remainder: float = 5.0
    several: int = 3
    finer: float = 2.0
    as_good: float = 0.03
    likeness: float = 0.9
    tie: float = 0.05
    points: int = 400


@dataclass(frozen=True)
class HoldRules:
    """How final models under different holds are compared.

    Attributes:
        same: relative difference of their indices that counts as none.
        stand_ins: effects that a wrong hold or a skew takes the shape of; their last parameter is
            a time by which the input acts later, one before it a lead.
        longest: such time that may be one of the logger [sample periods]: a skew of one, and half
            a one between what was held and what goes on.
        shortest: skew that is told from none [sample periods].
        half: distance from half a sample within which a delay may be a hold [sample periods].
        better: relative fall of the index of a final model from which on a search follows with
            another hold of a single input of several: one that hardly drives the plant fits alike
            with all.
        searches: at most, with other holds than the first one.
    """

    same: float = 0.02
    better: float = 5e-3
    searches: int = 2
    stand_ins: tuple[str, ...] = ("input_delay", "actuator_lag", "input_rate")
    longest: float = 1.5
    shortest: float = 0.02
    half: float = 0.15


@dataclass(frozen=True)
class DifferenceRules:
    """When records are said to differ.

    Attributes:
        most: records that are compared.
        deviations: by which their offsets differ from the common one, root mean square, in standard
            errors.
    """

    most: int = 20
    deviations: float = 5.0


@dataclass(frozen=True)
class OwnParameterRules:
    """When records are said to ask for different parameters (`own_parameters.py`).

    Set with a hoist of three loads and a vehicle with two ballasts in view.

    Attributes:
        most: records that are compared.
        ratio: error with parameters of each record over that with common ones, at most.
        small: error over the spread of an output that counts as none.
        deviations: of a parameter in two records, in standard errors of the difference.
        effects: that are added to the model at most. trials: in each round, for one.
        starts: of the fit with common parameters, from the values of as many records.
        steps: of the solver in a fit, at most.
        work: steps of these simulations times states and their derivatives, as in `FreeRunRules`:
            of longer records the beginnings are compared. windows: of these, at least.
    """

    most: int = 6
    ratio: float = 1.0 / 3.0
    small: float = 0.01
    deviations: float = 4.0
    effects: int = 2
    trials: int = 3
    starts: int = 3
    steps: int = 50
    work: int = 600_000
    windows: int = 2


@dataclass(frozen=True)
class DiscoveryRules:
    """All of them.

    Attributes:
        modes, noise, lags, wavenumbers: of the injection.
        search, round, answer: of the search in the injection, and of its answer.
        probability: of effects against their rivals.
        judge, free_runs, questions: of free runs on held-out records.
        curves: where no law fits.
        holds: of how the records were made.
        differences: between records. own_parameters: of these.
        refinement: on request.
    """

    modes: ModeRules = field(default_factory=ModeRules)
    noise: NoiseRules = field(default_factory=NoiseRules)
    lags: LagRules = field(default_factory=LagRules)
    wavenumbers: WavenumberRules = field(default_factory=WavenumberRules)
    search: SearchRules = field(default_factory=SearchRules)
    round: RoundRules = field(default_factory=RoundRules)
    answer: AnswerRules = field(default_factory=AnswerRules)
    probability: ProbabilityRules = field(default_factory=ProbabilityRules)
    judge: JudgeRules = field(default_factory=JudgeRules)
    free_runs: FreeRunRules = field(default_factory=FreeRunRules)
    questions: QuestionRules = field(default_factory=QuestionRules)
    curves: CurveRules = field(default_factory=CurveRules)
    holds: HoldRules = field(default_factory=HoldRules)
    differences: DifferenceRules = field(default_factory=DifferenceRules)
    own_parameters: OwnParameterRules = field(default_factory=OwnParameterRules)
    refinement: RefinementRules = field(default_factory=RefinementRules)


RULES = DiscoveryRules()
