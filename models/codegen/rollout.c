/* The discrete time step of a scene (semi-implicit Euler) and its adjoint, over whole
 * trajectories.
 *
 *   lam[t] = L(phi(q[t]))          a[t] = M^-1 (tau(q[t], v[t], u[t]) + J' lam[t] + S' f[t])
 *   v[t+1] = v[t] + h a[t]         q[t+1] = q[t] + h v[t+1]
 *
 * Arrays are row-major, one row per node or step. Contact law: 0 = ReLU, 1 = softplus with
 * sharpness b. Friction forces f (friction.h) follow the contact forces in each row of lam. */
#include <stddef.h>

#include "scene_model.h"
#if NF > 0
#include "friction.h"
#endif
#ifdef DAMPING
#include "damping.h"
#endif

#define EXPORT __attribute__((visibility("default")))
#define SIZE(n) ((n) > 0 ? (n) : 1)
#define NL (NC + NF) /* contact forces, then friction forces: one row of lam */

EXPORT const int kernel_sizes[5] = {NQ, NU, NC, NF, NP};

static double contact_force(int law, double b, double k, double phi)
{
    if (law == 0) return k * (phi > 0.0 ? phi : 0.0);
    const double z = b * phi;
    return (k / b) * ((z > 0.0 ? z : 0.0) + log1p(exp(-fabs(z))));
}

/* d lam / d phi; the ReLU has slope 0 at phi = 0. */
static double contact_slope(int law, double b, double k, double phi)
{
    if (law == 0) return phi > 0.0 ? k : 0.0;
    const double z = b * phi, e = exp(-fabs(z));
    return k * (z > 0.0 ? 1.0 : e) / (1.0 + e);
}

static void contact_forces(int law, double b, const double *k, const double *q, const double *p, double *lam)
{
    double phi[SIZE(NC)];
    scene_penetration(q, p, phi);
    for (int i = 0; i < NC; i++) lam[i] = contact_force(law, b, k[i], phi[i]);
}

/* Copy the parameters so that no output aliases them; the compiler then hoists 1/m out of the
 * loop. */
static void local_parameters(const double *parameters, double *p)
{
    for (int i = 0; i < NP; i++) p[i] = parameters[i];
    if (NP == 0) p[0] = 0.0;
}

static int finite_row(const double *row, int n)
{
    for (int i = 0; i < n; i++)
        if (!isfinite(row[i])) return 0;
    return 1;
}

/* q, v: (steps + 1, NQ), first row from start (2 NQ); lam: (steps, NL). Return the number of
 * finite steps, fewer than `steps` after a divergence or a loss of definiteness. */
EXPORT int kernel_rollout(int steps, double h, const double *parameters, int law, double b, const double *start, const double *u,
    double *q, double *v, double *lam)
{
    double p[SIZE(NP)], k[SIZE(NC)], a[NQ];
    local_parameters(parameters, p);
    scene_stiffness(p, k);
    for (int i = 0; i < NQ; i++) {
        q[i] = start[i];
        v[i] = start[NQ + i];
    }
    for (int t = 0; t < steps; t++) {
        const double *qt = q + t * NQ, *vt = v + t * NQ;
        double *qn = q + (t + 1) * NQ, *vn = v + (t + 1) * NQ;
        contact_forces(law, b, k, qt, p, lam + t * NL);
#ifdef DAMPING
        damp_contacts(law, b, k, qt, vt, p, lam + t * NL);
#endif
#if NF > 0
        if (friction_forces(law, b, h, p, qt, vt, u + t * NU, lam + t * NL)) return t;
#endif
        if (scene_acceleration(qt, vt, u + t * NU, lam + t * NL, p, a)) return t;
        for (int i = 0; i < NQ; i++) {
            vn[i] = vt[i] + h * a[i];
            qn[i] = qt[i] + h * vn[i];
        }
        if (!finite_row(qn, NQ) || !finite_row(vn, NQ)) return t;
    }
    return steps;
}

/* Reverse sweep: from the derivatives of a loss by q, v, lam (q_bar, v_bar, lam_bar), by the
 * last state (end_bar, 2 NQ), each may be NULL, and by the cost (cost_bar), write those by u
 * (steps, NU) and start (2 NQ). Return 1 if the mass matrix is not positive definite. */
EXPORT int kernel_adjoint(int steps, double h, const double *parameters, int law, double b, const double *q, const double *v,
    const double *lam, const double *u, const double *q_bar, const double *v_bar, const double *lam_bar, const double *end_bar, double cost_bar,
    double *u_bar, double *start_bar)
{
    double p[SIZE(NP)], k[SIZE(NC)], gq[NQ], gv[NQ];
    local_parameters(parameters, p);
    scene_stiffness(p, k);
    for (int i = 0; i < NQ; i++) {
        gq[i] = (q_bar ? q_bar[steps * NQ + i] : 0.0) + (end_bar ? end_bar[i] : 0.0);
        gv[i] = (v_bar ? v_bar[steps * NQ + i] : 0.0) + (end_bar ? end_bar[NQ + i] : 0.0);
    }
#ifdef FINAL_COST
    if (cost_bar != 0.0) scene_final_cost_vjp(q + steps * NQ, v + steps * NQ, p, &cost_bar, gq, gv);
#endif
    for (int t = steps - 1; t >= 0; t--) {
        const double *qt = q + t * NQ, *vt = v + t * NQ;
        double a_bar[NQ], phi[SIZE(NC)], gl[SIZE(NL)];
        for (int i = 0; i < NQ; i++) gv[i] += h * gq[i];
        for (int i = 0; i < NL; i++) gl[i] = lam_bar ? lam_bar[t * NL + i] : 0.0;
#if NF > 0
        if (friction_adjoint(law, b, h, p, qt, vt, u + t * NU, lam + t * NL, v + (t + 1) * NQ, gv, gq, gl)) return 1;
#endif
        for (int i = 0; i < NQ; i++) a_bar[i] = h * gv[i];
        for (int i = 0; i < NU; i++) u_bar[t * NU + i] = 0.0;
        if (scene_acceleration_vjp(qt, vt, u + t * NU, lam + t * NL, p, a_bar, gq, gv, u_bar + t * NU, gl)) return 1;
#ifdef DAMPING
        damp_contacts_vjp(law, b, k, qt, vt, p, gl, gq, gv);
#endif
        scene_penetration(qt, p, phi);
        for (int i = 0; i < NC; i++) gl[i] *= contact_slope(law, b, k[i], phi[i]);
        scene_penetration_vjp(qt, p, gl, gq);
        if (cost_bar != 0.0) scene_running_cost_vjp(qt, vt, u + t * NU, p, &cost_bar, gq, gv, u_bar + t * NU);
        for (int i = 0; i < NQ; i++) {
            if (q_bar) gq[i] += q_bar[t * NQ + i];
            if (v_bar) gv[i] += v_bar[t * NQ + i];
        }
    }
    for (int i = 0; i < NQ; i++) {
        start_bar[i] = gq[i];
        start_bar[NQ + i] = gv[i];
    }
    return 0;
}

EXPORT double kernel_cost(int n, const double *p, const double *q, const double *v, const double *u);

/* Rows of plans as in kernel_rollout, with costs and last states (rows, 2 NQ). NAN after the
 * last finite step, and in costs and ends, of a diverged row. */
EXPORT void kernel_rollouts(int rows, int steps, double h, const double *parameters, int law, double b, const double *start, const double *u,
    double *q, double *v, double *lam, double *costs, double *ends)
{
    for (int r = 0; r < rows; r++, start += 2 * NQ, u += steps * NU, q += (steps + 1) * NQ, v += (steps + 1) * NQ, lam += steps * NL) {
        const int done = kernel_rollout(steps, h, parameters, law, b, start, u, q, v, lam);
        costs[r] = done == steps ? kernel_cost(steps, parameters, q, v, u) : NAN;
        for (int i = (done + 1) * NQ; i < (steps + 1) * NQ; i++) q[i] = v[i] = NAN;
        for (int i = (done + 1) * NL; i < steps * NL; i++) lam[i] = NAN;
        for (int i = 0; i < NQ; i++) {
            ends[r * 2 * NQ + i] = q[steps * NQ + i];
            ends[r * 2 * NQ + NQ + i] = v[steps * NQ + i];
        }
    }
}

/* Their adjoints as in kernel_adjoint; cost_bars may be NULL too. NAN in diverged rows. Return
 * the number of rows, fewer than all if a mass matrix is not positive definite. */
EXPORT int kernel_adjoints(int rows, int steps, double h, const double *parameters, int law, double b, const double *q, const double *v,
    const double *lam, const double *u, const double *q_bar, const double *v_bar, const double *lam_bar, const double *cost_bars,
    const double *end_bars, double *u_bar, double *start_bar)
{
    for (int r = 0; r < rows; r++) {
        const size_t at_nodes = (size_t)r * (steps + 1) * NQ, at_u = (size_t)r * steps * NU, at_lam = (size_t)r * steps * NL;
        double *inputs_bar = u_bar + at_u, *from_bar = start_bar + r * 2 * NQ;
        if (!finite_row(q + at_nodes + steps * NQ, NQ) || !finite_row(v + at_nodes + steps * NQ, NQ)) {
            for (int i = 0; i < steps * NU; i++) inputs_bar[i] = NAN;
            for (int i = 0; i < 2 * NQ; i++) from_bar[i] = NAN;
        } else if (kernel_adjoint(steps, h, parameters, law, b, q + at_nodes, v + at_nodes, lam + at_lam, u + at_u, q_bar ? q_bar + at_nodes : NULL,
                       v_bar ? v_bar + at_nodes : NULL, lam_bar ? lam_bar + at_lam : NULL, end_bars ? end_bars + r * 2 * NQ : NULL,
                       cost_bars ? cost_bars[r] : 0.0, inputs_bar, from_bar))
            return r;
    }
    return rows;
}

EXPORT void kernel_penetration(int n, const double *p, const double *q, double *phi)
{
    for (int t = 0; t < n; t++) scene_penetration(q + t * NQ, p, phi + t * NC);
}

#ifdef DAMPING
EXPORT void kernel_damped_contact_force(int n, const double *p, int law, double b, const double *q, const double *v, double *lam)
{
    double k[SIZE(NC)];
    scene_stiffness(p, k);
    for (int t = 0; t < n; t++) {
        contact_forces(law, b, k, q + t * NQ, p, lam + t * NC);
        damp_contacts(law, b, k, q + t * NQ, v + t * NQ, p, lam + t * NC);
    }
}

/* The forces whose positive parts are the contact forces: k phi without damping. */
EXPORT void kernel_contact_push(int n, const double *p, const double *q, const double *v, double *push)
{
    double k[NC], c[NC], rate[NC];
    scene_stiffness(p, k);
    scene_damping(p, c);
    for (int t = 0; t < n; t++) {
        double *phi = push + t * NC;
        scene_penetration(q + t * NQ, p, phi);
        scene_penetration_jvp(q + t * NQ, p, v + t * NQ, rate);
        for (int i = 0; i < NC; i++)
            phi[i] = scene_damping_laws[i] && phi[i] > 0.0 ? contact_push(scene_damping_laws[i], k[i], c[i], phi[i], rate[i]).value : k[i] * phi[i];
    }
}
#endif
EXPORT void kernel_contact_force(int n, const double *p, int law, double b, const double *q, double *lam)
{
    double k[SIZE(NC)];
    scene_stiffness(p, k);
    for (int t = 0; t < n; t++) contact_forces(law, b, k, q + t * NQ, p, lam + t * NC);
}

EXPORT void kernel_stiffness(const double *p, double *k) { scene_stiffness(p, k); }

/* Return the number of rows, fewer than n if the mass matrix is not positive definite. */
EXPORT int kernel_acceleration(int n, const double *p, const double *q, const double *v, const double *u, const double *lam, double *a)
{
    for (int t = 0; t < n; t++)
        if (scene_acceleration(q + t * NQ, v + t * NQ, u + t * NU, lam + t * NL, p, a + t * NQ)) return t;
    return n;
}

#if NF > 0
EXPORT void kernel_slip(int n, const double *p, const double *q, const double *v, double *slip)
{
    for (int t = 0; t < n; t++) scene_slip(q + t * NQ, v + t * NQ, p, slip + t * NF);
}

EXPORT void kernel_friction_limit(int n, const double *p, const double *q, const double *lam, double *limit)
{
    for (int t = 0; t < n; t++) scene_friction_limit(q + t * NQ, lam + t * NL, p, limit + t * NF);
}
#endif

/* energy: (n, 2) kinetic and potential [J]. */
EXPORT void kernel_energy(int n, const double *p, const double *q, const double *v, double *energy)
{
    for (int t = 0; t < n; t++) {
        energy[2 * t] = scene_kinetic_energy(q + t * NQ, v + t * NQ, p);
        energy[2 * t + 1] = scene_potential_energy(q + t * NQ, p);
    }
}

/* power: (n, 2) by the inputs and dissipated [W]. */
EXPORT void kernel_power(int n, const double *p, const double *q, const double *v, const double *u, double *power)
{
    for (int t = 0; t < n; t++) {
        power[2 * t] = scene_input_power(q + t * NQ, v + t * NQ, u + t * NU, p);
        power[2 * t + 1] = scene_dissipated_power(q + t * NQ, v + t * NQ, p);
    }
}

/* Return the running cost over n steps plus the final cost (q, v: n + 1 rows; the last is read
 * only with a final cost). */
EXPORT double kernel_cost(int n, const double *p, const double *q, const double *v, const double *u)
{
    double total = 0.0;
    for (int t = 0; t < n; t++) total += scene_running_cost(q + t * NQ, v + t * NQ, u + t * NU, p);
#ifdef FINAL_COST
    total += scene_final_cost(q + n * NQ, v + n * NQ, p);
#endif
    return total;
}
