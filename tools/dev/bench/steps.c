/* Steps of the laws and of the barrel plant in plain C: the yardstick of `tools.dev.bench`.
 *
 *   void step(double t, double dt, double *p, double *x, double *u, double *y)
 *
 * Views and equations are those of the Python files named at each function; layout.h, made from the
 * Python blocks, gives the views as structs of doubles. Scratch space of x is left alone: C has a
 * stack. With -DPORTABLE_MATH the functions of executive/laws/emath.py, written again in C, stand in for
 * libm: then, with -ffp-contract=off, the bits are Python's. SI units.
 */
#include <math.h>
#include <string.h>

#include "layout.h"

typedef void step_function(double, double, double *, double *, double *, double *);

#define COUNT(group) ((int)(sizeof(struct group) / sizeof(double)))
#define CHECK(name, ports) \
    _Static_assert(sizeof(struct name) == ports * sizeof(double), #name " differs from the block")

static inline double clip(double x, double low, double high)
{
    return x < low ? low : x > high ? high : x;
}

/* ------------------------------------------------------------- executive/laws/emath.py, or libm --- */

#ifdef PORTABLE_MATH

#define ROUND 6755399441055744.0 /* 1.5 * 2^52 */
#define WHOLE 4503599627370496.0 /* 2^52 */

struct reduced { double k, r, rl; };

static inline double whole(double x) { return (x + ROUND) - ROUND; }

static inline double pow2(double k)
{
    double shifted = k + ROUND;
    unsigned long long bits;
    memcpy(&bits, &shifted, sizeof bits);
    bits = (bits + 1023) << 52;
    memcpy(&shifted, &bits, sizeof bits);
    return shifted;
}

static inline double e_floor(double x)
{
    double n = x;
    if (fabs(x) < WHOLE) {
        n = (fabs(x) + WHOLE) - WHOLE;
        n = x < 0.0 ? -n : n;
    }
    return n > x ? n - 1.0 : n;
}

static inline struct reduced exp_reduce(double x)
{
    double k = whole(x * 1.4426950408889634);
    double high = x - k * 0.6931471805592082;
    double low = k * 7.371002565167799e-13;
    double r = high - low;
    return (struct reduced){k, r, (high - r) - low};
}

static inline double exp_polynomial(double r)
{
    double r2 = r * r, r4 = r2 * r2;
    double q0 = (0.5 + 0.1666666666666667 * r)
                + (0.04166666666666667 + 0.008333333333326136 * r) * r2;
    double q4 = 0.0013888888888883748 + 0.00019841269874820627 * r;
    double q6 = 2.4801587325547743e-05 + 2.7557255400206422e-06 * r;
    double q8 = (2.75572736431103e-07 + 2.5105217004720745e-08 * r) + 2.0914686968086876e-09 * r2;
    return q0 + ((q4 + q6 * r2) + q8 * r4) * r4;
}

static inline double scale(double x, double k)
{
    double half = whole(k * 0.5);
    return x * pow2(half) * pow2(k - half);
}

static inline double e_exp(double x)
{
    struct reduced a = exp_reduce(clip(x, -750.0, 710.0));
    return scale(1.0 + (a.r + (a.r * a.r * exp_polynomial(a.r) + a.rl)), a.k);
}

static inline double expmsq(double x)
{
    x = clip(x, -27.5, 27.5);
    double high = 134217729.0 * x;
    high = high - (high - x);
    double low = x - high;
    double z = x * x;
    double zl = ((high * high - z) + 2.0 * high * low) + low * low;
    struct reduced a = exp_reduce(-z);
    double rl = a.rl - zl;
    double w = a.r * a.r * exp_polynomial(a.r);
    return scale(1.0 + (a.r + (w + rl * (1.0 + (a.r + w)))), a.k);
}

static inline double tanh_polynomial(double z)
{
    double z2 = z * z, z4 = z2 * z2;
    double m0 = -0.3333333333333333 + 0.13333333333332711 * z;
    double m2 = -0.05396825396743151 + 0.021869488493552625 * z;
    double m4 = -0.008863234395177999 + 0.003592110343931255 * z;
    double m6 = -0.0014556615522767396 + 0.00058893468259176 * z;
    double m8 = (-0.00023463067524526733 + 8.510647287642557e-05 * z)
                + -2.0598135435770385e-05 * z2;
    return (m0 + m2 * z2) + ((m4 + m6 * z2) + m8 * z4) * z4;
}

static inline double e_tanh(double x)
{
    double size = fabs(x) > 22.0 ? 22.0 : fabs(x), t;
    if (size < 0.55) {
        double z = size * size;
        t = size + size * z * tanh_polynomial(z);
    } else {
        struct reduced b = exp_reduce(2.0 * size);
        double w = b.r * b.r * exp_polynomial(b.r) + b.rl;
        double s = pow2(-b.k);
        double a = 1.0 + s;
        double d = a + b.r;
        t = 1.0 - (s + s) / (d + (((a - d) + b.r) + w));
    }
    return x == 0.0 ? x : x < 0.0 ? -t : t;
}

static inline double sin_kernel(double y, double yl)
{
    double z = y * y, z2 = z * z;
    double s0 = -0.16666666666666666 + 0.008333333333330946 * z;
    double s2 = -0.0001984126983675497 + 2.755731610068303e-06 * z;
    double s4 = -2.5051131455427946e-08 + 1.591810123027412e-10 * z;
    return y + (z * y * (s0 + (s2 + s4 * z2) * z2) + (yl - 0.5 * z * yl));
}

static inline double cos_kernel(double y, double yl)
{
    double z = y * y, z2 = z * z;
    double c0 = 0.041666666666666664 + -0.0013888888888887395 * z;
    double c2 = 2.4801587298763433e-05 + -2.755731727056031e-07 * z;
    double c4 = 2.087614602468733e-09 + -1.1382614868413877e-11 * z;
    double h = 0.5 * z;
    double u = 1.0 - h;
    return u + (((1.0 - u) - h) + (z2 * (c0 + (c2 + c4 * z2) * z2) - y * yl));
}

static inline void e_sincos(double x, double *sine, double *cosine)
{
    if (!(fabs(x) <= 1647099.0)) {
        *sine = *cosine = NAN;
        return;
    }
    double k = whole(x * 0.6366197723675814);
    double quadrant = k - 4.0 * whole(k * 0.25);
    double a = x - k * 1.5707963267341256;
    double w = k * 6.077100506303966e-11;
    double b = a - w;
    double e = (a - b) - w;
    w = k * 2.0222662487111665e-21;
    double c = b - w;
    e = ((b - c) - w) + e;
    e = e - k * 8.4784276603689e-32;
    double y = c + e, yl = (c - y) + e;
    double sy = sin_kernel(y, yl), cy = cos_kernel(y, yl);
    int odd = fabs(quadrant) == 1.0, back = fabs(quadrant) == 2.0;
    double s = odd ? cy : sy, co = odd ? sy : cy;
    s = quadrant == -1.0 || back ? -s : s;
    *sine = x == 0.0 ? x : s;
    *cosine = quadrant == 1.0 || back ? -co : co;
}

static inline double e_sin(double x) { double s, c; e_sincos(x, &s, &c); return s; }
static inline double e_cos(double x) { double s, c; e_sincos(x, &s, &c); return c; }
static inline double modulo(double a, double m) { return a - e_floor(a / m) * m; }

#define exp e_exp
#define tanh e_tanh
#define sin e_sin
#define cos e_cos
#define sine_cosine e_sincos

#else

static inline double expmsq(double x) { return exp(-(x * x)); }

static inline void sine_cosine(double x, double *sine, double *cosine)
{
    *sine = sin(x); /* one call of sincos, which is no standard C */
    *cosine = cos(x);
}

static inline double modulo(double a, double m) /* as in L'Ecuyer's own program */
{
    a -= (double)(long long)(a / m) * m;
    return a < 0.0 ? a + m : a;
}

#endif

static inline double logistic(double x)
{
    double e = exp(-fabs(x));
    return (x < 0.0 ? e : 1.0) / (1.0 + e);
}

/* ----------------------------------------------- executive/approximators/two_layer.py --------- */

static inline double scaled(double value, double size) { return clip(value / size, -3.0, 3.0); }

static inline void jump_pair(double v, double v_s, double *phi)
{
    double rise = 1.0 - exp(-fabs(v) / v_s);
    phi[0] = v > 0.0 ? rise : 0.0;
    phi[1] = v < 0.0 ? rise : 0.0;
}

static inline void hidden(const double *x, int n_in, int n, const double *v, double *a, double *phi)
{
    phi[0] = 1.0;
    for (int j = 0; j < n; j++) {
        double total = 0.0;
        for (int i = 0; i < n_in; i++)
            total += v[i * n + j] * x[i];
        a[j] = total;
        phi[j + 1] = logistic(total);
    }
}

static inline double dot(const double *a, const double *b, int n)
{
    double total = 0.0;
    for (int j = 0; j < n; j++)
        total += a[j] * b[j];
    return total;
}

struct rates { double kappa, f, fj, g; };

static inline void tune(double r, struct rates k, double dt, const double *x, int n_in, int n,
                        int n_jump, const double *a, const double *phi, double *w, double *v)
{
    double leak = k.kappa * fabs(r);
    for (int j = 0; j < n; j++) {
        double s = phi[j + 1];
        double slope = s * (1.0 - s);
        double back = slope * w[j + 1] * r;
        for (int i = 0; i < n_in; i++)
            v[i * n + j] += dt * k.g * (x[i] * back - leak * v[i * n + j]);
        w[j + 1] += dt * k.f * ((s - slope * a[j]) * r - leak * w[j + 1]);
    }
    w[0] += dt * k.f * (r - leak * w[0]);
    for (int j = n + 1; j < n + 1 + n_jump; j++)
        w[j] += dt * k.fj * (phi[j] * r - leak * w[j]);
}

/* ---------------------------------------- executive/controllers/tracking_network.py ----------- */

enum { NODES = 10, JUMPS = 4, PHI = 1 + NODES + JUMPS, INPUTS = 7, INNER_INPUTS = 6 };
#define FADE_S 0.1

static inline double learned_torque(double dt, double e, double e_rate, double r, double w,
                                    const struct pd_inputs *u, const struct fast_inputs *f,
                                    const struct network_parameters *p, struct network_states *x,
                                    struct network_outputs *y)
{
    double a[NODES], phi[PHI];
    double xi[INPUTS] = {
        1.0, scaled(e, 0.02), scaled(e_rate, 0.2), scaled(u->q_d_rad, 0.5),
        scaled(u->q_d_rate_rad_s, 0.5), scaled(f->q_d_acc_rad_s2, 3.0), scaled(w, 0.2),
    };
    hidden(xi, INPUTS, NODES, x->v, a, phi);
    double v_j = u->q_d_rate_rad_s - u->hull_rate_rad_s;
    jump_pair(v_j, 0.004, phi + 1 + NODES);
    jump_pair(v_j, 0.04, phi + 3 + NODES);
    double norm = sqrt(dot(x->w, x->w, PHI) + dot(x->v, x->v, INPUTS * NODES));
    double network = dot(x->w, phi, PHI);
    double learned = network + p->kz * (norm + p->z_bound) * r;

    int on = p->network_on > 0.5;
    if (on && !(fabs(network) <= p->y_max_Nm && norm <= p->z_max))
        x->network_fault = 1.0;
    int trusted = on && x->network_fault < 0.5;
    x->faded_Nm = trusted ? learned : x->faded_Nm * (1.0 - dt / FADE_S);

    int moving = fabs(e) > 1e-4 || fabs(f->q_d_acc_rad_s2) > 1e-6;
    struct rates rates = {p->kappa, p->f_rate, p->fj_rate, p->g_rate};
    tune(clip(r, -0.3, 0.3), rates, trusted && moving ? dt : 0.0, xi, INPUTS, NODES, JUMPS, a, phi,
         x->w, x->v);
    y->network_Nm = trusted ? network : x->faded_Nm;
    y->norm_z = norm;
    y->fallback = x->network_fault;
    return x->faded_Nm;
}

/* ------------------------------------------ executive/controllers/boundary_layer.py ----------- */

static inline double fast(double dt, double q_d, const struct fast_inputs *u, double speed,
                          const struct fast_parameters *p, struct fast_states *x)
{
    double w_f = p->mode_rad_s, h_f = p->mode_gain;
    double eta = u->strain_ue / p->strain_ue_per_mode + p->gravity_mode * cos(q_d)
                 + p->inertia_mode_s2_rad * u->q_d_acc_rad_s2;
    double innovation = eta - x->mode_x0;
    double drive = -w_f * w_f * x->mode_x0 - 2.0 * p->mode_damping * w_f * x->mode_x1
                   + h_f * x->fast_held_Nm;
    x->mode_x1 = x->mode_x1 + dt * (drive + p->observer_l2_per_s2 * innovation);
    x->mode_x0 = x->mode_x0 + dt * (x->mode_x1 + p->observer_l1_per_s * innovation);
    double k = -2.0 * (p->damping_wanted - 0.02) * w_f / fabs(h_f);
    double sine, cosine;
    sine_cosine(w_f * (1.5 * dt + p->actuator_delay_s), &sine, &cosine);
    double torque = k * w_f * sine * x->mode_x0 - k * cosine * x->mode_x1;
    x->gate_rad_s = x->gate_rad_s + dt / 0.03 * (fabs(speed) - x->gate_rad_s);
    x->fast_held_Nm = torque * clip((x->gate_rad_s - 0.0015) / 0.0015, 0.0, 1.0);
    return x->fast_held_Nm;
}

/* ------------------------------------------------------ executive/controllers/pd.py ----------- */

void pd(double t, double dt, double *p_, double *x, double *u_, double *y_)
{
    const struct pd_parameters *p = (void *)p_;
    const struct pd_inputs *u = (void *)u_;
    struct pd_outputs *y = (void *)y_;

    double e = u->q_d_rad - (u->encoder_rad + u->hull_pitch_rad);
    double r = (u->q_d_rate_rad_s - u->hub_rate_rad_s) + p->lam_per_s * e;
    double tau = clip(p->kv_Nms_rad * r, -p->tau_max_Nm, p->tau_max_Nm);
    double twist_rate = u->motor_speed_rad_s / p->gear_ratio
                        - (u->hub_rate_rad_s - u->hull_rate_rad_s);
    y->motor_torque_Nm = clip(tau - p->km_Nms_rad * twist_rate, -p->tau_max_Nm, p->tau_max_Nm)
                         / p->gear_ratio;
    y->tau_Nm = tau;
    y->e_rad = e;
    y->r_rad_s = r;
}

/* ---------------------------------------------- executive/controllers/pd_nn_fast.py ----------- */

struct composite_parameters {
    struct pd_parameters pd; struct network_parameters network; struct fast_parameters fast;
};
struct composite_states { struct network_states network; struct fast_states fast; };
struct composite_inputs { struct pd_inputs pd; struct fast_inputs fast; };
struct composite_outputs { struct pd_outputs pd; struct network_outputs network; double fast_Nm; };
CHECK(composite_parameters, PD_NN_FAST_PARAMETERS);
CHECK(composite_states, PD_NN_FAST_STATES);
CHECK(composite_inputs, PD_NN_FAST_INPUTS);
CHECK(composite_outputs, PD_NN_FAST_OUTPUTS);

/* Writes all outputs but the motor torque; returns w, hub against hull. */
static inline double composite(double dt, const struct composite_parameters *p,
                               struct composite_states *x, const struct composite_inputs *u,
                               struct composite_outputs *y)
{
    const struct pd_inputs *in = &u->pd;
    double limit = p->pd.tau_max_Nm;
    double e = in->q_d_rad - (in->encoder_rad + in->hull_pitch_rad);
    double e_rate = in->q_d_rate_rad_s - in->hub_rate_rad_s;
    double r = e_rate + p->pd.lam_per_s * e;
    double w = in->hub_rate_rad_s - in->hull_rate_rad_s;
    double learned = learned_torque(dt, e, e_rate, r, w, in, &u->fast, &p->network, &x->network,
                                    &y->network);
    y->fast_Nm = fast(dt, in->q_d_rad, &u->fast, w, &p->fast, &x->fast);
    y->pd.tau_Nm = clip(p->pd.kv_Nms_rad * r + learned + y->fast_Nm, -limit, limit);
    y->pd.e_rad = e;
    y->pd.r_rad_s = r;
    return w;
}

void pd_nn_fast(double t, double dt, double *p_, double *x_, double *u_, double *y_)
{
    const struct composite_parameters *p = (void *)p_;
    const struct composite_inputs *u = (void *)u_;
    struct composite_outputs *y = (void *)y_;

    double w = composite(dt, p, (void *)x_, u, y);
    double shaft = p->pd.km_Nms_rad * (u->pd.motor_speed_rad_s / p->pd.gear_ratio - w);
    y->pd.motor_torque_Nm = clip(y->pd.tau_Nm - shaft, -p->pd.tau_max_Nm, p->pd.tau_max_Nm)
                            / p->pd.gear_ratio;
}

/* ----------------------------------------- executive/controllers/nn_backstepping.py ----------- */

struct backstepping_parameters {
    struct composite_parameters outer; struct inner_parameters inner;
};
struct backstepping_states { struct composite_states outer; struct inner_states inner; };
struct backstepping_inputs { struct composite_inputs outer; struct inner_inputs inner; };
struct backstepping_outputs { struct composite_outputs outer; struct inner_outputs inner; };
CHECK(backstepping_parameters, NN_BACKSTEPPING_PARAMETERS);
CHECK(backstepping_states, NN_BACKSTEPPING_STATES);
CHECK(backstepping_inputs, NN_BACKSTEPPING_INPUTS);
CHECK(backstepping_outputs, NN_BACKSTEPPING_OUTPUTS);

static inline double inner_loop(double dt, double r, double tau_d, double tau, double v_j,
                                double latched, double tau_max, double z_max,
                                const struct inner_parameters *p, struct inner_states *x,
                                struct inner_outputs *y)
{
    double a[NODES], phi[PHI];
    double tt = tau_d - tau;
    double ttc = clip(tt, -2.0, 2.0);
    double tdd = 60.0 * (tau_d - x->tau_smooth_Nm);
    x->tau_smooth_Nm = x->tau_smooth_Nm + dt * tdd;
    double xi[INNER_INPUTS] = {
        1.0, scaled(r, 0.3), scaled(tt, 20.0), scaled(x->tau_smooth_Nm, 20.0), scaled(tdd, 1000.0),
        scaled(v_j, 0.5),
    };
    hidden(xi, INNER_INPUTS, NODES, x->v2, a, phi);
    jump_pair(v_j, 0.004, phi + 1 + NODES);
    jump_pair(x->tau_smooth_Nm, 3.0, phi + 3 + NODES);
    double y_2 = clip(dot(x->w2, phi, PHI), -8.0, 8.0);
    double norm = sqrt(dot(x->w2, x->w2, PHI) + dot(x->v2, x->v2, INNER_INPUTS * NODES));
    if (!(latched < 0.5 && fabs(y_2) <= 8.0 && norm <= z_max))
        x->inner_fault = 1.0;
    int trusted = x->inner_fault < 0.5;
    x->inner_faded_Nm = trusted ? y_2 : x->inner_faded_Nm * (1.0 - dt / FADE_S);
    y->inner_Nm = x->inner_faded_Nm;
    y->norm_z2 = norm;
    double added = x->inner_faded_Nm + x->integral_Nm;

    struct rates rates = {p->kappa2, p->f2_rate, p->fj2_rate, p->g2_rate};
    tune(ttc, rates, trusted ? dt : 0.0, xi, INNER_INPUTS, NODES, JUMPS, a, phi, x->w2, x->v2);
    if (!trusted)
        x->integral_Nm = x->integral_Nm * (1.0 - dt / FADE_S);
    else if (fabs(tau_d + added) < tau_max)
        x->integral_Nm = x->integral_Nm + dt * p->kb_per_s * ttc;
    return added;
}

void nn_backstepping(double t, double dt, double *p_, double *x_, double *u_, double *y_)
{
    const struct backstepping_parameters *p = (void *)p_;
    const struct pd_parameters *gain = &p->outer.pd;
    struct backstepping_states *x = (void *)x_;
    const struct backstepping_inputs *u = (void *)u_;
    const struct pd_inputs *in = &u->outer.pd;
    struct backstepping_outputs *y = (void *)y_;
    struct pd_outputs *out = &y->outer.pd;

    double w = composite(dt, &p->outer, &x->outer, &u->outer, &y->outer);
    double added = inner_loop(dt, out->r_rad_s, out->tau_Nm, u->inner.shaft_torque_Nm,
                              in->q_d_rate_rad_s - in->hull_rate_rad_s, y->outer.network.fallback,
                              gain->tau_max_Nm, p->outer.network.z_max, &p->inner, &x->inner,
                              &y->inner);
    y->outer.network.fallback = x->inner.inner_fault;
    double shaft = gain->km_Nms_rad * (in->motor_speed_rad_s / gain->gear_ratio - w);
    out->motor_torque_Nm = clip(out->tau_Nm + added - shaft, -gain->tau_max_Nm, gain->tau_max_Nm)
                           / gain->gear_ratio;
}

/* ------------------------------------- plants/actuators: friction.py, gear.py, drive.py ------- */

static inline double lugre(double v, double z, double g, double h,
                           const struct barrel_parameters *p, double *dz)
{
    double rate = p->sig0_Nm_rad * fabs(v) / g, fastest = 2.0 / h;
    if (rate >= fastest) {
        double sign = v > 0.0 ? 1.0 : v < 0.0 ? -1.0 : v;
        *dz = fastest * (sign * g / p->sig0_Nm_rad - z);
    } else {
        *dz = v - rate * z;
    }
    return p->sig0_Nm_rad * z + p->sig1_Nms_rad * expmsq(v / p->bristle_fade_rad_s) * *dz
           + p->sig2_Nms_rad * v;
}

static inline double penetration(double wind_up, double gap)
{
    double half = 0.5 * gap;
    return wind_up > half ? wind_up - half : wind_up < -half ? wind_up + half : 0.0;
}

static inline double shaft_torque(double pen, double wind_up_rate, double ks, double cs, double p0)
{
    double depth = fabs(pen) / p0;
    double torque = ks * pen + cs * (depth < 1.0 ? depth : 1.0) * wind_up_rate;
    return torque * pen > 0.0 ? torque : 0.0;
}

static inline double available_torque(double command, double speed,
                                      const struct barrel_parameters *p)
{
    double slip = speed / p->motor_no_load_rad_s;
    double on_voltage = clip(command, -p->motor_stall_Nm * (1.0 + slip),
                             p->motor_stall_Nm * (1.0 - slip));
    return clip(on_voltage, -p->motor_peak_Nm, p->motor_peak_Nm);
}

/* ------------------------------------------------------- plants/atb1000/dynamics.py ----------- */

#define GRAVITY 9.81
#define TWO_PI 6.283185307179586
enum { INTEGRATED = COUNT(motion), CHANNELS = 6, STREAM = 6, DELAY_SIZE = 8 };

union state { struct motion m; double v[INTEGRATED]; };
struct external {
    double pitch, pitch_rate, pitch_acc, heave_acc, hub_moment, muzzle_force, command, step_s;
};
struct barrel_states { union state s; struct barrel_rest rest; };
CHECK(barrel_states, BARREL_STATES);

static inline double dot3(const double *a, double b1, double b2, double b3)
{
    return a[0] * b1 + a[1] * b2 + a[2] * b3;
}

static inline void times_c(const double *c, const double *q, double *out)
{
    out[0] = dot3(c, q[0], q[1], q[2]);
    out[1] = c[1] * q[0] + c[3] * q[1] + c[4] * q[2];
    out[2] = c[2] * q[0] + c[4] * q[1] + c[5] * q[2];
}

static inline double gear_state(const struct barrel_parameters *p, const struct motion *s,
                                const struct external *w, double *pen)
{
    double wind_up = s->x_motor_angle_rad / p->gear_ratio - (s->x_theta_rad - w->pitch);
    double rate = s->x_motor_speed_rad_s / p->gear_ratio - (s->x_theta_rate_rad_s - w->pitch_rate);
    *pen = penetration(wind_up, p->gap_rad);
    return shaft_torque(*pen, rate, p->ks_Nm_rad, p->cs_Nms_rad, p->p0_rad);
}

static inline double trunnion_friction(const struct barrel_parameters *p, const struct motion *s,
                                       const struct external *w, double *bristle_rate)
{
    double v = s->x_theta_rate_rad_s - w->pitch_rate;
    *bristle_rate = 0.0;
    if (!(p->friction_model > 0.0))
        return 0.0;
    double g = p->coulomb_Nm + (p->breakaway_Nm - p->coulomb_Nm) * expmsq(v / p->stribeck_rad_s);
    if (p->friction_model > 1.0)
        return lugre(v, s->x_bristle_rad, g, w->step_s, p, bristle_rate);
    return g * tanh(v / p->reverse_rad_s) + p->sig2_Nms_rad * v;
}

static inline void barrel_acceleration(const struct barrel_parameters *p, const struct motion *s,
                                       const struct external *w, double torque, struct motion *d)
{
    const double *q = s->x_q, *v = s->x_q_rate, *m = p->coupling;
    double rate = s->x_theta_rate_rad_s, force = w->muzzle_force;
    double sine, cosine, c[3], f[3];
    sine_cosine(s->x_theta_rad, &sine, &cosine);
    double g = GRAVITY + w->heave_acc;
    times_c(p->centrifugal, q, c);
    double spin = rate * rate, weight = g * cosine;
    for (int i = 0; i < 3; i++)
        f[i] = spin * c[i] + p->tip[i] * force - p->gravity[i] * weight - p->damping_per_s[i] * v[i]
               - p->stiffness_per_s2[i] * q[i];
    double coriolis = 2.0 * rate * (v[0] * c[0] + v[1] * c[1] + v[2] * c[2]);
    double gravity = p->unbalance_Nm * (g / GRAVITY) * cosine
                     - g * sine * dot3(p->gravity, q[0], q[1], q[2]);
    double disturbance = w->hub_moment + p->length_m * force;
    double reaction = dot3(m, f[0], f[1], f[2]);
    double inertia = p->rigid_inertia_kg_m2 + dot3(q, c[0], c[1], c[2]) - dot3(m, m[0], m[1], m[2]);
    double acceleration = (torque - coriolis - gravity + disturbance - reaction) / inertia;
    d->x_theta_rate_rad_s = acceleration;
    for (int i = 0; i < 3; i++)
        d->x_q_rate[i] = f[i] - m[i] * acceleration;
}

static inline double rotor_acceleration(const struct barrel_parameters *p, const struct motion *s,
                                        const struct external *w, double gear_torque)
{
    double load = gear_torque / p->gear_ratio;
    double coulomb = p->motor_coulomb_Nm + p->mesh_loss * fabs(load);
    double loss = coulomb * tanh(s->x_motor_speed_rad_s / p->motor_reverse_rad_s)
                  + p->motor_viscous_Nms_rad * s->x_motor_speed_rad_s;
    return (s->x_motor_torque_Nm - loss - load) / p->motor_inertia_kg_m2 - w->pitch_acc;
}

static inline double lag_rate(double lagged, double signal, double bandwidth_hz)
{
    return TWO_PI * bandwidth_hz * (signal - lagged);
}

static void derivative(const struct barrel_parameters *p, const struct motion *s,
                       const struct external *w, struct motion *d)
{
    double pen;
    const double *q = s->x_q, *v = s->x_q_rate;
    double torque = gear_state(p, s, w, &pen);
    double opposing = trunnion_friction(p, s, w, &d->x_bristle_rad);
    d->x_theta_rad = s->x_theta_rate_rad_s;
    for (int i = 0; i < 3; i++)
        d->x_q[i] = v[i];
    barrel_acceleration(p, s, w, torque - opposing, d);
    d->x_motor_angle_rad = s->x_motor_speed_rad_s;
    d->x_motor_speed_rad_s = rotor_acceleration(p, s, w, torque);
    double wanted = available_torque(w->command, s->x_motor_speed_rad_s, p);
    d->x_motor_torque_Nm = (wanted - s->x_motor_torque_Nm) / p->motor_lag_s;
    double muzzle_rate = s->x_theta_rate_rad_s + dot3(p->slope, v[0], v[1], v[2]);
    double strain = dot3(p->root_strain_ue, q[0], q[1], q[2]);
    d->x_hub_rate_rad_s =
        lag_rate(s->x_hub_rate_rad_s, s->x_theta_rate_rad_s, p->gyro_bandwidth_hz);
    d->x_muzzle_rate_rad_s = lag_rate(s->x_muzzle_rate_rad_s, muzzle_rate, p->gyro_bandwidth_hz);
    d->x_strain_ue = lag_rate(s->x_strain_ue, strain, p->strain_bandwidth_hz);
    d->x_shaft_torque_Nm = lag_rate(s->x_shaft_torque_Nm, torque, p->torque_bandwidth_hz);
}

static inline double energy(const struct barrel_parameters *p, const struct motion *s,
                            const struct external *w, double pen)
{
    const double *q = s->x_q, *v = s->x_q_rate;
    double rate = s->x_theta_rate_rad_s, turning = s->x_motor_speed_rad_s + w->pitch_rate;
    double sine, cosine, c[3];
    sine_cosine(s->x_theta_rad, &sine, &cosine);
    times_c(p->centrifugal, q, c);
    double inertia = p->rigid_inertia_kg_m2 + dot3(q, c[0], c[1], c[2]);
    double kinetic = inertia * rate * rate + v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
    kinetic += 2.0 * rate * dot3(p->coupling, v[0], v[1], v[2])
               + p->motor_inertia_kg_m2 * turning * turning;
    double elastic = dot3(p->stiffness_per_s2, q[0] * q[0], q[1] * q[1], q[2] * q[2])
                     + p->ks_Nm_rad * pen * pen;
    double weight = p->unbalance_Nm * sine
                    + GRAVITY * cosine * dot3(p->gravity, q[0], q[1], q[2]);
    return 0.5 * (kinetic + elastic) + weight;
}

/* ----------------------------------------------------------- plants/atb1000/hull.py ----------- */

struct sines { double s[HULL_COMPONENTS], c[HULL_COMPONENTS]; };

static inline void hull_start(double t, const struct barrel_parameters *p, struct sines *at)
{
    for (int i = 0; i < (int)p->hull_sines; i++)
        sine_cosine(p->hull_omega_rad_s[i] * t + p->hull_phase_rad[i], &at->s[i], &at->c[i]);
}

static inline void hull_advance(const struct barrel_parameters *p, struct sines *at)
{
    for (int i = 0; i < (int)p->hull_sines; i++) {
        double s = at->s[i], c = at->c[i];
        at->s[i] = s * p->hull_turn_cos[i] + c * p->hull_turn_sin[i];
        at->c[i] = c * p->hull_turn_cos[i] - s * p->hull_turn_sin[i];
    }
}

static inline void hull_motion(const struct barrel_parameters *p, const struct sines *at,
                               struct external *w)
{
    double pitch = 0.0, rate = 0.0, sine_sum = 0.0, cosine_sum = 0.0;
    for (int i = 0; i < (int)p->hull_sines; i++) {
        double amplitude = p->hull_amplitude_rad[i], omega = p->hull_omega_rad_s[i];
        pitch += amplitude * at->s[i];
        rate += amplitude * omega * at->c[i];
        sine_sum += amplitude * omega * omega * at->s[i];
        cosine_sum += amplitude * omega * omega * at->c[i];
    }
    w->pitch = pitch;
    w->pitch_rate = rate;
    w->pitch_acc = -sine_sum;
    w->heave_acc = p->heave_cos_m * cosine_sum - p->heave_sin_m * sine_sum;
}

/* ------------------------------------------------- plants/noise.py, plants/sensors.py --------- */

static inline double uniform(double *x)
{
    const double m1 = 4294967087.0, m2 = 4294944443.0;
    double a = modulo(1403580.0 * x[1] - 810728.0 * x[0], m1);
    x[0] = x[1], x[1] = x[2], x[2] = a;
    double b = modulo(527612.0 * x[5] - 1370589.0 * x[3], m2);
    x[3] = x[4], x[4] = x[5], x[5] = b;
    return (a <= b ? a - b + m1 : a - b) / (m1 + 1.0);
}

static inline double normal(double *stream)
{
    double total = -6.0;
    for (int i = 0; i < 12; i++)
        total += uniform(stream);
    return total;
}

/* ---------------------------------------------------------- plants/atb1000/model.py ----------- */

static inline double half_sine(double t, double peak, double start, double lasts)
{
    double phase = clip((t - start) / lasts, 0.0, 1.0);
    return phase < 1.0 ? peak * sin(3.141592653589793 * phase) : 0.0;
}

static inline void external(double t, const struct barrel_parameters *p, const struct sines *sines,
                            struct external *w)
{
    hull_motion(p, sines, w);
    w->hub_moment = w->muzzle_force = 0.0;
    if (p->fire > 0.0) {
        w->hub_moment = half_sine(t, p->fire_hub_Nm, p->fire_hub_start_s, p->fire_hub_lasts_s);
        w->muzzle_force = half_sine(t, p->fire_muzzle_N, p->fire_muzzle_start_s,
                                    p->fire_muzzle_lasts_s);
    }
}

static inline void integrate(double start, double h, const struct barrel_parameters *p,
                             union state *s, struct external *w, struct sines *sines)
{
    static const double weight[4] = {1.0, 2.0, 2.0, 1.0}, reach[4] = {0.5, 0.5, 1.0, 0.0};
    union state k, total, at_stage;
    for (int n = 0; n < (int)p->substeps; n++) {
        for (int i = 0; i < INTEGRATED; i++) {
            total.v[i] = 0.0;
            at_stage.v[i] = s->v[i];
        }
        for (int j = 0; j < 4; j++) {
            derivative(p, &at_stage.m, w, &k.m);
            for (int i = 0; i < INTEGRATED; i++) {
                total.v[i] += weight[j] * k.v[i];
                at_stage.v[i] = s->v[i] + reach[j] * h * k.v[i];
            }
            if (j == 0 || j == 2) {
                hull_advance(p, sines);
                external(start + (n + 0.5 + 0.25 * j) * h, p, sines, w);
            }
        }
        for (int i = 0; i < INTEGRATED; i++)
            s->v[i] += h / 6.0 * total.v[i];
    }
}

static inline double delayed(double command, double samples, double *sent, int size)
{
    for (int i = size - 1; i > 0; i--)
        sent[i] = sent[i - 1];
    sent[0] = command;
    return sent[(int)samples];
}

static inline void sample_sensors(const struct barrel_parameters *p, struct barrel_states *x,
                                  const struct external *w, struct barrel_outputs *y)
{
    const struct motion *s = &x->s.m;
    y->encoder_rad = s->x_theta_rad - w->pitch;
    y->hub_rate_rad_s = s->x_hub_rate_rad_s;
    y->muzzle_rate_rad_s = s->x_muzzle_rate_rad_s;
    y->hull_pitch_rad = w->pitch;
    y->hull_rate_rad_s = w->pitch_rate;
    y->strain_ue = s->x_strain_ue;
    y->shaft_torque_Nm = s->x_shaft_torque_Nm;
    y->motor_speed_rad_s = s->x_motor_speed_rad_s;
    y->motor_torque_Nm = s->x_motor_torque_Nm;
    y->motor_angle_rad = s->x_motor_angle_rad;
    double *noisy = &y->hub_rate_rad_s;
    const double *std = &p->hub_gyro_noise_rad_s;
    for (int i = 0; i < CHANNELS; i++)
        noisy[i] = noisy[i] + std[i] * normal(x->rest.rng + i * STREAM);
}

static inline void report_truth(const struct barrel_parameters *p, const struct motion *s,
                                const struct external *w, struct barrel_outputs *y)
{
    double pen, bristle_rate;
    double elastic = dot3(p->slope, s->x_q[0], s->x_q[1], s->x_q[2]);
    y->theta_rad = s->x_theta_rad;
    y->theta_rate_rad_s = s->x_theta_rate_rad_s;
    y->muzzle_rad = s->x_theta_rad + elastic;
    y->elastic_slope_rad = elastic;
    y->slope1_rad = p->slope[0] * s->x_q[0];
    y->droop_rad = p->horizontal_droop_rad * cos(s->x_theta_rad);
    y->q1 = s->x_q[0], y->q2 = s->x_q[1], y->q3 = s->x_q[2];
    y->rel_rad = s->x_theta_rad - w->pitch;
    y->hull_rad = w->pitch;
    y->gear_torque_Nm = gear_state(p, s, w, &pen);
    y->friction_torque_Nm = trunnion_friction(p, s, w, &bristle_rate);
    y->penetration_rad = pen;
    y->energy_J = energy(p, s, w, pen);
}

void barrel(double t, double dt, double *p_, double *x_, double *u, double *y_)
{
    const struct barrel_parameters *p = (void *)p_;
    struct barrel_states *x = (void *)x_;
    struct barrel_outputs *y = (void *)y_;
    struct external w;
    struct sines sines;

    double start = t > 0.0 ? t - dt : 0.0;
    hull_start(start, p, &sines);
    external(start, p, &sines, &w);
    double h = dt / p->substeps;
    w.command = x->rest.x_held_Nm;
    w.step_s = h;
    if (t > 0.0) {
        integrate(start, h, p, &x->s, &w, &sines);
        x->rest.x_held_Nm = delayed(u[0], p->delay_samples, x->rest.sent_Nm, DELAY_SIZE);
    }
    sample_sensors(p, x, &w, y);
    report_truth(p, &x->s.m, &w, y);
}

void idle(double t, double dt, double *p, double *x, double *u, double *y) {}

/* ---------------------------------------------------- the loop, as in tools/dev/bench/steps.py ---- */

/* `repeats` times: state x0, then `rows` steps, each with a row of `inputs`. Views are those of v,
 * as in the table: parameters, state, inputs, outputs end at at[0] to at[3]. */
void drive(step_function *step, long long repeats, long long rows, double dt, double *v,
           const long long *at, const double *x0, const double *inputs)
{
    double *x = v + at[0], *y = v + at[2];
    long long n_x = at[1] - at[0], n_u = at[2] - at[1];
    for (long long n = 0; n < repeats; n++) {
        memcpy(x, x0, n_x * sizeof *x);
        for (long long k = 0; k < rows; k++)
            step(k * dt, dt, v, x, (double *)inputs + k * n_u, y);
    }
}
