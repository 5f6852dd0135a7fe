/* The forces of the cloth (sim/sheet.py: fabric_force without a clamp) and the flat cloth's own solve
   (sim/muscle_solve.py: solve, no muscles) of one block of 8 designs, by hand with AVX2: the yardstick of benchmarks/sim/kernel.py.
   Same arithmetic, order of rows and data layout as the Taichi kernels; float32.

   Offsets of planes and constants (P_Q, ..., L_K1, ...) come as -D from kernel.py, as they are constants of the
   compiled Taichi kernels too; sizes of the grid are run-time values there and here. */

#include "kernel_vectors.h"

static void velocity_row(int nu, int j, L cv)
{
    for (int i = 0; i < nu; i++) {
        int k = (j + 1) * (nu + 2) + i + 1;
        put(P_V + k, add(mul(cv, sub(vec(P_Q + k), vec(P_X0 + k))), vec(P_HV + k)));
    }
}

static void cell_row(int nu, int j)
{
    int s = nu + 2;
    L A = constant(L_AREA), SA = constant(L_S) * A, VA = all(0.5f) * constant(L_VISCOSITY) * A, half = all(0.5f);
    L ihh = constant(L_IHU) * constant(L_IHV), TA = all(2.0f) * constant(L_T) * A * ihh * ihh;
    for (int i = 0; i < nu - 1; i++) {
        int k = (j + 1) * s + i + 1;
        V q0 = vec(P_Q + k), q1 = vec(P_Q + k + 1), q2 = vec(P_Q + k + s), q3 = vec(P_Q + k + s + 1);
        V p = sub(q3, q0), m = sub(q1, q2), d = sub(sub(q3, q1), sub(q2, q0));
        V a = mul(half, add(p, m)), b = mul(half, sub(p, m));
        L i1 = inverse_root(dot(a, a)), i2 = inverse_root(dot(b, b));
        V t = mul(i1, a), u = mul(i2, b);
        L g = dot(t, u);
        V gt = mul(i1, sub(u, mul(g, t))), gu = mul(i2, sub(t, mul(g, u)));
        V n = cross(u, t);
        L il = inverse_root(dot(n, n));
        n = mul(il, n);
        V v0 = vec(P_V + k), v1 = vec(P_V + k + 1), v2 = vec(P_V + k + s), v3 = vec(P_V + k + s + 1);
        V vp = sub(v3, v0), vm = sub(v1, v2);
        V w = mul(half, add(vp, vm)), y = mul(half, sub(vp, vm));
        L tau = SA * g + VA * (dot(gt, w) + dot(gu, y));
        L nd = dot(n, d), moment = TA * nd;
        V c = mul(moment, sub(d, mul(nd, n)));
        put(P_CA + k, mul(half, sub(mul(il * i1, cross(u, c)), mul(tau, gt))));
        put(P_CB + k, mul(half, sub(mul(il * i2, cross(c, t)), mul(tau, gu))));
        put(P_CD + k, mul(-moment, n));
    }
}

static inline __attribute__((always_inline)) void edge_row(int nu, int nv, int j, int along_u)
{
    int s = nu + 2, step = along_u ? 1 : s, count = along_u ? nu - 1 : nu;
    int t_ = along_u ? P_TU : P_TV, strain = along_u ? P_EU : P_EV, tension = along_u ? P_SU : P_SV;
    L ih = constant(along_u ? L_IHU : L_IHV), A = constant(L_AREA), kA = constant(along_u ? L_K1 : L_K2) * A;
    L quadratic = constant(along_u ? L_Q1 : L_Q2), cubic = constant(along_u ? L_R1 : L_R2);
    L vA = constant(L_VISCOSITY) * A * ih, one = all(1.0f);
    for (int i = 0; i < count; i++) {
        int k = (j + 1) * s + i + 1, e = k + step;
        float w = (along_u ? j == 0 || j == nv - 1 : i == 0 || i == nu - 1) ? 0.5f : 1.0f;
        V d = sub(vec(P_Q + e), vec(P_Q + k));
        L square = dot(d, d), il = inverse_root(square);
        V t = mul(il, d);
        L ep = ih * square * il - one, up = _mm256_max_ps(ep, _mm256_setzero_ps());
        L r = dot(sub(vec(P_V + e), vec(P_V + k)), t);
        put(t_ + k, t);
        put_num(strain + k, ep);
        put_num(tension + k, all(w) * (kA * ep + A * up * up * (quadratic + cubic * up) + vA * r));
    }
}

static void star_row(int nu, int nv, int j)
{
    int s = nu + 2, has2 = j > 0 && j < nv - 1;
    L ihu = constant(L_IHU), ihv = constant(L_IHV), area = constant(L_AREA);
    L b1 = ihu * ihu * constant(L_B1), b2 = ihv * ihv * constant(L_B2);
    L d1 = ihu * ihu * constant(L_D1), d2 = ihv * ihv * constant(L_D2), d12 = ihu * ihv * constant(L_D12);
    for (int i = 0; i < nu; i++) {
        int k = (j + 1) * s + i + 1, has1 = i > 0 && i < nu - 1;
        int w = i == 0 ? k : k - 1, e = i == nu - 1 ? k : k + 1, n = j == 0 ? k : k - s, d = j == nv - 1 ? k : k + s;
        V x = vec(P_Q + k), xw = vec(P_Q + w), xe = vec(P_Q + e), xn = vec(P_Q + n), xd = vec(P_Q + d);
        V a = sub(xe, xw), b = sub(xd, xn), m = cross(b, a);
        L il = inverse_root(dot(m, m));
        m = mul(il, m);
        V u = mul(ihu, sub(sub(xe, x), sub(x, xw))), v = mul(ihv, sub(sub(xd, x), sub(x, xn)));
        L k1 = dot(m, u), k2 = dot(m, v), A = area * all((has1 ? 1.0f : 0.5f) * (has2 ? 1.0f : 0.5f));
        L M1 = all(0.0f), M2 = all(0.0f);
        if (has1 && has2) {
            M1 = (d1 * k1 + d12 * k2) * A;
            M2 = (d2 * k2 + d12 * k1) * A;
        } else if (has1) {
            M1 = b1 * k1 * A;
        } else if (has2) {
            M2 = b2 * k2 * A;
        }
        put_num(P_S1 + k, M1);
        put_num(P_S2 + k, M2);
        V c = add(mul(M1, u), mul(M2, v));
        c = mul(il, sub(c, mul(dot(c, m), m)));
        put(P_N + k, m);
        put(P_NA + k, cross(b, c));
        put(P_NB + k, cross(c, a));
    }
}

static inline __attribute__((always_inline)) void edge_force_row(int nu, int j, int along_u)
{
    int s = nu + 2, step = along_u ? 1 : s, side = along_u ? s : 1, count = along_u ? nu - 1 : nu;
    int t_ = along_u ? P_TU : P_TV, tension = along_u ? P_SU : P_SV, moment = along_u ? P_S1 : P_S2;
    int other = along_u ? P_EV : P_EU, out = along_u ? P_PU : P_PV;
    L ih = constant(along_u ? L_IHU : L_IHV), kc = all(0.25f) * constant(L_K12) * constant(L_AREA);
    for (int i = 0; i < count; i++) {
        int k = (j + 1) * s + i + 1, e = k + step;
        L T = ih * (num(tension + k) + kc * (num(other + k) + num(other + e) + num(other + k - side) + num(other + e - side)));
        V y = sub(mul(num(moment + k), vec(P_N + k)), mul(num(moment + e), vec(P_N + e)));
        put(out + k, add(mul(T, vec(t_ + k)), mul(ih, y)));
    }
    if (along_u)
        put(out + (j + 1) * s + nu, (V){all(0.0f), all(0.0f), all(0.0f)});
}

static void gather_row(int nu, int nv, int j, L ca)
{
    int s = nu + 2;
    V g = {constant(L_GX), constant(L_GX + 1), constant(L_GX + 2)};
    L drag = constant(L_AIR) * constant(L_AREA);
    float s2 = j == 0 ? -1.0f : j == nv - 1 ? 1.0f : 0.0f, w2 = j == 0 || j == nv - 1 ? 0.5f : 1.0f;
    for (int i = 0; i < nu; i++) {
        int k = (j + 1) * s + i + 1;
        float s1 = i == 0 ? -1.0f : i == nu - 1 ? 1.0f : 0.0f, w1 = i == 0 || i == nu - 1 ? 0.5f : 1.0f;
        V f = add(sub(vec(P_PU + k), vec(P_PU + k - 1)), sub(vec(P_PV + k), vec(P_PV + k - s)));
        f = add(f, add(sub(vec(P_NA + k - 1), vec(P_NA + k + 1)), sub(vec(P_NB + k - s), vec(P_NB + k + s))));
        if (s1 != 0.0f)
            f = add(f, mul(all(s1), vec(P_NA + k)));
        if (s2 != 0.0f)
            f = add(f, mul(all(s2), vec(P_NB + k)));
        f = add(f, sub(sub(vec(P_CD + k), vec(P_CA + k)), vec(P_CB + k)));
        f = add(f, sub(sub(vec(P_CA + k - 1), vec(P_CB + k - 1)), vec(P_CD + k - 1)));
        f = add(f, sub(sub(vec(P_CB + k - s), vec(P_CA + k - s)), vec(P_CD + k - s)));
        f = add(f, add(add(vec(P_CA + k - s - 1), vec(P_CB + k - s - 1)), vec(P_CD + k - s - 1)));
        f = add(f, mul(num(P_MASS + k), sub(sub(g, mul(ca, sub(vec(P_Q + k), vec(P_X0 + k)))), vec(P_HA + k))));
        f = sub(f, mul(all(w1 * w2) * drag, vec(P_V + k)));
        put(P_F + k, add(f, vec(P_CARRIED + k)));
    }
}

/* `repeats` evaluations; arrays hold one block, 32-byte aligned */
void forces(float *node3_, float *node_, float *lane_, int nu, int nv, float ca, float cv, int repeats)
{
    node3 = node3_, node = node_, lane = lane_;
    for (int repeat = 0; repeat < repeats; repeat++)
        for (int j = -1; j < nv + 2; j++) {
            if (j + 1 < nv)
                velocity_row(nu, j + 1, all(cv));
            if (j >= 0 && j < nv - 1) {
                cell_row(nu, j);
                edge_row(nu, nv, j, 0);
            }
            if (j >= 0 && j < nv)
                edge_row(nu, nv, j, 1);
            if (j >= 1 && j <= nv) {
                star_row(nu, nv, j - 1);
                edge_force_row(nu, j - 1, 1);
            }
            if (j >= 2 && j <= nv)
                edge_force_row(nu, j - 2, 0);
            if (j >= 2)
                gather_row(nu, nv, j - 2, all(ca));
        }
}

#include "kernel_solve.h"
