/* Force of damped contacts within a time step, and its derivatives. Needs scene_model.h; only
 * for scenes with a damped contact.
 *
 *   damping 1, Kelvin-Voigt:    lam = max(k phi + c r, 0)      if phi > 0, else 0      r = d phi
 * / dt
 *   damping 2, Hunt-Crossley:   lam = k phi max(1 + c r, 0)    if phi > 0, else 0
 *
 * Smoothed by s(x) = log(1 + exp(b x)) / b with derivative w(x) = 1 / (1 + exp(-b x)):
 *
 *   1:  lam = k s(phi + w(phi) c r / k)
 *   2:  lam = k s(phi) s(1 + c r) / s(1), with b L for b in the last two, L the scene's length
 *
 * Both are never negative, and equal the softplus law at rest (r = 0). */
#ifndef DAMPING_H
#define DAMPING_H

#include <math.h>

#include "scene_model.h"

/* A force and its derivatives by penetration, rate of penetration, stiffness and damping. */
typedef struct {
    double value, phi, rate, k, c;
} Push;

/* The force in contact, before the positive part. */
SCENE_FUNCTION Push contact_push(int damping, double k, double c, double phi, double rate)
{
    const double s = 1.0 + c * rate;
    const Push kelvin_voigt = {k * phi + c * rate, k, c, phi, rate}, hunt_crossley = {k * phi * s, k * s, k * phi * c, phi * s, k * phi * rate};
    return damping == 1 ? kelvin_voigt : hunt_crossley;
}

SCENE_FUNCTION double soft_part(double b, double x)
{
    const double z = b * x;
    return ((z > 0.0 ? z : 0.0) + log1p(exp(-fabs(z)))) / b;
}

SCENE_FUNCTION double soft_switch(double b, double x)
{
    const double e = exp(-fabs(b * x));
    return (x > 0.0 ? 1.0 : e) / (1.0 + e);
}

/* The law of a time step: 0 exact, 1 smoothed with sharpness b (without derivatives by k and c). */
SCENE_FUNCTION Push damped_force(int law, double b, int damping, double k, double c, double phi, double rate)
{
    Push none = {0.0, 0.0, 0.0, 0.0, 0.0};
    if (law == 0) {
        const Push push = contact_push(damping, k, c, phi, rate);
        return phi > 0.0 && push.value > 0.0 ? push : none;
    }
    const double w = soft_switch(b, phi);
    if (damping == 1) {
        const double y = phi + w * c * rate / k, slope = soft_switch(b, y);
        none.value = k * soft_part(b, y);
        none.phi = slope * (k + b * w * (1.0 - w) * c * rate);
        none.rate = slope * w * c;
    } else {
        const double bl = b * SCENE_LENGTH, one = soft_part(bl, 1.0), depth = soft_part(b, phi) / one, s = soft_part(bl, 1.0 + c * rate);
        none.value = k * depth * s;
        none.phi = k * w * s / one;
        none.rate = k * depth * soft_switch(bl, 1.0 + c * rate) * c;
    }
    return none;
}

/* Write the forces of the damped contacts at (q, v) into lam. */
SCENE_FUNCTION void damp_contacts(int law, double b, const double *k, const double *q, const double *v, const double *p, double *lam)
{
    double phi[NC], rate[NC], c[NC];
    scene_penetration(q, p, phi);
    scene_penetration_jvp(q, p, v, rate);
    scene_damping(p, c);
    for (int i = 0; i < NC; i++)
        if (scene_damping_laws[i]) lam[i] = damped_force(law, b, scene_damping_laws[i], k[i], c[i], phi[i], rate[i]).value;
}

/* Propagate lam_bar of the damped contacts to q_bar and v_bar, and set it to zero. */
SCENE_FUNCTION void damp_contacts_vjp(int law, double b, const double *k, const double *q, const double *v, const double *p, double *lam_bar,
    double *q_bar, double *v_bar)
{
    double phi[NC], rate[NC], c[NC], phi_bar[NC], rate_bar[NC];
    scene_penetration(q, p, phi);
    scene_penetration_jvp(q, p, v, rate);
    scene_damping(p, c);
    for (int i = 0; i < NC; i++) {
        phi_bar[i] = rate_bar[i] = 0.0;
        if (!scene_damping_laws[i]) continue;
        const Push force = damped_force(law, b, scene_damping_laws[i], k[i], c[i], phi[i], rate[i]);
        phi_bar[i] = force.phi * lam_bar[i];
        rate_bar[i] = force.rate * lam_bar[i];
        lam_bar[i] = 0.0;
    }
    scene_penetration_vjp(q, p, phi_bar, q_bar);
    scene_penetration_rate_vjp(q, v, p, rate_bar, q_bar, v_bar);
}

#endif
