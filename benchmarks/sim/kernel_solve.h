/* The flat cloth's own solve (sim/muscle_solve.py: solve, no muscles) by hand: included by kernel.c. */

static float *restrict modal, *restrict factors, *restrict basis;

static void butterfly(int nu, int odd, int row)
{
    for (int w = 0; w < odd; w++) {
        V x = get(modal, row + w), y = get(modal, row + nu - 1 - w);
        set(modal, row + w, add(x, y));
        set(modal, row + nu - 1 - w, sub(x, y));
    }
}

/* `width` entries of a row of the product, in registers all the way */
static inline __attribute__((always_inline)) void product(int x, int y, int C, int count, int k, int width)
{
    V sum[4] = {};
    for (int quad = 0; quad < (count + 3) / 4; quad++)
        for (int r = 0; r < 4; r++) {
            V a = get(modal, x + 4 * quad + r);
            const float *m = basis + 8 * (long)(C + quad * count + k) + r;
            for (int i = 0; i < width; i++) {
                L tangential = _mm256_broadcast_ss(m + 8 * i), normal = _mm256_broadcast_ss(m + 8 * i + 4);
                sum[i] = add(sum[i], mulv((V){tangential, tangential, normal}, a));
            }
        }
    for (int i = 0; i < width; i++)
        set(modal, y + k + i, sum[i]);
}

static void multiply_row(int x, int y, int C, int count)
{
    int k = 0;
    for (; k + 4 <= count; k += 4)
        product(x, y, C, count, k, 4);
    for (; k < count; k++)
        product(x, y, C, count, k, 1);
}

static void transform(int nu, int nv, int odd, int src, int dst, int inverse)
{
    int even = nu - odd, first = (even + 3) / 4 * even, all_of_one = first + (odd + 3) / 4 * odd;
    for (int j = 0; j < nv; j++) {
        int x = src + j * nu, y = dst + j * nu, C = inverse * all_of_one;
        if (!inverse)
            butterfly(nu, odd, x);
        multiply_row(x, y, C, even);
        multiply_row(x + even, y + even, C + first, odd);
        if (inverse)
            butterfly(nu, odd, y);
    }
}

static void solve_modes(int nu, int nv)
{
    int N = nu * nv;
    for (int j = 1; j < nv; j++)
        for (int o = j * nu; o < (j + 1) * nu; o++) {
            V z = sub(get(modal, N + o), mulv(get(factors, o), get(modal, N + o - nu)));
            if (j > 1)
                z = sub(z, mulv(get(factors, N + o), get(modal, N + o - 2 * nu)));
            set(modal, N + o, z);
        }
    for (int j = nv - 1; j >= 0; j--)
        for (int o = j * nu; o < (j + 1) * nu; o++) {
            V z = mulv(get(modal, N + o), get(factors, 2 * N + o));
            if (j < nv - 1)
                z = sub(z, mulv(get(factors, o + nu), get(modal, N + o + nu)));
            if (j < nv - 2)
                z = sub(z, mulv(get(factors, N + o + 2 * nu), get(modal, N + o + 2 * nu)));
            set(modal, N + o, z);
        }
}

/* `repeats` solves of the right side that lies in the third plane */
void solve(float *modal_, float *factors_, float *basis_, float *lane_, int nu, int nv, int odd, int repeats)
{
    modal = modal_, factors = factors_, basis = basis_, lane = lane_;
    int N = nu * nv;
    V top = {all(1.0f) - constant(L_TOP_HELD), top.x, top.x}, bottom = {all(1.0f) - constant(L_BOTTOM_HELD), bottom.x, bottom.x};
    for (int repeat = 0; repeat < repeats; repeat++) {
        for (int k = 0; k < N; k++)
            set(modal, k, get(modal, 2 * N + k));
        for (int k = 0; k < nu; k++) {
            set(modal, k, mulv(get(modal, k), top));
            set(modal, N - nu + k, mulv(get(modal, N - nu + k), bottom));
        }
        transform(nu, nv, odd, 0, N, 0);
        solve_modes(nu, nv);
        transform(nu, nv, odd, N, 0, 1);
    }
}
