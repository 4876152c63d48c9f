/* d(q, v, z)/dt of one robot (model section 5), for the adaptive peers: one call, no memory of its own.

   The numbers are those of sdirk2.c: 14 scalars, A, J. Commands are linear between stamps `dt` apart. */
#include <math.h>
#define N 6

void rhs(double t, const double *y, double *dy, const double *p, const double *drive, int stamps, double dt) {
  const double *q = y, *v = y + N, *z = y + 2 * N, *a = p + 14, *j = a + N * N;
  int at = (int)floor(t / dt);
  at = at < 0 ? 0 : at > stamps - 2 ? stamps - 2 : at;
  double w = fmin(fmax(t / dt - at, 0), 1), u = drive[2 * at] + w * (drive[2 * at + 2] - drive[2 * at]);
  double vacuum = drive[2 * at + 1] + w * (drive[2 * at + 3] - drive[2 * at + 1]), root = fmax(vacuum, 0);
  double alpha2 = (p[2] * vacuum + p[3]) * vacuum + p[4], phi = p[5] + p[6] * root / sqrt(root + 1e-4);
  double c[N], s[N], square[N], m[N][N], b[N], psi = 0, omega = 0, force = 0, fall = 0;
  for (int i = 0; i < N; i++) {
    psi += q[i];
    omega += v[i];
    c[i] = cos(psi);
    s[i] = sin(psi);
    square[i] = omega * omega;
  }
  double gravity = p[1] * sin(psi);
  for (int i = N - 1; i >= 0; i--) {
    double along = 0, across = 0;
    for (int k = 0; k < N; k++) {
      along += a[i * N + k] * c[k] * square[k];
      across += a[i * N + k] * s[k] * square[k];
    }
    force += s[i] * along - c[i] * across;
    double x = fabs(v[i] / p[13]);
    fall = (p[12] - p[11]) * exp(-pow(x, p[10]));
    double rate = v[i] - p[7] * fabs(v[i]) / (p[11] + fall) * z[i];
    b[i] = p[0] * u - gravity - alpha2 * q[i] - phi * (p[7] * z[i] + p[8] * rate + p[9] * v[i]) - force;
    dy[i] = v[i];
    dy[2 * N + i] = rate;
    for (int k = i; k >= 0; k--) {
      m[i][k] = a[i * N + k] * (c[i] * c[k] + s[i] * s[k]) + (i == k ? j[i] : 0);
      if (i + 1 < N) m[i][k] += m[i + 1][k] - m[i + 1][k + 1];
      if (k < i) m[i][k] += m[i][k + 1];
      else if (i + 1 < N) m[i][k] += m[i + 1][i];
    }
  }
  for (int i = 0; i < N; i++)
    for (int k = 0; k < i; k++) {
      double l = m[i][k] / m[k][k];
      for (int r = k + 1; r <= i; r++) m[i][r] -= l * m[r][k];
      b[i] -= l * b[k];
    }
  for (int i = N - 1; i >= 0; i--) {
    for (int k = i + 1; k < N; k++) b[i] -= m[k][i] * dy[N + k];
    dy[N + i] = b[i] / m[i][i];
  }
}
