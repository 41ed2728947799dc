// Elementary functions of lane vectors.
//
// Sine, cosine, exponential and their relatives: the argument is reduced to a small interval with a constant
// split into parts, so that the difference is exact, and a polynomial is taken there that ends below the last bit:
// the minimax one of the relative error (Remez) or the Taylor series. NaN and infinity go through as in the C library.
//
// Largest errors over the whole range, in units of the last place of the result; test_functions.py checks them:
//   exp, log, sin, cos 2; expm1, tanh 3. A sine or cosine below 2^-12 (float32) or 2^-38 (float64) has the error of one
//   of that size; beyond 8192 rad (1e6) they are those of the C library.

template <class V, class G> INLINE V each(V a, G g) {
  typename Of<V>::T t[W];
  memcpy(t, &a, sizeof t);
  for (int l = 0; l < W; l++) t[l] = g(t[l]);
  memcpy(&a, t, sizeof t);
  return a;
}
// The same as a call, for what nearly never happens: a body with the code in it has fewer registers for the rest.
template <class V, class G> static __attribute__((noinline, cold)) V rarely(V a, G g) { return each(a, g); }
template <class V, class G> INLINE V each2(V a, V b, G g) {
  typename Of<V>::T t[W], s[W];
  memcpy(t, &a, sizeof t);
  memcpy(s, &b, sizeof s);
  for (int l = 0; l < W; l++) t[l] = g(t[l], s[l]);
  memcpy(&a, t, sizeof t);
  return a;
}

// The larger and the smaller of a number and a bound, which is not NaN; NaN stays.
#if W == 1
template <class V> INLINE V at_least(V a, V bound) { return a < bound ? bound : a; }
template <class V> INLINE V at_most(V a, V bound) { return bound < a ? bound : a; }
#else
template <class V> INLINE V at_least(V a, V bound) { return sel(lt(a, bound), bound, a); }
template <class V> INLINE V at_most(V a, V bound) { return sel(lt(bound, a), bound, a); }
// One instruction of x86 each. It returns the second operand if either is NaN.
#if defined(__AVX512F__) && defined(__GNUC__) && !defined(__clang__)
#if W == 16
INLINE VF at_least(VF a, VF bound) { return __builtin_ia32_maxps512_mask(bound, a, a, -1, 4); }
INLINE VF at_most(VF a, VF bound) { return __builtin_ia32_minps512_mask(bound, a, a, -1, 4); }
#elif W == 8
INLINE VD at_least(VD a, VD bound) { return __builtin_ia32_maxpd512_mask(bound, a, a, -1, 4); }
INLINE VD at_most(VD a, VD bound) { return __builtin_ia32_minpd512_mask(bound, a, a, -1, 4); }
#endif
#endif
#endif
template <class V> INLINE V max_(V a, V b) { return sel(lt(b, a) | ne(a, a), a, b); } // NaN of either
template <class V> INLINE V min_(V a, V b) { return sel(lt(a, b) | ne(a, a), a, b); }
INLINE VB max_(VB a, VB b) { return a | b; }
INLINE VB min_(VB a, VB b) { return a & b; }
INLINE VL abs_(VL a) { return sel(lt(a, splat<VL>(0)), -a, a); }
INLINE VI abs_(VI a) { return sel(lt(a, splat<VI>(0)), -a, a); }
INLINE VF abs_(VF a) { return from_bits<VF>(bits(a) & 0x7fffffff); }
INLINE VD abs_(VD a) { return from_bits<VD>(bits(a) & 0x7fffffffffffffffLL); }
INLINE VF with_sign(VF a, VF s) { return from_bits<VF>(bits(a) | (bits(s) & i32(0x80000000u))); }
INLINE VD with_sign(VD a, VD s) { return from_bits<VD>(bits(a) | (bits(s) & i64(1ULL << 63))); }
INLINE VF sqrt_(VF a) { return each(a, [](float x) { return __builtin_sqrtf(x); }); }
INLINE VD sqrt_(VD a) { return each(a, [](double x) { return __builtin_sqrt(x); }); }
template <class V> INLINE V times(V a, double c) { return a * typename Of<V>::T(c); }
template <class V> INLINE V relu_(V a) { return sel(lt(a, splat<V>(0)), splat<V>(0), a); }
template <class V> INLINE V sign_(V a) {
  const V zero = splat<V>(0), one = splat<V>(1);
  return sel(lt(zero, a), one, sel(lt(a, zero), -one, zero));
}

template <class V> struct Limits;
template <> struct Limits<VF> {
  static constexpr float whole = 8388608.0f; // from here on every number is whole
  static constexpr float shift = 12582912.0f; // added to a small number, leaves it rounded in the last bits
  static constexpr float turns = 2608;       // half turns of the largest angle whose reduction is exact to the last bits
};
template <> struct Limits<VD> {
  static constexpr double whole = 4503599627370496.0;
  static constexpr double shift = 6755399441055744.0;
  static constexpr double turns = 318310;
};
template <class V> INLINE V whole_number(V a) { return (a + Limits<V>::shift) - Limits<V>::shift; } // if small
template <class V> INLINE V rint_(V a) { // to the nearest, halves to even
  const V whole = splat<V>(Limits<V>::whole);
  const V size = abs_(a);
  return sel(lt(size, whole), with_sign((size + whole) - whole, a), a);
}
template <class V> INLINE V floor_(V a) {
  const V r = rint_(a);
  return sel(lt(a, r), r - splat<V>(1), r);
}
template <class V> INLINE V trunc_(V a) { return with_sign(floor_(abs_(a)), a); }
INLINE VL trunc_(VL a) { return a; }
INLINE VI trunc_(VI a) { return a; }
// Division of integers: by 0 it gives 0 (torch raises an error), and the one quotient that is out of range wraps.
INLINE i64 quotient_of(i64 x, i64 y) { return y == 0 ? 0 : y == -1 ? i64(0 - uint64_t(x)) : x / y; }
INLINE i64 rest_of(i64 x, i64 y) { return y == 0 || y == -1 ? 0 : x % y; }
INLINE VL truncdiv_(VL a, VL b) {
  return each2(a, b, [](i64 x, i64 y) { return quotient_of(x, y); });
}
INLINE VL fmod_(VL a, VL b) {
  return each2(a, b, [](i64 x, i64 y) { return rest_of(x, y); });
}
INLINE VL remainder_(VL a, VL b) {
  return each2(a, b, [](i64 x, i64 y) { i64 r = rest_of(x, y); return r && ((r < 0) != (y < 0)) ? r + y : r; });
}
INLINE VL floordiv_(VL a, VL b) {
  return each2(a, b, [](i64 x, i64 y) { return quotient_of(x, y) - (rest_of(x, y) && ((x < 0) != (y < 0))); });
}
#define NARROW(name) \
  INLINE VI name(VI a, VI b) { return cvt<VI>(name(cvt<VL>(a), cvt<VL>(b))); }
NARROW(truncdiv_)
NARROW(fmod_)
NARROW(remainder_)
NARROW(floordiv_)
template <class V> INLINE V fmod_(V a, V b) {
  return each2(a, b, [](auto x, auto y) { return std::fmod(x, y); });
}
// The quotient is small in nearly every use; else the remainder is worked out digit by digit.
template <class V> INLINE V remainder_(V a, V b) {
  const V zero = splat<V>(0), q = floor_(a / b);
  V r = a - q * b;
  r = sel(lt(zero, b) & lt(r, zero), r + b, sel(lt(b, zero) & lt(zero, r), r + b, r));
  r = sel((lt(zero, b) & le(b, r)) | (lt(b, zero) & le(r, b)), r - b, r);
  // Lanes whose quotient is large, or so near to a whole number that rounding decides, and no other ones: none depends on
  // another.
  const V margin = abs_(a) * (4 * std::numeric_limits<typename Of<V>::T>::epsilon());
  const V size = abs_(r), left = abs_(b) - size;
  const VB doubtful = ~(lt(abs_(q), splat<V>(Limits<V>::whole / 4)) & lt(margin, size) & lt(margin, left));
  if (__builtin_expect(any(doubtful), 0)) {
    const V d = fmod_(a, b);
    return sel(doubtful, sel(ne(d, zero) & ne(VB(lt(d, zero)), VB(lt(b, zero))), d + b, d), r);
  }
  return r;
}
template <class V> INLINE V truncdiv_(V a, V b) { return trunc_(a / b); }
template <class V> INLINE V floordiv_(V a, V b) { return floor_((a - remainder_(a, b)) / b + splat<V>(0.5)); }

template <int N, class V> INLINE V power(V a) {
  if constexpr (N == 1) return a;
  else if constexpr (N % 2) return power<N - 1>(a) * a;
  else {
    const V half = power<N / 2>(a);
    return half * half;
  }
}

// Coefficients +-1/n! of the Taylor series, from the highest power down.
template <class V, class T, int N> INLINE V horner(V x, const T (&c)[N]) {
  V r = splat<V>(c[0]);
#pragma GCC unroll 16
  for (int i = 1; i < N; i++) r = r * x + c[i];
  return r;
}
INLINE VF sine_series(VF x) { // |x| <= pi / 2, relative error 6e-9
  static constexpr float c[] = {2.60575023e-6f, -1.98095899e-4f, 8.33306608e-3f, -0.166666595f};
  const VF y = x * x;
  return x + x * y * horner(y, c);
}
INLINE VD sine_series(VD x) { // 3e-19
  static constexpr double c[] = {2.721156935001328160575595e-15, -7.642989812822608158976958e-13,
                                 1.605893964290637835670309e-10, -2.505210687157898022255188e-8,
                                 2.755731921112425830312775e-6 , -1.984126984120914536327981e-4,
                                 8.333333333333194108708506e-3,  -0.1666666666666666556779192};
  const VD y = x * x;
  return x + x * y * horner(y, c);
}
#if defined(__FMA__) || defined(__ARM_FEATURE_FMA)
// A product and a difference are rounded together, so that two parts of pi are enough: the first difference is exact.
INLINE VF reduced(VF a, VF q) { return (a - q * 0x1.921fb6p+1f) + q * 0x1.777a5cp-24f; }
INLINE VD reduced(VD a, VD q) { return (a - q * 0x1.921fb54442d18p+1) - q * 0x1.1a62633145c07p-53; }
#else
// pi in three parts; the first ones have zeros at the end, so that their products with a number of half turns
// are exact.
INLINE VF reduced(VF a, VF q) { return ((a - q * 0x1.92p+1f) - q * 0x1.fb4p-11f) - q * 0x1.4442d2p-23f; }
INLINE VD reduced(VD a, VD q) {
  return ((a - q * 0x1.921fb544p+1) - q * 0x1.0b4611a6p-33) - q * 0x1.3198a2e037073p-68;
}
#endif
INLINE VF odd_sign(VF shifted) { return from_bits<VF>(bits(shifted) << 31); } // -0 for odd numbers
INLINE VD odd_sign(VD shifted) { return from_bits<VD>(bits(shifted) << 63); }
template <class V> INLINE V flip(V a, V sign) { return from_bits<V>(bits(a) ^ bits(sign)); }
template <class V> INLINE bool too_many(V squares) {
  constexpr typename Of<V>::T most = Limits<V>::turns;
  return __builtin_expect(any_from(squares, splat<V>(most * most)), 0);
}
// What is done about angles whose half turns are too many in any lane, or not a number.
//
// `Far` looks at each at once. `FarLater` adds their squares up, so that a body has no branches and its statements can be
// mixed with those of others; if there are any, the body runs again with `FarApart`, which looks at each behind a call.
// The compiler rounds a product and a sum together where no branch is between them, so all three give the same bits, and
// no lane depends on the angles of another.
struct Far {};
struct FarApart {};
struct FarLater {
  VF single{};
  VD twofold{};
  INLINE_MEMBER void add(VF turns) { single += turns * turns; }
  INLINE_MEMBER void add(VD turns) { twofold += turns * turns; }
  INLINE_MEMBER bool found() const { return too_many(single) | too_many(twofold); }
};
template <class V, class G>
static __attribute__((noinline, cold)) V unless_far(V turns, V a, V near, FarApart, G exact) {
  typename Of<V>::T n[W], x[W], y[W];
  memcpy(n, &turns, sizeof n);
  memcpy(x, &a, sizeof x);
  memcpy(y, &near, sizeof y);
  for (int l = 0; l < W; l++)
    if (!(n[l] * n[l] < Limits<V>::turns * Limits<V>::turns)) y[l] = exact(x[l]);
  memcpy(&near, y, sizeof y);
  return near;
}
template <class V, class G> INLINE V unless_far(V turns, V a, V near, Far, G exact) {
  return too_many(turns * turns) ? unless_far(turns, a, near, FarApart{}, exact) : near;
}
template <class V, class G> INLINE V unless_far(V turns, V, V near, FarLater &far, G) {
  far.add(turns);
  return near;
}
// sin(r + n pi) = (-1)^n sin(r)
template <class V, class F> INLINE V sin_(V a, F &far) {
  typedef typename Of<V>::T T;
  const V shifted = a * T(0.31830988618379067154) + Limits<V>::shift, n = shifted - Limits<V>::shift;
  const V near = flip(sine_series(reduced(a, n)), odd_sign(shifted));
  return unless_far(n, a, near, far, [](T x) { return std::sin(x); });
}
// cos(r + (n + 1/2) pi) = -(-1)^n sin(r)
template <class V, class F> INLINE V cos_(V a, F &far) {
  typedef typename Of<V>::T T;
  const V shifted = (a * T(0.31830988618379067154) - T(0.5)) + Limits<V>::shift, n = shifted - Limits<V>::shift;
  const V near = flip(sine_series(-reduced(a, n + T(0.5))), odd_sign(shifted));
  return unless_far(n, a, near, far, [](T x) { return std::cos(x); });
}

// e^r - 1 for |r| <= ln(2) / 2
INLINE VF small_exponential(VF r) { // relative error 1.3e-8
  static constexpr float c[] = {1.3882511e-3f, 8.36658033e-3f, 4.16672018e-2f, 0.166665432f, 0.499999981f};
  return r + r * r * horner(r, c);
}
INLINE VD small_exponential(VD r) { // 1.8e-17
  static constexpr double c[] = {2.505377259897113797132e-8, 2.762616143941327630891e-7, 2.755740787588812212847e-6,
                                 2.480150497882513029773e-5, 1.984126971833148506511e-4, 1.388888893179506405812e-3,
                                 8.333333333389962839713e-3, 4.166666666657610835056e-2, 0.1666666666666658857561,
                                 0.500000000000000522581};
  return r + r * r * horner(r, c);
}
INLINE VF power_of_two(VF n) { return from_bits<VF>((cvt<VI>(n) + 127) << 23); }
INLINE VD power_of_two(VD n) { return from_bits<VD>((cvt<VL>(n) + 1023) << 52); }
INLINE VF without_powers(VF a, VF n) { return (a - n * 0x1.62ep-1f) - n * 0x1.0bfbe8p-15f; }
INLINE VD without_powers(VD a, VD n) { return (a - n * 0x1.62e42fef8p-1) - n * 0x1.1cf79abc9e3b4p-36; }
// Beyond `high` and `low` the exponential is infinite and 0, beyond `one` the hyperbolic tangent is 1.
template <class V> struct Exponential;
template <> struct Exponential<VF> { static constexpr float high = 88.8f, low = -104.0f, one = 9.1f; };
template <> struct Exponential<VD> { static constexpr double high = 709.9, low = -746.0, one = 19.1; };
template <class V> INLINE V exp_(V a) {
  typedef typename Of<V>::T T;
  const V high = splat<V>(Exponential<V>::high), low = splat<V>(Exponential<V>::low);
  const V x = sel(lt(high, a), high, sel(lt(a, low), low, a));
  const V n = whole_number(x * T(1.4426950408889634));
  const V half = whole_number(n * T(0.5)); // in two steps: 2^n alone may be out of range where e^x is not
  const V r = (1 + small_exponential(without_powers(x, n))) * power_of_two(half) * power_of_two(n - half);
  return sel(ne(a, a), a, r);
}
template <class V> INLINE V expm1_(V a) {
  typedef typename Of<V>::T T;
  const V limit = splat<V>(Exponential<V>::one * 2);
  const V x = sel(lt(abs_(a), limit), a, splat<V>(0));
  const V n = whole_number(x * T(1.4426950408889634));
  const V scale = power_of_two(n);
  const V r = scale * small_exponential(without_powers(x, n)) + (scale - 1);
  return sel(lt(abs_(a), limit), r, exp_(a) - 1);
}
// (e^2x - 1) / (e^2x + 1) from h = (e^2x - 1) / 2, where x = n ln(2) / 2 + r. One part of ln(2) is enough: what its
// error does to e^2x lies below the last bit of the result. The result for -0 is 0.
INLINE VF tanh_(VF a) {
  static constexpr float c[] = {0.0444240351f, 0.133865285f, 0.333337614f, 0.666661727f, 0.999999963f}; // 1.3e-8
  const VF limit = splat<VF>(Exponential<VF>::one), x = at_most(at_least(a, -limit), limit);
  constexpr float shift = Limits<VF>::shift + 127; // leaves the exponent of 2^n in the last bits
  const VF shifted = x * 2.88539008f + shift;
  const VF r = x - (shifted - shift) * 0.346573591f;
  const VF scale = from_bits<VF>(bits(shifted) << 23);
  const VF h = scale * (r + r * r * horner(r, c)) + (scale * 0.5f - 0.5f);
  return h / (h + 1);
}
INLINE VD tanh_(VD a) {
  const VD limit = splat<VD>(Exponential<VD>::one), size = abs_(a);
  const VD x = 2 * sel(lt(size, limit), size, limit);
  const VD n = whole_number(x * 1.4426950408889634);
  const VD scale = power_of_two(n);
  const VD e = scale * small_exponential(without_powers(x, n)) + (scale - 1);
  return sel(ne(a, a), a, with_sign(e / (e + 2), a));
}
INLINE VF logarithm_series(VF y) {
  static constexpr float c[] = {1.0f / 9, 1.0f / 7, 1.0f / 5, 1.0f / 3};
  return horner(y, c);
}
INLINE VD logarithm_series(VD y) {
  static constexpr double c[] = {1.0 / 21, 1.0 / 19, 1.0 / 17, 1.0 / 15, 1.0 / 13,
                                 1.0 / 11, 1.0 / 9,  1.0 / 7,  1.0 / 5,  1.0 / 3};
  return horner(y, c);
}
INLINE VF exponent(VF a) { return cvt<VF>(((bits(a) >> 23) & 255) - 127); }
INLINE VD exponent(VD a) { return cvt<VD>(((bits(a) >> 52) & 2047) - 1023); }
INLINE VF mantissa(VF a) { return from_bits<VF>((bits(a) & 0x007fffff) | 0x3f800000); }
INLINE VD mantissa(VD a) { return from_bits<VD>((bits(a) & 0x000fffffffffffffLL) | 0x3ff0000000000000LL); }
template <class V> INLINE V log_(V a) {
  typedef typename Of<V>::T T;
  const V smallest = splat<V>(std::numeric_limits<T>::min()), largest = splat<V>(std::numeric_limits<T>::max());
  const V m = mantissa(a);
  const VB upper = lt(splat<V>(T(1.4142135623730951)), m);
  const V x = sel(upper, m * T(0.5), m), n = sel(upper, exponent(a) + 1, exponent(a));
  const V s = (x - 1) / (x + 1), y = s * s;
  const V near = n * T(0.6931471805599453) + 2 * (s + s * y * logarithm_series(y));
  const VB odd = ~(le(smallest, a) & le(a, largest)); // these lanes alone, so that none depends on another
  if (__builtin_expect(any(odd), 0)) return sel(odd, rarely(a, [](T x) { return std::log(x); }), near);
  return near;
}
