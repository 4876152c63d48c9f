/* The shapes of causes in layers, structure and friction: each takes its cause's row f. See plant.c. */
#include "plant.h"

/* Up to 1 at high vacuum P [kPa]: half of it at once, half about the second one. */
static double by_steps(double P, double second) {
    return -0.5 * expm1(-P / 2.5) + 0.5 / (1 + exp((second - P) / 2)) - 0.5 / (1 + exp(second / 2));
}

/* The pressures [kPa] that stiffness and friction go by; packed: how far the layers have been pressed. */
static double stiffening(const double *f, double P, double *packed) {
    double knee = f[0] * P / 20, x;
    if (f[0] <= 0) return P;
    switch (form(f)) {
    case 0: return P / cbrt(1 + knee * knee * knee);
    case 1: return P / (1 + knee);
    case 2: return -20 / f[0] * expm1(-knee);
    case 3: x = P * P / (f[1] * f[1]); return (1 - f[0]) * P + f[0] * 25 * x / (1 + x);
    case 5: return 20 * pow(P / 20, 1 - f[0]); /* as a root */
    case 7: /* once packed they stay packed until the vacuum is nearly gone */
        *packed = clamp(*packed, P, 2.5 * P);
        return (1 - f[0]) * P + f[0] * 20 * expm1(-*packed / f[1]) / expm1(-20 / f[1]);
    case 8: /* two stacks, of which one jams at once and one when its spacers give way: by two steps */
        return (1 - f[0]) * P + f[0] * 20 * by_steps(P, f[1]) / by_steps(20, f[1]);
    case 6: /* in proportion until they touch, then as soil is consolidated: by the logarithm */
        x = 20 / f[0];
        return (P < x ? P : x * (1 + log(P / x))) * (f[0] > 1 ? f[0] / (1 + log(f[0])) : 1);
    default: /* the layers lie flat, at a knee */
        return (1 - f[0]) * P + f[0] * 17.5 / f[1] * (P - hypot(P - f[1], 2) + hypot(f[1], 2));
    }
}

/* clung: the vacuum that has brought the layers as close as they are. */
static double rubbing(const Robot *r, const double *f, double P, double *clung) {
    double usual = sqrt(P);
    if (f[0] <= 0) return r->c4 + r->c5 * usual;
    if (form(f) == 0) return r->c4 + r->c5 * sqrt(20 / f[0] * tanh(f[0] * P / 20));
    double other = form(f) == 1 ? (1 + f[1] / 20) * P / (P + f[1]) : expm1(-P / f[1]) / expm1(-20 / f[1]);
    double met = P * P * P / (f[1] * f[1] * f[1]), usually = 8000 / (f[1] * f[1] * f[1]);
    if (form(f) == 3) other = (1 + usually) / usually * met / (1 + met); /* layers must meet first */
    if (form(f) == 4) other = fmin(P, f[1]) / fmin(20, f[1]); /* in proportion, up to a limit */
    if (form(f) == 6) other = log1p(P / f[1]) / log1p(20 / f[1]); /* by the logarithm */
    if (form(f) == 7) { /* they cling to each other until most of the vacuum is gone */
        *clung = clamp(*clung, P, 3 * P);
        other = expm1(-*clung / f[1]) / expm1(-20 / f[1]);
    }
    if (form(f) == 5) /* beyond a peak the sheath's folds carry the load past the layers */
        other = P / 20 * (f[1] * f[1] + 400) / (f[1] * f[1] + P * P);
    return r->c4 + r->c5 * ((1 - f[0]) * usual + f[0] * sqrt(20) * other);
}

/* Friction drops, or stiffness, or both, or one of them rises. */
static void warmed(const double *f, double warm, double *phi, double *alpha2, double *added) {
    double x = warm / 10, share;
    if (f[0] <= 0 || form(f) > 5) return;
    if (form(f) == 2) {
        x = 1 / (1 + exp((f[1] - warm) / 0.5)) - 1 / (1 + exp(f[1] / 0.5));
        share = 1 - 0.5 * f[0] * x;
        *phi *= 1 - f[0] * x, *alpha2 *= share, *added *= share;
        return;
    }
    if (form(f) == 3) { /* it rubs most when lukewarm, and softens */
        x = warm / f[1], share = 1 - 0.2 * f[0] * x / (1 + x);
        *phi *= 1 + f[0] * x * exp(1 - x), *alpha2 *= share, *added *= share;
        return;
    }
    if (form(f) == 4) { /* as polymers do above their glass transition */
        x = warm / (f[1] + warm), share = exp(-0.3 * f[0] * x);
        *phi *= exp(-f[0] * x), *alpha2 *= share, *added *= share;
        return;
    }
    share = form(f) == 0 ? exp(-f[0] * x * sqrt(1 + x)) : fmax(0.1, 1 + f[2] * f[0] * x);
    if (f[1] < 0.5) *phi *= share; else *alpha2 *= share, *added *= share;
}

/* The same where it is the layers' warmth that counts, to which the heat must get first. */
static void warmed_inside(const double *f, Carried *c, double *phi, double *alpha2, double *added, double h) {
    c->core += h * (c->warm - c->core) / f[1];
    double x = f[0] * c->core / 10, share = 1 / (1 + 0.3 * x);
    *phi /= 1 + x, *alpha2 *= share, *added *= share;
}

/* Warmth of the layers at the start of a run, after a pause [s] in which both cooled. */
static double soaked(const double *f, double core, double warm, double pause) {
    double along = warm / (1 - f[1] / 260);
    return along + (core - along * exp(pause / 260)) * exp(-pause / f[1]);
}

/* What of a joint's track lies beside angle q: the place in it of the first of two, and the share of the second. */
static int beneath(double q, double *share) {
    double at = clamp(q / 0.05 + TRACK / 2, 0, TRACK - 1.001);
    *share = at - (int)at;
    return (int)at;
}

/* Layers that remember: shares of their torque. */
static double remembered(const double *f, double play[PLAYS], double q, double dq, double P, double h) {
    static const double width[PLAYS] = {0.01, 0.03, 0.07, 0.14}, share[PLAYS] = {0.4, 0.28, 0.2, 0.12};
    double x = 0.25 * tanh(q / 0.25), sum = 0, *z = play, steep;
    if (form(f) == 6) { /* springs that slip; q: what has slid past by here, from the clamp on */
        *z = clamp(*z + dq / f[1], -1, 1);
        return *z * (0.35 + P / 25);
    }
    if (form(f) == 7) { /* a spring from where it was when they jammed, which slips, and melts as they are vented */
        *z += (q - *z) * -expm1(-h / (0.05 + 0.01 * P * P * P * P));
        *z = clamp(*z, q - f[1], q + f[1]);
        return 1.5 * (q - *z) / f[1] * P / (P + 8);
    }
    if (form(f) == 3) { /* springs that slip, the later the more they are pressed */
        for (int k = 0; k < PLAYS; k++) {
            double most = width[k] * (0.3 + P / 15);
            play[k] = clamp(play[k], q - most, q + most);
            sum += share[k] * (q - play[k]) / 0.03;
        }
        return sum;
    }
    if (form(f) == 5) { /* they bond the better the longer they lie: by the age of their contacts [s] */
        play[1] += h + play[1] * expm1(-fabs(dq) / f[2]);
        steep = sign(dq * *z) / (0.4 + 0.35 * log1p(play[1] / 0.1));
        *z = clamp(*z + dq / f[1] * (1 - steep * fabs(*z)), -4, 4);
        return *z * (0.35 + P / 25);
    }
    if (form(f) == 4) { /* Dahl's model, with a square */
        steep = 1 - sign(dq) * *z;
        *z = clamp(*z + dq / f[1] * steep * steep, -1, 1);
        return *z * (0.35 + P / 25);
    }
    if (form(f) == 0) {
        for (int k = 0; k < PLAYS; k++) {
            play[k] = clamp(play[k], x - width[k], x + width[k]);
            sum += share[k] * (x - play[k]) / width[k];
        }
        return sum * (0.35 + P / 25);
    }
    steep = form(f) == 1 ? 0.7 * sign(dq * *z) + 0.3 : sign(dq * *z);
    *z = clamp(*z + dq / f[1] * (1 - steep * (form(f) == 1 ? pow(fabs(*z), f[2]) : fabs(*z))), -1, 1);
    if (form(f) == 1) return *z * (0.35 + P / 25);
    x = q * q / 0.01; /* little where it is straight */
    return 1.5 * *z * x / (1 + x) * (0.3 + sqrt(P / 20));
}

static double crept(const double *f, double branch[4], double q, double P, double h) {
    static const double time[4] = {0.25, 1.2, 6, 30}, share[4] = {0.4, 0.3, 0.2, 0.1};
    double sum = 0, over = q - branch[0];
    if (form(f) == 0) {
        for (int k = 0; k < 4; k++) {
            branch[k] += h * (q - branch[k]) / time[k];
            sum += share[k] * (q - branch[k]);
        }
        return sum;
    }
    if (form(f) == 7) { /* a hose through all joints; q: what each has of its bend */
        branch[0] += over * -expm1(-h / f[1]);
        branch[1] += (q - branch[1]) * -expm1(-h / (8 * f[1]));
        return 0.6 * (q - branch[0]) + 0.4 * (q - branch[1]);
    }
    if (form(f) == 6) { /* the harder it is pressed, the more slowly it flows */
        branch[0] += over * -expm1(-h / (f[1] * (0.3 + P / 8)));
        return q - branch[0];
    }
    if (form(f) == 3) { /* it comes back more slowly than it went */
        branch[0] += h * over / (f[1] * (over * q > 0 ? 1 : f[2]));
        return q - branch[0];
    }
    if (form(f) == 4) { /* what relaxes is a spring that hardens */
        over = f[2] * sinh(clamp(q / f[2], -4, 4)) - branch[0];
        branch[0] += over * -expm1(-h / f[1]);
        return over;
    }
    if (form(f) == 5) { /* the farther it has flowed, the more slowly it flows */
        branch[0] += over * -expm1(-h / (f[1] * (1 + branch[0] * branch[0] / (f[2] * f[2]))));
        return q - branch[0];
    }
    branch[0] += h / f[1] * (form(f) == 1 ? over : 0.04 * sinh(clamp(over / 0.04, -7, 7)));
    return q - branch[0];
}

/* Torque of joint i's damping, and its slope added; stiff: its stiffness over that without vacuum; worked: how thin its
   grease has become. */
static double damped(const double *f, int i, double q, double v, double stiff, double worked, double *slope) {
    double v0 = 0.25, of = f[0] * (0.4 + 0.24 * i);
    if (form(f) == 0) {
        *slope += f[0] / sqrt(1 + v * v / (v0 * v0));
        return f[0] * v0 * asinh(v / v0);
    }
    if (form(f) == 4) { /* in proportion to the stiffness */
        *slope += f[0] * stiff;
        return f[0] * stiff * v;
    }
    if (form(f) == 5) { /* that thins while it is worked and sets at rest */
        of = f[0] * (1 - 0.85 * worked);
        *slope += of;
        return of * v;
    }
    if (form(f) == 3) { /* grease that is squeezed where it is bent */
        of = f[0] * (0.2 + fmin(q * q / 0.02, 4));
        *slope += of;
        return of * v;
    }
    *slope += form(f) == 1 ? f[0] : 2 * of * fabs(v);
    return form(f) == 1 ? f[0] * v : of * v * fabs(v);
}

static double hardened(const double *f, double q, double share) {
    if (form(f) == 0) return f[0] * q * fabs(q);
    if (form(f) == 1) return f[0] * q * q * q;
    if (form(f) == 7) return f[0] * share * q * q * q; /* share: of the joint that a sleeve covers */
    if (form(f) == 3) { /* a sheath that comes taut */
        double over = fabs(q) - f[1];
        return 0.5 * f[0] * sign(q) * (fabs(q) + hypot(over, 0.02) - hypot(f[1], 0.02));
    }
    if (form(f) == 4) { /* chains that can stretch so far */
        double x = q * q / (f[1] * f[1]);
        return f[0] * q * x / (1 - fmin(x, 0.8));
    }
    if (form(f) == 5) return f[0] * q * q * q * (1 + f[1] * tanh(q / 0.03)); /* to one side more than to the other */
    double x = clamp(q / f[1], -6, 6);
    if (form(f) == 6) return f[0] * f[1] * sign(q) * (expm1(fabs(x)) - fabs(x)); /* as soft tissue */
    return f[0] * share * f[1] * (sinh(x) - x);
}

/* By how much loading rubs more than unloading, or one way more than the other: shares of the usual friction. */
static double lopsided(const double *f, double *loading, double q, double v, double P, double h) {
    if (form(f) == 0) return f[0] * tanh(q / 0.02) * tanh(v / 0.01);
    if (form(f) == 1) return f[0] * tanh(q / 0.002) * tanh(v / 0.002);
    *loading += clamp(h * fabs(v) / 0.02, 0, 1) * (sign(q * v) - *loading);
    if (form(f) == 2) return f[0] * *loading;
    if (form(f) == 5) { /* the more, the faster it slides */
        loading[1] += (fabs(v) - loading[1]) * -expm1(-h / 0.01);
        return 1.4 * f[0] * *loading * loading[1] / (loading[1] + 0.05);
    }
    if (form(f) == 4) return 1.3 * f[0] * *loading * P / (P + 6); /* scales that catch where they are pressed */
    if (form(f) == 6) return 0.7 * f[0] * *loading * (1 + f[1] * tanh(q / 0.03)); /* layers on one side of it only */
    return 1.4 * f[0] * *loading * q * q / (q * q + 0.0009); /* the more, the more it is bent */
}

/* What a tendon loses on joint i, and what the other one gains: shares of tension; sliding: how fast it has been. */
static double rubbed(const double *f, double *guide, double *sliding, double q, double rate, double h) {
    double soft = 1e-4, wrap = fabs(q) + (form(f) == 0 ? f[1] : 0);
    *guide = (*guide + h * rate / soft) / (1 + h * fabs(rate) / soft);
    if (form(f) == 0) return f[0] * wrap * (*guide + 0.8 * rate);
    if (form(f) == 3) return *guide;
    if (form(f) == 6) { /* on a polymer, by a power of the speed */
        *sliding += (fabs(rate) - *sliding) * -expm1(-h / 0.02);
        return f[0] * wrap * *guide * pow(*sliding / 0.02 + 1e-3, f[1]);
    }
    if (form(f) == 4) return f[0] * *guide; /* in a bent sheath before the robot */
    return f[0] * wrap * *guide * (form(f) == 1 || form(f) == 7 ? 1 : 1 + 0.8 * exp(-rate * rate / 1e-5));
}

/* What of the tension x an elastic cable hands on past guide i: it sticks there, stretched by `drawn` [m] more, as long
   as the capstan can hold the difference. */
static double stuck(const double *f, double *beyond, double x, double q, double drawn) {
    double most = exp(f[0] * (fabs(q) + 0.03));
    *beyond = clamp(*beyond + f[1] * drawn, x / most, x * most);
    return *beyond;
}

/* The same in soft liners, unevenly worn: as a power of the force that presses the tendon x on them. */
static double lined(const double *f, int i, double q, double x) {
    return fmin(0.4, f[0] * f[1 + i] * pow(x * (fabs(q) + 0.01) + 1e-9, 0.7) / (x + 0.3));
}

/* What the surroundings hold the tip back with [N]: a magnet that it passes, a rough patch that it drags over. */
static double beside(const double f[][WIDTH], double *dragged, double x, double rate, double h) {
    const double *m = f[MAGNET], *r = f[ROUGH_PATCH];
    double force = 0, soft = 1e-3;
    if (m[0] > 0) {
        double u = (x - m[1]) / m[2];
        force += m[0] * 3.08 * u / ((1 + u * u) * (1 + u * u));
    }
    if (r[0] > 0) {
        double u = (x - r[1]) / r[2];
        *dragged = (*dragged + h * rate / soft) / (1 + h * fabs(rate) / soft);
        force += r[0] * *dragged / (1 + u * u * u * u);
    }
    return force;
}
