/* The plant's numbers and state, and what its inputs go through: actuators and vacuum. See plant.c. */
#include <math.h>
#include <string.h>

#define N 6
#define WIDTH 10
#define PLAYS 4

enum { /* the order of causes.py */
    TENDON_FRICTION, TENDON_SLACK, ACTUATOR_LAG, ACTUATOR_DELAY, ACTUATOR_DEADBAND, ACTUATOR_GAIN, ACTUATOR_RIPPLE,
    ACTUATOR_SATURATION, PRESSURE_LAG, PRESSURE_LEAK, PRESSURE_BIAS, STIFFNESS_SATURATION, FRICTION_SATURATION,
    LAYER_HYSTERESIS, LAYER_WEAR, VISCOELASTIC_CREEP, VISCOUS_DAMPING, STIFFNESS_HARDENING, REST_CURVATURE, BASE_TILT,
    TIP_PAYLOAD, GRAVITY_DISTRIBUTION, NONUNIFORM_STIFFNESS, CONTACT, FRICTION_ASYMMETRY, LOAD_DEPENDENT_FRICTION,
    THERMAL_DRIFT, JAMMED_JOINT, BASE_VIBRATION, BUCKLING_FRICTION, GLUE_FAILURE, SNAP_THROUGH, HIDDEN_PENDULUM,
    DROPOUT, CAUSES
};

typedef struct {
    double half_length, radius, lever, mass, alpha1, c1, c2, c3, c4, c5, sigma1, sigma2, sigma3, mu_c, mu_s, v_s;
} Robot;

/* What one run leaves to the next: accumulated slip [rad] of each joint, warmth [K], of the sensor too. */
typedef struct { double slip[N], warm, felt; } Carried;

typedef struct {
    double q[N], v[N], z[N], omega_mid[N];
    double first[2], tension[2], breakaway[2], slack[2][2], guide[N]; /* actuation */
    double line, sheath, seal;                                        /* pressure */
    double play[N][PLAYS], branch[N][4], pendulum, pendulum_rate;     /* structure */
} State;

static double clamp(double x, double low, double high) { return x < low ? low : x > high ? high : x; }
static double sign(double x) { return (x > 0) - (x < 0); }

/* Command i at time t [s], held. */
static double held(const double *x, int count, int stride, double t, double period) {
    int k = (int)floor(t / period + 1e-9);
    return x[stride * (k < 0 ? 0 : k >= count ? count - 1 : k)];
}

/* From commands to what leaves the spools: s->tension [N]. */
static void actuate(const double f[][WIDTH], State *s, const double *u, int count, double t, double period, double h,
                    double lever) {
    double bend = 0;
    for (int i = 0; i < N; i++) bend += s->q[i];
    double late = f[ACTUATOR_DELAY][0];
    if (late > 0) late *= 1 + 0.25 * sin(6.283185307 * f[ACTUATOR_DELAY][1] * t + f[ACTUATOR_DELAY][2]);
    for (int i = 0; i < 2; i++) {
        double x = held(u + i, count, 2, t - late, period);
        if (f[DROPOUT][0] > 0) /* a loose plug: three spells a run */
            for (int k = 1; k < 4; k++)
                if (t > f[DROPOUT][k] && t < f[DROPOUT][k] + f[DROPOUT][0]) x *= 0.3;
        if (f[ACTUATOR_SATURATION][0] > 0) {
            double top = f[ACTUATOR_SATURATION][1] * (1 - f[ACTUATOR_SATURATION][0]);
            if (x > top) x = top + 0.04 * (x - top);
        }
        if (f[ACTUATOR_DEADBAND][0] > 0) {
            double d = f[ACTUATOR_DEADBAND][0];
            if (x > d) s->breakaway[i] = 1;
            if (x < 0.75 * d) s->breakaway[i] = 0;
            x = s->breakaway[i] ? x - 0.75 * d : 0;
        }
        double e = f[ACTUATOR_GAIN][0] * f[ACTUATOR_GAIN][1 + i];
        x *= 1 + e * (1 - 0.1 * tanh(x / 15));
        if (f[ACTUATOR_LAG][0] > 0) {
            double slow = f[ACTUATOR_LAG][0], quick = 0.35 * slow;
            s->first[i] += (x - s->first[i]) * -expm1(-h / quick);
            double rate = clamp((s->first[i] - s->tension[i]) / slow, -400, 400);
            s->tension[i] += h * rate;
            x = s->tension[i];
        }
        if (f[ACTUATOR_RIPPLE][0] != 0) {
            const double *p = f[ACTUATOR_RIPPLE];
            double angle = ((i ? -1 : 1) * lever * bend + x / p[1]) / p[2], teeth = p[3];
            double wave = sin(teeth * angle + p[4 + i]) + 0.45 * sin(2 * teeth * angle + p[6 + i]);
            x += p[0] * wave * x / (x + 2);
        }
        s->tension[i] = x > 0 ? x : 0;
    }
}

/* What reaches the first guide: a pair of plays, side by side. */
static double past_slack(const double *f, double state[2], double x) {
    if (f[0] <= 0) return x;
    double width[2] = {f[0], 0.45 * f[0]}, out = 0;
    for (int k = 0; k < 2; k++) {
        state[k] = clamp(state[k], x - width[k], x + width[k]);
        out += (k ? 0.35 : 0.65) * state[k];
    }
    out = 0.06 * x + 0.94 * out;
    return out > 0 ? out : 0;
}

/* Vacuum in the line and in the sheath [kPa] from the commanded one. */
static void pressurise(const double f[][WIDTH], State *s, double commanded, double h) {
    s->line = commanded;
    double inside = commanded;
    if (f[PRESSURE_BIAS][0] != 0) {
        double b = f[PRESSURE_BIAS][0];
        inside += b * (1 + 0.2 * tanh((commanded - 20) / 12));
    }
    if (f[PRESSURE_LAG][0] > 0) {
        double drop = inside - s->sheath, time = f[PRESSURE_LAG][0] * (drop > 0 ? 1 : f[PRESSURE_LAG][1]);
        double flow = 5 * drop / sqrt(fabs(drop) * 5 + 4); /* through an orifice: as the root of the drop */
        s->sheath += h * flow / time;
        inside = s->sheath;
    }
    if (f[PRESSURE_LEAK][0] > 0) {
        double p = inside > 0 ? inside : 0, a;
        s->seal += h * (p / 40 * (1 - s->seal) / f[PRESSURE_LEAK][1] - s->seal / f[PRESSURE_LEAK][2] * (p < 1));
        a = f[PRESSURE_LEAK][0] * s->seal;
        double root = 0.5 * (sqrt(a * a + 4 * p) - a);
        inside = root * root;
    }
    s->sheath = inside > 0 ? inside : 0;
}
