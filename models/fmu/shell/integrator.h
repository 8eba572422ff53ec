/* Fixed-step integration of a Model. Runge-Kutta methods keep their order through contact and
 * friction, because steps are divided at located mode changes (a contact closes or opens, a
 * friction sticks or slips). The Euler methods are the plain ones under the true contact law;
 * semi-implicit Euler is the time step of the plans.
 *
 * Within a located step the modes are frozen and forces continue smoothly beyond their
 * boundaries. */
#ifndef INTEGRATOR_H
#define INTEGRATOR_H

#include "equations.h" /* and StepResult and Observer of stepping.h */

/* Return the failure as a clause. */
static inline const char *step_trouble(const Model *m, StepResult result)
{
    (void)m;
    return result == STEP_MASS ? "the mass matrix lost its definiteness" : "a state became infinite or not a number (internal_step too large?)";
}

/* Located mode changes per internal step; a step with more is finished with the true law. */
#define EVENTS_PER_STEP (8 * ROOM(NL) + 8)

/* Iterations of a location; each at least halves the bracket, and a double has 53 bits. */
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

/* One Runge-Kutta step in which every stage starts from the rates of the previous stage. */
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

static inline StepResult runge_kutta(const Model *m, const Law *law, const Point *from, const Inputs *inputs, double offset, double s, Point *to)
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
        if (model_acceleration(m, q, v, u, law, rate_v)) return STEP_MASS;
        for (int i = 0; i < NQ; i++) {
            rate_q[i] = v[i];
            sum.q[i] += part * rate_q[i];
            sum.v[i] += part * rate_v[i];
        }
    }
    *to = sum;
    return finite_point(to);
}

/* Update the velocities, then the positions with the new velocities. */
static inline StepResult semi_implicit_euler(const Model *m, const Law *law, const Point *from, const Inputs *inputs, double offset, double s, Point *to)
{
    double u[ROOM(NU)], a[NQ];
    Point x = *from;
    inputs_at(inputs, offset, u);
    if (model_acceleration(m, x.q, x.v, u, law, a)) return STEP_MASS;
    for (int i = 0; i < NQ; i++) {
        x.v[i] += s * a[i];
        x.q[i] += s * x.v[i];
    }
    *to = x;
    return finite_point(to);
}

/* Step by s from `from`, at `offset` within the internal step. modes NULL: the true law, with
 * friction that sticks or slips over the whole step (friction.h). */
static inline StepResult advance(const Model *m, const int *modes, const Point *from, const Inputs *inputs, double offset, double s, Point *to)
{
    Law law = {modes, NULL};
#if NF > 0
    double lam[NL];
    if (!modes) {
        double phi[ROOM(NC)], k[ROOM(NC)], u[ROOM(NU)];
        scene_penetration(from->q, m->p, phi);
        scene_stiffness(m->p, k);
        contact_forces(phi, k, NULL, lam);
        DAMPED(damped_forces(m, from->q, from->v, phi, NULL, lam);)
        inputs_at(inputs, offset, u);
        if (friction_forces(0, 0.0, s, m->p, from->q, from->v, u, lam)) return STEP_MASS;
        law.friction = lam + NC;
    }
#endif
    return (m->integrator == SEMI_IMPLICIT_EULER ? semi_implicit_euler : runge_kutta)(m, &law, from, inputs, offset, s, to);
}

/* For each contact and friction: excess beyond its mode (negative: inside), its rate (NAN if
 * unknown: a sticking force), and its zero. */
typedef struct {
    double excess[ROOM(NL)], rate[ROOM(NL)], band[ROOM(NL)];
} View;

/* Evaluate at x, `offset` within the internal step; return 1 if the mass matrix is not positive
 * definite. */
static inline int look(const Model *m, const int *modes, const Point *x, const Inputs *inputs, double offset, View *view)
{
    scene_penetration(x->q, m->p, view->excess);
    scene_penetration_jvp(x->q, m->p, x->v, view->rate);
#if NF > 0
    double u[ROOM(NU)], k[ROOM(NC)], lam[NL], a[NQ], reserve[NF], limit[NF], rate[NF];
    const Law law = {modes, NULL};
    inputs_at(inputs, offset, u);
    scene_stiffness(m->p, k);
    if (model_forces(m, x->q, x->v, u, &law, view->excess, k, lam) || scene_acceleration(x->q, x->v, u, lam, m->p, a)) return 1;
    friction_reserves(m, x->q, x->v, lam, modes + NC, reserve);
    scene_friction_limit(x->q, lam, m->p, limit);
    scene_slip_rate(x->q, x->v, a, m->p, rate);
    for (int j = 0; j < NF; j++) {
        const int mode = modes[NC + j];
        view->excess[NC + j] = -reserve[j];
        view->rate[NC + j] = mode ? -mode * rate[j] / scene_friction_nominals[j] : NAN;
        view->band[NC + j] = reserve_band(j, mode, limit[j]);
    }
#else
    (void)inputs, (void)offset;
#endif
    DAMPED(double now[ROOM(NU)]; inputs_at(inputs, offset, now);)
    DAMPED(if (look_at_pressing(m, modes, x->q, x->v, now, view->excess, view->rate, view->band)) return 1;)
    for (int i = 0; i < NC; i++) {
        view->band[i] = HYSTERESIS * CONTACT_NOMINALS[i];
        if (!modes[i]) continue;
        view->excess[i] = -view->excess[i];
        view->rate[i] = -view->rate[i];
    }
    return 0;
}

/* Return the extremum after 0 of the cubic through (0, e0), (s, e1) with slopes r0, r1, or a
 * negative number if there is none in (0, s). */
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

/* A contact or friction that is watched through a step from `from`. */
typedef struct {
    const Model *m;
    const int *modes;
    const Point *from;
    const Inputs *inputs;
    double offset;
    int which;
} Watch;

/* Return its excess after a step of size s, NAN if the step fails. */
static inline double excess_after(const Watch *watch, double s)
{
    Point x;
    View view;
    if (advance(watch->m, watch->modes, watch->from, watch->inputs, watch->offset, s, &x) != STEP_OK) return NAN;
    if (look(watch->m, watch->modes, &x, watch->inputs, watch->offset + s, &view)) return NAN;
    return view.excess[watch->which];
}

/* Return the root of the excess in [low, high], with values <= 0 and > 0 at the ends: regula
 * falsi (Illinois) with bisection if the bracket is not halved. beyond: on the far side of the
 * root. */
static inline double locate(const Watch *watch, double low, double high, double at_low, double at_high, double enough, int beyond)
{
    const double width = 4e-16 * high;
    for (int n = 0; n < LOCATION_ITERATIONS && high - low > width; n++) {
        double middle = low + (high - low) * at_low / (at_low - at_high);
        if (n % 3 == 2 || !(middle > low && middle < high)) middle = 0.5 * (low + high);
        const double value = excess_after(watch, middle);
        if (!(fabs(value) > enough) && !(beyond && value <= 0.0)) return middle;
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

/* Return when a contact or friction leaves its mode within a step of size s, else a negative
 * number. With a known rate this includes one that leaves and returns. */
static inline double crossing(const Watch *watch, double s, const View *start, const View *end)
{
    const int i = watch->which;
    const double band = fmin(start->band[i], end->band[i]), enough = 1e-3 * band;
    const double e0 = start->excess[i], r0 = start->rate[i], e1 = end->excess[i], r1 = end->rate[i];
    double low = 0.0, high = s, at_low = e0, at_high = e1;
    if (e0 > band) return 0.0; /* after a step finished with the true law */
    if (e1 <= band) {
        if (!(r0 > 0.0 && r1 < 0.0)) return -1.0;
        high = cubic_extremum(e0, r0, e1, r1, s);
        if (high <= 0.0) return -1.0;
        at_high = excess_after(watch, high);
        if (!(at_high > band)) return -1.0;
    }
    if (isnan(r0)) return locate(watch, low, high, fmin(at_low, -enough), at_high, enough, 1);
    if (e0 > -band) {
        /* A start at the boundary leaves at once, or enters first and leaves later. */
        if (r0 >= 0.0) return 0.0;
        low = cubic_extremum(e0, r0, e1, r1, s);
        if (low <= 0.0) return 0.0;
        at_low = excess_after(watch, low);
        if (!(at_low < 0.0)) return 0.0;
    }
    return locate(watch, low, high, at_low, at_high, enough, 0);
}

/* Return whether event mode would change a mode at x. */
static inline int modes_change(const Model *m, const int *modes, const Point *x, const double *u)
{
    int changed[ROOM(NL)];
    memcpy(changed, modes, sizeof changed);
    return update_modes(m, x->q, x->v, u, changed) > 0;
}

/* One internal step of an Euler method without event location; a changed mode is an event at its
 * end. */
static inline StepResult plain_step(const Model *m, int *modes, Point *x, const Inputs *inputs, double s, int stopping)
{
    const StepResult result = advance(m, NULL, x, inputs, 0.0, s, x);
    if (result != STEP_OK) return result;
    double u[ROOM(NU)];
    inputs_at(inputs, s, u);
    if (stopping && modes_change(m, modes, x, u)) return STEP_EVENT;
    update_modes(m, x->q, x->v, u, modes);
    return STEP_OK;
}

/* Switch the mode of a contact or friction that leaves its own at x. */
static inline void leave_mode(const Model *m, int *modes, const Point *x, const double *u, int which)
{
    if (which < NC) modes[which] = !modes[which];
    DAMPED(if (which >= PRESSING) modes[which] = !modes[which]; else decide_pressing(m, x->q, x->v, u, modes);)
#if NF > 0
    double phi[ROOM(NC)], k[ROOM(NC)], lam[NL];
    scene_penetration(x->q, m->p, phi);
    scene_stiffness(m->p, k);
    contact_forces(phi, k, modes, lam);
    DAMPED(damped_forces(m, x->q, x->v, phi, modes, lam);)
    decide_friction(m, x->q, x->v, u, modes + NC, lam);
#else
    (void)m, (void)x, (void)u;
#endif
}

/* One internal step of size *s, divided at mode changes; x and modes are advanced to its end.
 * With `stopping` the first change ends it: *s becomes the elapsed seconds, and event mode
 * changes the modes. */
static inline StepResult internal_step(const Model *m, int *modes, Point *x, const Inputs *inputs, double *s, int stopping)
{
    if (m->integrator == EXPLICIT_EULER || m->integrator == SEMI_IMPLICIT_EULER) return plain_step(m, modes, x, inputs, *s, stopping);
    double done = 0.0;
    for (int events = 0;; events++) {
        const double rest = *s - done;
        const int locating = events < EVENTS_PER_STEP;
        Point end;
        StepResult result = advance(m, locating ? modes : NULL, x, inputs, done, rest, &end);
        if (result != STEP_OK) return result;
        int which = -1;
        double first = rest, u[ROOM(NU)];
        if (NL > 0 && locating) {
            View before, after;
            if (look(m, modes, x, inputs, done, &before) || look(m, modes, &end, inputs, done + rest, &after)) return STEP_MASS;
            for (int i = 0; i < NL; i++) {
                const Watch watch = {m, modes, x, inputs, done, i};
                const double when = crossing(&watch, rest, &before, &after);
                if (when >= 0.0 && (which < 0 || when < first)) {
                    which = i;
                    first = when;
                }
            }
        }
        if (which < 0) {
            *x = end;
            return STEP_OK;
        }
        if (first > 0.0) {
            result = advance(m, modes, x, inputs, done, first, &end);
            if (result != STEP_OK) return result;
            *x = end;
        }
        done += first;
        inputs_at(inputs, done, u);
        if (stopping && modes_change(m, modes, x, u)) {
            *s = done;
            return STEP_EVENT;
        }
        leave_mode(m, modes, x, u, which);
        if (!(done < *s)) return STEP_OK;
    }
}

/* Prepare the inputs from `begin` to `finish` seconds after the communication point: constant,
 * along their rates, or the parabola through the importer's values at beginning, middle and end. */
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

/* Integrate over a communication step *dt from `time` in `count` equal internal steps. *dt
 * becomes the elapsed seconds, fewer if the observer ends the step, or if `stopping`
 * (STEP_EVENT) at a changing contact. A failure leaves the Model unchanged. */
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
        result = internal_step(m, m->modes, &x, &inputs, &s, stopping);
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
