/* Fixed-step integration of a Model. The Runge-Kutta methods keep their order through contact because the instant at which
 * a contact closes or opens is located and the step is divided there; the two Euler methods are the plain textbook ones under
 * the true contact law, semi-implicit Euler being the time step of the plans.
 *
 * Within a located step the contact modes are frozen and the force continues smoothly beyond its boundary, so each part of a
 * divided step is a smooth problem.
 */
#ifndef INTEGRATOR_H
#define INTEGRATOR_H

#include "equations.h"

typedef enum { STEP_OK, STEP_EVENT, STEP_MASS, STEP_NOT_FINITE } StepResult;

/* Mode changes that are located within one internal step; a step with more is finished with the true law instead. */
#define EVENTS_PER_STEP (8 * ROOM(NC) + 8)

/* Iterations of one location; each halves the bracket at worst, and a double has 53 bits. */
#define LOCATION_ITERATIONS 80

/* Inputs during one internal step: polynomials in the seconds since its beginning. */
typedef struct {
    double value[ROOM(NU)], slope[ROOM(NU)], curvature[ROOM(NU)];
} Inputs;

static inline void inputs_at(const Inputs *inputs, double offset, double *u)
{
    for (int i = 0; i < NU; i++) u[i] = inputs->value[i] + offset * (inputs->slope[i] + offset * inputs->curvature[i]);
}

static inline StepResult finite_point(const Point *x)
{
    for (int i = 0; i < NQ; i++)
        if (!isfinite(x->q[i]) || !isfinite(x->v[i])) return STEP_NOT_FINITE;
    return STEP_OK;
}

/* One Runge-Kutta step whose every stage starts from the rates of the stage before it. */
typedef struct {
    int stages;
    double at[4], weight[4];
} Tableau;

static inline const Tableau *tableau(int integrator)
{
    static const Tableau euler = {1, {0.0}, {1.0}}, heun = {2, {0.0, 1.0}, {0.5, 0.5}},
                         classical = {4, {0.0, 0.5, 0.5, 1.0}, {1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0}};
    return integrator == EXPLICIT_EULER ? &euler : integrator == HEUN ? &heun : &classical;
}

static inline StepResult runge_kutta(const Model *m, const int *active, const Point *from, const Inputs *inputs, double offset, double s, Point *to)
{
    const Tableau *method = tableau(m->integrator);
    double u[ROOM(NU)], q[NQ], v[NQ], rate_q[NQ], rate_v[NQ];
    Point sum = *from;
    memset(rate_q, 0, sizeof rate_q);
    memset(rate_v, 0, sizeof rate_v);
    for (int stage = 0; stage < method->stages; stage++) {
        const double ahead = method->at[stage] * s, part = s * method->weight[stage];
        for (int i = 0; i < NQ; i++) {
            q[i] = from->q[i] + ahead * rate_q[i];
            v[i] = from->v[i] + ahead * rate_v[i];
        }
        inputs_at(inputs, offset + ahead, u);
        if (model_acceleration(m, q, v, u, active, rate_v)) return STEP_MASS;
        for (int i = 0; i < NQ; i++) {
            rate_q[i] = v[i];
            sum.q[i] += part * rate_q[i];
            sum.v[i] += part * rate_v[i];
        }
    }
    *to = sum;
    return finite_point(to);
}

/* First the velocities, then the positions with the new velocities. */
static inline StepResult semi_implicit_euler(const Model *m, const int *active, const Point *from, const Inputs *inputs, double offset, double s, Point *to)
{
    double u[ROOM(NU)], a[NQ];
    Point x = *from;
    inputs_at(inputs, offset, u);
    if (model_acceleration(m, x.q, x.v, u, active, a)) return STEP_MASS;
    for (int i = 0; i < NQ; i++) {
        x.v[i] += s * a[i];
        x.q[i] += s * x.v[i];
    }
    *to = x;
    return finite_point(to);
}

/* A step of size s from `from`, which lies `offset` after the beginning of the internal step. active: modes, or NULL for the
 * true law. */
static inline StepResult advance(const Model *m, const int *active, const Point *from, const Inputs *inputs, double offset, double s, Point *to)
{
    return (m->integrator == SEMI_IMPLICIT_EULER ? semi_implicit_euler : runge_kutta)(m, active, from, inputs, offset, s, to);
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
static inline double excess_after(const Model *m, const int *active, const Point *from, const Inputs *inputs, double offset, double s, int contact)
{
    Point x;
    ContactView view;
    if (advance(m, active, from, inputs, offset, s, &x) != STEP_OK) return NAN;
    look_at_contacts(m, active, &x, &view);
    return view.excess[contact];
}

/* Root of the excess in [low, high], at whose ends it is <= 0 and > 0: regula falsi, Illinois variant, with bisection
 * whenever that does not halve the bracket. */
static inline double locate(const Model *m, const int *active, const Point *from, const Inputs *inputs, double offset, double low, double high,
    double at_low, double at_high, int contact)
{
    const double enough = 1e-3 * HYSTERESIS * CONTACT_NOMINALS[contact];
    const double width = 4e-16 * high;
    for (int n = 0; n < LOCATION_ITERATIONS && high - low > width; n++) {
        double middle = low + (high - low) * at_low / (at_low - at_high);
        if (n % 3 == 2 || !(middle > low && middle < high)) middle = 0.5 * (low + high);
        const double value = excess_after(m, active, from, inputs, offset, middle, contact);
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
static inline double crossing(const Model *m, const int *active, const Point *from, const Inputs *inputs, double offset, double s,
    const ContactView *start, const ContactView *end, int contact)
{
    const double band = HYSTERESIS * CONTACT_NOMINALS[contact];
    const double e0 = start->excess[contact], r0 = start->rate[contact], e1 = end->excess[contact], r1 = end->rate[contact];
    double low = 0.0, high = s, at_low = e0, at_high = e1;
    if (e0 > band) return 0.0; /* as after a step that was finished with the true law */
    if (e1 <= band) {
        if (!(r0 > 0.0 && r1 < 0.0)) return -1.0;
        high = cubic_extremum(e0, r0, e1, r1, s);
        if (high <= 0.0) return -1.0;
        at_high = excess_after(m, active, from, inputs, offset, high, contact);
        if (!(at_high > band)) return -1.0;
    }
    if (e0 > -band) {
        /* It starts at its boundary: either it leaves at once, or it enters first and leaves later. */
        if (r0 >= 0.0) return 0.0;
        low = cubic_extremum(e0, r0, e1, r1, s);
        if (low <= 0.0) return 0.0;
        at_low = excess_after(m, active, from, inputs, offset, low, contact);
        if (!(at_low < 0.0)) return 0.0;
    }
    return locate(m, active, from, inputs, offset, low, high, at_low, at_high, contact);
}

/* Whether event mode would change the mode of one contact at x. */
static inline int contact_changes(const Model *m, const int *active, const Point *x, int contact)
{
    double phi[ROOM(NC)], rate[ROOM(NC)];
    scene_penetration(x->q, m->p, phi);
    scene_penetration_jvp(x->q, m->p, x->v, rate);
    return contact_mode(contact, phi[contact], rate[contact], active[contact]) != active[contact];
}

/* One internal step of an Euler method: nothing is located, and a changed contact is an event at its end. */
static inline StepResult plain_step(const Model *m, int *active, Point *x, const Inputs *inputs, double s, int stopping)
{
    const StepResult result = advance(m, NULL, x, inputs, 0.0, s, x);
    if (result != STEP_OK) return result;
    int modes[ROOM(NC)];
    memcpy(modes, active, sizeof modes);
    if (!update_modes(m, x->q, x->v, modes)) return STEP_OK;
    if (stopping) return STEP_EVENT;
    memcpy(active, modes, sizeof modes);
    return STEP_OK;
}

/* One internal step of size *s, divided where contacts change their modes. x and active are brought to its end. If `stopping`,
 * the first change ends it: *s becomes the seconds done, and the modes are left for event mode to change. */
static inline StepResult internal_step(const Model *m, int *active, Point *x, const Inputs *inputs, double *s, int stopping)
{
    if (m->integrator == EXPLICIT_EULER || m->integrator == SEMI_IMPLICIT_EULER) return plain_step(m, active, x, inputs, *s, stopping);
    double done = 0.0;
    for (int events = 0;; events++) {
        const double rest = *s - done;
        const int locating = events < EVENTS_PER_STEP;
        Point end;
        StepResult result = advance(m, locating ? active : NULL, x, inputs, done, rest, &end);
        if (result != STEP_OK) return result;
        int contact = -1;
        double first = rest;
        if (NC > 0 && locating) {
            ContactView before, after;
            look_at_contacts(m, active, x, &before);
            look_at_contacts(m, active, &end, &after);
            for (int i = 0; i < NC; i++) {
                const double when = crossing(m, active, x, inputs, done, rest, &before, &after, i);
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
            result = advance(m, active, x, inputs, done, first, &end);
            if (result != STEP_OK) return result;
            *x = end;
        }
        done += first;
        if (stopping && contact_changes(m, active, x, contact)) {
            *s = done;
            return STEP_EVENT;
        }
        active[contact] = !active[contact];
        if (!(done < *s)) return STEP_OK;
    }
}

/* What the importer may do within a communication step; both functions may be NULL. Offsets are seconds after its beginning. */
typedef struct {
    void *context;
    void (*set_inputs)(void *context, double offset);                    /* may change the Model's u */
    void (*step_finished)(void *context, double offset, double *finish); /* the Model is at `offset`; may shorten the step to *finish */
} Observer;

/* Inputs from `begin` to `finish` seconds after the communication point: held, or along their rates, or the parabola through
 * what the importer sets at the beginning, the middle and the end. */
static inline void prepare_inputs(Model *m, const Observer *observer, double begin, double finish, Inputs *inputs)
{
    memset(inputs, 0, sizeof *inputs);
    for (int i = 0; i < NU; i++) {
        inputs->value[i] = m->u[i] + m->u_rate[i] * begin;
        inputs->slope[i] = m->u_rate[i];
    }
    if (NU == 0 || !observer->set_inputs) return;
    double middle[ROOM(NU)];
    const double s = finish - begin;
    observer->set_inputs(observer->context, begin + 0.5 * s);
    memcpy(middle, m->u, sizeof middle);
    observer->set_inputs(observer->context, finish);
    for (int i = 0; i < NU; i++) {
        const double first = middle[i] - inputs->value[i], second = m->u[i] - middle[i];
        inputs->slope[i] = (3.0 * first - second) / s;
        inputs->curvature[i] = 2.0 * (second - first) / (s * s);
    }
}

/* Integrate over a communication step *dt from `time` in `count` equal internal steps. *dt becomes the seconds done, fewer if
 * the observer ended the step or (STEP_EVENT) if `stopping` at a contact that changes. On failure the Model is left as it was. */
static inline StepResult model_step(Model *m, double time, double *dt, long count, int stopping, const Observer *observer)
{
    Model before;
    memcpy(&before, m, sizeof before);
    Point x;
    double finish = *dt;
    StepResult result = STEP_OK;
    if (!m->frozen) model_update_modes(m);
    memcpy(x.q, m->q, sizeof x.q);
    memcpy(x.v, m->v, sizeof x.v);
    for (long n = 0; n < count && result == STEP_OK; n++) {
        const double begin = *dt * (double)n / (double)count;
        double end = *dt * (double)(n + 1) / (double)count, s;
        if (begin >= finish) break;
        if (end > finish) end = finish;
        Inputs inputs;
        prepare_inputs(m, observer, begin, end, &inputs);
        s = end - begin;
        result = internal_step(m, m->active, &x, &inputs, &s, stopping);
        if (result == STEP_MASS || result == STEP_NOT_FINITE) {
            memcpy(m, &before, sizeof before);
            return result;
        }
        if (result == STEP_EVENT) {
            finish = end = begin + s;
            if (observer->set_inputs) inputs_at(&inputs, s, m->u);
        }
        if (!observer->step_finished) continue;
        memcpy(m->q, x.q, sizeof x.q);
        memcpy(m->v, x.v, sizeof x.v);
        m->time = time + end;
        m->evaluated = 0;
        observer->step_finished(observer->context, end, &finish);
    }
    memcpy(m->q, x.q, sizeof x.q);
    memcpy(m->v, x.v, sizeof x.v);
    for (int i = 0; i < NU; i++) m->u[i] += m->u_rate[i] * finish;
    memset(m->u_rate, 0, sizeof m->u_rate);
    m->evaluated = 0;
    m->time = time + finish;
    *dt = finish;
    return result;
}

#endif
