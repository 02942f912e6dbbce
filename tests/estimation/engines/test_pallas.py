"""The kernel for GPUs: interpreted on a CPU it equals the scan, and it lowers for CUDA."""

from contextlib import nullcontext
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eoi_jax.compiler.graph import Untranslatable
from eoi_jax.estimation.engines import Lanes, OneKernel, Scan
from eoi_jax.estimation.kernel import Steps
from eoi_jax.estimation.lowpass import LowPass
from eoi_jax.estimation.observers import FirstOrder, SecondOrder
from eoi_jax.models.library import Plant, cascaded_tanks, level_tank, pendulum

# JAX 0.11 says so of each kernel on a GPU.
pytestmark = pytest.mark.filterwarnings("ignore:The Pallas Triton backend:DeprecationWarning")

H, S, BLOCKS = 5e-3, 240, 4
FILTER = LowPass(15.0).discretise(H)


@pytest.fixture(scope="module", autouse=True)
def _hardly_optimised():
    """These loops take no time to run but seconds to compile."""
    before = jax.config.read("jax_disable_most_optimizations")
    jax.config.update("jax_disable_most_optimizations", True)
    yield
    jax.config.update("jax_disable_most_optimizations", before)


def delayed(t, u, p):
    """Half-way to the input before, an actuator with a parameter."""
    return u - p.lag * (u - jnp.concatenate([u[:1], u[:-1]]))


DRIVEN = Plant(
    lambda t, x, u, p: -p.a * x.y[0] + u, {"a": 0.8, "lag": 0.4}, name="driven", actuator=delayed
)


def coupled(t, x, u, p):
    """Two masses, a spring between them; each rate has parameters that the other has not."""
    (y1, y2), (v1, v2) = x.y
    return jnp.stack([p.k * (y2 - y1) - p.c * v1 + u[0], p.k * (y1 - y2) - p.d * v2])


def rounded(t, x, u, p):
    """Whole numbers by all ways that there are."""
    y = x.y[0]
    whole = jnp.round(3.0 * y) + jnp.floor(-2.0 * y) + (5.0 * y).astype(int).astype(y.dtype)
    return u - p.a * y - p.b * jnp.sign(jnp.sin(9.0 * y)) * whole * jnp.cbrt(y)


ROUNDED = Plant(rounded, {"a": 0.8, "b": 0.1}, name="rounded")

COUPLED = Plant(
    coupled,
    {"k": 50.0, "c": 1.0, "d": 2.0},
    relative_degree=2,
    outputs=("y1", "y2"),
    name="two masses",
)

CASES: dict[str, tuple[Plant, Any]] = {
    "pendulum": (pendulum(), SecondOrder(200.0, 2e3, 5e2)),
    "pendulum, explicit": (pendulum(), SecondOrder(20.0, 2e2, 5e2, "explicit")),
    "level tank": (level_tank(), FirstOrder(20.0)),
    "cascaded tanks": (cascaded_tanks(), FirstOrder(10.0)),
    "two masses": (COUPLED, SecondOrder(200.0, 2e3, 5e2)),
    "driven": (DRIVEN, FirstOrder(20.0)),
    "rounded": (ROUNDED, FirstOrder(20.0)),
}


def steps_of(plant: Plant) -> Steps:
    """A smooth record with a gap; sums are compared, so it need not come from the plant."""
    time = H * np.arange(S + 1)
    ny, nu = len(plant.outputs), len(plant.inputs)
    y = 2.0 + np.sin(np.outer(time, 3.0 + np.arange(ny))) + 0.3 * np.sin(19.0 * time)[:, None]
    u = 1.0 + np.cos(np.outer(time[:-1], 2.0 + np.arange(nu)))
    use, restart = np.ones((S, ny)), np.zeros(S, dtype=bool)
    use[110:120] = 0.0
    restart[[0, 120]] = True
    score = np.where(np.arange(S)[:, None] < 30, 0.0, use)  # all but 40
    ends = np.isin(np.arange(S), [70, 130, 200, S - 1])
    weight = np.linspace(0.5, 1.5, S)
    middle = time[:-1] + 0.5 * H
    return Steps(middle, y[:-1], y[1:], u, use, score, restart, weight, ends, np.asarray(H))  # type: ignore[call-arg]


def lanes_of(
    plant: Plant, observer: Any, count: int, weighed: bool = False, dtype: Any = float
) -> Lanes:
    """Gains, θ and all else differ from lane to lane."""
    scale = np.linspace(0.7, 1.4, count)
    ny, size = len(plant.outputs), len(plant.names)
    draw = np.random.default_rng(7)
    return Lanes(
        jax.tree.map(lambda gain: (gain * scale).astype(dtype), observer),
        (plant.theta * draw.uniform(0.9, 1.1, (count, size))).astype(dtype),
        draw.normal(size=(count, size)).astype(dtype),
        draw.uniform(0.5, 2.0, (count, ny)).astype(dtype),
        draw.integers(0, 3, (count, BLOCKS)).astype(dtype) if weighed else None,
    )


def agree(engine: OneKernel, plant: Plant, lanes: Lanes, store: str, rtol: float) -> None:
    steps = steps_of(plant)
    got = engine.run(plant, lanes, FILTER, steps, store)
    want = Scan().run(plant, lanes, FILTER, steps, store)
    assert lanes.emphasis is not None or np.all(want.count == S - 40)
    assert np.max(np.abs(want.rhs)) > 0
    assert (np.max(np.abs(want.meat)) > 0) == (store == "scores")
    for one, other in zip(jax.tree.leaves(got), jax.tree.leaves(want), strict=True):
        assert one.shape == other.shape
        assert one.dtype == other.dtype
        # The scale of each kind of sum bounds its rounding.
        np.testing.assert_allclose(one, other, rtol=rtol, atol=rtol * np.max(np.abs(other)))


@pytest.mark.parametrize("name", ["pendulum, explicit", "cascaded tanks", "driven", "rounded"])
def test_the_kernel_equals_the_scan(name: str):
    plant, observer = CASES[name]
    agree(OneKernel(tile=4), plant, lanes_of(plant, observer, 5), "nothing", 1e-12)


def test_any_number_of_lanes():
    """Padding up to whole tiles, and to a power of two of them, leaves no trace."""
    plant, observer = CASES["level tank"]
    lanes, engine = lanes_of(plant, observer, 33), OneKernel(tile=8)
    agree(engine, plant, lanes, "nothing", 1e-12)
    one, many = (engine.run(plant, some, FILTER, steps_of(plant)) for some in (lanes[:1], lanes))
    for alone, whole in zip(jax.tree.leaves(one), jax.tree.leaves(many), strict=True):
        np.testing.assert_allclose(alone, whole[:1], rtol=1e-12, atol=1e-13)


def test_a_bad_lane_leaves_the_others_alone():
    plant, observer = CASES["level tank"]
    lanes, steps, others = lanes_of(plant, observer, 5), steps_of(plant), np.arange(5) != 3
    good = OneKernel(tile=8).run(plant, lanes, FILTER, steps)
    lanes.theta[3, 0] = np.nan
    bad = OneKernel(tile=8).run(plant, lanes, FILTER, steps)
    for one, other in zip(jax.tree.leaves(bad), jax.tree.leaves(good), strict=True):
        np.testing.assert_array_equal(one[others], other[others])
        assert np.all(np.isnan(one[3]))


@pytest.mark.parametrize("name", ["pendulum", "two masses"])
def test_the_kernel_equals_the_scan_in_scores_with_emphasis(name: str):
    plant, observer = CASES[name]
    agree(OneKernel(tile=4), plant, lanes_of(plant, observer, 5, True), "scores", 1e-12)


def test_single_precision():
    plant, observer = CASES["pendulum"]
    lanes = lanes_of(plant, observer, 5, dtype=np.float32)
    agree(OneKernel(tile=4), plant, lanes, "scores", 2e-5)


def test_inputs_of_single_lanes_fit_the_memory():
    """Actuators make inputs differ between lanes; several launches give the same sums."""
    plant, observer = CASES["driven"]
    lanes, steps = lanes_of(plant, observer, 5), steps_of(plant)
    whole = OneKernel(tile=2).run(plant, lanes, FILTER, steps)
    parts = OneKernel(tile=2, memory=8 * S * 3 * 3).run(plant, lanes, FILTER, steps)
    for one, other in zip(jax.tree.leaves(whole), jax.tree.leaves(parts), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-13)


def absent_gpu() -> Any:
    """From JAX 0.12 on a kernel is lowered for one kind of GPU, which must be named."""
    if jax.__version_info__ < (0, 12):
        return nullcontext()
    kind = jax.sharding.AbstractDevice("NVIDIA H100 80GB HBM3", 132, "gpu")
    return jax.sharding.use_abstract_mesh(jax.sharding.AbstractMesh((), (), abstract_device=kind))


# JAX 0.12 announces the end of its Triton backend.
@pytest.mark.filterwarnings("ignore:The Pallas Triton backend is deprecated:DeprecationWarning")
@pytest.mark.parametrize(
    ("name", "dtype"), [*((name, np.float32) for name in CASES), ("pendulum", np.float64)]
)
def test_the_kernel_lowers_for_cuda(name: str, dtype: Any):
    """No GPU is needed for that: every operation has its rule in Triton."""
    plant, observer = CASES[name]
    lanes, engine = lanes_of(plant, observer, 40, True, dtype), OneKernel(interpret=False)

    def launch(lanes: Lanes, steps: Steps) -> Any:
        return engine.launch(plant, lanes, FILTER, steps, "scores")

    with absent_gpu():
        traced = jax.jit(launch).trace(lanes, steps_of(plant))
        text = traced.lower(lowering_platforms=("cuda",)).as_text()
    # One for what the lanes share of a step, one for the lanes.
    count = 1 if plant.actuator is not None else 2
    assert text.count("stablehlo.custom_call @__gpu$xla.gpu.triton") == count
    assert "stablehlo.while" not in text


@pytest.mark.gpu
@pytest.mark.skipif(jax.default_backend() != "gpu", reason="needs a GPU")
def test_the_compiled_kernel_equals_the_scan():
    plant, observer = CASES["pendulum"]
    agree(OneKernel(), plant, lanes_of(plant, observer, 33), "scores", 1e-9)


def test_what_is_not_supported_has_a_name():
    def settled(t, x, u, p):
        return jax.lax.while_loop(lambda v: v[0] > 1.0, lambda v: 0.5 * v, p.k * x.y[0] + u)

    plant = Plant(settled, {"k": 1.0})
    with pytest.raises(Untranslatable, match="while"):
        OneKernel().run(plant, lanes_of(plant, FirstOrder(20.0), 2), FILTER, steps_of(plant))


def test_a_tile_is_a_power_of_two():
    with pytest.raises(ValueError, match="`tile` must be a power of two, got 12"):
        OneKernel(tile=12)
