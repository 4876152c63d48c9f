/* The robot of docs/model.md with the causes of gaps built in, written apart from ljjax.

   Absolute angles psi_i = q_1 + ... + q_i and an implicit midpoint for (v, z) between two half-steps of q.
   Every cause has a row f[ID] of WIDTH numbers; f[ID][0] is its strength, 0 when it is not there, the last one which of
   its shapes it has. SI units; kPa. */
#include "shapes.h"

/* Cholesky of the symmetric positive definite a, b solved in place. */
static void solve(double a[N][N], double b[N]) {
    for (int j = 0; j < N; j++) {
        for (int k = 0; k < j; k++) a[j][j] -= a[j][k] * a[j][k];
        a[j][j] = sqrt(a[j][j]);
        double inverse = 1 / a[j][j];
        for (int i = j + 1; i < N; i++) {
            for (int k = 0; k < j; k++) a[i][j] -= a[i][k] * a[j][k];
            a[i][j] *= inverse;
        }
    }
    for (int i = 0; i < N; i++) {
        for (int k = 0; k < i; k++) b[i] -= a[i][k] * b[k];
        b[i] /= a[i][i];
    }
    for (int i = N - 1; i >= 0; i--) {
        for (int k = i + 1; k < N; k++) b[i] -= a[k][i] * b[k];
        b[i] /= a[i][i];
    }
}

/* One run from rest. Out, at the start of each period: q (periods, N), tension at the spool (periods, 2), vacuum in
   the line and temperature above the first morning's (periods). Returns 0, or 1 where the motion blew up. */
int run(const double *robot, const double *causes, double *carried, int count, const double *u, const double *vacuum,
        double period, int substeps, double session, double *q_out, double *tension_out, double *line_out,
        double *warm_out) {
    const Robot *r = (const Robot *)robot;
    const double (*f)[WIDTH] = (const double (*)[WIDTH])causes;
    Carried *c = (Carried *)carried;
    State s;
    memset(&s, 0, sizeof s);

    double length[N], inertia[N][N] = {{0}}, weight[N];
    for (int i = 0; i < N; i++) length[i] = 2 * r->half_length * (i < N - 1 ? 1 : 0.5);
    for (int b = 0; b < N; b++) {
        double own = r->mass * (b < N - 1 ? 1 : 0.5), beyond = 0;
        for (int k = b + 1; k < N; k++) beyond += r->mass * (k < N - 1 ? 1 : 0.5);
        inertia[b][b] = own * (r->radius * r->radius / 4 + length[b] * length[b] / 3) + beyond * length[b] * length[b];
        for (int a = 0; a < b; a++)
            inertia[a][b] = inertia[b][a] = length[a] * (own * length[b] / 2 + beyond * length[b]);
        weight[b] = 9.81 * (own * length[b] / 2 + beyond * length[b]);
    }
    double payload = f[TIP_PAYLOAD][0], arm[N], full = payload;
    if (form(f[TIP_PAYLOAD]) == 4 && session < f[TIP_PAYLOAD][4]) payload = 0; /* put on between two runs */
    for (int i = 0; i < N; i++) arm[i] = length[i] + (i == N - 1 ? f[TIP_PAYLOAD][1] : 0);
    int hung = form(f[TIP_PAYLOAD]) == 5, drips = form(f[TIP_PAYLOAD]) == 6; /* on a thread, or from a bottle */
    int grips = form(f[TIP_PAYLOAD]) == 7; /* picks something up in each run, and lets go of it */
    if (payload > 0 && !hung) {
        for (int a = 0; a < N; a++)
            for (int b = 0; b < N; b++) inertia[a][b] += payload * arm[a] * arm[b];
        inertia[N - 1][N - 1] += 0.4 * payload * f[TIP_PAYLOAD][3] * f[TIP_PAYLOAD][3];
    }
    double spread = f[GRAVITY_DISTRIBUTION][0], cosine = spread > 1 ? 0 : 1 - spread;
    double lump[N] = {0}; /* [kg] that these links carry, with its inertia */
    for (int i = 0; i < N && form(f[GRAVITY_DISTRIBUTION]) == 4; i++) {
        lump[i] = 0.08 * spread * f[GRAVITY_DISTRIBUTION][1 + i];
        for (int k = 0; k < i; k++) inertia[i][k] = inertia[k][i] += lump[i] * length[i] * length[k];
        inertia[i][i] += lump[i] * length[i] * length[i];
    }
    for (int i = 0; i < 2; i++) {
        s.tension[i] = s.first[i] = s.slack[i][0] = s.slack[i][1] = u[i];
        if (form(f[TENDON_SLACK]) == 2) s.slack[i][0] = u[i] < 0.8 ? 1e-3 * f[TENDON_SLACK][0] : 0;
        for (int k = 0; k < N; k++) s.cable[k][i] = u[i];
        for (int k = 0; k < 4; k++) s.eddy[i][k] = u[i];
        s.breakaway[i] = form(f[ACTUATOR_DEADBAND]) == 6 ? u[i] : u[i] > f[ACTUATOR_DEADBAND][0];
        if (form(f[TENDON_SLACK]) == 6) s.slack[i][0] = sqrt(u[i]);
    }
    s.sheath = s.line = s.feed = s.fore = s.deep = s.topped = s.packed = s.clung = vacuum[0];
    s.gauge = vacuum[0] - f[PRESSURE_BIAS][1];
    s.session = session;
    s.pressed = u[0] + u[1];
    if (form(f[THERMAL_DRIFT]) == 5) c->core = soaked(f[THERMAL_DRIFT], c->core, c->warm, session - c->ended);
    c->ended = session + count * period;
    int harness = form(f[GRAVITY_DISTRIBUTION]) == 6 && spread > 0;
    int looped = form(f[GRAVITY_DISTRIBUTION]) == 7 && spread > 0; /* a hose from a link to the stand */
    int settle = f[REST_CURVATURE][0] != 0 || f[BASE_TILT][0] != 0 || payload > 0 || harness || looped;
    actuate(f, &s, u, count, 0, period, 0, r->lever);
    double h = period / substeps, half = h / 2;
    double answers = form(f[PRESSURE_LAG]) == 7 ? f[PRESSURE_LAG][0] * f[PRESSURE_LAG][1] : 0; /* so late */
    long begin = settle ? -(long)(3.0 / h) : 0, all = (long)count * substeps;

    for (long step = begin; step < all; step++) {
        double t = step * h, middle = t + half;
        int calm = step < 0;
        if (step == 0) {
            for (int i = 0; i < N; i++) {
                s.v[i] = s.omega_mid[i] = s.z[i] = s.guide[i] = 0;
                int held_there = form(f[LAYER_HYSTERESIS]) % 3 == 0 && form(f[LAYER_HYSTERESIS]) < 6;
                if (form(f[LAYER_HYSTERESIS]) == 7) held_there = 1;
                for (int k = 0; k < PLAYS; k++) s.play[i][k] = held_there ? s.q[i] : 0;
                if (form(f[LAYER_HYSTERESIS]) == 5) s.play[i][1] = 60;
                for (int k = 0; k < 4; k++) s.branch[i][k] = s.q[i];
                s.pendulum += s.q[i];
            }
            for (int i = 0; i < N && form(f[VISCOELASTIC_CREEP]) == 7; i++)
                s.branch[i][0] = s.branch[i][1] = s.pendulum / N;
        }
        if (!calm && step % substeps == 0) {
            long k = step / substeps;
            memcpy(q_out + k * N, s.q, sizeof s.q);
            tension_out[2 * k] = s.tension[0], tension_out[2 * k + 1] = s.tension[1];
            line_out[k] = s.line, warm_out[k] = c->felt;
        }
        actuate(f, &s, u, count, calm ? 0 : middle, period, h, r->lever);
        pressurise(f, &s, held(vacuum, count, 1, calm ? 0 : middle, period),
                   held(vacuum, count, 1, calm ? 0 : middle - answers, period), calm ? 0 : middle, calm ? 0 : h);
        double pull[2], freed[2] = {0}, curl = 0;
        for (int i = 0; i < N; i++) curl += s.q[i];
        for (int i = 0; i < N && !calm; i++) freed[0] += r->lever * s.v[i], freed[1] -= r->lever * s.v[i];
        for (int i = 0; i < 2; i++)
            pull[i] = past_slack(f[TENDON_SLACK], s.slack[i], s.tension[i], freed[i], session + fmax(t, 0), curl, h);
        if (f[DERAILED_TENDON][0] > 0) { /* out of its guides beyond one angle, back in them within another */
            int which = (int)f[DERAILED_TENDON][1];
            double bent = 0;
            for (int i = 0; i < N; i++) bent += (which ? -1 : 1) * s.q[i] / N / f[DERAILED_TENDON][2];
            if (bent > 1) s.derailed = 1;
            if (bent < 0.4) s.derailed = 0;
            pull[which] *= 1 - f[DERAILED_TENDON][0] * s.derailed;
        }
        double P = s.sheath, heat = (s.tension[0] + s.tension[1]) / 25 + 0.4;
        if ((drips || grips) && payload > 0) {
            const double *d = f[TIP_PAYLOAD];
            double holds = 0.5 * (tanh((fmax(t, 0) - d[4]) / 0.1) - tanh((fmax(t, 0) - d[5]) / 0.1));
            double less = payload - full * (drips ? exp(-(session + fmax(t, 0)) / d[4]) : 0.3 + 0.7 * holds);
            for (int a = 0; a < N; a++)
                for (int b = 0; b < N; b++) inertia[a][b] -= less * arm[a] * arm[b];
            inertia[N - 1][N - 1] -= 0.4 * less * f[TIP_PAYLOAD][3] * f[TIP_PAYLOAD][3];
            payload -= less;
        }
        if (!calm) {
            c->warm += h * (heat * 0.12 - c->warm / 260);
            c->felt += h * (c->warm - c->felt) / 4;
        }

        /* The pressure's laws. */
        double stiff = stiffening(f[STIFFNESS_SATURATION], P, &s.packed);
        double phi = rubbing(r, f[FRICTION_SATURATION], P, &s.clung), fresh = phi;
        double alpha2 = r->c3 + r->c2 * stiff + r->c1 * stiff * stiff, added = alpha2 - r->c3;
        double viscous = r->sigma2;
        if (form(f[THERMAL_DRIFT]) == 7) viscous *= exp(-f[THERMAL_DRIFT][0] * c->warm / 10); /* grease thins */
        if (form(f[THERMAL_DRIFT]) != 5) warmed(f[THERMAL_DRIFT], c->warm, &phi, &alpha2, &added);
        else warmed_inside(f[THERMAL_DRIFT], c, &phi, &alpha2, &added, calm ? 0 : h);
        if (f[GLUE_FAILURE][0] > 0 && session + t > f[GLUE_FAILURE][1]) alpha2 *= 1 - f[GLUE_FAILURE][0];
        if (f[SHAKEN_LOOSE][0] > 0) /* by a machine near by, on and off */
            phi *= 1 - f[SHAKEN_LOOSE][0] * (0.5 + 0.5 * tanh(5 * sin(TURN * (session + t) / f[SHAKEN_LOOSE][1] +
                                                                       f[SHAKEN_LOOSE][2])));
        double load = pull[0] + pull[1];
        const double *pressed = f[LOAD_DEPENDENT_FRICTION];
        if (pressed[0] > 0 && form(pressed) < 2) phi += pressed[0] * (form(pressed) ? load : pow(load + 1e-3, 0.75));

        if (pressed[0] > 0 && form(pressed) == 7) /* it presses as so much more vacuum would */
            phi += r->c5 * (sqrt(P + pressed[0] * load) - sqrt(P));
        if (pressed[0] > 0 && form(pressed) == 6) { /* guides that stand off the layers until they are pulled in */
            double over = load - pressed[1];
            phi += pressed[0] * 0.5 * (over + hypot(over, 0.5));
        }
        if (pressed[0] > 0 && form(pressed) == 5) { /* contacts that soon grow under load and slowly part */
            s.pressed += (load - s.pressed) * -expm1(-h / (load > s.pressed ? 0.3 : pressed[1]));
            phi += pressed[0] * s.pressed;
        }

        /* Half a step of q, and what depends on q. */
        double psi[N], cosp[N], sinp[N], bend = 0, torque[N], phi_i[N], extra[N], asymmetry[N], around[N];
        for (int i = 0; i < N; i++) {
            s.q[i] += half * s.v[i];
            psi[i] = bend += s.q[i];
            cosp[i] = cos(bend), sinp[i] = sin(bend);
        }
        double left[N], right[N], a = pull[0], b = pull[1], slide[N], beyond = 0;
        for (int i = N - 1; i >= 0; i--) slide[i] = beyond += s.v[i];
        for (int i = 0; i < N; i++) {
            const double *t = f[TENDON_FRICTION];
            if (t[0] > 0 && form(t) == 5) {
                double drawn = calm ? 0 : h * r->lever * s.v[i];
                a = stuck(t, &s.cable[i][0], a, s.q[i], -drawn), b = stuck(t, &s.cable[i][1], b, s.q[i], drawn);
            } else if (t[0] > 0) {
                double still[1] = {0}, *guide = calm ? still : &s.guide[i];
                double passes = calm ? 0 : r->lever * slide[form(t) == 1 ? 0 : i];
                double loss = rubbed(t, guide, &s.sliding[i], s.q[i], passes, h);
                if (form(t) == 4 && i > 0) loss = 0;
                if (form(t) == 7) loss *= 1 - 0.85 * exp(-c->slip[i] / t[1]); /* grease is wiped out of the guides */
                switch (form(t)) {
                case 0: a *= 1 - loss, b *= 1 + loss; break;
                case 4:
                case 6:
                case 7:
                case 1: a *= exp(-loss), b *= exp(loss); break;
                case 3: a *= 1 - lined(t, i, s.q[i], a) * loss, b *= 1 + lined(t, i, s.q[i], b) * loss; break;
                default: a *= 1 - t[1] * loss, b *= 1 + t[2] * loss;
                }
            }
            left[i] = a, right[i] = b;
        }
        for (int i = 0; i < N; i++) {
            double q = s.q[i], of = alpha2;
            if (f[NONUNIFORM_STIFFNESS][0] > 0) {
                const double *d = f[NONUNIFORM_STIFFNESS];
                double seam = form(d) == 4 ? 0.6 + 0.5 * tanh(q / 0.02) : 1; /* that resists to one side */
                if (form(d) == 8) seam = q * q / (q * q + d[7] * d[7]); /* it creases where it is bent */
                double base_share = form(d) == 8 ? 1 : d[7], added_share = form(d) == 8 ? 1 : d[8];
                if (form(d) == 6) /* each ages in its own way, by its own bending */
                    base_share = added_share = 1 - 0.8 * exp(-c->slip[i] / d[7]);
                of += d[0] * d[1 + i] * seam * (base_share * (alpha2 - added) + added_share * added);
                if (of < 0.05 * alpha2) of = 0.05 * alpha2;
            }
            double free = f[REST_CURVATURE][0] * f[REST_CURVATURE][1 + i];
            if (form(f[REST_CURVATURE]) == 3) free *= 0.3 + P / 20; /* a sheath that pulls to one side */
            if (form(f[REST_CURVATURE]) == 4) /* that it takes little by little */
                free *= -expm1(-(session + fmax(t, 0)) / f[REST_CURVATURE][7]);
            if (form(f[REST_CURVATURE]) == 5) /* from the reel, worked out of it by bending */
                free *= 0.15 + 0.85 * exp(-c->slip[i] / f[REST_CURVATURE][7]);
            if (form(f[REST_CURVATURE]) == 7) /* it lies bent between runs, and comes out of it in each */
                free *= 0.35 + 0.65 * exp(-fmax(t, 0) / f[REST_CURVATURE][7]);
            if (form(f[REST_CURVATURE]) == 6) /* straightened by hand before each run */
                free *= 2 * chance(session + f[REST_CURVATURE][7]) - 0.5;
            double sprung = form(f[REST_CURVATURE]) == 2 ? r->c3 : of;
            torque[i] = of * q - sprung * free - r->lever * (left[i] - right[i]);
            if (f[STIFFNESS_HARDENING][0] != 0) { /* of each joint, or of a hose through all of them */
                double x = form(f[STIFFNESS_HARDENING]) == 6 ? bend / N : q;
                double covered = 1 / (1 + exp((i - f[STIFFNESS_HARDENING][1]) / 0.3)); /* from the base on */
                torque[i] += hardened(f[STIFFNESS_HARDENING], x,
                                      form(f[STIFFNESS_HARDENING]) == 7 ? covered : alpha2 / r->c3);
            }
            if (f[CONTACT][0] > 0 && form(f[CONTACT]) == 2) { /* an end stop in the joint */
                double soft = 0.004, x = (f[CONTACT][2] * q - f[CONTACT][1]) / soft;
                torque[i] += f[CONTACT][0] * f[CONTACT][2] * soft * (x > 30 ? x : log1p(exp(x)));
            }
            if (f[COLUMN_SOFTENING][0] > 0) /* pressed lengthwise, between guides that stop it */
                torque[i] -= f[COLUMN_SOFTENING][0] * load * 0.2 * tanh(q / 0.2);
            if (f[SNAP_THROUGH][0] > 0)
                torque[i] -= f[SNAP_THROUGH][0] * sin(f[SNAP_THROUGH][1] * q);
            if (f[LAYER_HYSTERESIS][0] > 0 && !calm && form(f[LAYER_HYSTERESIS]) != 6)
                torque[i] += f[LAYER_HYSTERESIS][0] * remembered(f[LAYER_HYSTERESIS], s.play[i], q, h * s.v[i], P, h);
            if (f[VISCOELASTIC_CREEP][0] > 0 && !calm)
                torque[i] += f[VISCOELASTIC_CREEP][0] *
                             crept(f[VISCOELASTIC_CREEP], s.branch[i],
                                   form(f[VISCOELASTIC_CREEP]) == 7 ? bend / N : q, P, h);
            if (f[BASE_VIBRATION][0] > 0)
                torque[i] -= f[BASE_VIBRATION][0] * (N - i) / N *
                             sin(TURN * f[BASE_VIBRATION][1] * (session + t) + f[BASE_VIBRATION][2]);
            phi_i[i] = phi;
            if (form(f[THERMAL_DRIFT]) == 6) /* most of the warmth is near the motors */
                phi_i[i] /= 1 + f[THERMAL_DRIFT][0] * c->warm / 10 * (1.8 - 0.32 * i);
            if (pressed[0] > 0 && form(pressed) == 4) phi_i[i] *= 1 + 0.06 * pressed[0] * load;
            if (pressed[0] > 0 && form(pressed) == 3) /* tendons press where they are bent */
                phi_i[i] += pressed[0] * load * fabs(q) / 0.1;
            if (pressed[0] > 0 && form(pressed) == 2)
                phi_i[i] += pressed[0] * 10 * load / (load + 10) * (1.5 - 0.2 * i);
            if (f[LAYER_WEAR][0] > 0) {
                double slid = c->slip[i] / f[LAYER_WEAR][1], x = pow(slid, 0.8);
                switch (form(f[LAYER_WEAR])) {
                case 0: phi_i[i] *= 1 - f[LAYER_WEAR][0] * x / (1 + x); break;
                case 1: phi_i[i] *= 1 + f[LAYER_WEAR][0] * expm1(-slid); break;
                case 3: phi_i[i] *= 1 - f[LAYER_WEAR][0] / (1 + pow(slid + 1e-6, -4)); break; /* a coat wears through */
                case 4: phi_i[i] *= fmax(0.1, 1 - f[LAYER_WEAR][0] * slid); break;
                case 7: /* all that the vacuum adds: it is the layers that wear, not what else rubs */
                    phi_i[i] *= 1 + f[LAYER_WEAR][0] * (1 - r->c4 / fresh) * expm1(-slid);
                    break;
                case 6: /* they run in, then wear steadily */
                    phi_i[i] *= fmax(0.1, 1 + f[LAYER_WEAR][0] * (0.45 * expm1(-6 * slid) - 0.55 * slid));
                    break;
                case 5: { /* a track, at the angles where it has slid */
                    int k = beneath(q, &x);
                    slid = ((1 - x) * c->track[i][k] + x * c->track[i][k + 1]) / f[LAYER_WEAR][1];
                    phi_i[i] *= 1 + f[LAYER_WEAR][0] * expm1(-slid);
                    break;
                }
                default: phi_i[i] /= 1 + f[LAYER_WEAR][0] * log1p(slid);
                }
            }
            if (f[JAMMED_JOINT][0] > 0 && i == (int)f[JAMMED_JOINT][1])
                phi_i[i] *= 1 + f[JAMMED_JOINT][0] * (1 + sin(q / 0.05 + f[JAMMED_JOINT][2]));
            if (f[BUCKLING_FRICTION][0] > 0) {
                double x = q / f[BUCKLING_FRICTION][1];
                phi_i[i] *= 1 / (1 + f[BUCKLING_FRICTION][0] * x * x * x * x / (1 + x * x * x * x));
            }
            asymmetry[i] = 1;
            if (f[FRICTION_ASYMMETRY][0] != 0)
                asymmetry[i] += lopsided(f[FRICTION_ASYMMETRY], s.loading[i], q, s.v[i], P, calm ? 0 : h);
            extra[i] = calm ? 0.3 : 0;
        }
        /* In absolute angles: gravity, Coriolis, contact. */
        double tilt = f[BASE_TILT][0], aside = 0, swept = 0, rate[N], sum = 0;
        double uneven = form(f[BASE_TILT]) == 0 ? 0.15 : 0;
        if (form(f[BASE_TILT]) == 2) tilt *= 0.5 + chance(session + f[BASE_TILT][1]); /* mounted anew for each run */
        if (form(f[BASE_TILT]) == 3) /* a mount that sags */
            tilt *= 1 - 0.8 * exp(-(session + fmax(t, 0)) / f[BASE_TILT][1]);
        if (form(f[BASE_TILT]) == 4) /* a stand that somebody knocks */
            tilt *= 0.5 + 0.5 * tanh((session + fmax(t, 0) - f[BASE_TILT][1]) / 0.1);
        if (form(f[BASE_TILT]) == 5) { /* a loose clamp, to the side to which it hangs */
            double moved = bend * bend / (bend * bend + 0.03) / 0.15;
            s.rocker += (calm ? 0 : h) * moved * (tanh(6 * bend) - s.rocker);
            tilt = 0.55 * tilt + 0.45 * fabs(tilt) * s.rocker;
        }
        if (form(f[BASE_TILT]) == 7) { /* a slender stand, not upright, that rocks as the body swings */
            double w = TURN * f[BASE_TILT][1], to = sin(0.5 * bend);
            s.rocking += calm ? 0 : h * w * (w * (to - s.rocker) - 0.12 * s.rocking);
            s.rocker = calm ? to : s.rocker + h * s.rocking;
            tilt = 0.6 * tilt + 0.8 * fabs(tilt) * s.rocker;
        }
        double leaning = form(f[BASE_TILT]) == 6 ? tilt : 0; /* felt by every link's own weight */
        if (form(f[BASE_TILT]) == 6) tilt = 0;
        double tipward = r->alpha1 * cosine;
        tipward *= sinp[N - 1] * cos(tilt) - cosp[N - 1] * sin(tilt) * (1 + uneven * sinp[N - 1]);
        int touched = form(f[CONTACT]) == 4 ? (int)f[CONTACT][3] : N - 1; /* the link that meets it */
        double met = 0, meets = 0, loop = 0;
        for (int i = 0; i < N; i++) {
            rate[i] = sum += s.v[i];
            aside += length[i] * sinp[i];
            swept += length[i] * cosp[i] * rate[i];
            if (i == touched) met = aside, meets = swept;
            if (looped && i == (int)f[GRAVITY_DISTRIBUTION][1]) loop = aside;
        }
        double depth = f[CONTACT][2] * met - f[CONTACT][1], slip = f[CONTACT][2] * meets, push = 0;
        if (f[CONTACT][0] > 0 && form(f[CONTACT]) == 6) { /* a padded tube, with a wall to either side */
            double other = fmax(0, -f[CONTACT][2] * met - f[CONTACT][3]), near = fmax(0, depth);
            push = f[CONTACT][0] * (near * near - other * other) / 0.01;
        } else if (f[CONTACT][0] > 0 && depth > 0) {
            if (form(f[CONTACT]) == 0) push = f[CONTACT][0] * depth * sqrt(depth) * clamp(1 + 3 * slip, 0, 3);
            if (form(f[CONTACT]) == 1) push = f[CONTACT][0] * depth;
            if (form(f[CONTACT]) == 4) push = f[CONTACT][0] * fmax(0, depth + 0.003 * slip);
            if (form(f[CONTACT]) == 3) /* foam on something hard */
                push = f[CONTACT][0] * (0.15 * depth + fmax(0, depth - f[CONTACT][3]));
            if (form(f[CONTACT]) == 7) { /* a box that is shoved along, and stays where it is left */
                push = clamp(2000 * (depth - s.dent), 0, f[CONTACT][0]);
                s.dent = fmax(s.dent, depth - f[CONTACT][0] / 2000);
            }
            if (form(f[CONTACT]) == 5) /* it yields, and comes back */
                push = f[CONTACT][0] * (0.3 * depth + 0.7 * fmax(0, depth - s.dent));
        }
        if (form(f[CONTACT]) == 5 && !calm) s.dent += h * (fmax(depth, 0) - s.dent) / f[CONTACT][3];
        double hook = 0, aback = 0, collar = 0;
        if (payload > 0 && hung) {
            double w2 = 9.81 / f[TIP_PAYLOAD][4];
            for (int i = 0; i < N; i++) hook += arm[i] * sinp[i];
            if (calm) s.swing = hook;
            s.swing_rate += h * (w2 * (hook - s.swing) - 0.06 * sqrt(w2) * s.swing_rate);
            if (!calm) s.swing += h * s.swing_rate;
            aback = payload * w2 * (hook - s.swing);
        }
        if (form(f[GRAVITY_DISTRIBUTION]) == 5 && spread > 0) { /* a loose collar that works its way down */
            const double *d = f[GRAVITY_DISTRIBUTION];
            for (int i = 0; i < N; i++) collar += c->slip[i] / N / d[3];
            collar = d[2] + (d[1] - d[2]) * exp(-collar);
        }
        double hose_weight = 0, hose_pull = 0; /* on the link from which it hangs; more, the farther from the stand */
        if (looped) {
            const double *d = f[GRAVITY_DISTRIBUTION];
            double span = fmax(0, 1 - d[2] * loop / d[3]);
            hose_weight = spread * 2.5 * r->mass * 9.81, hose_pull = d[2] * d[4] * hose_weight * span * span;
        }
        double blown = 0, pulled = calm ? 0 : beside(f, &s.dragged, aside, swept, h);
        const double *air = f[DRAUGHT];
        if (air[0] > 0 && !calm)
            for (int k = 1; k < 5; k++)
                blown += air[0] * tanh(t) * sin(TURN * (air[k] * t + chance(air[5] + session + k)));
        if (f[HIDDEN_PENDULUM][0] > 0 && !calm) {
            double w = f[HIDDEN_PENDULUM][1];
            s.pendulum_rate += h * (w * w * (psi[N - 1] - s.pendulum) - 0.12 * w * s.pendulum_rate);
            s.pendulum += h * s.pendulum_rate;
            tipward += f[HIDDEN_PENDULUM][0] * (psi[N - 1] - s.pendulum);
        }
        double mass[N][N], across = f[CONTACT][2] * push - blown + pulled, beyond_it = pulled - blown;
        for (int i = 0; i < N; i++) {
            double spun = 0;
            for (int j = 0; j < N; j++) {
                double cosine_ij = cosp[i] * cosp[j] + sinp[i] * sinp[j];
                mass[i][j] = inertia[i][j] * cosine_ij / half;
                spun += inertia[i][j] * (sinp[i] * cosp[j] - cosp[i] * sinp[j]) * s.omega_mid[j] * s.omega_mid[j];
            }
            around[i] = spun + (i == N - 1 ? tipward : 0) + (i <= touched ? across : beyond_it) * length[i] * cosp[i];
            if (payload > 0) {
                around[i] += payload * 9.81 * arm[i] * sinp[i];
                if (i == N - 1) around[i] += payload * 9.81 * f[TIP_PAYLOAD][2] * cosp[i];
                around[i] += aback * arm[i] * cosp[i];
            }
            if (leaning != 0) around[i] += weight[i] * (sin(psi[i] - leaning) - sinp[i]);
            if (f[LAYER_HYSTERESIS][0] > 0 && form(f[LAYER_HYSTERESIS]) == 6 && !calm)
                around[i] += f[LAYER_HYSTERESIS][0] *
                             remembered(f[LAYER_HYSTERESIS], s.play[i], psi[i], h * rate[i], P, h);
            if (harness) /* strapped along one side */
                around[i] += spread * f[GRAVITY_DISTRIBUTION][7] * 9.81 * r->mass * (i < N - 1 ? 1 : 0.5) * cosp[i];
            if (looped && i <= (int)f[GRAVITY_DISTRIBUTION][1])
                around[i] += length[i] * (hose_weight * sinp[i] - hose_pull * cosp[i]);
            if (lump[i] > 0) around[i] += lump[i] * 9.81 * length[i] * sinp[i];
            else if (spread > 0 && form(f[GRAVITY_DISTRIBUTION]) == 5)
                around[i] += spread * 2.5 * r->mass * 9.81 * length[i] * clamp(collar - i, 0, 1) * sinp[i];
            else if (spread > 0 && !looped && form(f[GRAVITY_DISTRIBUTION]) != 4) {
                double hose = 2 * sinp[i] * sinp[i] * (form(f[GRAVITY_DISTRIBUTION]) == 3); /* lifted off the floor */
                around[i] += spread * weight[i] * f[GRAVITY_DISTRIBUTION][1 + i] * sinp[i] * (1 + hose);
            }
        }

        /* Newton for the velocity at mid-step. */
        double mid[N], mid_z[N], d_z[N], gain[N], before = 0;
        for (int i = 0; i < N; i++) {
            double now = s.omega_mid[i];
            mid[i] = step == begin || step == 0 ? 0 : now - before;
            before = now;
        }
        double drop = r->mu_s - r->mu_c, memory = r->sigma1 / half;
        double bath = form(f[VISCOUS_DAMPING]) == 6 && !calm ? f[VISCOUS_DAMPING][0] * half : 0; /* as of the mass */
        double geared = form(f[VISCOUS_DAMPING]) == 7 && !calm ? f[VISCOUS_DAMPING][0] : 0; /* of drives it turns */
        for (int turn = 0; turn < 4; turn++) {
            double matrix[N][N], right_side[N], tau[N], d_tau[N], relative = 0, largest = 0, delta[N];
            for (int i = 0; i < N; i++) {
                double v = mid[i], speed = fabs(v);
                if (calm) {
                    mid_z[i] = d_z[i] = 0;
                    tau[i] = torque[i] + extra[i] * v, d_tau[i] = extra[i];
                } else {
                    double x = speed > 1e-12 ? exp(r->sigma3 * log(speed / r->v_s)) : 0, g = drop * exp(-x);
                    double rho = (r->mu_c + g) * asymmetry[i], scale = 1 + half * speed / rho;
                    double slope = sign(v) / rho * (1 + g / (r->mu_c + g) * r->sigma3 * x);
                    mid_z[i] = (s.z[i] + half * v) / scale;
                    d_z[i] = half * (1 - slope * mid_z[i]) / scale;
                    tau[i] = torque[i] + phi_i[i] * ((1 + memory) * mid_z[i] - memory * s.z[i] + viscous * v);
                    d_tau[i] = phi_i[i] * ((1 + memory) * d_z[i] + viscous);
                    if (f[VISCOUS_DAMPING][0] > 0 && form(f[VISCOUS_DAMPING]) < 6)
                        tau[i] += damped(f[VISCOUS_DAMPING], i, s.q[i], v, alpha2 / r->c3, s.sheared[i], &d_tau[i]);
                }
                relative += mid[i] - s.v[i];
                gain[i] = relative;
            }
            for (int i = 0; i < N; i++) {
                double x = around[i] + tau[i] - (i + 1 < N ? tau[i + 1] : 0);
                for (int j = 0; j < N; j++) {
                    matrix[i][j] = mass[i][j];
                    x += mass[i][j] * gain[j];
                }
                for (int j = 0; j < N && bath > 0; j++) { /* what it moves in drags on every link */
                    matrix[i][j] += bath * mass[i][j];
                    x += bath * mass[i][j] * (gain[j] + rate[j]);
                }
                if (i == N - 1) { /* the tendons that turn them run through all joints */
                    matrix[i][i] += geared;
                    x += geared * (gain[i] + rate[i]);
                }
                right_side[i] = -x;
                matrix[i][i] += d_tau[i] + (i + 1 < N ? d_tau[i + 1] : 0);
                if (i) matrix[i][i - 1] -= d_tau[i], matrix[i - 1][i] -= d_tau[i];
            }
            solve(matrix, right_side);
            for (int i = 0; i < N; i++) {
                delta[i] = right_side[i] - (i ? right_side[i - 1] : 0);
                mid[i] += delta[i];
                mid_z[i] += d_z[i] * delta[i];
                if (fabs(delta[i]) > largest) largest = fabs(delta[i]);
            }
            if (turn >= 1 && largest < 1e-7) break;
        }
        sum = 0;
        for (int i = 0; i < N; i++) {
            s.omega_mid[i] = sum += mid[i];
            s.v[i] = 2 * mid[i] - s.v[i];
            s.z[i] = calm ? 0 : 2 * mid_z[i] - s.z[i];
            s.q[i] += half * s.v[i];
            double pressing = form(f[LAYER_WEAR]) == 2 ? fresh / (r->c4 + r->c5 * sqrt(20)) : 1;
            if (form(f[LAYER_WEAR]) == 4) pressing = P / 20;
            if (!calm) c->slip[i] += h * fabs(mid[i]) * pressing;
            if (!calm && form(f[LAYER_WEAR]) == 5) {
                double share, slid = h * fabs(mid[i]);
                int k = beneath(s.q[i], &share);
                c->track[i][k] += (1 - share) * slid, c->track[i][k + 1] += share * slid;
            }
            if (!calm && form(f[VISCOUS_DAMPING]) == 5)
                s.sheared[i] += h * (fabs(mid[i]) * (1 - s.sheared[i]) / f[VISCOUS_DAMPING][2] -
                                    s.sheared[i] / f[VISCOUS_DAMPING][1]);
            if (!(fabs(s.q[i]) < 3)) return 1;
        }
    }
    return 0;
}
