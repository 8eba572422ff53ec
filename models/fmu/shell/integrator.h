/* Fixed-step integration of a Model: classical Runge-Kutta of order 4, which keeps its order through contact because the
 * instant at which a contact closes or opens is located and the step is divided there.
 *
 * Within a step the contact modes are frozen and the force continues smoothly beyond its boundary, so each part of a
 * divided step is a smooth problem.
 */
#ifndef INTEGRATOR_H
#define INTEGRATOR_H

#include "equations.h"

typedef enum { STEP_OK, STEP_MASS, STEP_NOT_FINITE } StepResult;

/* Mode changes that are located within one internal step; a step with more is finished with the true law instead. */
#define EVENTS_PER_STEP (8 * ROOM(NC) + 8)

/* Iterations of one location; each halves the bracket at worst, and a double has 53 bits. */
#define LOCATION_ITERATIONS 80

/* Inputs `offset` seconds after the communication point. */
static inline void inputs_at(const Model *m, double offset, double *u)
{
    for (int i = 0; i < NU; i++) u[i] = m->u[i] + m->u_rate[i] * offset;
}

/* One Runge-Kutta step of size s from `from`, which lies `offset` after the communication point. active: modes, or NULL for
 * the true law. */
static inline StepResult runge_kutta(const Model *m, const int *active, const Point *from, double offset, double s, Point *to)
{
    static const double at[4] = {0.0, 0.5, 0.5, 1.0}, weight[4] = {1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0};
    double u[ROOM(NU)], q[NQ], v[NQ], rate_q[NQ], rate_v[NQ];
    Point sum = *from;
    memset(rate_q, 0, sizeof rate_q);
    memset(rate_v, 0, sizeof rate_v);
    for (int stage = 0; stage < 4; stage++) {
        for (int i = 0; i < NQ; i++) {
            q[i] = from->q[i] + at[stage] * s * rate_q[i];
            v[i] = from->v[i] + at[stage] * s * rate_v[i];
        }
        inputs_at(m, offset + at[stage] * s, u);
        if (model_acceleration(m, q, v, u, active, rate_v)) return STEP_MASS;
        for (int i = 0; i < NQ; i++) {
            rate_q[i] = v[i];
            sum.q[i] += s * weight[stage] * rate_q[i];
            sum.v[i] += s * weight[stage] * rate_v[i];
        }
    }
    for (int i = 0; i < NQ; i++)
        if (!isfinite(sum.q[i]) || !isfinite(sum.v[i])) return STEP_NOT_FINITE;
    *to = sum;
    return STEP_OK;
}

/* How far each contact is on the wrong side of its mode (negative: on the right side), and how fast that grows. */
typedef struct {
    double excess[ROOM(NC)], rate[ROOM(NC)];
} ContactView;

static inline void look_at_contacts(const Model *m, const int *active, const Point *x, ContactView *view)
{
    scene_penetration(x->q, m->p, view->excess);
    scene_penetration_jvp(x->q, m->p, x->v, view->rate);
    for (int i = 0; i < NC; i++) {
        if (!active[i]) continue;
        view->excess[i] = -view->excess[i];
        view->rate[i] = -view->rate[i];
    }
}

/* Where the cubic through (0, e0), (s, e1) with slopes r0, r1 is extreme after leaving 0; a negative number if nowhere in (0, s). */
static inline double cubic_extremum(double e0, double r0, double e1, double r1, double s)
{
    const double secant = (e1 - e0) / s;
    const double a = 3.0 * (r0 + r1 - 2.0 * secant), b = 2.0 * (3.0 * secant - 2.0 * r0 - r1), c = r0;
    const double discriminant = b * b - 4.0 * a * c;
    if (!(discriminant >= 0.0)) return -1.0;
    /* roots of a x^2 + b x + c, x = time/s, without cancellation */
    const double half = -0.5 * (b + (b >= 0.0 ? sqrt(discriminant) : -sqrt(discriminant)));
    const double x1 = a != 0.0 ? half / a : -1.0, x2 = half != 0.0 ? c / half : -1.0;
    const int in1 = x1 > 0.0 && x1 < 1.0, in2 = x2 > 0.0 && x2 < 1.0;
    if (in1 && in2) return s * (x1 < x2 ? x1 : x2);
    return in1 ? s * x1 : in2 ? s * x2 : -1.0;
}

/* The excess of one contact after a step of size s; NAN if that step fails. */
static inline double excess_after(const Model *m, const int *active, const Point *from, double offset, double s, int contact)
{
    Point x;
    ContactView view;
    if (runge_kutta(m, active, from, offset, s, &x) != STEP_OK) return NAN;
    look_at_contacts(m, active, &x, &view);
    return view.excess[contact];
}

/* Root of the excess in [low, high], at whose ends it is <= 0 and > 0: regula falsi, Illinois variant, with bisection
 * whenever that does not halve the bracket. */
static inline double locate(const Model *m, const int *active, const Point *from, double offset, double low, double high,
    double at_low, double at_high, int contact)
{
    const double enough = 1e-3 * HYSTERESIS * CONTACT_NOMINALS[contact];
    const double width = 4e-16 * high;
    for (int n = 0; n < LOCATION_ITERATIONS && high - low > width; n++) {
        double middle = low + (high - low) * at_low / (at_low - at_high);
        if (n % 3 == 2 || !(middle > low && middle < high)) middle = 0.5 * (low + high);
        const double value = excess_after(m, active, from, offset, middle, contact);
        if (!(fabs(value) > enough)) return middle;
        if (value > 0.0) {
            high = middle;
            at_high = value;
            at_low *= 0.5;
        } else {
            low = middle;
            at_low = value;
            at_high *= 0.5;
        }
    }
    return high;
}

/* When within a step of size s a contact leaves its mode; a negative number if it does not. Also finds a contact that closes
 * and opens again (or the other way round) within the step. */
static inline double crossing(const Model *m, const int *active, const Point *from, double offset, double s, const ContactView *start,
    const ContactView *end, int contact)
{
    const double band = HYSTERESIS * CONTACT_NOMINALS[contact];
    const double e0 = start->excess[contact], r0 = start->rate[contact], e1 = end->excess[contact], r1 = end->rate[contact];
    double low = 0.0, high = s, at_low = e0, at_high = e1;
    if (e0 > band) return 0.0; /* as after a step that was finished with the true law */
    if (e1 <= band) {
        if (!(r0 > 0.0 && r1 < 0.0)) return -1.0;
        high = cubic_extremum(e0, r0, e1, r1, s);
        if (high <= 0.0) return -1.0;
        at_high = excess_after(m, active, from, offset, high, contact);
        if (!(at_high > band)) return -1.0;
    }
    if (e0 > -band) {
        /* It starts at its boundary: either it leaves at once, or it enters first and leaves later. */
        if (r0 >= 0.0) return 0.0;
        low = cubic_extremum(e0, r0, e1, r1, s);
        if (low <= 0.0) return 0.0;
        at_low = excess_after(m, active, from, offset, low, contact);
        if (!(at_low < 0.0)) return 0.0;
    }
    return locate(m, active, from, offset, low, high, at_low, at_high, contact);
}

/* One internal step, divided where contacts change their modes. x and active are brought to its end. */
static inline StepResult internal_step(const Model *m, int *active, Point *x, double offset, double s)
{
    double done = 0.0;
    for (int events = 0;; events++) {
        const double rest = s - done;
        const int locating = events < EVENTS_PER_STEP;
        Point end;
        StepResult result = runge_kutta(m, locating ? active : NULL, x, offset + done, rest, &end);
        if (result != STEP_OK) return result;
        int contact = -1;
        double first = rest;
        if (NC > 0 && locating) {
            ContactView before, after;
            look_at_contacts(m, active, x, &before);
            look_at_contacts(m, active, &end, &after);
            for (int i = 0; i < NC; i++) {
                const double when = crossing(m, active, x, offset + done, rest, &before, &after, i);
                if (when >= 0.0 && (contact < 0 || when < first)) {
                    contact = i;
                    first = when;
                }
            }
        }
        if (contact < 0) {
            *x = end;
            return STEP_OK;
        }
        if (first > 0.0) {
            result = runge_kutta(m, active, x, offset + done, first, &end);
            if (result != STEP_OK) return result;
            *x = end;
        }
        active[contact] = !active[contact];
        done += first;
        if (!(done < s)) return STEP_OK;
    }
}

/* Integrate over a communication step dt in `count` equal internal steps; on failure the Model is left as it was. */
static inline StepResult model_step(Model *m, double dt, long count)
{
    Point x;
    int active[ROOM(NC)];
    model_update_modes(m);
    memcpy(x.q, m->q, sizeof x.q);
    memcpy(x.v, m->v, sizeof x.v);
    memcpy(active, m->active, sizeof active);
    for (long n = 0; n < count; n++) {
        const double begin = dt * (double)n / (double)count, finish = dt * (double)(n + 1) / (double)count;
        const StepResult result = internal_step(m, active, &x, begin, finish - begin);
        if (result != STEP_OK) return result;
    }
    memcpy(m->q, x.q, sizeof x.q);
    memcpy(m->v, x.v, sizeof x.v);
    memcpy(m->active, active, sizeof active);
    inputs_at(m, dt, m->u);
    memset(m->u_rate, 0, sizeof m->u_rate);
    m->evaluated = 0;
    return STEP_OK;
}

#endif
