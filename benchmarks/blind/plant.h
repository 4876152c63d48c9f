/* The plant's numbers and state, and what its inputs go through: actuators and vacuum. See plant.c. */
#include <math.h>
#include <string.h>

#define N 6
#define WIDTH 10
#define PLAYS 4
#define TRACK 17
#define TURN 6.283185307

enum { /* the order of causes.py */
    TENDON_FRICTION, TENDON_SLACK, ACTUATOR_LAG, ACTUATOR_DELAY, ACTUATOR_DEADBAND, ACTUATOR_GAIN, ACTUATOR_RIPPLE,
    ACTUATOR_SATURATION, PRESSURE_LAG, PRESSURE_LEAK, PRESSURE_BIAS, STIFFNESS_SATURATION, FRICTION_SATURATION,
    LAYER_HYSTERESIS, LAYER_WEAR, VISCOELASTIC_CREEP, VISCOUS_DAMPING, STIFFNESS_HARDENING, REST_CURVATURE, BASE_TILT,
    TIP_PAYLOAD, GRAVITY_DISTRIBUTION, NONUNIFORM_STIFFNESS, CONTACT, FRICTION_ASYMMETRY, LOAD_DEPENDENT_FRICTION,
    THERMAL_DRIFT, JAMMED_JOINT, BASE_VIBRATION, BUCKLING_FRICTION, GLUE_FAILURE, SNAP_THROUGH, HIDDEN_PENDULUM,
    DROPOUT, DRAUGHT, DERAILED_TENDON, PUMP_PULSES, MAGNET, ROUGH_PATCH, COLUMN_SOFTENING, BROWNOUT, SHAKEN_LOOSE,
    SERVO_HUNTING, CAUSES
};

typedef struct {
    double half_length, radius, lever, mass, alpha1, c1, c2, c3, c4, c5, sigma1, sigma2, sigma3, mu_c, mu_s, v_s;
} Robot;

/* What one run leaves to the next: accumulated slip [rad] of each joint, warmth [K], of the sensor too; slip of each
   joint by angle; warmth of the layers, and when they had it [s]. */
typedef struct { double slip[N], warm, felt, track[N][TRACK], core, ended; } Carried;

typedef struct {
    double q[N], v[N], z[N], omega_mid[N];
    double first[2], tension[2], surge[2], breakaway[2], hot[2], slack[2][2], guide[N], derailed; /* actuation */
    double line, feed, fore, deep, sheath, seal;                                                  /* pressure */
    double play[N][PLAYS], branch[N][4], loading[N][2], pendulum, pendulum_rate, dragged;         /* structure */
    double rocker, rocking, swing, swing_rate, dent, pump, asked[2], still[2];
    double sheared[N], pressed;                                                                   /* layers, grease */
    double session;
    double cable[N][2], eddy[2][4], worked[2], surging; /* further ones of actuation and pressure, and more of them */
    double copper[2], slow_wave[2], topped, unfed, gauge, packed, clung, sliding[N];
} State;

static double clamp(double x, double low, double high) { return x < low ? low : x > high ? high : x; }
static double sign(double x) { return (x > 0) - (x < 0); }
/* Which of its shapes a cause has. */
static int form(const double *f) { return (int)f[WIDTH - 1]; }

/* In [0, 1), the same for the same number. */
static double chance(double key) {
    unsigned x = (unsigned)(long)floor(key) * 2654435761u + 374761393u;
    x = (x ^ x >> 15) * 2246822519u;
    x = (x ^ x >> 13) * 3266489917u;
    return (x ^ x >> 16) / 4294967296.0;
}

/* Command i at time t [s], held. */
static double held(const double *x, int count, int stride, double t, double period) {
    int k = (int)floor(t / period + 1e-9);
    return x[stride * (k < 0 ? 0 : k >= count ? count - 1 : k)];
}

/* When the command was given that arrives at time t [s] at drive i. */
static double given(const double *f, double session, double t, int i) {
    double late = f[0];
    if (late <= 0) return t;
    if (form(f) == 3) return t - late * f[1 + i] * (0.6 + fmin(t / 15, 1)); /* buffers of their own, slowly filling */
    if (form(f) == 4) return 2 * late * (floor(t / (2 * late) - f[1]) + f[1]); /* read at a slow beat, then held */
    if (form(f) == 5) return t - late * (0.25 + 1.5 * chance(session + f[1])); /* connected anew for each run */
    if (form(f) == 6) { /* each drive's clock is a little slow, until it leaves out what has queued up */
        double behind = (session + t) / f[1 + i] + f[3];
        return t - late * (0.3 + 1.4 * (behind - floor(behind)));
    }
    if (form(f) == 7) { /* a link that hangs every now and then, and then works off what has queued up */
        double spell = floor(t / f[2]), key = spell + 7919 * session + f[1];
        double hangs = late * (1 + 2 * chance(key)), since = t - f[2] * spell;
        since -= chance(key + 104729) * fmax(0, f[2] - 2 * hangs);
        return t - 0.5 * late - fmax(0, fmin(since, 2 * hangs - since));
    }
    if (form(f) == 0) late *= 1 + 0.25 * sin(TURN * f[1] * t + f[2]);
    if (form(f) < 2) return t - late;
    double every = 0.7 * late, k = floor(t / every); /* packets, on their way for different times */
    while (k * every + late * (0.35 + 0.6 * chance(k + 7919 * session + f[1])) > t) k--;
    return k * every;
}

static double saturated(const double *f, double *hot, double x, double other, double rate, double h) {
    double top = f[1] * (1 - f[0]);
    if (form(f) == 3) return x / pow(1 + pow((x + other) / (1.6 * top), 8), 1 / 8.0); /* one supply for both drives */
    if (form(f) == 0) return x > top ? top + 0.04 * (x - top) : x;
    if (form(f) == 1) return x / pow(1 + pow(x / top, 6), 1 / 6.0);
    if (form(f) == 7) { /* a clutch: once it slips it holds less, until so little is asked that it grips again */
        *hot += ((x > top * (*hot > 0.5 ? f[2] : 1)) - *hot) * -expm1(-h / 0.03);
        return fmin(x, top * (1 - (1 - f[2]) * *hot));
    }
    if (form(f) == 6) { /* the loop winds up at the limit, and must unwind before it lets go */
        *hot = clamp(*hot + h * (x - top) / f[2], 0, 0.6 * top);
        return fmin(top, x + *hot);
    }
    if (form(f) == 5) /* folds back: the more is asked beyond the limit, the less is given */
        return fmax(fmin(x, top - f[2] * (x - top)), fmin(x, 0.3 * top));
    if (form(f) == 4) { /* the faster it winds, the less the motor can pull; here its speed is kept */
        *hot += (rate - *hot) * -expm1(-h / 0.02);
        return fmin(x, f[1] * fmax(0.05, 1 - f[0] * (1 + fmax(*hot, 0) / f[2])));
    }
    *hot += h * ((x > top) - *hot) / f[2];
    return fmin(x, top + (f[1] - top) * (1 - *hot));
}

/* since: the session began [s]. */
static double past_deadband(const double *f, double *breakaway, double *worked, double x, int i, double since,
                            double h) {
    double d = f[0];
    if (form(f) == 7) return fmax(0, x - d * (0.2 + 0.8 * exp(-since / f[1]))); /* a gearbox that is cold at first */
    if (form(f) == 6) { /* it stays where it is until it is asked to move by so much, then jumps there */
        if (fabs(x - *breakaway) > d) *breakaway = x;
        return *breakaway;
    }
    if (form(f) == 5) { /* grease that thins while it is worked, and sets again at rest */
        *worked += h * (x > d ? (1 - *worked) / f[1] : -*worked / (2 * f[1]));
        return fmax(0, x - d * (1 - 0.75 * *worked));
    }
    if (form(f) == 1) return x > d ? x - d : 0;
    if (form(f) == 2) return hypot(x, d * f[1 + i]) - d * f[1 + i];
    if (form(f) == 3) return x > d ? x - d * exp((d - x) / (f[1] * d)) : 0; /* once it turns it rubs less */
    if (form(f) == 4) return x > d ? x : 0; /* all or nothing */
    if (x > d) *breakaway = 1;
    if (x < 0.75 * d) *breakaway = 0;
    return *breakaway ? x - 0.75 * d : 0;
}

/* Tension after the current loop; s->tension is its state; rate: at which the body gives in to this tendon [m/s]. */
static double lagged(const double *f, State *s, double x, int i, double rate, double h) {
    double slow = f[0], quick = 0.35 * slow;
    if (form(f) == 0) {
        s->first[i] += (x - s->first[i]) * -expm1(-h / quick);
        return s->tension[i] + h * clamp((s->first[i] - s->tension[i]) / slow, -400, 400);
    }
    if (form(f) == 5) { /* flux that diffuses into solid iron: half an order, as first orders side by side */
        static const double time[4] = {0.05, 0.3, 1.5, 8}, share[4] = {0.2, 0.35, 0.3, 0.15};
        double sum = 0;
        for (int k = 0; k < 4; k++) {
            s->eddy[i][k] += (x - s->eddy[i][k]) * -expm1(-h / (slow * time[k]));
            sum += share[k] * s->eddy[i][k];
        }
        return sum;
    }
    if (form(f) == 7) { /* a loop that gives a share at once and integrates what is missing */
        s->first[i] += (x - s->first[i]) * -expm1(-h / slow);
        return f[1] * x + (1 - f[1]) * s->first[i];
    }
    if (form(f) == 6) /* on an elastic cable, from which the body takes what the loop has not wound yet */
        return fmax(0, s->tension[i] + (x - s->tension[i]) * -expm1(-h / slow) - h * f[1] * rate);
    if (form(f) == 4) /* so many newtons a second and no more */
        return s->tension[i] + clamp(x - s->tension[i], -h * f[1] / slow, h * f[1] / slow);
    if (form(f) == 3) /* a slack cable is soft, and a drive lets go more slowly than it winds */
        slow *= (0.3 + 1.4 * f[2] / (f[2] + s->tension[i])) * (x < s->tension[i] ? f[1] : 1);
    if (form(f) != 2) return s->tension[i] + (x - s->tension[i]) * -expm1(-h / slow);
    double w = 1 / fmax(slow, 3 * h);
    s->surge[i] += h * w * (w * (x - s->tension[i]) - 2 * f[1] * s->surge[i]);
    return s->tension[i] + h * s->surge[i];
}

/* From commands to what leaves the spools: s->tension [N]. */
static void actuate(const double f[][WIDTH], State *s, const double *u, int count, double t, double period, double h,
                    double lever) {
    double bend = 0, rate = 0;
    for (int i = 0; i < N; i++) bend += s->q[i], rate += lever * s->v[i];
    for (int i = 0; i < 2; i++) {
        double at = given(f[ACTUATOR_DELAY], s->session, t, i), other = held(u + 1 - i, count, 2, at, period);
        double x = held(u + i, count, 2, at, period), wound = (i ? -1 : 1) * lever * bend;
        if (f[DROPOUT][0] > 0) /* a loose plug: three spells a run */
            for (int k = 1; k < 4; k++)
                if (t > f[DROPOUT][k] && t < f[DROPOUT][k] + f[DROPOUT][0]) x *= 0.3;
        if (f[BROWNOUT][0] > 0) x *= 1 - f[BROWNOUT][0] * s->pump / (s->pump + 0.3);
        if (f[ACTUATOR_SATURATION][0] > 0)
            x = saturated(f[ACTUATOR_SATURATION], &s->hot[i], x, other, i ? -rate : rate, h);
        if (f[ACTUATOR_DEADBAND][0] > 0)
            x = past_deadband(f[ACTUATOR_DEADBAND], &s->breakaway[i], &s->worked[i], x, i, s->session + fmax(t, 0), h);
        double e = f[ACTUATOR_GAIN][0] * f[ACTUATOR_GAIN][1 + i];
        switch (form(f[ACTUATOR_GAIN])) {
        case 0: x *= 1 + e * (1 - 0.1 * tanh(x / 15)); break;
        case 1: x *= 1 + e; break;
        case 3: x *= 1 + e * x / (x + f[ACTUATOR_GAIN][3]); break; /* the iron saturates */
        case 4: x *= 1 + e * -expm1(-t / f[ACTUATOR_GAIN][3]); break; /* the motor warms up in each run */
        case 5: /* cable that climbs onto a second layer of itself */
            x /= 1 + 0.5 * f[ACTUATOR_GAIN][0] * (1 + tanh((wound - f[ACTUATOR_GAIN][1 + i]) / 5e-4));
            break;
        case 6: { /* copper that its own current warms, at a given voltage */
            double share = x / f[ACTUATOR_GAIN][4];
            x /= fmax(0.3, 1 + 3 * e * s->copper[i]);
            s->copper[i] += h * (share * share - s->copper[i]) / f[ACTUATOR_GAIN][3];
            break;
        }
        case 7: /* cable wound on anew before each run, never twice as tightly */
            x *= 1 + 1.7 * f[ACTUATOR_GAIN][0] * (2 * chance(s->session + f[ACTUATOR_GAIN][1] + 31 * i) - 1);
            break;
        default: x /= fmax(0.3, 1 + f[ACTUATOR_GAIN][0] * wound / 0.02); /* the spool grows as it winds */
        }
        if (f[ACTUATOR_LAG][0] > 0) x = s->tension[i] = lagged(f[ACTUATOR_LAG], s, x, i, i ? -rate : rate, h);
        if (f[ACTUATOR_RIPPLE][0] != 0) {
            const double *p = f[ACTUATOR_RIPPLE];
            double angle = (wound + x / p[1]) / p[2], teeth = p[3];
            double wave = sin(teeth * angle + p[4 + i]);
            if (form(p) == 0)
                x += p[0] * (wave + 0.45 * sin(2 * teeth * angle + p[6 + i])) * x / (x + 2);
            else if (form(p) == 1)
                x += p[0] * wave;
            else if (form(p) == 3) /* teeth that lean, on a wheel off its centre */
                x += p[0] * sin(teeth * angle + p[4 + i] + 0.8 * wave) * (1 + 0.7 * sin(angle + p[6 + i]));
            else if (form(p) == 4) /* a gear of two stages */
                x += p[0] * (0.8 * wave + 0.6 * sin(p[8] * teeth * angle + p[6 + i]));
            else if (form(p) == 7) { /* a printed wheel, each tooth too high or too low by its own */
                double tooth = floor((teeth * angle + p[4 + i]) / TURN);
                x += 1.1 * p[0] * (1 - cos(teeth * angle + p[4 + i])) * (2 * chance(tooth + 977 * i + p[8]) - 1);
            } else if (form(p) == 6) { /* of which the loop takes out what is slow */
                s->slow_wave[i] = h > 0 ? s->slow_wave[i] + (wave - s->slow_wave[i]) * -expm1(-h / p[8]) : wave;
                x += 1.3 * p[0] * (wave - s->slow_wave[i]);
            } else if (form(p) == 5) /* narrow magnets far apart: a dip and a bump each, nothing between them */
                x += 3.2 * p[0] * wave * exp(4 * (cos(teeth * angle + p[4 + i]) - 1));
            else
                x *= 1 + p[0] / 10 * (1.5 * (fabs(wave) - 0.64) + 0.5 * sin(angle + p[6 + i]));
        }
        if (f[SERVO_HUNTING][0] > 0) { /* about what is asked for, once that is steady */
            s->still[i] += h * (1 - s->still[i]) / 0.5;
            s->still[i] *= exp(-fabs(x - s->asked[i]) / 1.5);
            s->asked[i] = x;
            x += f[SERVO_HUNTING][0] * s->still[i] * x / (x + 2) *
                 asin(0.99 * sin(TURN * t / f[SERVO_HUNTING][1] + f[SERVO_HUNTING][2] + 2 * i)) / 1.43;
        }
        s->tension[i] = x > 0 ? x : 0;
    }
}

/* What reaches the first guide: a pair of plays side by side, one play, cable that a released spool has paid out,
   cable that the body has let go by bending this way faster than the spool winds, a play with round corners, or a play
   in the length of a cable that is the stiffer the tauter it is; rate: of that bending [m/s]; since: the session began
   [s]; bend: of the whole body. */
static double past_slack(const double *f, double state[2], double x, double rate, double since, double bend,
                         double h) {
    if (f[0] <= 0) return x;
    if (form(f) == 6) {
        state[0] = clamp(state[0], sqrt(x) - f[0], sqrt(x) + f[0]);
        return state[0] > 0 ? state[0] * state[0] : 0;
    }
    if (form(f) == 4) {
        double by = x - state[1], near = state[0] + f[1] * by;
        state[1] = x;
        state[0] = near + (x - near) * fmin(1, fabs(by) * (1 - f[1]) / f[0]);
        return state[0] > 0 ? state[0] : 0;
    }
    if (form(f) == 3) {
        double freed = rate > 0 ? rate / (1 + x * x) : rate, wind = 1e-3 * f[1] * x / (0.8 + x);
        state[0] = clamp(state[0] + h * (freed - wind), 0, 1e-3 * f[0]);
        return x * (1 - tanh(state[0] / 6e-4));
    }
    if (form(f) == 2) {
        double all = 1e-3 * f[0], wind = 1e-3 * f[1];
        state[0] = clamp(state[0] + h * wind * (0.8 - x) / (0.8 + x), 0, all);
        return x * (1 - tanh(state[0] / 4e-4));
    }
    double width[2] = {f[0], 0.45 * f[0]}, out = 0;
    if (form(f) == 5) width[0] *= -expm1(-since / f[1]); /* knots that give over the session: one play, ever wider */
    if (form(f) == 7) /* holes off the joints' axes: the more it is bent, the more cable is loose */
        width[0] *= 0.1 + 0.9 * bend * bend / (bend * bend + 0.3);
    for (int k = 0; k < 2; k++) {
        state[k] = clamp(state[k], x - width[k], x + width[k]);
        out += (k ? 0.35 : 0.65) * state[k];
    }
    out = form(f) == 0 ? 0.06 * x + 0.94 * out : state[0];
    return out > 0 ? out : 0;
}

/* What the sheath follows the line with, h on. */
static double filled(const double *f, State *s, double inside, double h) {
    double drop = inside - s->sheath, time = f[0] * (drop > 0 ? 1 : f[1]);
    if (form(f) == 0) /* through an orifice: as the root of the drop */
        return s->sheath + h * 5 * drop / sqrt(fabs(drop) * 5 + 4) / time;
    if (form(f) == 5) { /* a regulator that overshoots */
        double w = 2 / f[0], dies = exp(-f[1] * w * h), turns = w * sqrt(1 - f[1] * f[1]), c = dies * cos(turns * h);
        double by = dies * sin(turns * h) / turns, rate = s->surging;
        s->surging = rate * c + (w * w * drop - f[1] * w * rate) * by;
        double next = inside - drop * c + (rate - f[1] * w * drop) * by;
        if (next > 0) return next;
        return s->surging = 0;
    }
    if (form(f) == 4) return s->sheath + clamp(drop, -20 * h / time, 20 * h / time); /* a pump of one speed */
    if (form(f) == 7) return s->sheath + drop * -expm1(-h / f[0]); /* after a valve that is late to answer */
    if (form(f) == 6) time = f[0] * (0.15 + 2.5 * exp(-s->sheath / f[1])); /* a bag that is slack until most is out */
    if (form(f) == 3) time *= 0.15 + s->sheath / 15; /* layers pressed together close their own channels */
    if (form(f) != 2) return s->sheath + drop * -expm1(-h / time);
    s->feed += (inside - s->feed) * -expm1(-h / (0.5 * time));
    s->fore += (s->feed - s->fore) * -expm1(-h / (0.5 * time));
    s->deep += (s->fore - s->deep) * -expm1(-h / (4 * time));
    return 0.75 * s->fore + 0.25 * s->deep;
}

/* What a leak leaves of the vacuum. */
static double leaked(const double *f, State *s, double p, double t, double h) {
    if (form(f) == 0) {
        s->seal += h * (p / 40 * (1 - s->seal) / f[1] - s->seal / f[2] * (p < 1));
        double a = f[0] * s->seal, root = 0.5 * (sqrt(a * a + 4 * p) - a);
        return root * root;
    }
    if (form(f) == 1) { /* less and less is held until it is vented */
        s->seal += h * ((p > 1) - s->seal) / (p > 1 ? f[1] : 0.5);
        return p * (1 - f[0] * s->seal);
    }
    if (form(f) == 4) return p * (1 + f[0] * expm1(-(s->session + t) / f[1])); /* a tear that widens */
    if (form(f) == 5) { /* pricked at some moment: a hole in a line that chokes */
        double a = f[0] * (0.5 + 0.5 * tanh((s->session + t - f[1]) / 0.2)), root = 0.5 * (sqrt(a * a + 4 * p) - a);
        return root * root;
    }
    if (form(f) == 6) { /* shut off once it is pumped, and pumped up again every now and then */
        s->unfed += h;
        if (s->unfed > f[1] || fabs(p - s->topped) > 1) s->unfed = 0, s->topped = p;
        return p * (1 - f[0] * s->unfed / f[1]);
    }
    if (form(f) == 7) { /* a slit on one side of one joint, that gapes while that side is stretched */
        double gapes = fmax(0, f[2] * s->q[(int)f[1]]) / 0.1;
        s->seal += h * (gapes / (1 + gapes) - s->seal) / 0.3;
        return p / (1 + f[0] * s->seal);
    }
    double bend = 0, open; /* folds open where it is bent, or a lip while it moves */
    for (int i = 0; i < N; i++) bend += form(f) == 3 ? fabs(s->v[i]) / N / 0.3 : s->q[i] * s->q[i] / N / 0.0144;
    open = bend / (1 + bend);
    s->seal += h * (open - s->seal) / f[1];
    return p / (1 + f[0] * s->seal);
}

/* Vacuum in the line and in the sheath [kPa] from the commanded one, and from that which a late valve still goes by;
   t: since the run began [s]. */
static void pressurise(const double f[][WIDTH], State *s, double commanded, double before, double t, double h) {
    if (f[BROWNOUT][0] > 0) /* while the pump draws its surge */
        s->pump = s->pump * exp(-h / f[BROWNOUT][1]) + fmax(0, commanded - s->line) / 10;
    s->line = commanded;
    double inside = commanded, b = f[PRESSURE_BIAS][0];
    switch (form(f[PRESSURE_BIAS])) {
    case 0: inside += b * (1 + 0.2 * tanh((commanded - 20) / 12)); break;
    case 1: inside += b; break;
    case 3: inside += b * (0.2 + 1.6 * chance(s->session + f[PRESSURE_BIAS][1])); break; /* zeroed anew for each run */
    case 4: inside += b * (s->session + t) / 600; break; /* it drifts */
    case 5: inside += b * exp(-t / f[PRESSURE_BIAS][1]); break; /* a gauge switched on for each run */
    case 6: /* a gauge set on the way up, and off on the way down */
        s->gauge = clamp(s->gauge, commanded - f[PRESSURE_BIAS][1], commanded + f[PRESSURE_BIAS][1]);
        inside += b * (0.5 + 0.5 * (s->gauge - commanded) / f[PRESSURE_BIAS][1]);
        break;
    case 7: /* it keeps a rest of vacuum where it should vent, or does not open below some */
        if (b != 0) inside = cbrt(fmax(0, commanded * commanded * commanded + b * b * b));
        break;
    default: inside += b * (1 - exp(-commanded / 4));
    }
    inside += before - commanded;
    if (f[PUMP_PULSES][0] > 0) /* that a damped gauge does not show */
        inside += f[PUMP_PULSES][0] * sin(TURN * f[PUMP_PULSES][1] * (s->session + t)) * commanded / (commanded + 3);
    if (f[PRESSURE_LAG][0] > 0) inside = s->sheath = filled(f[PRESSURE_LAG], s, inside, h);
    if (f[PRESSURE_LEAK][0] > 0) inside = leaked(f[PRESSURE_LEAK], s, inside > 0 ? inside : 0, t, h);
    s->sheath = inside > 0 ? inside : 0;
}
