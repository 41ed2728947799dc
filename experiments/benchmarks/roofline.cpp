// The benchmark's pendulum by hand: Runge-Kutta steps of lane vectors that stay in registers, with the same vector
// functions and nothing else. What a kernel could reach on this machine at most.
//
// lanes.h and functions.h stand before this text, LANES of float in a vector.
#include <cstdio>
#include <cstdlib>

typedef VF Number;

struct Unchecked {}; // angles stay far below the limit of the fast sine in all steps
template <class V, class G> INLINE V unless_far(V, V, V near, Unchecked, G) { return near; }

struct Pendulum {
  Number constant, resistance, weight, viscous, coulomb, inertia; // of the last two and resistance: reciprocals, hoisted
};

template <bool FRICTION, int UNITS>
INLINE void derivative(const Pendulum &p, Number effort, const Number (&angle)[UNITS], const Number (&speed)[UNITS],
                       Number (&out)[UNITS]) {
  Unchecked far;
#pragma GCC unroll 8
  for (int i = 0; i < UNITS; i++) {
    Number torque = (effort - speed[i] * p.constant) * p.constant * p.resistance + p.weight * sin_(angle[i], far);
    torque -= p.viscous * speed[i];
    if (FRICTION) torque -= p.coulomb * tanh_(speed[i] * 10.0f);
    out[i] = torque * p.inertia;
  }
}

// A step of 10 ms for a number of vectors side by side.
template <bool FRICTION, int UNITS>
INLINE void step(const Pendulum &p, Number effort, Number (&angle)[UNITS], Number (&speed)[UNITS]) {
  const float h = 0.01f;
  Number k[4][UNITS], at[UNITS], v[4][UNITS];
#pragma GCC unroll 8
  for (int i = 0; i < UNITS; i++) v[0][i] = speed[i];
  derivative<FRICTION>(p, effort, angle, v[0], k[0]);
#pragma GCC unroll 4
  for (int s = 1; s < 4; s++) {
    const float part = s == 3 ? h : h / 2;
#pragma GCC unroll 8
    for (int i = 0; i < UNITS; i++) {
      v[s][i] = speed[i] + k[s - 1][i] * part;
      at[i] = angle[i] + v[s - 1][i] * part;
    }
    derivative<FRICTION>(p, effort, at, v[s], k[s]);
  }
#pragma GCC unroll 8
  for (int i = 0; i < UNITS; i++) {
    angle[i] += (v[0][i] + 2 * v[1][i] + 2 * v[2][i] + v[3][i]) * (h / 6);
    speed[i] += (k[0][i] + 2 * k[1][i] + 2 * k[2][i] + k[3][i]) * (h / 6);
    speed[i] = at_most(at_least(speed[i], splat<Number>(-40.0f)), splat<Number>(40.0f));
  }
}

template <bool FRICTION, int UNITS> static void run(const float *parameters, i64 steps, float *states) {
  Number angle[UNITS], speed[UNITS];
  for (int i = 0; i < UNITS; i++) {
    angle[i] = ld<Number>((char *)states, 2 * i);
    speed[i] = ld<Number>((char *)states, 2 * i + 1);
  }
  Number q[6];
  for (int i = 0; i < 6; i++) q[i] = splat<Number>(parameters[i]);
  const Pendulum p{q[0], q[1], q[2], q[3], q[4], q[5]};
  const Number effort = splat<Number>(parameters[6]);
  for (i64 s = 0; s < steps; s++) step<FRICTION>(p, effort, angle, speed);
  for (int i = 0; i < UNITS; i++) {
    st((char *)states, 2 * i, angle[i]);
    st((char *)states, 2 * i + 1, speed[i]);
  }
}

// `units` vectors side by side, with dry friction or without; whether there is such a function.
extern "C" int roofline(const float *parameters, int friction, int units, i64 steps, float *states) {
#define CASE(n) \
  if (units == n) return friction ? run<true, n>(parameters, steps, states) : run<false, n>(parameters, steps, states), 1;
  CASE(1) CASE(2) CASE(3) CASE(4) CASE(6)
  return 0;
}
