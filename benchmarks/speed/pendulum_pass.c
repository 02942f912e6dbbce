/* One pass of the pendulum for many gain sets, as a careful C programmer would write it: the rival
   of `throughput.py`, which compiles it. Equations: eq. (9) in implicit form, eqs. (11), (14), (19),
   (20), as in eoi_jax/estimation/kernel.py, whose code it does not share.

   Lanes go in tiles that stay in the first-level cache, one instruction for several of them; what
   depends on the record alone is computed once a step for a whole tile. */

#ifndef REAL
#define REAL float
#endif
#ifndef TILE
#define TILE 64
#endif

enum { SUMS = 17 }; /* of each lane: information 10 (upper triangle), rhs 4, square, observed, sliding */

/* The filter's companion form: state <- T state + entry value, output state[0]. */
typedef struct {
    REAL t00, t01, t10, t11, e0, e1;
} Filter;

void pass(int lanes, int steps, REAL h, Filter f, const REAL *y, const REAL *u, const REAL *use,
          const REAL *score, const unsigned char *restart, const REAL *sine, /* of the middle */
          const REAL *c1, const REAL *c2, const REAL *c3, const REAL *theta, /* 4 x lanes */
          REAL *out /* SUMS x lanes */) {
#pragma omp parallel for schedule(static)
    for (int first = 0; first < lanes; first += TILE) {
        REAL x1[TILE], x2[TILE], drift[TILE], rate0[TILE], sign0[TILE], f0[TILE];
        REAL w0[TILE], w1[TILE], o0[TILE], o1[TILE], r0[TILE], r1[TILE], g0[TILE], g1[TILE];
        REAL s[SUMS][TILE];
        for (int l = 0; l < TILE; l++) {
            x1[l] = x2[l] = drift[l] = rate0[l] = sign0[l] = f0[l] = 0;
            w0[l] = w1[l] = o0[l] = o1[l] = r0[l] = r1[l] = g0[l] = g1[l] = 0;
        }
        for (int i = 0; i < SUMS; i++)
            for (int l = 0; l < TILE; l++) s[i][l] = 0;
        /* shared by the tile: -sin y and u, before and behind the filter, and their sums */
        REAL sin0 = 0, u0 = 0, a0 = 0, a1 = 0, b0 = 0, b1 = 0, aa = 0, ab = 0, bb = 0;
        const REAL *pa = theta + first, *pb = theta + lanes + first;
        const REAL *pc = theta + 2 * lanes + first, *pd = theta + 3 * lanes + first;
        const REAL *k1 = c1 + first, *k2 = c2 + first, *k3 = c3 + first;
        for (int k = 0; k < steps; k++) {
            const REAL now = y[k], next = y[k + 1], force = u[k], m = use[k], c = score[k];
            const REAL si = -sine[k];
            if (restart[k])
                for (int l = 0; l < TILE; l++) {
                    x1[l] = now;
                    x2[l] = (next - now) / h;
                    drift[l] = 0;
                }
            const REAL as = m * (REAL)0.5 * (si + sin0), us = m * (REAL)0.5 * (force + u0);
            const REAL an = f.t00 * a0 + f.t01 * a1 + f.e0 * as, bn = f.t00 * b0 + f.t01 * b1 + f.e0 * us;
            a1 = f.t10 * a0 + f.t11 * a1 + f.e1 * as;
            b1 = f.t10 * b0 + f.t11 * b1 + f.e1 * us;
            a0 = an, b0 = bn, sin0 = si, u0 = force;
            aa += c * a0 * a0, ab += c * a0 * b0, bb += c * b0 * b0;
            const REAL square = 1 / (h * h);
#pragma omp simd
            for (int l = 0; l < TILE; l++) {
                const REAL v = x2[l], e = now - x1[l];
                const REAL d = pa[l] * si - pb[l] * v -
                               pc[l] * (REAL)((v > 0) - (v < 0)) + pd[l] * force;
                const REAL a = d + k2[l] * e;
                const REAL p = x1[l] + h * v + (REAL)0.5 * h * h * a + h * k1[l] * e;
                REAL w = (next - p) * square;
                w = w > k3[l] ? k3[l] : (w < -k3[l] ? -k3[l] : w);
                x1[l] = p + h * h * w;
                x2[l] = v + h * (a + w);
                const REAL seen = w + (REAL)0.5 * (d + drift[l]);
                drift[l] = d;
                const REAL rate = -(x2[l] - (REAL)0.5 * h * a);
                const REAL sign = (REAL)((rate > 0) - (rate < 0));
                const REAL model = pa[l] * si + pb[l] * rate + pc[l] * sign + pd[l] * force;
                const REAL injection = m * (seen - (REAL)0.5 * (model + f0[l]));
                const REAL observed = m * seen;
                const REAL fr = m * (REAL)0.5 * (rate + rate0[l]), fs = m * (REAL)0.5 * (sign + sign0[l]);
                f0[l] = model, rate0[l] = rate, sign0[l] = sign;
                const REAL wn = f.t00 * w0[l] + f.t01 * w1[l] + f.e0 * injection;
                w1[l] = f.t10 * w0[l] + f.t11 * w1[l] + f.e1 * injection;
                const REAL on = f.t00 * o0[l] + f.t01 * o1[l] + f.e0 * observed;
                o1[l] = f.t10 * o0[l] + f.t11 * o1[l] + f.e1 * observed;
                const REAL rn = f.t00 * r0[l] + f.t01 * r1[l] + f.e0 * fr;
                r1[l] = f.t10 * r0[l] + f.t11 * r1[l] + f.e1 * fr;
                const REAL gn = f.t00 * g0[l] + f.t01 * g1[l] + f.e0 * fs;
                g1[l] = f.t10 * g0[l] + f.t11 * g1[l] + f.e1 * fs;
                w0[l] = wn, o0[l] = on, r0[l] = rn, g0[l] = gn;
                s[1][l] += c * a0 * rn;
                s[2][l] += c * a0 * gn;
                s[4][l] += c * rn * rn;
                s[5][l] += c * rn * gn;
                s[6][l] += c * rn * b0;
                s[7][l] += c * gn * gn;
                s[8][l] += c * gn * b0;
                s[10][l] += c * a0 * wn;
                s[11][l] += c * rn * wn;
                s[12][l] += c * gn * wn;
                s[13][l] += c * b0 * wn;
                s[14][l] += c * wn * wn;
                s[15][l] += c * on * on;
                s[16][l] += w < k3[l] && w > -k3[l] ? c : 0;
            }
        }
        for (int l = 0; l < TILE; l++) s[0][l] = aa, s[3][l] = ab, s[9][l] = bb;
        for (int i = 0; i < SUMS; i++)
            for (int l = 0; l < TILE; l++) out[i * lanes + first + l] = s[i][l];
    }
}
