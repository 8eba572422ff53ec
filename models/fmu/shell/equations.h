/* Contact law, accelerations and outputs of a Model, and their exact directional derivatives. */
#ifndef EQUATIONS_H
#define EQUATIONS_H

#include "model.h"
#ifdef DAMPING
#include "damping_modes.h"
#endif
#if NF > 0
#include "friction_modes.h"
#else
/* Replacement of friction_modes.h without friction. */
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
static inline int slipping_adjoint(const Model *m, Tangent *bar) { return (void)m, (void)bar, 0; }
#endif

/* Half-width of the hysteresis around gap = 0, as a share of the contact's nominal penetration.
 * Event location has an error of about 1e-13 m; within the band the direction of motion decides,
 * with a force below 1e-10 of a typical one. */
#define HYSTERESIS 1e-10

/* Return the mode of a contact at an event: by the sign of phi outside the band, else by the
 * direction of motion, else unchanged. */
static inline int contact_mode(int contact, double phi, double phi_rate, int before)
{
    const double band = HYSTERESIS * CONTACT_NOMINALS[contact];
    if (phi > band) return 1;
    if (phi < -band) return 0;
    if (phi_rate > 0.0) return 1;
    if (phi_rate < 0.0) return 0;
    return before;
}

/* lam = closed ? k phi : 0, the smooth continuation of a contact mode; without modes the true
 * law lam = k max(phi, 0). */
static inline void contact_forces(const double *phi, const double *k, const int *modes, double *lam)
{
    for (int i = 0; i < NC; i++) lam[i] = (modes ? modes[i] : phi[i] > 0.0) ? k[i] * phi[i] : 0.0;
}

DAMPED(static inline int decide_pressing(const Model *m, const double *q, const double *v, const double *u, int *modes);)

/* Update the modes at a point of the motion under the inputs u; return the number of changes. */
static inline int update_modes(const Model *m, const double *q, const double *v, const double *u, int *modes)
{
    double phi[ROOM(NC)], rate[ROOM(NC)];
    int changes = 0;
    scene_penetration(q, m->p, phi);
    scene_penetration_jvp(q, m->p, v, rate);
    for (int i = 0; i < NC; i++) {
        const int mode = contact_mode(i, phi[i], rate[i], modes[i]);
        changes += mode != modes[i];
        modes[i] = mode;
    }
    DAMPED(changes += decide_pressing(m, q, v, u, modes);)
#if NF > 0
    double k[ROOM(NC)], lam[NL];
    scene_stiffness(m->p, k);
    contact_forces(phi, k, modes, lam);
    DAMPED(damped_forces(m, q, v, phi, modes, lam);)
    const int slips = decide_friction(m, q, v, u, modes + NC, lam);
    changes += slips > 0 ? slips : 0; /* a failure recurs in the acceleration */
#else
    (void)u;
#endif
    return changes;
}

/* As update_modes, for the Model itself. */
static inline int model_update_modes(Model *m)
{
    const int changes = update_modes(m, m->q, m->v, m->u, m->modes);
    if (changes) m->evaluated = 0;
    return changes;
}

/* The modes of the forces, or (NULL) the true law of contact with given friction forces. */
typedef struct {
    const int *modes;
    const double *friction; /* (NF), used without modes */
} Law;

/* Compute all forces at (q, v, u) under a law; return 1 as model_acceleration. */
SCENE_INLINE int model_forces(const Model *m, const double *q, const double *v, const double *u, const Law *law, const double *phi, const double *k,
    double *lam)
{
    contact_forces(phi, k, law->modes, lam);
    DAMPED(damped_forces(m, q, v, phi, law->modes, lam);)
#if NF > 0
    if (law->modes) return friction_in_modes(m, q, v, u, law->modes + NC, lam);
    memcpy(lam + NC, law->friction, NF * sizeof *lam);
#else
    (void)m, (void)q, (void)v, (void)u;
#endif
    return 0;
}

/* Compute a = M^-1 (tau + J' lam + S' f) at (q, v, u) under a law; return 1 if M is not positive
 * definite. */
static inline int model_acceleration(const Model *m, const double *q, const double *v, const double *u, const Law *law, double *a)
{
    double phi[ROOM(NC)], k[ROOM(NC)], lam[ROOM(NL)];
    scene_penetration(q, m->p, phi);
    scene_stiffness(m->p, k);
    return model_forces(m, q, v, u, law, phi, k, lam) || scene_acceleration(q, v, u, lam, m->p, a);
}

#ifdef DAMPING
/* Compute the rows of the damped contacts for the integrator; open ones have no events. Return 1
 * as model_acceleration. */
static inline int look_at_pressing(const Model *m, const int *modes, const double *q, const double *v, const double *u, double *excess,
    double *rate, double *band)
{
    double phi[NC], k[NC], lam[NL], a[NQ], rates[ND];
    const Law law = {modes, NULL};
    scene_penetration(q, m->p, phi);
    scene_stiffness(m->p, k);
    if (model_forces(m, q, v, u, &law, phi, k, lam) || scene_acceleration(q, v, u, lam, m->p, a)) return 1;
    pressing_rates(m, q, v, a, rates);
    for (int j = 0; j < ND; j++) {
        const int row = PRESSING + j, side = !modes[scene_damped[j]] ? 0 : modes[row] ? -1 : 1;
        excess[row] = side ? side * lam[row] : -1.0;
        rate[row] = side * rates[j];
        band[row] = PRESSING_BAND;
    }
    return 0;
}

/* Decide which closed contacts press; return the number of changes. */
static inline int decide_pressing(const Model *m, const double *q, const double *v, const double *u, int *modes)
{
    double phi[NC], k[NC], lam[NL], a[NQ], rates[ND] = {0.0};
    const Law law = {modes, NULL};
    int changes = 0;
    scene_penetration(q, m->p, phi);
    scene_stiffness(m->p, k);
    if (!model_forces(m, q, v, u, &law, phi, k, lam) && !scene_acceleration(q, v, u, lam, m->p, a)) pressing_rates(m, q, v, a, rates);
    damped_forces(m, q, v, phi, modes, lam);
    for (int j = 0; j < ND; j++) {
        const int before = modes[PRESSING + j], mode = modes[scene_damped[j]] && pressing_mode(lam[PRESSING + j], rates[j], before);
        changes += mode != before;
        modes[PRESSING + j] = mode;
    }
    return changes;
}
#endif

/* Compute phi, k, lam and a; return 1 if the mass matrix is not positive definite. */
static inline int model_evaluate(Model *m)
{
    if (m->evaluated) return 0;
    if (!m->frozen) model_update_modes(m);
    scene_penetration(m->q, m->p, m->phi);
    scene_stiffness(m->p, m->k);
    const Law law = {m->modes, NULL};
    if (model_forces(m, m->q, m->v, m->u, &law, m->phi, m->k, m->lam)) return 1;
    if (scene_acceleration(m->q, m->v, m->u, m->lam, m->p, m->a)) return 1;
    m->evaluated = 1;
    return 0;
}

/* Compute the event indicators of an evaluated Model: the gaps, then the reserves of the
 * frictions. */
static inline void model_indicators(const Model *m, double *indicators)
{
    for (int i = 0; i < NC; i++) indicators[i] = -m->phi[i];
#if NF > 0
    friction_reserves(m, m->q, m->v, m->lam, m->modes + NC, indicators + NC);
#else
    (void)m, (void)indicators;
#endif
    DAMPED(for (int i = PRESSING; i < NL; i++) indicators[i] = m->lam[i];)
}

/* Return whether an evaluated Model is beyond the hysteresis of one of its modes. */
static inline int model_modes_wrong(const Model *m)
{
    int wrong = 0;
    for (int i = 0; i < NC; i++) wrong |= contact_mode(i, m->phi[i], 0.0, m->modes[i]) != m->modes[i];
#ifdef DAMPING
    for (int j = 0; j < ND; j++)
        wrong |= m->modes[scene_damped[j]] && pressing_mode(m->lam[PRESSING + j], 0.0, m->modes[PRESSING + j]) != m->modes[PRESSING + j];
#endif
#if NF > 0
    double reserve[NF], limit[NF];
    friction_reserves(m, m->q, m->v, m->lam, m->modes + NC, reserve);
    scene_friction_limit(m->q, m->lam, m->p, limit);
    for (int j = 0; j < NF; j++) wrong |= reserve[j] < -reserve_band(j, m->modes[NC + j], limit[j]);
#endif
    return wrong;
}

#ifndef DAMPING
static inline double contact_energy(const Model *m)
{
    double energy = 0.0;
    for (int i = 0; i < NC; i++) energy += 0.5 * m->lam[i] * m->phi[i];
    return energy;
}
#endif

/* Return the value of a variable of an evaluated Model. */
static inline double model_value(const Model *m, const Variable *variable)
{
    const int i = variable->index;
    switch (variable->kind) {
    case KIND_TIME: return m->time;
    case KIND_POSITION: return m->q[i];
    case KIND_VELOCITY:
    case KIND_POSITION_RATE: return m->v[i];
    case KIND_VELOCITY_RATE: return m->a[i];
    case KIND_INPUT: return m->u[i];
    case KIND_PARAMETER: return m->p[i];
    case KIND_FORCE: return m->lam[i];
    case KIND_GAP: return -m->phi[i];
    case KIND_KINETIC_ENERGY: return scene_kinetic_energy(m->q, m->v, m->p);
    case KIND_POTENTIAL_ENERGY: return scene_potential_energy(m->q, m->p);
#ifdef DAMPING
    case KIND_PRESSING: return m->lam[i];
    case KIND_CONTACT_ENERGY: return spring_energy(m);
#else
    case KIND_CONTACT_ENERGY: return contact_energy(m);
#endif
    case KIND_INPUT_POWER: return scene_input_power(m->q, m->v, m->u, m->p);
#ifdef DAMPING
    case KIND_DISSIPATED_POWER: return scene_dissipated_power(m->q, m->v, m->p) + friction_power(m) + damping_power(m);
#else
    case KIND_DISSIPATED_POWER: return scene_dissipated_power(m->q, m->v, m->p) + friction_power(m);
#endif
    case KIND_SLIP: return slip_value(m, i);
    case KIND_RESERVE: return reserve_value(m, i);
    case KIND_INTERNAL_STEP: return m->internal_step;
    case KIND_INTEGRATOR: return m->integrator;
    }
    return NAN;
}

static inline void model_assign(Model *m, const Variable *variable, double value)
{
    switch (variable->kind) {
    case KIND_POSITION: m->q[variable->index] = value; break;
    case KIND_VELOCITY: m->v[variable->index] = value; break;
    case KIND_INPUT: m->u[variable->index] = value; break;
    case KIND_PARAMETER: m->p[variable->index] = value; break;
    case KIND_INTERNAL_STEP: m->internal_step = value; break;
    case KIND_INTEGRATOR: m->integrator = (int)value; break;
    default: break;
    }
    m->evaluated = 0;
}

/* Return the entry of a state, an input or a parameter in a tangent or an adjoint, else NULL. */
static inline double *known_entry(const Variable *variable, Tangent *tangent)
{
    switch (variable->kind) {
    case KIND_POSITION: return &tangent->q[variable->index];
    case KIND_VELOCITY: return &tangent->v[variable->index];
    case KIND_INPUT: return &tangent->u[variable->index];
    case KIND_PARAMETER: return &tangent->p[variable->index];
    default: return NULL;
    }
}

/* Complete a tangent with given q, v, u, p in the contact modes of the evaluated Model; return 1
 * as model_evaluate. */
static inline int model_tangent(const Model *m, Tangent *d)
{
    double phi_p[ROOM(NC)], a_p[NQ];
    scene_penetration_jvp(m->q, m->p, d->q, d->phi);
    scene_penetration_parameter_jvp(m->q, m->p, d->p, phi_p);
    scene_stiffness_parameter_jvp(m->p, d->p, d->k);
    for (int i = 0; i < NC; i++) {
        d->phi[i] += phi_p[i];
        d->lam[i] = m->modes[i] ? m->k[i] * d->phi[i] + d->k[i] * m->phi[i] : 0.0;
    }
    DAMPED(damping_tangent(m, d);)
    if (friction_tangent(m, d)) return 1;
    if (scene_acceleration_jvp(m->q, m->v, m->u, m->lam, m->p, d->q, d->v, d->u, d->lam, d->a)) return 1;
    if (scene_acceleration_parameter_jvp(m->q, m->v, m->u, m->lam, m->p, m->a, d->p, a_p)) return 1;
    for (int i = 0; i < NQ; i++) d->a[i] += a_p[i];
    return 0;
}

#ifndef DAMPING
static inline double contact_energy_tangent(const Model *m, const Tangent *d)
{
    double energy = 0.0;
    for (int i = 0; i < NC; i++) energy += 0.5 * (d->lam[i] * m->phi[i] + m->lam[i] * d->phi[i]);
    return energy;
}
#endif

/* Return the directional derivative of a variable along a completed tangent. */
static inline double model_value_tangent(const Model *m, const Tangent *d, const Variable *variable)
{
    const int i = variable->index;
    switch (variable->kind) {
    case KIND_POSITION: return d->q[i];
    case KIND_VELOCITY:
    case KIND_POSITION_RATE: return d->v[i];
    case KIND_VELOCITY_RATE: return d->a[i];
    case KIND_INPUT: return d->u[i];
    case KIND_PARAMETER: return d->p[i];
    case KIND_FORCE: return d->lam[i];
    case KIND_GAP: return -d->phi[i];
    case KIND_KINETIC_ENERGY: return scene_kinetic_energy_jvp(m->q, m->v, m->p, d->q, d->v, d->p);
    case KIND_POTENTIAL_ENERGY: return scene_potential_energy_jvp(m->q, m->p, d->q, d->p);
#ifdef DAMPING
    case KIND_PRESSING: return d->lam[i];
    case KIND_CONTACT_ENERGY: return spring_energy_tangent(m, d);
#else
    case KIND_CONTACT_ENERGY: return contact_energy_tangent(m, d);
#endif
    case KIND_INPUT_POWER: return scene_input_power_jvp(m->q, m->v, m->u, m->p, d->q, d->v, d->u, d->p);
#ifdef DAMPING
    case KIND_DISSIPATED_POWER:
        return scene_dissipated_power_jvp(m->q, m->v, m->p, d->q, d->v, d->p) + friction_power_tangent(m, d) + damping_power_tangent(m, d);
#else
    case KIND_DISSIPATED_POWER: return scene_dissipated_power_jvp(m->q, m->v, m->p, d->q, d->v, d->p) + friction_power_tangent(m, d);
#endif
    case KIND_SLIP: return slip_tangent(m, d, i);
    case KIND_RESERVE: return reserve_tangent(m, d, i);
    case KIND_TIME:
    case KIND_INTERNAL_STEP:
    case KIND_INTEGRATOR: break;
    }
    return 0.0;
}

/* Add the direct dependences of `weight` times a variable to an adjoint; model_adjoint
 * propagates these to states, inputs and parameters. */
static inline void model_value_adjoint(const Model *m, double weight, const Variable *variable, Tangent *bar)
{
    const int i = variable->index;
    const double *w = &weight;
    switch (variable->kind) {
    case KIND_POSITION: bar->q[i] += weight; break;
    case KIND_VELOCITY:
    case KIND_POSITION_RATE: bar->v[i] += weight; break;
    case KIND_VELOCITY_RATE: bar->a[i] += weight; break;
    case KIND_INPUT: bar->u[i] += weight; break;
    case KIND_PARAMETER: bar->p[i] += weight; break;
    case KIND_FORCE: bar->lam[i] += weight; break;
    case KIND_GAP: bar->phi[i] -= weight; break;
    case KIND_KINETIC_ENERGY: scene_kinetic_energy_vjp(m->q, m->v, m->p, w, bar->q, bar->v, bar->p); break;
    case KIND_POTENTIAL_ENERGY: scene_potential_energy_vjp(m->q, m->p, w, bar->q, bar->p); break;
#ifdef DAMPING
    case KIND_PRESSING: bar->lam[i] += weight; break;
    case KIND_CONTACT_ENERGY: spring_energy_adjoint(m, weight, bar); break;
#else
    case KIND_CONTACT_ENERGY:
        for (int n = 0; n < NC; n++) {
            bar->lam[n] += 0.5 * weight * m->phi[n];
            bar->phi[n] += 0.5 * weight * m->lam[n];
        }
        break;
#endif
    case KIND_INPUT_POWER: scene_input_power_vjp(m->q, m->v, m->u, m->p, w, bar->q, bar->v, bar->u, bar->p); break;
    case KIND_DISSIPATED_POWER:
        scene_dissipated_power_vjp(m->q, m->v, m->p, w, bar->q, bar->v, bar->p);
        friction_power_adjoint(m, weight, bar);
        DAMPED(damping_power_adjoint(m, weight, bar);)
        break;
    case KIND_SLIP: slip_adjoint(m, weight, i, bar); break;
    case KIND_RESERVE: reserve_adjoint(m, weight, i, bar); break;
    case KIND_TIME:
    case KIND_INTERNAL_STEP:
    case KIND_INTEGRATOR: break;
    }
}

/* Complete an adjoint: from a, lam, phi and k to q, v, u and p; the transpose of model_tangent.
 * Return 1 as model_evaluate. */
static inline int model_adjoint(const Model *m, Tangent *bar)
{
    if (sticking_adjoint(m, bar)) return 1;
    if (scene_acceleration_vjp(m->q, m->v, m->u, m->lam, m->p, bar->a, bar->q, bar->v, bar->u, bar->lam)) return 1;
    if (scene_acceleration_parameter_vjp(m->q, m->v, m->u, m->lam, m->p, m->a, bar->a, bar->p)) return 1;
    if (slipping_adjoint(m, bar)) return 1;
    DAMPED(damping_adjoint(m, bar);)
    for (int i = 0; i < NC; i++) {
        if (!m->modes[i]) continue;
        bar->phi[i] += m->k[i] * bar->lam[i];
        bar->k[i] += m->phi[i] * bar->lam[i];
    }
    scene_penetration_vjp(m->q, m->p, bar->phi, bar->q);
    scene_penetration_parameter_vjp(m->q, m->p, bar->phi, bar->p);
    scene_stiffness_parameter_vjp(m->p, bar->k, bar->p);
    return 0;
}

#endif
