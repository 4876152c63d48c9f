/* The closed loop as a C programmer would write it: the exported law ("law.h"), one robot of a vector after the other,
   around the solver's step by hand, W robots at a time (../sdirk2.c). One thread. Compile with LJJAX_FLOAT where REAL is
   float, and with N, W and REAL as that file says. */
#include "law.h"

#include "../sdirk2.c"

/* `blocks` blocks of W robots from rest at q = 0 and z = 0, a tick of delay: parameters (blocks, COUNT, W), angles and
   stiffness wanted (blocks, 2, W), noise on the bend (blocks, ticks, W); mean angle, left and right tension at every
   tick's beginning into path (blocks, ticks, 3, W). Returns the ticks that the law refused. */
int loops(int blocks, int ticks, int substeps, int iterations, double h, const vec *parameters, const vec *wanted,
          const vec *noise, vec *path) {
  int refused = 0;
  for (int b = 0; b < blocks; b++, parameters += COUNT, wanted += 2) {
    state now;
    ljjax_law_state law[W];
    ljjax_law_output held[W] = {{0}};
    for (int i = 0; i < N; i++) now.q[i] = now.v[i] = now.z[i] = all(0);
    for (int l = 0; l < W; l++) law[l] = ljjax_law_start(0, 0, 0, 0);
    for (int k = 0; k < ticks; k++, noise++, path += 3) {
      vec bend = all(0), pull, vacuum;
      for (int i = 0; i < N; i++) bend += now.q[i];
      path[0] = bend / N;
      bend += *noise;
      for (int l = 0; l < W; l++) {
        const ljjax_law_measured seen = {bend[l], law[l].vacuum};
        const ljjax_law_command asked = {wanted[0][l], wanted[1][l]};
        pull[l] = held[l].left - held[l].right;
        vacuum[l] = held[l].vacuum;
        refused += !ljjax_law_step(&law[l], &seen, &asked, &held[l]);
        path[1][l] = held[l].left;
        path[2][l] = held[l].right;
      }
      for (int j = 0; j < substeps; j++) advance(&now, parameters, pull, vacuum, (REAL)h, iterations);
    }
  }
  return refused;
}
