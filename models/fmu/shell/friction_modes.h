/* Dry friction in continuous time: each friction slips one way (mode 1 or -1) or sticks (mode
 * 0). Included by equations.h only with friction.
 *
 * A slipping friction has f = -mode mu N. Sticking forces together keep the slip speeds
 * constant, ds/dt = 0, so the slip stays zero without creep. Modes change only at events: a slip
 * reaches zero, or a sticking force exceeds mu N. Maximal dissipation of the slip accelerations
 * (friction.h) decides all open modes together. */
#ifndef FRICTION_MODES_H
#define FRICTION_MODES_H

#include <float.h>

#include "friction.h"
#include "model.h"

/* A smaller slip, relative to its nominal, is zero: event location has an error of about 1e-14
 * m/s. */
#define SLIP_BAND 1e-10
/* Sticking continues below this share while modes are frozen: ds/dt = 0 holds the slip only
 * within the importer's tolerance, and foreign events must not end sticking. */
#define DRIFT_BAND 1e-4
/* Relative excess of a sticking force over mu N; it starts to slip with at least this push.
 * Sticking is decided with half of it, so that an event located slightly early still ends it. */
#define STICKING_SLACK 1e-10

/* At (q, v, u) with contact forces lam: slip accelerations s0 without friction, hW = S M^-1 S',
 * limit = mu N. */
static inline int friction_rates(const Model *m, const double *q, const double *v, const double *u, double *lam, FrictionStep *rates)
{
    double a[NQ];
    for (int j = 0; j < NF; j++) lam[NC + j] = 0.0;
    if (scene_acceleration(q, v, u, lam, m->p, a)) return 1;
    scene_slip_rate(q, v, a, m->p, rates->s0);
    return friction_columns(1.0, m->p, q, v, u, lam, rates);
}

/* Sticking frictions whose slips are multiples of one slip form a group, and share its force in
 * proportion to their limits, so that all begin to slip together. */
typedef struct {
    int leader[NF]; /* first friction of the group, -1 if slipping */
    double ratio[NF];   /* |slip / slip of the leader| */
    double share[NF];   /* friction force / force of the group along the leader's slip */
    double limit[NF]; /* of the group, at its leader */
} Sharing;

/* Return whether the slips of two frictions are multiples of each other. */
static inline int is_parallel(const FrictionStep *rates, int i, int j)
{
    return rates->hW[i][j] * rates->hW[j][i] >= (1.0 - 1e-12) * rates->hW[i][i] * rates->hW[j][j];
}

static inline void share_sticking(const FrictionStep *rates, const int *modes, Sharing *g)
{
    for (int j = 0; j < NF; j++) {
        g->leader[j] = modes[j] ? -1 : j;
        g->limit[j] = g->share[j] = 0.0;
        for (int i = 0; i < j && g->leader[j] == j; i++)
            if (g->leader[i] == i && is_parallel(rates, i, j)) g->leader[j] = i;
        if (modes[j]) continue;
        const double ratio = g->leader[j] == j ? 1.0 : rates->hW[j][g->leader[j]] / rates->hW[g->leader[j]][g->leader[j]];
        g->ratio[j] = fabs(ratio);
        g->share[j] = copysign(fmax(rates->limit[j], DBL_MIN), ratio);
        g->limit[g->leader[j]] += fabs(ratio * g->share[j]);
    }
    for (int j = 0; j < NF; j++)
        if (!modes[j]) g->share[j] /= g->limit[g->leader[j]];
}

/* Solve (S M^-1 S') x = b on the leaders of the sticking frictions, with x = b on entry and
 * zeros elsewhere on return. A share of 1e-13 on the diagonal divides the force of leaders that
 * hold the same motion. */
static inline int solve_leaders(const FrictionStep *rates, const Sharing *g, double *x)
{
    double K[NF][NF], b[NF], largest = 0.0;
    int at[NF], n = 0;
    for (int j = 0; j < NF; j++)
        if (g->leader[j] == j) at[n++] = j;
    for (int i = 0; i < n; i++) {
        b[i] = x[at[i]];
        for (int j = 0; j < n; j++) K[i][j] = rates->hW[at[i]][at[j]];
        largest = fmax(largest, K[i][i]);
    }
    for (int i = 0; n > 1 && i < n; i++) K[i][i] += 1e-13 * largest;
    if (n > 0 && friction_solve(n, K, b)) return 1;
    for (int j = 0; j < NF; j++) x[j] = 0.0;
    for (int i = 0; i < n; i++) x[at[i]] = b[i];
    return 0;
}

/* Compute the forces x of sticking frictions that change their slip accelerations by b, with x =
 * b on entry and zeros elsewhere on return. */
static inline int solve_sticking(const FrictionStep *rates, const int *modes, double *x)
{
    Sharing g;
    share_sticking(rates, modes, &g);
    if (solve_leaders(rates, &g, x)) return 1;
    for (int j = NF - 1; j >= 0; j--) /* leaders precede followers */
        if (g.leader[j] >= 0) x[j] = g.share[j] * x[g.leader[j]];
    return 0;
}

/* Compute the friction forces in the given modes into lam[NC ..]. Return 1 if the mass matrix is
 * not positive definite or a sticking friction has nothing to hold. */
static inline int friction_in_modes(const Model *m, const double *q, const double *v, const double *u, const int *modes, double *lam)
{
    FrictionStep rates;
    double sticking[NF], *f = lam + NC;
    int sticks = 0;
    for (int j = 0; j < NF; j++) sticks |= !modes[j];
    if (!sticks) {
        /* Slipping needs neither rates nor a mass matrix, which reduces a step of push_box to a
         * third of the time. */
        for (int j = 0; j < NF; j++) f[j] = 0.0;
        scene_friction_limit(q, lam, m->p, rates.limit);
        for (int j = 0; j < NF; j++) f[j] = -modes[j] * (rates.limit[j] > 0.0 ? rates.limit[j] : 0.0);
        return 0;
    }
    if (friction_rates(m, q, v, u, lam, &rates)) return 1;
    for (int j = 0; j < NF; j++) f[j] = modes[j] ? -modes[j] * rates.limit[j] : 0.0;
    for (int j = 0; j < NF; j++) sticking[j] = -slip_at_end(&rates, f, j);
    if (solve_sticking(&rates, modes, sticking)) return 1;
    for (int j = 0; j < NF; j++)
        if (!modes[j]) f[j] = sticking[j];
    return 0;
}

/* Decide the friction modes at (q, v, u) with contact forces lam, and write the forces to lam[NC
 * ..]. Return the number of changes, or -1 as friction_in_modes fails. */
static inline int decide_friction(const Model *m, const double *q, const double *v, const double *u, int *modes, double *lam)
{
    FrictionStep rates;
    double s[NF], *f = lam + NC;
    int undecided[NF], changes = 0;
    if (friction_rates(m, q, v, u, lam, &rates)) return -1;
    scene_slip(q, v, m->p, s);
    for (int j = 0; j < NF; j++) {
        const double band = m->frozen && !modes[j] ? DRIFT_BAND : SLIP_BAND;
        undecided[j] = fabs(s[j]) <= band * scene_friction_nominals[j] && rates.limit[j] > 0.0;
        f[j] = undecided[j] ? 0.0 : s[j] > 0.0 ? -rates.limit[j] : rates.limit[j];
        if (undecided[j]) rates.limit[j] *= 1.0 + 0.5 * STICKING_SLACK;
    }
    friction_balance(0, 0.0, &rates, undecided, f);
    for (int j = 0; j < NF; j++) {
        int mode = s[j] > 0.0 ? 1 : -1;
        if (undecided[j]) {
            mode = f[j] > 0.0 ? -1 : 1;
            for (int i = 0; i < NF; i++) /* a group sticks if a member does */
                if (undecided[i] && fabs(f[i]) < rates.limit[i] && (i == j || is_parallel(&rates, i, j))) mode = 0;
        }
        else if (fabs(s[j]) <= SLIP_BAND * scene_friction_nominals[j]) {
            /* Without pressure it slips in its imminent direction, so that a slip through zero
             * is one event. */
            const double rate = slip_at_end(&rates, f, j);
            mode = rate > 0.0 ? 1 : rate < 0.0 ? -1 : modes[j] ? modes[j] : 1;
        }
        changes += mode != modes[j];
        modes[j] = mode;
    }
    return friction_in_modes(m, q, v, u, modes, lam) ? -1 : changes;
}

/* Compute each friction's distance from leaving its mode, relative to nominal values: the slip
 * in its direction, or the rest of mu N. */
static inline void friction_reserves(const Model *m, const double *q, const double *v, const double *lam, const int *modes, double *reserve)
{
    double s[NF], limit[NF];
    scene_slip(q, v, m->p, s);
    scene_friction_limit(q, lam, m->p, limit);
    for (int j = 0; j < NF; j++)
        reserve[j] = modes[j] ? modes[j] * s[j] / scene_friction_nominals[j]
                              : (limit[j] * (1.0 + STICKING_SLACK) - fabs(lam[NC + j])) / FRICTION_NOMINALS[j];
}

/* The zero of a reserve. */
static inline double reserve_band(int j, int mode, double limit)
{
    return mode ? SLIP_BAND : STICKING_SLACK * limit / FRICTION_NOMINALS[j];
}

/* Values of an evaluated Model, and their exact directional and adjoint derivatives in its
 * modes. */

static inline double slip_value(const Model *m, int j)
{
    double s[NF];
    scene_slip(m->q, m->v, m->p, s);
    return s[j];
}

static inline double reserve_value(const Model *m, int j)
{
    double reserve[NF];
    friction_reserves(m, m->q, m->v, m->lam, m->modes + NC, reserve);
    return reserve[j];
}

/* Return the power dissipated by friction. */
static inline double friction_power(const Model *m)
{
    double s[NF], power = 0.0;
    scene_slip(m->q, m->v, m->p, s);
    for (int j = 0; j < NF; j++) power -= m->lam[NC + j] * s[j];
    return power;
}

/* Add the friction forces to a tangent that has its contact forces. A sticking force is defined
 * by 0 = ds/dt(q, v, a(q, v, u, lam, f)), which is differentiated. Return 1 as model_evaluate. */
static inline int friction_tangent(const Model *m, Tangent *d)
{
    const int *modes = m->modes + NC;
    double limit[NF], da[NQ], da_p[NQ], rate[NF];
    FrictionStep rates;
    scene_friction_limit_jvp(m->q, m->lam, m->p, d->q, d->lam, d->p, limit);
    for (int j = 0; j < NF; j++) d->lam[NC + j] = -modes[j] * limit[j];
    if (scene_acceleration_jvp(m->q, m->v, m->u, m->lam, m->p, d->q, d->v, d->u, d->lam, da)) return 1;
    if (scene_acceleration_parameter_jvp(m->q, m->v, m->u, m->lam, m->p, m->a, d->p, da_p)) return 1;
    for (int i = 0; i < NQ; i++) da[i] += da_p[i];
    scene_slip_rate_jvp(m->q, m->v, m->a, m->p, d->q, d->v, da, d->p, rate);
    for (int j = 0; j < NF; j++) rate[j] = -rate[j];
    if (friction_columns(1.0, m->p, m->q, m->v, m->u, m->lam, &rates) || solve_sticking(&rates, modes, rate)) return 1;
    for (int j = 0; j < NF; j++)
        if (!modes[j]) d->lam[NC + j] = rate[j];
    if (NF > 1) { /* shares follow the limits */
        Sharing g;
        double group[NF] = {0.0};
        share_sticking(&rates, modes, &g);
        for (int j = 0; j < NF; j++)
            if (!modes[j] && rates.limit[j] > 0.0) group[g.leader[j]] += g.ratio[j] * limit[j];
        for (int j = 0; j < NF; j++)
            if (!modes[j] && rates.limit[j] > 0.0)
                d->lam[NC + j] += m->lam[NC + j] * (limit[j] / rates.limit[j] - group[g.leader[j]] / g.limit[g.leader[j]]);
    }
    return 0;
}

static inline double slip_tangent(const Model *m, const Tangent *d, int j)
{
    double ds[NF];
    scene_slip_jvp(m->q, m->v, m->p, d->q, d->v, d->p, ds);
    return ds[j];
}

static inline double reserve_tangent(const Model *m, const Tangent *d, int j)
{
    const int mode = m->modes[NC + j];
    double limit[NF];
    if (mode) return mode * slip_tangent(m, d, j) / scene_friction_nominals[j];
    scene_friction_limit_jvp(m->q, m->lam, m->p, d->q, d->lam, d->p, limit);
    return (limit[j] * (1.0 + STICKING_SLACK) - (m->lam[NC + j] < 0.0 ? -d->lam[NC + j] : d->lam[NC + j])) / FRICTION_NOMINALS[j];
}

static inline double friction_power_tangent(const Model *m, const Tangent *d)
{
    double power = 0.0;
    for (int j = 0; j < NF; j++) power -= d->lam[NC + j] * slip_value(m, j) + m->lam[NC + j] * slip_tangent(m, d, j);
    return power;
}

static inline void slip_adjoint(const Model *m, double weight, int j, Tangent *bar)
{
    double slip_bar[NF] = {0.0};
    slip_bar[j] = weight;
    scene_slip_vjp(m->q, m->v, m->p, slip_bar, bar->q, bar->v);
    scene_slip_parameter_vjp(m->q, m->v, m->p, slip_bar, bar->p);
}

static inline void limit_adjoint(const Model *m, const double *limit_bar, Tangent *bar)
{
    scene_friction_limit_vjp(m->q, m->lam, m->p, limit_bar, bar->q, bar->lam);
    scene_friction_limit_parameter_vjp(m->q, m->lam, m->p, limit_bar, bar->p);
}

static inline void reserve_adjoint(const Model *m, double weight, int j, Tangent *bar)
{
    const int mode = m->modes[NC + j];
    double limit_bar[NF] = {0.0};
    if (mode) {
        slip_adjoint(m, mode * weight / scene_friction_nominals[j], j, bar);
        return;
    }
    weight /= FRICTION_NOMINALS[j];
    limit_bar[j] = weight * (1.0 + STICKING_SLACK);
    limit_adjoint(m, limit_bar, bar);
    bar->lam[NC + j] -= m->lam[NC + j] < 0.0 ? -weight : weight;
}

static inline void friction_power_adjoint(const Model *m, double weight, Tangent *bar)
{
    for (int j = 0; j < NF; j++) {
        bar->lam[NC + j] -= weight * slip_value(m, j);
        slip_adjoint(m, -weight * m->lam[NC + j], j, bar);
    }
}

/* First part of an adjoint, before the accelerations: multipliers of ds/dt = 0 of sticking
 * frictions. Return 1 as model_evaluate. */
static inline int sticking_adjoint(const Model *m, Tangent *bar)
{
    double rate_bar[NF];
    FrictionStep rates;
    Sharing g;
    if (friction_columns(1.0, m->p, m->q, m->v, m->u, m->lam, &rates)) return 1;
    share_sticking(&rates, m->modes + NC, &g);
    for (int j = 0; j < NF; j++) {
        rate_bar[j] = 0.0;
        for (int i = 0; i < NQ; i++) rate_bar[j] -= rates.A[j][i] * bar->a[i];
    }
    for (int j = 0; j < NF; j++)
        if (g.leader[j] >= 0) rate_bar[g.leader[j]] -= g.share[j] * bar->lam[NC + j];
    if (solve_leaders(&rates, &g, rate_bar)) return 1;
    scene_slip_rate_vjp(m->q, m->v, m->a, m->p, rate_bar, bar->q, bar->v, bar->a, bar->p);
    return 0;
}

/* Second part: through the limits of slipping and the shares of sticking frictions to their
 * contact forces. */
static inline int slipping_adjoint(const Model *m, Tangent *bar)
{
    const int *modes = m->modes + NC;
    double limit_bar[NF];
    for (int j = 0; j < NF; j++) limit_bar[j] = -modes[j] * bar->lam[NC + j];
    if (NF > 1) {
        FrictionStep rates;
        Sharing g;
        double group[NF] = {0.0};
        if (friction_columns(1.0, m->p, m->q, m->v, m->u, m->lam, &rates)) return 1;
        share_sticking(&rates, modes, &g);
        for (int j = 0; j < NF; j++)
            if (!modes[j]) group[g.leader[j]] += bar->lam[NC + j] * m->lam[NC + j];
        for (int j = 0; j < NF; j++)
            if (!modes[j] && rates.limit[j] > 0.0)
                limit_bar[j] = bar->lam[NC + j] * m->lam[NC + j] / rates.limit[j]
                    - g.ratio[j] * group[g.leader[j]] / g.limit[g.leader[j]];
    }
    limit_adjoint(m, limit_bar, bar);
    return 0;
}

#endif
