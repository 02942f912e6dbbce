"""The pass of the pendulum for many gain sets, written by hand: in C, for Numba, with NumPy.

The rivals of `throughput.py`. Equations: (9) in implicit form, (11), (14), (19), (20), each step
averaged over two as the observer averages. Nothing here uses the library; the sine of the record,
which the others compute on the way, is given to all three.
"""

import ctypes
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numba
import numpy as np

SOURCE = Path(__file__).with_name("pendulum_pass.c")
FLAGS = ("-O3", "-march=native", "-ffast-math", "-fopenmp", "-fPIC")
TILE = 64  # lanes that step together
SUMS = 17  # of each lane: information 10 (upper triangle), rhs 4, square, observed, in sliding


@dataclass(frozen=True)
class Problem:
    """One record and many lanes, as plain arrays of one type.

    Attributes:
        h: sample period [s].
        transition, entry: the sampled filter, of order two.
        y: outputs at both ends of all steps, shape (S + 1,).
        u, use, score, restart: of each step, shape (S,).
        c1, c2, c3: gains, shape (lanes,).
        theta: parameters a, b, c, d, shape (4, lanes).
    """

    h: float
    transition: np.ndarray
    entry: np.ndarray
    y: np.ndarray
    u: np.ndarray
    use: np.ndarray
    score: np.ndarray
    restart: np.ndarray
    c1: np.ndarray
    c2: np.ndarray
    c3: np.ndarray
    theta: np.ndarray

    @property
    def lanes(self) -> int:
        return len(self.c1)

    def sine(self) -> np.ndarray:
        """sin y in the middle of each step."""
        return np.sin(0.5 * (self.y[:-1] + self.y[1:])).astype(self.y.dtype)

    def first(self, steps: int) -> "Problem":
        """The same on the first steps of the record."""
        cut = {key: getattr(self, key)[:steps] for key in ("u", "use", "score", "restart")}
        return Problem(**{**vars(self), **cut, "y": self.y[: steps + 1]})


# -- C ----------------------------------------------------------------------------------------


class C:
    """`pendulum_pass.c`, compiled on the spot; its threads are OpenMP's."""

    def __init__(self, problem: Problem, threads: int):
        real = problem.y.dtype
        self._kind = ctypes.c_float if real == np.float32 else ctypes.c_double
        name = "float" if real == np.float32 else "double"
        library = Path(tempfile.mkdtemp()) / "pass.so"
        code = library.with_suffix(".o")
        words = [*FLAGS, f"-DREAL={name}", f"-DTILE={TILE}", "-c", str(SOURCE), "-o", str(code)]
        subprocess.run(["gcc", *words], check=True)
        # Linked without -ffast-math: that would take denormal numbers for zero in this process.
        subprocess.run(["gcc", "-shared", "-fopenmp", str(code), "-o", str(library)], check=True)
        self._code = ctypes.CDLL(str(library))
        self._code.omp_set_num_threads(threads)
        self._problem, self._sine = problem, problem.sine()
        kind = self._kind

        class Filter(ctypes.Structure):
            _fields_ = [(key, kind) for key in ("t00", "t01", "t10", "t11", "e0", "e1")]

        values = [*problem.transition.ravel(), *problem.entry]
        self._filter = Filter(*[float(value) for value in values])

    @staticmethod
    def available() -> bool:
        return shutil.which("gcc") is not None

    def __call__(self) -> np.ndarray:
        problem = self._problem
        out = np.zeros((SUMS, problem.lanes), problem.y.dtype)
        restart = problem.restart.astype(np.uint8)
        arrays = (problem.y, problem.u, problem.use, problem.score, restart, self._sine)
        gains = (problem.c1, problem.c2, problem.c3, problem.theta, out)
        pointers = [array.ctypes.data_as(ctypes.c_void_p) for array in (*arrays, *gains)]
        self._code["pass"](
            problem.lanes, len(problem.u), self._kind(problem.h), self._filter, *pointers
        )
        return out


# -- Numba ------------------------------------------------------------------------------------

# Rows of a tile's memory: one array, so that the compiler need not ask whether two overlap.
X1, X2, D, F, R, G, W0, W1, O0, O1, R0, R1, G0, G1 = (TILE * row for row in range(14))
K1, K2, K3, PA, PB, PC, PD, P = (TILE * row for row in range(14, 22))


@numba.njit(parallel=True, fastmath=True, error_model="numpy")
def _numba_pass(h, T, E, y, u, use, score, restart, sine, c1, c2, c3, theta, out):
    one, half, zero = h / h, h / (h + h), h - h  # in the type of the data
    t00, t01, t10, t11, e0, e1 = T[0, 0], T[0, 1], T[1, 0], T[1, 1], E[0], E[1]
    for tile in numba.prange(len(c1) // TILE):
        s = np.zeros(P + SUMS * TILE, y.dtype)
        for i in range(TILE):
            j = tile * TILE + i
            s[K1 + i], s[K2 + i], s[K3 + i] = c1[j], c2[j], c3[j]
            s[PA + i], s[PB + i] = theta[0, j], theta[1, j]
            s[PC + i], s[PD + i] = theta[2, j], theta[3, j]
        s_old, u_old = zero, zero
        a0, a1, b0, b1, aa, ab, bb = zero, zero, zero, zero, zero, zero, zero
        for k in range(len(u)):
            now, following, force, m, c, si = y[k], y[k + 1], u[k], use[k], score[k], -sine[k]
            if restart[k]:
                for i in range(TILE):
                    s[X1 + i], s[X2 + i], s[D + i] = now, (following - now) / h, zero
            sa, su = m * half * (si + s_old), m * half * (force + u_old)
            a0, a1 = t00 * a0 + t01 * a1 + e0 * sa, t10 * a0 + t11 * a1 + e1 * sa
            b0, b1 = t00 * b0 + t01 * b1 + e0 * su, t10 * b0 + t11 * b1 + e1 * su
            s_old, u_old = si, force
            aa, ab, bb = aa + c * a0 * a0, ab + c * a0 * b0, bb + c * b0 * b0
            inverse = one / (h * h)
            for i in range(TILE):
                v, e = s[X2 + i], now - s[X1 + i]
                sign = (one if v > zero else zero) - (one if v < zero else zero)
                d = s[PA + i] * si - s[PB + i] * v - s[PC + i] * sign + s[PD + i] * force
                a = d + s[K2 + i] * e
                x = s[X1 + i] + h * v + half * h * h * a + h * s[K1 + i] * e
                w = min(max((following - x) * inverse, -s[K3 + i]), s[K3 + i])
                s[X1 + i] = x + h * h * w
                s[X2 + i] = v + h * (a + w)
                seen = w + half * (d + s[D + i])
                s[D + i] = d
                rate = -(s[X2 + i] - half * h * a)
                sign = (one if rate > zero else zero) - (one if rate < zero else zero)
                f = s[PA + i] * si + s[PB + i] * rate + s[PC + i] * sign + s[PD + i] * force
                injection, observed = m * (seen - half * (f + s[F + i])), m * seen
                fr, fg = m * half * (rate + s[R + i]), m * half * (sign + s[G + i])
                s[F + i], s[R + i], s[G + i] = f, rate, sign
                wn = t00 * s[W0 + i] + t01 * s[W1 + i] + e0 * injection
                s[W1 + i] = t10 * s[W0 + i] + t11 * s[W1 + i] + e1 * injection
                on = t00 * s[O0 + i] + t01 * s[O1 + i] + e0 * observed
                s[O1 + i] = t10 * s[O0 + i] + t11 * s[O1 + i] + e1 * observed
                rn = t00 * s[R0 + i] + t01 * s[R1 + i] + e0 * fr
                s[R1 + i] = t10 * s[R0 + i] + t11 * s[R1 + i] + e1 * fr
                gn = t00 * s[G0 + i] + t01 * s[G1 + i] + e0 * fg
                s[G1 + i] = t10 * s[G0 + i] + t11 * s[G1 + i] + e1 * fg
                s[W0 + i], s[O0 + i], s[R0 + i], s[G0 + i] = wn, on, rn, gn
                cr, cg, cw = c * rn, c * gn, c * wn
                s[P + 1 * TILE + i] += c * a0 * rn
                s[P + 2 * TILE + i] += c * a0 * gn
                s[P + 4 * TILE + i] += cr * rn
                s[P + 5 * TILE + i] += cr * gn
                s[P + 6 * TILE + i] += cr * b0
                s[P + 7 * TILE + i] += cg * gn
                s[P + 8 * TILE + i] += cg * b0
                s[P + 10 * TILE + i] += cw * a0
                s[P + 11 * TILE + i] += cw * rn
                s[P + 12 * TILE + i] += cw * gn
                s[P + 13 * TILE + i] += cw * b0
                s[P + 14 * TILE + i] += cw * wn
                s[P + 15 * TILE + i] += c * on * on
                s[P + 16 * TILE + i] += c if (w < s[K3 + i]) & (w > -s[K3 + i]) else zero
        for i in range(TILE):
            for j in range(SUMS):
                out[j, tile * TILE + i] = s[P + j * TILE + i]
            out[0, tile * TILE + i], out[3, tile * TILE + i] = aa, ab
            out[9, tile * TILE + i] = bb


class Numba:
    """The same loop for Numba, all cores."""

    def __init__(self, problem: Problem, threads: int):
        self._problem, self._sine = problem, problem.sine()
        numba.set_num_threads(threads)

    def __call__(self) -> np.ndarray:
        problem = self._problem
        out = np.zeros((SUMS, problem.lanes), problem.y.dtype)
        h = problem.y.dtype.type(problem.h)
        record = (problem.y, problem.u, problem.use, problem.score, problem.restart, self._sine)
        gains = (problem.c1, problem.c2, problem.c3, problem.theta)
        _numba_pass(h, problem.transition, problem.entry, *record, *gains, out)
        return out


# -- NumPy ------------------------------------------------------------------------------------


class Loop:
    """A loop over time in Python, all lanes at once in NumPy."""

    def __init__(self, problem: Problem, threads: int):
        del threads
        self._problem, self._sine = problem, problem.sine()

    def __call__(self) -> np.ndarray:
        problem, sine = self._problem, self._sine
        real, lanes = problem.y.dtype, problem.lanes
        h = real.type(problem.h)
        half = real.type(0.5)
        pa, pb, pc, pd = problem.theta
        x1, x2, drift, f_old = (np.zeros(lanes, real) for _ in range(4))
        # Columns: injection, observed, then φ = (-sin y, -ẏ, -sign ẏ, u).
        state, old = np.zeros((2, 6, lanes), real), np.zeros((4, lanes), real)
        upper = np.triu_indices(4)
        out = np.zeros((SUMS, lanes), real)
        for k in range(len(problem.u)):
            now, following, force = problem.y[k], problem.y[k + 1], problem.u[k]
            if problem.restart[k]:
                x1, x2 = np.full(lanes, now), np.full(lanes, (following - now) / h)
                drift = np.zeros(lanes, real)
            e = now - x1
            d = -pa * sine[k] - pb * x2 - pc * np.sign(x2) + pd * force
            a = d + problem.c2 * e
            x = x1 + h * x2 + half * h**2 * a + h * problem.c1 * e
            w = np.clip((following - x) / h**2, -problem.c3, problem.c3)
            x1, x2 = x + h**2 * w, x2 + h * (a + w)
            seen, drift = w + half * (d + drift), d
            rate = x2 - half * h * a
            sign = np.sign(rate)
            f = -pa * sine[k] - pb * rate - pc * sign + pd * force
            phi = np.stack([np.full(lanes, -sine[k]), -rate, -sign, np.full(lanes, force)])
            columns = np.stack([seen - half * (f + f_old), seen, *(half * (phi + old))])
            old, f_old = phi, f
            state = (
                problem.transition[:, :1, None] * state[0]
                + problem.transition[:, 1:, None] * state[1]
                + problem.entry[:, None, None] * (problem.use[k] * columns)
            )
            injection, observed, regressors = state[0, 0], state[0, 1], state[0, 2:]
            score = problem.score[k]
            out[:10] += score * regressors[upper[0]] * regressors[upper[1]]
            out[10:14] += score * regressors * injection
            out[14] += score * injection**2
            out[15] += score * observed**2
            out[16] += score * (np.abs(w) < problem.c3)
        return out
