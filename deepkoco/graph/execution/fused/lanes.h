// Lane vectors: one number of each of the W environments of a block. W is defined before this text.
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>

typedef int32_t i32;
typedef int64_t i64;
typedef uint8_t u8;
#define INLINE_MEMBER inline __attribute__((always_inline))
#define INLINE static INLINE_MEMBER
#define SPECIAL template <> INLINE_MEMBER

// Has the compiler keep a vector that is used several times in a register, where it would load it again each time.
#if defined(__AVX512F__) && W == 16
#define IN_REGISTER(v) asm("" : "+v"(v))
#else
#define IN_REGISTER(v)
#endif

#if W == 1
#define LOOP _Pragma("omp simd") // the machine's vectors go over elements instead of environments
typedef float VF;
typedef double VD;
typedef i32 VI;
typedef i64 VL;
#else
#define LOOP
typedef float VF __attribute__((vector_size(4 * W)));
typedef double VD __attribute__((vector_size(8 * W)));
typedef i32 VI __attribute__((vector_size(4 * W)));
typedef i64 VL __attribute__((vector_size(8 * W)));
#endif

// A truth value is 0 or -1 in a type of its own, so that it is told from an integer.
struct VB {
  VI m;
};

template <class V> struct Of;
template <> struct Of<VF> { typedef float T; typedef VI I; };
template <> struct Of<VD> { typedef double T; typedef VL I; };
template <> struct Of<VL> { typedef i64 T; typedef VL I; };
template <> struct Of<VI> { typedef i32 T; typedef VI I; };

#if W == 1
template <class V, class T> INLINE V splat(T x) { return V(x); }
SPECIAL VB splat<VB>(int x) { return VB{x}; }
template <class V> INLINE V cvt(VF a) { return V(a); }
template <class V> INLINE V cvt(VD a) { return V(a); }
template <class V> INLINE V cvt(VL a) { return V(a); }
template <class V> INLINE V cvt(VI a) { return V(a); }
template <class V> INLINE typename Of<V>::T get(V a, int) { return a; }
template <class V> INLINE void put(V &a, int, typename Of<V>::T x) { a = x; }
#define COMPARE(name, op)                                              \
  template <class V> INLINE VB name(V a, V b) { return VB{-(a op b)}; }
template <class V> INLINE V sel(VB c, V a, V b) { return c.m ? a : b; }
template <class V> INLINE typename Of<V>::I bits(V a) {
  typename Of<V>::I r;
  memcpy(&r, &a, sizeof r);
  return r;
}
#else
template <class V, class T> INLINE V splat(T x) { return V{} + typename Of<V>::T(x); }
SPECIAL VB splat<VB>(int x) { return VB{VI{} + x}; }
template <class V> INLINE V cvt(VF a) { return __builtin_convertvector(a, V); }
template <class V> INLINE V cvt(VD a) { return __builtin_convertvector(a, V); }
template <class V> INLINE V cvt(VL a) { return __builtin_convertvector(a, V); }
template <class V> INLINE V cvt(VI a) { return __builtin_convertvector(a, V); }
template <class V> INLINE typename Of<V>::T get(V a, int l) { return a[l]; }
template <class V> INLINE void put(V &a, int l, typename Of<V>::T x) { a[l] = x; }
#define COMPARE(name, op)                                                                       \
  template <class V> INLINE VB name(V a, V b) { return VB{__builtin_convertvector(a op b, VI)}; }
INLINE VF sel(VB c, VF a, VF b) { return c.m ? a : b; }
INLINE VI sel(VB c, VI a, VI b) { return c.m ? a : b; }
INLINE VD sel(VB c, VD a, VD b) { return __builtin_convertvector(c.m, VL) ? a : b; }
INLINE VL sel(VB c, VL a, VL b) { return __builtin_convertvector(c.m, VL) ? a : b; }
template <class V> INLINE typename Of<V>::I bits(V a) { return (typename Of<V>::I)a; }
#endif

COMPARE(eq, ==)
COMPARE(ne, !=)
COMPARE(lt, <)
COMPARE(le, <=)
SPECIAL VF cvt<VF>(VF a) { return a; }
SPECIAL VD cvt<VD>(VD a) { return a; }
SPECIAL VL cvt<VL>(VL a) { return a; }
SPECIAL VI cvt<VI>(VI a) { return a; }
template <class V> INLINE V cvt(VB a) { return cvt<V>(-a.m); }
INLINE VB operator&(VB a, VB b) { return VB{a.m & b.m}; }
INLINE VB operator|(VB a, VB b) { return VB{a.m | b.m}; }
INLINE VB operator^(VB a, VB b) { return VB{a.m ^ b.m}; }
INLINE VB operator~(VB a) { return VB{~a.m}; }
INLINE VB eq(VB a, VB b) { return ~(a ^ b); }
INLINE VB ne(VB a, VB b) { return a ^ b; }
INLINE VB sel(VB c, VB a, VB b) { return (c & a) | (~c & b); }

template <class V> INLINE V from_bits(typename Of<V>::I a) {
  V r;
  memcpy(&r, &a, sizeof r);
  return r;
}

// Element i of a record: its lanes lie side by side; a truth value takes one byte.
template <class V> struct Memory {
  static INLINE_MEMBER V load(const char *p, i64 i) {
    V v;
    memcpy(&v, p + i * i64(sizeof(V)), sizeof(V));
    return v;
  }
  static INLINE_MEMBER void store(char *p, i64 i, V v) { memcpy(p + i * i64(sizeof(V)), &v, sizeof(V)); }
};
template <> struct Memory<VB> {
  static INLINE_MEMBER VB load(const char *p, i64 i) {
    i32 t[W];
    for (int l = 0; l < W; l++) t[l] = -i32(p[i * W + l]);
    VB v;
    memcpy(&v.m, t, sizeof t);
    return v;
  }
  static INLINE_MEMBER void store(char *p, i64 i, VB v) {
    i32 t[W];
    memcpy(t, &v.m, sizeof t);
    for (int l = 0; l < W; l++) p[i * W + l] = char(-t[l]);
  }
};
template <class V> INLINE V ld(const char *p, i64 i) { return Memory<V>::load(p, i); }
template <class V> INLINE void st(char *p, i64 i, V v) { Memory<V>::store(p, i, v); }

INLINE bool any(VB a) {
#if W == 1
  return a.m;
#elif W == 8 && defined(__AVX__)
  return __builtin_ia32_movmskps256(from_bits<VF>(a.m));
#elif W == 16 && defined(__AVX512DQ__)
  return __builtin_ia32_cvtd2mask512(a.m);
#else
  i32 t[W], r = 0;
  memcpy(t, &a.m, sizeof t);
  for (int l = 0; l < W; l++) r |= t[l];
  return r != 0;
#endif
}
// Whether a number of any lane is not below a limit.
template <class V> INLINE bool any_from(V a, V limit) { return any(~lt(a, limit)); }
#if W == 16 && defined(__AVX512F__) && defined(__GNUC__) && !defined(__clang__)
INLINE bool any_from(VF a, VF limit) { return __builtin_ia32_cmpps512_mask(a, limit, 5, -1, 4); }
#elif W == 8 && defined(__AVX512F__) && defined(__GNUC__) && !defined(__clang__)
INLINE bool any_from(VD a, VD limit) { return __builtin_ia32_cmppd512_mask(a, limit, 5, -1, 4); }
#endif

template <class V> struct Lane { typedef typename Of<V>::T T; };
template <> struct Lane<VB> { typedef i32 T; };
template <class V> INLINE V gather_shared(const typename Lane<V>::T *p, VL index) {
  typename Of<V>::T t[W];
  for (int l = 0; l < W; l++) t[l] = p[get(index, l)];
  V v;
  memcpy(&v, t, sizeof v);
  return v;
}
template <class V> INLINE V gather_lanes(const char *p, VL index) {
  typename Of<V>::T t[W];
  for (int l = 0; l < W; l++) memcpy(&t[l], p + (get(index, l) * W + l) * i64(sizeof t[0]), sizeof t[0]);
  V v;
  memcpy(&v, t, sizeof v);
  return v;
}
template <class V> INLINE V gather_local(const V *p, VL index) {
  return gather_lanes<V>((const char *)p, index);
}
// An index as torch takes it, negative from the end; kept inside, where torch would raise an error.
INLINE VL within(VL index, i64 size) {
  VL zero = splat<VL>(0), last = splat<VL>(size - 1);
  index = sel(lt(index, zero), index + size, index);
  index = sel(lt(index, zero), zero, index);
  return sel(lt(last, index), last, index);
}

// Row vectors of K lane vectors of several blocks times a (K, N) matrix of shared numbers with strides R and C. A number
// that is loaded once serves all blocks.
template <int K, int N, int R, int C, class V, class T, int BLOCKS>
static void matvecs(const V (*x)[BLOCKS], const T *w, const V (*bias)[BLOCKS], V (*out)[BLOCKS]) {
  constexpr int most = BLOCKS == 1 ? 8 : 16 / BLOCKS, tile = N < most ? N : most; // sums, which stay in registers
  for (int first = 0; first < N; first += tile) {
    V sum[tile][BLOCKS];
    const int n0 = first + tile <= N ? first : N - tile; // the last tile may repeat some columns
#pragma GCC unroll 16
    for (int j = 0; j < tile; j++)
#pragma GCC unroll 4
      for (int b = 0; b < BLOCKS; b++) sum[j][b] = bias ? bias[n0 + j][b] : splat<V>(0);
    for (int k = 0; k < K; k++) {
      V own[BLOCKS];
#pragma GCC unroll 4
      for (int b = 0; b < BLOCKS; b++) {
        own[b] = x[k][b];
        IN_REGISTER(own[b]);
      }
#pragma GCC unroll 16
      for (int j = 0; j < tile; j++) {
        const T number = w[k * R + (n0 + j) * C];
#pragma GCC unroll 4
        for (int b = 0; b < BLOCKS; b++) sum[j][b] += own[b] * number;
      }
    }
#pragma GCC unroll 16
    for (int j = 0; j < tile; j++)
#pragma GCC unroll 4
      for (int b = 0; b < BLOCKS; b++) out[n0 + j][b] = sum[j][b];
  }
}
// Row vector of K lane vectors times a (K, N) matrix of shared numbers with strides R and C.
template <int K, int N, int R, int C, class V, class T>
static void matvec(const V *x, const T *w, const V *bias, V *out) {
#if W == 1
  const V zero = splat<V>(0);
  // One environment: the lanes of the machine's vectors are columns of the matrix.
  const int P = 64 / sizeof(T);
  typedef T Row __attribute__((vector_size(64)));
  int n = 0;
  if (C == 1) {
    const int tile = N / P < 4 ? (N / P ? N / P : 1) : 4;
    for (; n + P * tile <= N; n += P * tile) {
      Row sum[tile] = {};
      if (bias) memcpy(sum, bias + n, sizeof sum);
      for (int k = 0; k < K; k++) {
#pragma GCC unroll 4
        for (int j = 0; j < tile; j++) {
          Row row;
          memcpy(&row, w + k * R + n + j * P, sizeof row);
          sum[j] += x[k] * row;
        }
      }
      memcpy(out + n, sum, sizeof sum);
    }
  }
  for (; n < N; n++) {
    V sum = bias ? bias[n] : zero;
    int k = 0;
    if (R == 1 && K >= P) {
      Row parts = {};
      for (; k + P <= K; k += P) {
        Row own, row;
        memcpy(&own, x + k, sizeof own);
        memcpy(&row, w + k + n * C, sizeof row);
        parts += own * row;
      }
      for (int j = 0; j < P; j++) sum += parts[j];
    }
    for (; k < K; k++) sum += x[k] * w[k * R + n * C];
    out[n] = sum;
  }
#else
  matvecs<K, N, R, C, V, T, 1>((const V(*)[1])x, w, (const V(*)[1])bias, (V(*)[1])out);
#endif
}
