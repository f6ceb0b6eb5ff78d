/* Two laws of the barrel by hand: what generated C is held against (`pcpc bench generated`).
 *
 * All other steps of the bench are C that `pcpc generate c` writes. Were these generated too, nobody
 * would see the generator get slower, nor an error that Python and its translation share.
 * Structures and elementary functions are those of the generated files; scratch space is on the
 * stack. Equations are those of the Python files named at each function. SI units.
 */
#include "pcpc_math.h"
#include "pd.h"
#include "pd_nn_fast.h"

/* ---------------------------------------------------------- executive/laws/approximators ------- */

static inline double scaled(double value, double size) { return pcpc_clip(value / size, -3.0, 3.0); }

static inline void jump_pair(double v, double v_s, double *phi)
{
    double rise = 1.0 - pcpc_exp(-pcpc_abs(v) / v_s);
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
        phi[j + 1] = pcpc_logistic(total);
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
    double leak = k.kappa * pcpc_abs(r);
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

/* --------------------------------------------- plants/atb1000/laws/tracking_network.py -------- */

enum { NODES = 10, JUMPS = 4, PHI = 1 + NODES + JUMPS, INPUTS = 7 };
#define FADE_S 0.1

static inline double learned_torque(double dt, double e, double e_rate, double r, double w,
                                    const pd_nn_fast_inputs *u,
                                    const pd_nn_fast_network_parameters *p,
                                    pd_nn_fast_network_states *x, pd_nn_fast_outputs *y)
{
    double a[NODES], phi[PHI], *v = &x->v[0][0];
    double xi[INPUTS] = {
        1.0, scaled(e, 0.02), scaled(e_rate, 0.2), scaled(u->q_d_rad, 0.5),
        scaled(u->q_d_rate_rad_s, 0.5), scaled(u->q_d_acc_rad_s2, 3.0), scaled(w, 0.2),
    };
    hidden(xi, INPUTS, NODES, v, a, phi);
    double v_j = u->q_d_rate_rad_s - u->hull_rate_rad_s;
    jump_pair(v_j, 0.004, phi + 1 + NODES);
    jump_pair(v_j, 0.04, phi + 3 + NODES);
    double norm = pcpc_sqrt(dot(x->w, x->w, PHI) + dot(v, v, INPUTS * NODES));
    double network = dot(x->w, phi, PHI);
    double learned = network + p->kz * (norm + p->z_bound) * r;

    int on = p->network_on > 0.5;
    if (on && !(pcpc_abs(network) <= p->y_max_Nm && norm <= p->z_max))
        x->network_fault = 1.0;
    int trusted = on && x->network_fault < 0.5;
    x->faded_Nm = trusted ? learned : x->faded_Nm * (1.0 - dt / FADE_S);

    int moving = pcpc_abs(e) > 1e-4 || pcpc_abs(u->q_d_acc_rad_s2) > 1e-6;
    struct rates rates = {p->kappa, p->f_rate, p->fj_rate, p->g_rate};
    tune(pcpc_clip(r, -0.3, 0.3), rates, trusted && moving ? dt : 0.0, xi, INPUTS, NODES, JUMPS, a,
         phi, x->w, v);
    y->network_Nm = trusted ? network : x->faded_Nm;
    y->norm_z = norm;
    y->fallback = x->network_fault;
    return x->faded_Nm;
}

/* ------------------------------------------------ plants/atb1000/laws/boundary_layer.py ------- */

static inline double fast(double dt, const pd_nn_fast_inputs *u, double speed,
                          const pd_nn_fast_fast_parameters *p, pd_nn_fast_fast_states *x)
{
    double w_f = p->mode_rad_s, h_f = p->mode_gain;
    double eta = u->strain_ue / p->strain_ue_per_mode + p->gravity_mode * pcpc_cos(u->q_d_rad)
                 + p->inertia_mode_s2_rad * u->q_d_acc_rad_s2;
    double innovation = eta - x->mode_x0;
    double drive = -w_f * w_f * x->mode_x0 - 2.0 * p->mode_damping * w_f * x->mode_x1
                   + h_f * x->fast_held_Nm;
    x->mode_x1 = x->mode_x1 + dt * (drive + p->observer_l2_per_s2 * innovation);
    x->mode_x0 = x->mode_x0 + dt * (x->mode_x1 + p->observer_l1_per_s * innovation);
    double k = -2.0 * (p->damping_wanted - 0.02) * w_f / pcpc_abs(h_f);
    double sine, cosine;
    pcpc_sincos(w_f * (1.5 * dt + p->actuator_delay_s), &sine, &cosine);
    double torque = k * w_f * sine * x->mode_x0 - k * cosine * x->mode_x1;
    x->gate_rad_s = x->gate_rad_s + dt / 0.03 * (pcpc_abs(speed) - x->gate_rad_s);
    x->fast_held_Nm = torque * pcpc_clip((x->gate_rad_s - 0.0015) / 0.0015, 0.0, 1.0);
    return x->fast_held_Nm;
}

/* --------------------------------------------------- plants/atb1000/laws/pd.py, pd_nn_fast.py - */

void pd_by_hand(double t, double dt, const pd_parameters *p, void *x, const pd_inputs *u,
                pd_outputs *y)
{
    double e = u->q_d_rad - (u->encoder_rad + u->hull_pitch_rad);
    double r = (u->q_d_rate_rad_s - u->hub_rate_rad_s) + p->lam_per_s * e;
    double tau = pcpc_clip(p->kv_Nms_rad * r, -p->tau_max_Nm, p->tau_max_Nm);
    double twist_rate = u->motor_speed_rad_s / p->gear_ratio
                        - (u->hub_rate_rad_s - u->hull_rate_rad_s);
    y->motor_torque_Nm = pcpc_clip(tau - p->km_Nms_rad * twist_rate, -p->tau_max_Nm, p->tau_max_Nm)
                         / p->gear_ratio;
    y->tau_Nm = tau;
    y->e_rad = e;
    y->r_rad_s = r;
}

void pd_nn_fast_by_hand(double t, double dt, const pd_nn_fast_parameters *p,
                        pd_nn_fast_states *x, const pd_nn_fast_inputs *u, pd_nn_fast_outputs *y)
{
    double limit = p->pd.tau_max_Nm;
    double e = u->q_d_rad - (u->encoder_rad + u->hull_pitch_rad);
    double e_rate = u->q_d_rate_rad_s - u->hub_rate_rad_s;
    double r = e_rate + p->pd.lam_per_s * e;
    double w = u->hub_rate_rad_s - u->hull_rate_rad_s;
    double learned = learned_torque(dt, e, e_rate, r, w, u, &p->network, &x->network, y);
    y->fast_Nm = fast(dt, u, w, &p->fast, &x->fast);
    y->tau_Nm = pcpc_clip(p->pd.kv_Nms_rad * r + learned + y->fast_Nm, -limit, limit);
    y->e_rad = e;
    y->r_rad_s = r;
    double shaft = p->pd.km_Nms_rad * (u->motor_speed_rad_s / p->pd.gear_ratio - w);
    y->motor_torque_Nm = pcpc_clip(y->tau_Nm - shaft, -limit, limit) / p->pd.gear_ratio;
}
