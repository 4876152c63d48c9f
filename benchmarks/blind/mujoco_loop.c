/* Steps a MuJoCo model of the robot; MuJoCo knows no LuGre friction, so its torque is applied at every step,
   linearised in the velocity, the slope as joint damping (which MuJoCo integrates implicitly). */
#include <math.h>
#include <mujoco/mujoco.h>

#define N 6

typedef struct {
    double half_length, radius, lever, mass, alpha1, c1, c2, c3, c4, c5, sigma1, sigma2, sigma3, mu_c, mu_s, v_s;
} Robot;

typedef struct { /* the plant's numbers beside MuJoCo's own */
    double tilt, damping, where, friction[2], capstan, base_share, added_share, uneven[N];
} Extra;

static double friction(const Robot *r, double phi, double z, double v, double h, double *slope, double *next) {
    double speed = fabs(v), x = speed > 1e-12 ? exp(r->sigma3 * log(speed / r->v_s)) : 0;
    double g = (r->mu_s - r->mu_c) * exp(-x), rho = r->mu_c + g, scale = 1 + h * speed / rho;
    double d_ratio = (v > 0 ? 1 : v < 0 ? -1 : 0) / rho * (1 + g * r->sigma3 * x / rho);
    *next = (z + h * v) / scale;
    *slope = phi * ((1 + r->sigma1 / h) * h * (1 - d_ratio * *next) / scale + r->sigma2);
    if (*slope < 0) *slope = 0;
    return phi * (*next + r->sigma1 * (*next - z) / h + r->sigma2 * v);
}

int run(void *model, void *data, const double *robot, const double *extra, int count, const double *u,
        const double *vacuum, double period, int substeps, double *q_out, double *tension_out) {
    mjModel *m = (mjModel *)model;
    mjData *d = (mjData *)data;
    const Robot *r = (const Robot *)robot;
    const Extra *e = (const Extra *)extra;
    double h = period / substeps, z[N] = {0}, slope, next;
    long begin = -(long)(3 / h);
    m->opt.timestep = h;
    for (long step = begin; step < (long)count * substeps; step++) {
        int calm = step < 0;
        long k = calm ? 0 : step / substeps;
        if (step == 0)
            for (int i = 0; i < N; i++) d->qvel[i] = 0;
        if (!calm && step % substeps == 0) {
            for (int i = 0; i < N; i++) q_out[k * N + i] = d->qpos[i];
            for (int i = 0; i < 2; i++) tension_out[2 * k + i] = step ? d->actuator_force[i] : u[i];
        }
        double P = vacuum[k], alpha2 = r->c1 * P * P + r->c2 * P + r->c3, phi = r->c4 + r->c5 * sqrt(P), bend = 0;
        for (int i = 0; i < N; i++) bend += d->qpos[i];
        for (int i = 0; i < 2; i++) {
            d->ctrl[i] = u[2 * k + i];
            if (m->na && step == begin) d->act[i] = u[i];
            double pressed = (e->capstan ? fabs(bend) : 1) * fabs(d->actuator_force[i]);
            if (e->capstan == 4) pressed = (1 + fabs(bend)) * fabs(d->actuator_force[i]); /* a bent sheath too */
            else if (e->capstan > 2) pressed = pow(pressed + 1e-9, 0.7); /* soft liners */
            m->tendon_frictionloss[i] = calm ? 0 : e->friction[i] * pressed;
        }
        for (int i = 0; i < N; i++) {
            double v = d->qvel[i];
            double of = alpha2 + e->uneven[i] * (e->base_share * r->c3 + e->added_share * (alpha2 - r->c3));
            m->jnt_stiffness[i] = fmax(of, 0.05 * alpha2);
            d->qfrc_applied[i] = -r->alpha1 * sin(bend - e->tilt);
            if (calm) {
                m->dof_damping[i] = 0.3;
                continue;
            }
            double torque = friction(r, phi, z[i], v, h, &slope, &next);
            d->qfrc_applied[i] -= torque - slope * v;
            double q = d->qpos[i], squeezed = 0.2 + fmin(q * q / 0.02, 4);
            double stiff = e->where == 4 ? alpha2 / r->c3 : 1; /* in proportion to the stiffness */
            double times = e->where == 2 ? 0.4 + 0.24 * i : e->where == 3 ? squeezed : stiff;
            m->dof_damping[i] = slope + e->damping * times;
        }
        mj_step(m, d);
        for (int i = 0; i < N && !calm; i++) {
            friction(r, phi, z[i], d->qvel[i], h, &slope, &next);
            z[i] = next;
            if (!(fabs(d->qpos[i]) < 3)) return 1;
        }
    }
    return 0;
}
