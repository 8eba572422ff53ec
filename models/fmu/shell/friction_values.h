/* Slips, reserves and dissipation of the frictions of an evaluated Model, and their exact directional and adjoint derivatives in
 * its modes. In scenes without friction the same functions do nothing. Included by equations.h. */
#ifndef FRICTION_VALUES_H
#define FRICTION_VALUES_H

#include "model.h"

#if NF > 0

#include "friction_modes.h"

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

/* Power that friction takes out. */
static inline double friction_power(const Model *m)
{
    double s[NF], power = 0.0;
    scene_slip(m->q, m->v, m->p, s);
    for (int j = 0; j < NF; j++) power -= m->lam[NC + j] * s[j];
    return power;
}

/* Complete a tangent by the friction forces; its contact forces are there already. A sticking force is defined by
 * 0 = ds/dt(q, v, a(q, v, u, lam, f)), which is differentiated. 1 as in model_evaluate. */
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

/* Before an adjoint is followed through the accelerations: the multipliers of ds/dt = 0 of what sticks. 1 as in model_evaluate. */
static inline int sticking_adjoint(const Model *m, Tangent *bar)
{
    double rate_bar[NF];
    FrictionStep rates;
    if (friction_columns(1.0, m->p, m->q, m->v, m->u, m->lam, &rates)) return 1;
    for (int j = 0; j < NF; j++) {
        rate_bar[j] = -bar->lam[NC + j];
        for (int i = 0; i < NQ; i++) rate_bar[j] -= rates.A[j][i] * bar->a[i];
    }
    if (solve_sticking(&rates, m->modes + NC, rate_bar)) return 1;
    scene_slip_rate_vjp(m->q, m->v, m->a, m->p, rate_bar, bar->q, bar->v, bar->a, bar->p);
    return 0;
}

/* After it: through the limits of what slips, to the contact forces that press it. */
static inline void slipping_adjoint(const Model *m, Tangent *bar)
{
    double limit_bar[NF];
    for (int j = 0; j < NF; j++) limit_bar[j] = -m->modes[NC + j] * bar->lam[NC + j];
    limit_adjoint(m, limit_bar, bar);
}

#else

static inline double slip_value(const Model *m, int j) { return (void)m, (void)j, NAN; }
static inline double reserve_value(const Model *m, int j) { return (void)m, (void)j, NAN; }
static inline double friction_power(const Model *m) { return (void)m, 0.0; }
static inline int friction_tangent(const Model *m, Tangent *d) { return (void)m, (void)d, 0; }
static inline double slip_tangent(const Model *m, const Tangent *d, int j) { return (void)m, (void)d, (void)j, NAN; }
static inline double reserve_tangent(const Model *m, const Tangent *d, int j) { return (void)m, (void)d, (void)j, NAN; }
static inline double friction_power_tangent(const Model *m, const Tangent *d) { return (void)m, (void)d, 0.0; }
static inline void slip_adjoint(const Model *m, double weight, int j, Tangent *bar) { (void)m, (void)weight, (void)j, (void)bar; }
static inline void reserve_adjoint(const Model *m, double weight, int j, Tangent *bar) { (void)m, (void)weight, (void)j, (void)bar; }
static inline void friction_power_adjoint(const Model *m, double weight, Tangent *bar) { (void)m, (void)weight, (void)bar; }
static inline int sticking_adjoint(const Model *m, Tangent *bar) { return (void)m, (void)bar, 0; }
static inline void slipping_adjoint(const Model *m, Tangent *bar) { (void)m, (void)bar; }

#endif
#endif
