"""Forces with memory."""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from eoi_jax.data.recursion import states
from eoi_jax.models.effects.effect import AbstractTerm, At, Grid, Parameter, Seen, mechanical
from eoi_jax.models.plant import Plant


class Hysteresis(AbstractTerm):
    r"""Bouc–Wen: -k z, δ dz/dt = v - β |v| z - (1 - β) v |z|.

    z runs between -1 and 1: a spring k/δ for small motion that yields at the force k. δ is the
    yield displacement, β the share of hysteresis in the loop's shape.

    Source: Wen, J. Eng. Mech. Div. ASCE 102 (1976) 249, n = 1, with the state scaled to one.
    """

    name = "hysteresis"
    sentence = "hysteresis (Bouc–Wen): a spring that yields"
    gains = (Parameter("force", "{f}", lower=0.0),)
    shapes = (
        Parameter("displacement", "{y}", lower=0.0),
        Parameter("share", "1", lower=0.0, upper=1.5),
    )
    states = 1
    depends_on = "y"
    contains = ("coulomb_friction",)

    def fits(self, plant: Plant, output: int) -> bool:
        return mechanical(plant, output)

    def grid(self, seen: Seen) -> Grid:
        reach = 0.5 * np.ptp(seen.y)
        sizes, shares = np.geomspace(0.03, 1.5, 7) * reach, np.array([0.4, 0.8])
        return np.stack(np.meshgrid(sizes, shares, indexing="ij"), axis=-1).reshape(-1, 2)

    def rate(self, at: At, shape: Any) -> Any:
        size, share = shape
        return (at.v - share * jnp.abs(at.v) * at.z - (1.0 - share) * at.v * jnp.abs(at.z)) / size

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        return -gain[0] * at.z[0]


class AbstractDecay(AbstractTerm):
    """a z, dz/dt = -b z - dy/dt: a force by a difference that decays while the output rests."""

    shapes = (Parameter("rate", "1/s", lower=0.0),)
    states = 1
    depends_on = "y"
    follows_slope = True
    only_in_free_runs = True

    @abstractmethod
    def fits(self, plant: Plant, output: int) -> bool:
        """Whether such a difference is meaningful for this output."""

    def grid(self, seen: Seen) -> Grid:
        return np.geomspace(1.0 / seen.duration, 0.5 / seen.sample_period, 12)[:, None]

    def rate(self, at: At, shape: Any) -> Any:
        return -shape[0] * at.z - at.slope

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        return gain[0] * at.z[0]

    def states_along(
        self,
        y: Float[np.ndarray, "runs S 3"],
        v: Float[np.ndarray, "runs S 3"],
        period: float,
        shape: np.ndarray,
    ) -> Float[np.ndarray, "1 runs S 3"]:
        del v
        # Exact for y that is straight between its samples; from zero on.
        decay = np.exp(-shape[0] * period)
        mean = (1.0 - decay) / (shape[0] * period)
        change = (y[..., 2] - y[..., 0]).T
        ends = states(np.full((1, 1), decay), np.full(1, -mean), change)[:, 0].T
        begins = np.concatenate([np.zeros((len(y), 1)), ends[:, :-1]], axis=1)
        return np.stack([begins, 0.5 * (begins + ends), ends], axis=-1)[None]


class SecondNode(AbstractDecay):
    r"""A store that is not measured, beside the measured one: a (z - y), dz/dt = b (y - z).

    Heat in a housing, charge behind a resistance, gas behind a throttle. In equilibrium at the
    start of a record; the state is the difference w = z - y, dw/dt = -b w - dy/dt.
    """

    name = "second_node"
    sentence = "a second store, not measured, that exchanges with the first one"
    gains = (Parameter("exchange", "{f/y}", lower=0.0),)

    def fits(self, plant: Plant, output: int) -> bool:
        return plant.degrees[output] == 1


class MaxwellElement(AbstractDecay):
    r"""A spring and a damper in series: a force -k w, dw/dt = dy/dt - b w.

    w is the stretch of the spring, b = k/c with the damper c, 1/b the time of relaxation. Rubber
    and foam, a mount with oil, the suspension of a loudspeaker that creeps; eddy currents, whose
    inductance is the spring. Relaxed at the start of a record; the state is z = -w.

    Source: J. C. Maxwell, Phil. Trans. R. Soc. 157 (1867) 49; a spring beside it makes the standard
    linear solid (Zener).
    """

    name = "maxwell_element"
    sentence = "a spring and a damper in series, which relax (rubber, a mount with oil)"
    gains = (Parameter("stiffness", "{f/y}", lower=0.0),)

    def fits(self, plant: Plant, output: int) -> bool:
        # In free motion a spring, a damper and this have more parameters than there are modes.
        return mechanical(plant, output) and bool(plant.inputs)


class Relaxation(AbstractTerm):
    r"""-a z, τ dz/dt = u - z: a part of an output that follows the input with a lag.

    The voltage of an RC pair of a battery, diffusion, creep of a sensor. It fits an output that is
    a function of the states and of the input (relative degree 0), which shows the drop at once; z
    is zero at the start of a record.
    """

    name = "relaxation"
    sentence = "a part that follows the input with a lag (relaxation, an RC pair)"
    gains = (Parameter("gain", ""),)
    shapes = (Parameter("time", "s", lower=0.0),)
    states = 1
    depends_on = "u"

    def fits(self, plant: Plant, output: int) -> bool:
        return plant.degrees[output] == 0 and bool(plant.inputs)

    def grid(self, seen: Seen) -> Grid:
        return np.geomspace(2.0 * seen.sample_period, 0.5 * seen.duration, 12)[:, None]

    def rate(self, at: At, shape: Any) -> Any:
        return (at.u - at.z) / shape[0]

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        return -gain[0] * at.z[0]


@dataclass(frozen=True)
class SecondMass(AbstractTerm):
    r"""A mass that is not measured, behind a spring with damping: r (ω² w + c (p - v)).

    The load behind a flexible joint, the first mode of a beam; of an output that is a position, or
    a speed of relative degree one. w is the stretch of the spring and p the speed of the mass,
    dw/dt = p - v, dp/dt = -ω² w - c (p - v), and r its inertia over that of the measured one. ω is
    its frequency where that is held; left free, both swing with ω √(1 + r). At rest at the start of
    a record.

    Or the damping is that of a bearing of the mass, which takes its force from the ground: the
    force is r ω² w, and dp/dt = -ω² w - c p.

    Attributes:
        in_bearing: whether it is the second form.
    """

    name = "second_mass"
    sentence = "a second mass, not measured, that swings behind a spring"
    rarity = 1.0  # three parameters fit much
    gains = (Parameter("ratio", "1", lower=0.0),)
    shapes = (Parameter("frequency", "rad/s", lower=0.0), Parameter("damping", "1/s", lower=0.0))
    states = 2
    depends_on = "y"
    only_in_free_runs = True

    in_bearing: bool = False

    @property
    def form(self) -> str:
        """Where the damping acts."""
        return "damped in its bearing" if self.in_bearing else "damped in the spring"

    def fits(self, plant: Plant, output: int) -> bool:
        # In free motion its modes are fewer than its parameters and those of the plant.
        moves = mechanical(plant, output) or plant.kinds[plant.outputs[output]] == "speed"
        return moves and bool(plant.inputs)

    def grid(self, seen: Seen) -> Grid:
        # A mode with little damping is only met near its frequency, where the residual has a peak.
        slowest, fastest = 2.0 * np.pi / seen.duration, 0.3 * np.pi / seen.sample_period
        peaks = seen.peaks[(seen.peaks > slowest) & (seen.peaks < fastest)]
        frequencies = np.concatenate([np.geomspace(slowest, fastest, 8), peaks])
        shares = np.array([0.1, 0.6])  # of the damping, over the frequency
        pairs = np.meshgrid(frequencies, shares, indexing="ij")
        return np.stack([pairs[0], pairs[0] * pairs[1]], axis=-1).reshape(-1, 2)

    def further_starts(self, values: Sequence[float]) -> list[tuple[float, ...]]:
        # The residual shows the frequency with which both swing, ω √(1 + r), as if r were small.
        _, joint, damping = values
        return [(r, joint / np.sqrt(1.0 + r), damping) for r in (1.0, 4.0)]

    def rate(self, at: At, shape: Any) -> Any:
        relative = at.z[1] - at.v
        damped = at.z[1] if self.in_bearing else relative
        return jnp.stack([relative, -(shape[0] ** 2) * at.z[0] - shape[1] * damped])

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        force = shape[0] ** 2 * at.z[0]
        return gain[0] * (force if self.in_bearing else force + shape[1] * (at.z[1] - at.v))

    def states_along(
        self,
        y: Float[np.ndarray, "runs S 3"],
        v: Float[np.ndarray, "runs S 3"],
        period: float,
        shape: np.ndarray,
    ) -> Float[np.ndarray, "2 runs S 3"]:
        del y
        # Exact for a velocity that keeps its mean in each half sample: (w, p) decays freely in it,
        # to p = v and the stretch that pulls it through its bearing. It moves with the measured one
        # at first.
        from scipy.linalg import expm  # only discovery needs it

        nodes = np.concatenate([v[..., :2].reshape(len(v), -1), v[:, -1:, 2]], axis=1)
        speeds = 0.5 * (nodes[:, 1:] + nodes[:, :-1]).T
        decay = expm(0.5 * period * np.array([[0.0, 1.0], [-(shape[0] ** 2), -shape[1]]]))
        start = np.stack([np.zeros(len(v)), nodes[:, 0]])
        goal = np.array([-shape[1] / shape[0] ** 2 if self.in_bearing else 0.0, 1.0])
        course = states(decay, goal - decay @ goal, speeds, start)
        course = np.concatenate([start[None], course])
        return np.stack([course[:-2:2], course[1::2], course[2::2]]).transpose(2, 3, 1, 0)
