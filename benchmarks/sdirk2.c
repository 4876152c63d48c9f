/* The scheme of ljjax/step.py as a C programmer would write it by hand: the peer of the second benchmark.

   One thread. W robots side by side fill the vector registers; a robot's state never leaves them but for what the
   compiler spills. SDIRK2, bristles eliminated, M and C frozen at the predicted middle, kink clip, LDLt.
   Compile with -DREAL=double -DW=4, or -DREAL=float -DW=8 (32-byte registers). */
#include <math.h>

#ifndef N
#define N 6
#endif
typedef REAL vec __attribute__((vector_size(W * sizeof(REAL))));
#ifdef SINGLE
typedef int whole;
#define MATH(name) name##f
#else
typedef long long whole;
#define MATH(name) name
#endif
typedef whole mask __attribute__((vector_size(W * sizeof(REAL))));

/* Per block of W robots: these numbers, then per step (tension difference, vacuum). */
enum { LEVER, ALPHA1, C1, C2, C3, C4, C5, SIGMA0, SIGMA1, SIGMA2, SIGMA3, MU_C, MU_S, V_S, A, J = A + N * N, COUNT = J + N };

static inline vec all(REAL x) { return x - (vec){0}; }
static inline vec pick(mask m, vec a, vec b) { return (vec)((m & (mask)a) | (~m & (mask)b)); }
static inline vec vsign(vec x) { return pick(x > 0, all(1), pick(x < 0, all(-1), all(0))); }
static inline vec vabs(vec x) { return pick(x < 0, -x, x); }

/* A loop of W calls, which -ffast-math turns into one call of the vector mathematics library. */
#define EACH(name, f)                                    \
  static inline vec name(vec x) {                        \
    union { vec v; REAL x[W]; } in = {x}, out;           \
    for (int l = 0; l < W; l++) out.x[l] = MATH(f)(in.x[l]); \
    return out.v;                                        \
  }
EACH(vexp, exp)
EACH(vlog, log)
EACH(vsin, sin)
EACH(vcos, cos)
EACH(vsqrt, sqrt)

typedef struct { vec q[N], v[N], z[N]; } state;
typedef struct { const vec *p; vec m[N][N], load[N], alpha2, phi; REAL s; } frozen;
typedef struct { vec torque, slope, z; } joint;

static inline joint at_joint(const frozen *f, const state *base, int i, vec v, vec side) {
  const vec *p = f->p;
  vec one = all(1), s = all(f->s), x = vabs(v / p[V_S]);
  mask tiny = x < all((REAL)1e-30);
  vec log_power = p[SIGMA3] * vlog(pick(tiny, one, x));
  log_power = pick(log_power > 5, all(5), log_power);
  vec power = pick(tiny, all(0), vexp(log_power)), fall = (p[MU_S] - p[MU_C]) * vexp(-power), rho = p[MU_C] + fall;
  vec rho_slope = -fall * power * p[SIGMA3] / pick(tiny, one, v);
  vec inverse = 1 / rho, den = 1 / (one + s * p[SIGMA0] * side * v * inverse), z = (base->z[i] + s * v) * den;
  vec z_slope = (s - z * s * p[SIGMA0] * side * (inverse - v * rho_slope * inverse * inverse)) * den;
  joint out;
  out.z = z;
  out.torque = f->phi * (p[SIGMA0] * z + p[SIGMA1] * (z - base->z[i]) / s + p[SIGMA2] * v) +
               f->alpha2 * (base->q[i] + s * v);
  out.slope = f->phi * ((p[SIGMA0] + p[SIGMA1] / s) * z_slope + p[SIGMA2]) + f->alpha2 * s;
  return out;
}

/* One stage: from its base and a first guess of v to (q, v, z) at its end. */
static inline state stage(const frozen *f, const state *base, const vec *guess, int iterations) {
  vec v[N], side[N], s = all(f->s);
  for (int i = 0; i < N; i++) { v[i] = guess[i]; side[i] = vsign(v[i]); }
  for (int it = 0; it < iterations; it++) {
    vec sum = all(0), a[N][N], b[N], d[N];
    for (int i = 0; i < N; i++) sum += base->q[i] + s * v[i];
    vec gravity = f->p[ALPHA1] * vsin(sum), common = s * s * f->p[ALPHA1] * vcos(sum);
    for (int i = 0; i < N; i++) {
      joint on = at_joint(f, base, i, v[i], side[i]);
      vec inertia = all(0);
      for (int k = 0; k < N; k++) inertia += (k <= i ? f->m[i][k] : f->m[k][i]) * (v[k] - base->v[k]);
      b[i] = s * (f->load[i] - gravity - on.torque) - inertia;
      for (int k = 0; k <= i; k++) a[i][k] = f->m[i][k] + common;
      a[i][i] += s * on.slope;
    }
    for (int j = 0; j < N; j++) {
      d[j] = 1 / a[j][j];
      for (int i = j + 1; i < N; i++) {
        vec l = a[i][j] * d[j];
        for (int k = j + 1; k <= i; k++) a[i][k] -= l * a[k][j];
        b[i] -= l * b[j];
      }
    }
    for (int i = N - 1; i >= 0; i--) {
      for (int k = i + 1; k < N; k++) b[i] -= a[k][i] * b[k];
      b[i] *= d[i];
    }
    for (int i = 0; i < N; i++) {
      vec new = v[i] + b[i];
      mask crossed = side[i] * new < 0;
      side[i] = pick(crossed, -side[i], pick(side[i] == 0, vsign(b[i]), side[i]));
      v[i] = pick(crossed, all(0), new);
    }
  }
  state out;
  for (int i = 0; i < N; i++) {
    out.q[i] = base->q[i] + s * v[i];
    out.v[i] = v[i];
    out.z[i] = at_joint(f, base, i, v[i], vsign(v[i])).z;
  }
  return out;
}

static inline void inertia_and_coriolis(frozen *f, const state *now, REAL h) {
  const vec *p = f->p;
  vec cosine[N], sine[N], square[N], psi = all(0), omega = all(0), force = all(0);
  for (int i = 0; i < N; i++) {
    psi += now->q[i] + (REAL)0.5 * h * now->v[i];
    omega += now->v[i];
    cosine[i] = vcos(psi);
    sine[i] = vsin(psi);
    square[i] = omega * omega;
  }
  for (int i = N - 1; i >= 0; i--) {
    for (int k = i; k >= 0; k--) {
      vec x = p[A + i * N + k] * (cosine[i] * cosine[k] + sine[i] * sine[k]);
      if (i == k) x += p[J + i];
      if (i + 1 < N) x += f->m[i + 1][k] - f->m[i + 1][k + 1];
      if (k < i) x += f->m[i][k + 1];
      else if (i + 1 < N) x += f->m[i + 1][i];
      f->m[i][k] = x;
    }
    vec along = all(0), across = all(0);
    for (int k = 0; k < N; k++) {
      along += p[A + i * N + k] * cosine[k] * square[k];
      across += p[A + i * N + k] * sine[k] * square[k];
    }
    force += sine[i] * along - cosine[i] * across;
    f->load[i] -= force;
  }
}

/* The state a step later, under a tension difference and a vacuum. */
static inline void advance(state *now, const vec *p, vec u, vec line, REAL h, int iterations) {
  const REAL gamma = (REAL)(1 - 0.70710678118654752440), more = (1 - gamma) / gamma;
  vec vacuum = pick(line > 0, line, all(0));
  frozen f = {.p = p, .s = gamma * h};
  f.alpha2 = (p[C1] * line + p[C2]) * line + p[C3];
  f.phi = p[C4] + p[C5] * vacuum / vsqrt(vacuum + (REAL)1e-4);
  for (int i = 0; i < N; i++) f.load[i] = p[LEVER] * u;
  inertia_and_coriolis(&f, now, h);
  state half = stage(&f, now, now->v, iterations), base;
  vec guess[N];
  for (int i = 0; i < N; i++) {
    base.q[i] = now->q[i] + more * (half.q[i] - now->q[i]);
    base.v[i] = now->v[i] + more * (half.v[i] - now->v[i]);
    base.z[i] = now->z[i] + more * (half.z[i] - now->z[i]);
    guess[i] = now->v[i] + (half.v[i] - now->v[i]) / gamma;
    guess[i] = pick(guess[i] * half.v[i] < 0, half.v[i], guess[i]);
  }
  *now = stage(&f, &base, guess, iterations);
}

/* `blocks` blocks of W robots from rest at q = 0: parameters (blocks, COUNT, W), first z (blocks, N, W), drives
   (blocks, steps, 2, W), q after every `every` steps into path (blocks, steps / every, N, W). */
void simulate(int blocks, int steps, int every, int iterations, double h, const vec *parameters, const vec *first,
              const vec *drive, vec *path) {
  for (int b = 0; b < blocks; b++, parameters += COUNT, first += N) {
    state now;
    for (int i = 0; i < N; i++) { now.q[i] = now.v[i] = all(0); now.z[i] = first[i]; }
    for (int step = 1; step <= steps; step++, drive += 2) {
      advance(&now, parameters, drive[0], drive[1], (REAL)h, iterations);
      if (step % every == 0)
        for (int i = 0; i < N; i++) *path++ = now.q[i];
    }
  }
}
