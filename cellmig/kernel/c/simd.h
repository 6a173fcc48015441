/* Vectors of four doubles and their functions, for any processor; with AVX2 and FMA where it has them.  `signs` has a
 * bit of each number that is negative. */

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

typedef double v4 __attribute__((vector_size(32), may_alias));
typedef int64_t i4 __attribute__((vector_size(32)));

static inline v4 load(const double *a) { v4 x; memcpy(&x, a, sizeof x); return x; }
static inline void store(double *a, v4 x) { memcpy(a, &x, sizeof x); }
static inline v4 splat(double a) { return (v4){a, a, a, a}; }

#define INLINED static inline __attribute__((always_inline))

/* The elements of a and b, together numbered from 0 to 7, that make a new vector. */
#ifdef __clang__
#define SHUFFLE(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#else
#define SHUFFLE(a, b, ...) __builtin_shuffle(a, b, (i4){__VA_ARGS__})
#endif

#ifdef __AVX2__
/* The parts of immintrin.h that are used: reading all of it takes longer than compiling most files. */
#define _IMMINTRIN_H_INCLUDED /* GCC's name of it, for its parts to be read alone */
#define __IMMINTRIN_H /* Clang's */
#include <smmintrin.h>
#include <avxintrin.h>
#include <fmaintrin.h>
static inline v4 twice(const double *a) { return (v4)_mm256_broadcast_pd((const __m128d *)a); }
static inline v4 fma4(v4 a, v4 b, v4 c) { return (v4)_mm256_fmadd_pd((__m256d)a, (__m256d)b, (__m256d)c); }
static inline v4 fms4(v4 a, v4 b, v4 c) { return (v4)_mm256_fmsub_pd((__m256d)a, (__m256d)b, (__m256d)c); }
static inline v4 fnma4(v4 a, v4 b, v4 c) { return (v4)_mm256_fnmadd_pd((__m256d)a, (__m256d)b, (__m256d)c); }
static inline v4 halves(v4 a, v4 b) { return (v4)_mm256_blend_pd((__m256d)a, (__m256d)b, 12); }
static inline v4 smaller(v4 a, v4 b) { return (v4)_mm256_min_pd((__m256d)b, (__m256d)a); }
static inline v4 larger(v4 a, v4 b) { return (v4)_mm256_max_pd((__m256d)b, (__m256d)a); }
static inline int signs(v4 a) { return _mm256_movemask_pd((__m256d)a); }
static inline v4 v4_sqrt(v4 a) { return (v4)_mm256_sqrt_pd((__m256d)a); }
static inline v4 load_single(const float *a) { return (v4)_mm256_cvtps_pd(_mm_loadu_ps(a)); }
static inline void store_single(float *a, v4 x) { _mm_storeu_ps(a, _mm256_cvtpd_ps((__m256d)x)); }
static inline v4 even_single(const float *a) { return (v4)_mm256_cvtps_pd(_mm_moveldup_ps(_mm_loadu_ps(a))); }
static inline v4 odd_single(const float *a) { return (v4)_mm256_cvtps_pd(_mm_movehdup_ps(_mm_loadu_ps(a))); }
#else
static inline v4 twice(const double *a) { return (v4){a[0], a[1], a[0], a[1]}; }
static inline v4 fma4(v4 a, v4 b, v4 c) { return a * b + c; }
static inline v4 fms4(v4 a, v4 b, v4 c) { return a * b - c; }
static inline v4 fnma4(v4 a, v4 b, v4 c) { return c - a * b; }
static inline v4 halves(v4 a, v4 b) { return (v4){a[0], a[1], b[2], b[3]}; }
static inline v4 smaller(v4 a, v4 b) { for (int i = 0; i < 4; i++) a[i] = b[i] < a[i] ? b[i] : a[i]; return a; }
static inline v4 larger(v4 a, v4 b) { for (int i = 0; i < 4; i++) a[i] = b[i] > a[i] ? b[i] : a[i]; return a; }
static inline int signs(v4 a) { int s = 0; for (int i = 0; i < 4; i++) s |= !!signbit(a[i]) << i; return s; }
static inline v4 v4_sqrt(v4 a) { return (v4){sqrt(a[0]), sqrt(a[1]), sqrt(a[2]), sqrt(a[3])}; }
static inline v4 load_single(const float *a) { return (v4){a[0], a[1], a[2], a[3]}; }
static inline void store_single(float *a, v4 x) { for (int i = 0; i < 4; i++) a[i] = (float)x[i]; }
static inline v4 even_single(const float *a) { return (v4){a[0], a[0], a[2], a[2]}; }
static inline v4 odd_single(const float *a) { return (v4){a[1], a[1], a[3], a[3]}; }
#endif

#if defined __AVX2__ && !defined __AVX512VL__
/* Read from memory each time: a compiler that kept a in a register would put sums into memory instead. */
static inline v4 even_double(const double *a)
{
    v4 x;
    __asm__("vpermilpd $0, %1, %0" : "=x"(x) : "m"(*(const v4 *)a));
    return x;
}
/* The second and the fourth, likewise. */
static inline v4 odd_double(const double *a)
{
    v4 x;
    __asm__("vpermilpd $15, %1, %0" : "=x"(x) : "m"(*(const v4 *)a));
    return x;
}
#else
static inline v4 even_double(const double *a) { const v4 x = load(a); return SHUFFLE(x, x, 0, 0, 2, 2); }
static inline v4 odd_double(const double *a) { const v4 x = load(a); return SHUFFLE(x, x, 1, 1, 3, 3); }
#endif

/* Of four coefficients in single or double precision, the first and the third twice; the second and the fourth. */
#define even_of(a) _Generic((a), const float *: even_single, const double *: even_double)(a)
#define odd_of(a) _Generic((a), const float *: odd_single, const double *: odd_double)(a)
#define four_of(a) _Generic((a), const float *: load_single, const double *: load)(a)

#ifdef __AVX512VL__
enum { MOST = 3 }; /* blocks at a time, whose sums fill the registers */
#else
enum { MOST = 2 };
#endif

/* Rows of a are the columns of b. */
static inline void transpose(const v4 a[4], v4 b[4])
{
    const v4 x = SHUFFLE(a[0], a[1], 0, 4, 2, 6), y = SHUFFLE(a[0], a[1], 1, 5, 3, 7);
    const v4 z = SHUFFLE(a[2], a[3], 0, 4, 2, 6), w = SHUFFLE(a[2], a[3], 1, 5, 3, 7);
    b[0] = SHUFFLE(x, z, 0, 1, 4, 5);
    b[1] = SHUFFLE(y, w, 0, 1, 4, 5);
    b[2] = SHUFFLE(x, z, 2, 3, 6, 7);
    b[3] = SHUFFLE(y, w, 2, 3, 6, 7);
}

/* Σ c_k x^k of 16 terms by Estrin's scheme: short chains, for the processor to overlap. */
static inline v4 polynomial(const double c[16], v4 x)
{
    const v4 x2 = x * x, x4 = x2 * x2, x8 = x4 * x4;
    v4 q[4];
    for (int i = 0; i < 4; i++)
        q[i] = fma4(fma4(splat(c[4 * i + 3]), x, splat(c[4 * i + 2])), x2,
                    fma4(splat(c[4 * i + 1]), x, splat(c[4 * i])));
    return fma4(fma4(q[3], x4, q[2]), x8, fma4(q[1], x4, q[0]));
}

/* ln x for finite x > 0, to 2 units in the last place: 2 artanh s, s = (m - 1)/(m + 1), m in [0.7, 1.4]. */
static inline v4 v4_log(v4 x)
{
    const i4 bits = (i4)x, high = (bits & 0xfffffffffffff) > (int64_t)0x6a09e667f3bcd; /* mantissa above sqrt 2 */
    const i4 e = (bits >> 52) - 1023 - high;
    const v4 m = (v4)((bits & 0xfffffffffffff) | ((i4){1023, 1023, 1023, 1023} + high) << 52);
    const v4 exponent = (v4)(e + 0x4338000000000000) - 6755399441055744.0;
    const v4 s = (m - 1.0) / (m + 1.0), t = s * s;
    static const double c[16] = {1. / 3, 1. / 5, 1. / 7, 1. / 9, 1. / 11, 1. / 13, 1. / 15, 1. / 17, 1. / 19, 1. / 21};
    const v4 r = polynomial(c, t);
    return fma4(exponent, splat(0.6931471805599453), 2.0 * fma4(r * t, s, s));
}

/* e^x for |x| < 700, to 2 units in the last place. */
static inline v4 v4_exp(v4 x)
{
    const v4 shifted = fma4(x, splat(1.4426950408889634), splat(6755399441055744.0)), n = shifted - 6755399441055744.0;
    const v4 y = fma4(n, splat(-1.9082149292705877e-10), fma4(n, splat(-0.6931471803691238), x));
    static const double c[16] = {1, 1, 1. / 2, 1. / 6, 1. / 24, 1. / 120, 1. / 720, 1. / 5040, 1. / 40320, 1. / 362880,
                                 1. / 3628800, 1. / 39916800, 1. / 479001600, 1. / 6227020800};
    const v4 r = polynomial(c, y);
    return (v4)((i4)r + ((i4)shifted << 52));
}

static inline v4 v4_cbrt(v4 x) { return v4_exp(v4_log(x) * (1.0 / 3)); }
static inline v4 v4_where(i4 yes, v4 a, v4 b) { return (v4)(((i4)a & yes) | ((i4)b & ~yes)); }
static inline v4 v4_minimum(v4 a, v4 b) { return v4_where(a < b, a, b); }
static inline v4 v4_maximum(v4 a, v4 b) { return v4_where(a > b, a, b); }
static inline v4 v4_pow(v4 a, v4 b) { return (v4){pow(a[0], b[0]), pow(a[1], b[1]), pow(a[2], b[2]), pow(a[3], b[3])}; }
#define OF_LIBM(f) static inline v4 v4_of_##f(v4 a) { return (v4){f(a[0]), f(a[1]), f(a[2]), f(a[3])}; }
OF_LIBM(exp) OF_LIBM(sin) OF_LIBM(cos) OF_LIBM(tan) OF_LIBM(atan)
OF_LIBM(sinh) OF_LIBM(cosh) OF_LIBM(tanh) OF_LIBM(fabs)
static inline double d_minimum(double a, double b) { return a < b ? a : b; }
static inline double d_maximum(double a, double b) { return a > b ? a : b; }

enum { TOGETHER = 64, KINDS = 4 };

/* Numbers of n things from one kind to the next, so that four of a kind are computed at a time; the last to the end. */
static inline void by_kinds(const double *kind, int n, int order[TOGETHER])
{
    int at[KINDS + 1] = {0};
    for (int k = 0; k < n; k++) at[(int)kind[k] + 1]++;
    for (int k = 1; k < KINDS; k++) at[k] += at[k - 1];
    for (int k = 0; k < n; k++) order[at[(int)kind[k]]++] = k;
    const int last = order[n - 1]; /* Clang 22 ends a loop of order[k] = order[k - 1] after its first turn */
    for (int k = n; k % 4; k++) order[k] = last;
}

/* The numbers of four. */
static inline v4 pick(const double *a, const int of[4]) { return (v4){a[of[0]], a[of[1]], a[of[2]], a[of[3]]}; }

/* Puts numbers where those of four stand. */
static inline void put(double *all, const int of[4], v4 x)
{
    for (int i = 0; i < 4; i++) all[of[i]] = x[i];
}

/* Vectors of three. */
static inline double dot3(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static inline void cross3(const double a[3], const double b[3], double out[3])
{
    for (int i = 0; i < 3; i++) out[i] = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
}
