/* One number of 8 designs, a vector of three of them, and where they lie: included by kernel.c. */

#include <immintrin.h>

typedef __m256 L; /* one number of 8 designs */
typedef struct {
    L x, y, z;
} V;

static float *restrict node3, *restrict node, *restrict lane;

static inline L num(int k) { return _mm256_load_ps(node + 8 * (long)k); }
static inline void put_num(int k, L a) { _mm256_store_ps(node + 8 * (long)k, a); }
static inline L constant(int k) { return _mm256_load_ps(lane + 8 * (long)k); }
static inline L all(float a) { return _mm256_set1_ps(a); }
static inline V get(const float *f, int k)
{
    const float *p = f + 24 * (long)k;
    return (V){_mm256_load_ps(p), _mm256_load_ps(p + 8), _mm256_load_ps(p + 16)};
}
static inline void set(float *f, int k, V a)
{
    float *p = f + 24 * (long)k;
    _mm256_store_ps(p, a.x), _mm256_store_ps(p + 8, a.y), _mm256_store_ps(p + 16, a.z);
}
static inline V vec(int k) { return get(node3, k); }
static inline void put(int k, V a) { set(node3, k, a); }
static inline V add(V a, V b) { return (V){a.x + b.x, a.y + b.y, a.z + b.z}; }
static inline V sub(V a, V b) { return (V){a.x - b.x, a.y - b.y, a.z - b.z}; }
static inline V mul(L s, V a) { return (V){s * a.x, s * a.y, s * a.z}; }
static inline V mulv(V a, V b) { return (V){a.x * b.x, a.y * b.y, a.z * b.z}; }
static inline L dot(V a, V b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static inline V cross(V a, V b)
{
    return (V){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
/* 1 / sqrt(a): the estimate and one Newton step, 2 float32 roundings */
static inline L inverse_root(L a)
{
    L r = _mm256_rsqrt_ps(a);
    return all(0.5f) * r * (all(3.0f) - a * r * r);
}
