/* Damped contacts in continuous time. A closed contact presses (mode 1), or is released (mode 0)
 * if the bodies separate so fast that its force would pull. Included by equations.h only with
 * damped contacts.
 *
 * Rows of lam, modes and event indicators after the frictions belong to the damped contacts. In
 * lam they contain the push of a closed contact as a share of a typical force (Hunt-Crossley: 1
 * + d r), and 1 for an open one. */
#ifndef DAMPING_MODES_H
#define DAMPING_MODES_H

#include "damping.h"
#include "model.h"

#define PRESSING (NC + NF) /* the first of these rows */
/* Half-width of the hysteresis around a push of zero; see HYSTERESIS. */
#define PRESSING_BAND 1e-10

/* Results of a state for all contacts: penetrations, their rates, coefficients. */
typedef struct {
    double phi[NC], rate[NC], k[NC], c[NC];
} Contacts;

static inline void look_at_contacts(const Model *m, const double *q, const double *v, Contacts *at)
{
    scene_penetration(q, m->p, at->phi);
    scene_penetration_jvp(q, m->p, v, at->rate);
    scene_stiffness(m->p, at->k);
    scene_damping(m->p, at->c);
}

static inline Push push_of(const Contacts *at, int i)
{
    return contact_push(scene_damping_laws[i], at->k[i], at->c[i], at->phi[i], at->rate[i]);
}

/* The share of a closed contact in the rows of lam. */
static inline Push pressing(const Contacts *at, int i)
{
    const double unit = 1.0 / (at->k[i] * CONTACT_NOMINALS[i]), share = (at->k[i] * at->phi[i] + at->c[i] * at->rate[i]) * unit;
    const Push kelvin_voigt = {share, at->k[i] * unit, at->c[i] * unit, at->phi[i] * unit - share / at->k[i], at->rate[i] * unit};
    const Push hunt_crossley = {1.0 + at->c[i] * at->rate[i], 0.0, at->c[i], 0.0, at->rate[i]};
    return scene_damping_laws[i] == 1 ? kelvin_voigt : hunt_crossley;
}

/* Overwrite the forces of the damped contacts in lam, and fill their rows; modes NULL: the true
 * law. */
SCENE_INLINE void damped_forces(const Model *m, const double *q, const double *v, const double *phi, const int *modes, double *lam)
{
    Contacts at;
    int known = 0;
    for (int j = 0; j < ND; j++) {
        const int i = scene_damped[j];
        lam[i] = 0.0;
        lam[PRESSING + j] = 1.0;
        if (!(modes ? modes[i] : phi[i] > 0.0)) continue;
        if (!known) look_at_contacts(m, q, v, &at);
        known = 1;
        const double push = push_of(&at, i).value;
        if (modes ? modes[PRESSING + j] : push > 0.0) lam[i] = push;
        lam[PRESSING + j] = pressing(&at, i).value;
    }
}

/* Compute the rates of the shares of closed contacts (ND) at accelerations a. */
static inline void pressing_rates(const Model *m, const double *q, const double *v, const double *a, double *rates)
{
    double second[NC];
    Contacts at;
    look_at_contacts(m, q, v, &at);
    scene_penetration_rate_jvp(q, v, m->p, v, a, second);
    for (int j = 0; j < ND; j++) {
        const Push share = pressing(&at, scene_damped[j]);
        rates[j] = share.phi * at.rate[scene_damped[j]] + share.rate * second[scene_damped[j]];
    }
}

/* Return the mode of a closed contact at an event: by the sign of its push outside the band,
 * else by its direction. */
static inline int pressing_mode(double share, double rate, int before)
{
    if (share > PRESSING_BAND) return 1;
    if (share < -PRESSING_BAND) return 0;
    if (rate > 0.0) return 1;
    if (rate < 0.0) return 0;
    return before;
}

/* Add the damped contacts and their rows to a tangent with phi, k, q, v and p. */
static inline void damping_tangent(const Model *m, Tangent *d)
{
    Contacts at;
    double rate[NC], rate_p[NC], c[NC];
    look_at_contacts(m, m->q, m->v, &at);
    scene_penetration_rate_jvp(m->q, m->v, m->p, d->q, d->v, rate);
    scene_penetration_rate_parameter_jvp(m->q, m->v, m->p, d->p, rate_p);
    scene_damping_parameter_jvp(m->p, d->p, c);
    for (int j = 0; j < ND; j++) {
        const int i = scene_damped[j];
        const Push push = push_of(&at, i), share = pressing(&at, i);
        rate[i] += rate_p[i];
        d->lam[i] = m->modes[i] && m->modes[PRESSING + j] ? push.phi * d->phi[i] + push.rate * rate[i] + push.k * d->k[i] + push.c * c[i] : 0.0;
        d->lam[PRESSING + j] = m->modes[i] ? share.phi * d->phi[i] + share.rate * rate[i] + share.k * d->k[i] + share.c * c[i] : 0.0;
    }
}

/* The transpose of damping_tangent; sets lam_bar of the damped contacts to zero. */
static inline void damping_adjoint(const Model *m, Tangent *bar)
{
    Contacts at;
    double rate_bar[NC] = {0.0}, c_bar[NC] = {0.0};
    look_at_contacts(m, m->q, m->v, &at);
    for (int j = 0; j < ND; j++) {
        const int i = scene_damped[j];
        const Push push = push_of(&at, i), share = pressing(&at, i);
        const double of_push = m->modes[i] && m->modes[PRESSING + j] ? bar->lam[i] : 0.0, of_share = m->modes[i] ? bar->lam[PRESSING + j] : 0.0;
        bar->phi[i] += push.phi * of_push + share.phi * of_share;
        bar->k[i] += push.k * of_push + share.k * of_share;
        rate_bar[i] = push.rate * of_push + share.rate * of_share;
        c_bar[i] = push.c * of_push + share.c * of_share;
        bar->lam[i] = 0.0;
    }
    scene_penetration_rate_vjp(m->q, m->v, m->p, rate_bar, bar->q, bar->v);
    scene_penetration_rate_parameter_vjp(m->q, m->v, m->p, rate_bar, bar->p);
    scene_damping_parameter_vjp(m->p, c_bar, bar->p);
}

/* Return the energy of the springs of closed contacts, also of released ones, whose dampers
 * receive it. */
static inline double spring_energy(const Model *m)
{
    double energy = 0.0;
    for (int i = 0; i < NC; i++)
        if (m->modes[i]) energy += 0.5 * m->k[i] * m->phi[i] * m->phi[i];
    return energy;
}

static inline double spring_energy_tangent(const Model *m, const Tangent *d)
{
    double energy = 0.0;
    for (int i = 0; i < NC; i++)
        if (m->modes[i]) energy += m->phi[i] * (m->k[i] * d->phi[i] + 0.5 * d->k[i] * m->phi[i]);
    return energy;
}

static inline void spring_energy_adjoint(const Model *m, double weight, Tangent *bar)
{
    for (int i = 0; i < NC; i++) {
        if (!m->modes[i]) continue;
        bar->phi[i] += weight * m->k[i] * m->phi[i];
        bar->k[i] += 0.5 * weight * m->phi[i] * m->phi[i];
    }
}

/* Return the power dissipated by damped contacts: their force beyond the spring times the
 * penetration rate. */
static inline double damping_power(const Model *m)
{
    double rate[NC], power = 0.0;
    scene_penetration_jvp(m->q, m->p, m->v, rate);
    for (int j = 0; j < ND; j++) {
        const int i = scene_damped[j];
        if (m->modes[i]) power += (m->lam[i] - m->k[i] * m->phi[i]) * rate[i];
    }
    return power;
}

static inline double damping_power_tangent(const Model *m, const Tangent *d)
{
    double rate[NC], d_rate[NC], by_p[NC], power = 0.0;
    scene_penetration_jvp(m->q, m->p, m->v, rate);
    scene_penetration_rate_jvp(m->q, m->v, m->p, d->q, d->v, d_rate);
    scene_penetration_rate_parameter_jvp(m->q, m->v, m->p, d->p, by_p);
    for (int j = 0; j < ND; j++) {
        const int i = scene_damped[j];
        if (!m->modes[i]) continue;
        power += (m->lam[i] - m->k[i] * m->phi[i]) * (d_rate[i] + by_p[i]) + (d->lam[i] - m->k[i] * d->phi[i] - d->k[i] * m->phi[i]) * rate[i];
    }
    return power;
}

static inline void damping_power_adjoint(const Model *m, double weight, Tangent *bar)
{
    double rate[NC], rate_bar[NC] = {0.0};
    scene_penetration_jvp(m->q, m->p, m->v, rate);
    for (int j = 0; j < ND; j++) {
        const int i = scene_damped[j];
        if (!m->modes[i]) continue;
        rate_bar[i] = weight * (m->lam[i] - m->k[i] * m->phi[i]);
        bar->lam[i] += weight * rate[i];
        bar->phi[i] -= weight * rate[i] * m->k[i];
        bar->k[i] -= weight * rate[i] * m->phi[i];
    }
    scene_penetration_rate_vjp(m->q, m->v, m->p, rate_bar, bar->q, bar->v);
    scene_penetration_rate_parameter_vjp(m->q, m->v, m->p, rate_bar, bar->p);
}

#endif
