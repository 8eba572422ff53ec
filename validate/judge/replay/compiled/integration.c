/* A Model Exchange FMU and CVODE: from point to point of the record, until an event; the loop of validate/judge/replay/reference.py.
 *
 * CVODE is the library that scikit-sundae brings, by the addresses of its functions (SUNDIALS 7). */
#include <string.h>

#include "fmu_calls.h"

/* In the order of integration.SOLVER. */
enum solver_call {
    CONTEXT_CREATE, CONTEXT_CLEAR_HANDLERS, CONTEXT_FREE, VECTOR_NEW, VECTOR_DATA, VECTOR_DESTROY, MATRIX_DENSE, MATRIX_DESTROY, LINEAR_DENSE,
    LINEAR_FREE, CREATE, FREE, INIT, REINIT, TOLERANCES, SET_USER_DATA, SET_LINEAR, SET_NONLINEAR_ITERATIONS, SET_FAILURES, ROOT_INIT,
    SET_ROOT_DIRECTION, SET_FIRST_STEP, SET_MIN_STEP, SET_MAX_STEP, SET_MAX_ORDER, SET_MAX_STEPS, SET_STOP, CLEAR_STOP, ADVANCE, GET_ROOTS,
    SOLVER_CALLS
};
enum { ADAMS = 1, NORMAL = 1, ONE_STEP = 2, STOP_RETURN = 1, ROOT_RETURN = 2, MAX_ORDER = 12, NONLINEAR_ITERATIONS = 3, FAILURES = 10 };
/* Rounds of event iteration before an FMU is given up as never settling. */
enum { EVENT_ROUNDS = 100 };

/* Filled by validate/judge/replay/reference.py, field by field in this order. y: states, then what is accumulated. */
struct integration {
    struct fmu fmu;
    function solver[SOLVER_CALLS];
    double rtol, min_step, max_step;
    int64_t max_steps, wants_steps, linear;
    const double *absolute; /* (states + rates) tolerances */
    const double *bound;    /* (states) */
    int32_t *roots;         /* (indicators) of the last event; before, all zero: any direction */
    /* The step of the plan that is in progress. */
    double begin;
    double *values, *slopes, *applied; /* (inputs) */
    /* Where the integration is. */
    double time, next_event;
    double *y;
    /* What came of it. */
    int64_t flag, reached; /* CVODE's answer; points recorded */
    double fault_time;
    int64_t fault; /* a reason, of a function that CVODE called */
    void *context, *memory, *vector, *tolerances, *matrix, *linear_solver;
};

struct fmi2_event_info {
    int needs_update, ends, nominals_changed, states_changed, has_next;
    double next;
};

static double *data_of(struct integration *run, void *vector) { return ((double *(*)(void *))run->solver[VECTOR_DATA])(vector); }

static int held_inputs(struct integration *run, double time)
{
    struct fmu *fmu = &run->fmu;
    for (int64_t i = 0; i < fmu->inputs; i++) run->applied[i] = run->values[i] + run->slopes[i] * (time - run->begin);
    return write_values(fmu, fmu->input_references, fmu->inputs, run->applied);
}

/* CVRhsFn: negative, and run->fault says why. */
static int rates(double time, void *y, void *yp, void *data)
{
    struct integration *run = data;
    struct fmu *fmu = &run->fmu;
    double *rate = data_of(run, yp), sum = 0.0;
    run->fault = CALL_REFUSED;
    if (run->linear && held_inputs(run, time)) return -1;
    if (move(fmu, time, data_of(run, y)) || fill(fmu, GET_DERIVATIVES, rate, fmu->states)) return -1;
    if (read_values(fmu, fmu->rate_references, fmu->rates, rate + fmu->states)) return -1;
    for (int64_t i = 0; i < fmu->states + fmu->rates; i++) sum += rate[i];
    run->fault = isfinite(sum) ? DONE : RATE_NOT_FINITE;
    run->fault_time = time;
    return run->fault == DONE ? 0 : -1;
}

/* CVRootFn. */
static int indicators(double time, void *y, double *values, void *data)
{
    struct integration *run = data;
    run->fault = CALL_REFUSED;
    if (move(&run->fmu, time, data_of(run, y)) || fill(&run->fmu, GET_INDICATORS, values, run->fmu.indicators)) return -1;
    run->fault = DONE;
    return 0;
}

EXPORT void integration_close(struct integration *run)
{
    if (run->memory) ((void (*)(void **))run->solver[FREE])(&run->memory);
    if (run->linear_solver) ((int (*)(void *))run->solver[LINEAR_FREE])(run->linear_solver);
    if (run->matrix) ((void (*)(void *))run->solver[MATRIX_DESTROY])(run->matrix);
    if (run->tolerances) ((void (*)(void *))run->solver[VECTOR_DESTROY])(run->tolerances);
    if (run->vector) ((void (*)(void *))run->solver[VECTOR_DESTROY])(run->vector);
    if (run->context) ((int (*)(void **))run->solver[CONTEXT_FREE])(&run->context);
    run->memory = run->linear_solver = run->matrix = run->tolerances = run->vector = run->context = NULL;
}

static int set_number(struct integration *run, enum solver_call call, double value)
{
    return ((int (*)(void *, double))run->solver[call])(run->memory, value) < 0;
}

static int set_count(struct integration *run, enum solver_call call, int value)
{
    return ((int (*)(void *, int))run->solver[call])(run->memory, value) < 0;
}

/* A new solver at (run->time, run->y), as scikit-sundae's CVODE(method="Adams") makes one. */
EXPORT int64_t integration_renew(struct integration *run)
{
    struct fmu *fmu = &run->fmu;
    int64_t n = fmu->states + fmu->rates;
    function *solver = run->solver;
    integration_close(run);
    if (((int (*)(int, void **))solver[CONTEXT_CREATE])(0, &run->context) < 0) return SETUP_REFUSED;
    ((int (*)(void *))solver[CONTEXT_CLEAR_HANDLERS])(run->context);
    run->vector = ((void *(*)(int64_t, void *))solver[VECTOR_NEW])(n, run->context);
    run->tolerances = ((void *(*)(int64_t, void *))solver[VECTOR_NEW])(n, run->context);
    run->memory = ((void *(*)(int, void *))solver[CREATE])(ADAMS, run->context);
    if (!run->vector || !run->tolerances || !run->memory) return SETUP_REFUSED;
    memcpy(data_of(run, run->vector), run->y, (size_t)n * sizeof(double));
    memcpy(data_of(run, run->tolerances), run->absolute, (size_t)n * sizeof(double));
    if (((int (*)(void *, void *))solver[SET_USER_DATA])(run->memory, run) < 0) return SETUP_REFUSED;
    if (((int (*)(void *, int (*)(double, void *, void *, void *), double, void *))solver[INIT])(run->memory, rates, run->time, run->vector) < 0)
        return SETUP_REFUSED;
    if (((int (*)(void *, double, void *))solver[TOLERANCES])(run->memory, run->rtol, run->tolerances) < 0) return SETUP_REFUSED;
    run->matrix = ((void *(*)(int64_t, int64_t, void *))solver[MATRIX_DENSE])(n, n, run->context);
    if (!run->matrix) return SETUP_REFUSED;
    run->linear_solver = ((void *(*)(void *, void *, void *))solver[LINEAR_DENSE])(run->vector, run->matrix, run->context);
    if (!run->linear_solver) return SETUP_REFUSED;
    if (((int (*)(void *, void *, void *))solver[SET_LINEAR])(run->memory, run->linear_solver, run->matrix) < 0) return SETUP_REFUSED;
    if (set_count(run, SET_NONLINEAR_ITERATIONS, NONLINEAR_ITERATIONS) || set_count(run, SET_FAILURES, FAILURES)) return SETUP_REFUSED;
    if (fmu->indicators) {
        memset(run->roots, 0, (size_t)fmu->indicators * sizeof *run->roots);
        if (((int (*)(void *, int, int (*)(double, void *, double *, void *)))solver[ROOT_INIT])(run->memory, (int)fmu->indicators, indicators) < 0
            || ((int (*)(void *, int32_t *))solver[SET_ROOT_DIRECTION])(run->memory, run->roots) < 0)
            return SETUP_REFUSED;
    }
    if (set_number(run, SET_FIRST_STEP, 0.0) || set_number(run, SET_MIN_STEP, run->min_step) || set_number(run, SET_MAX_STEP, run->max_step)
        || set_count(run, SET_MAX_ORDER, MAX_ORDER)
        || ((int (*)(void *, long))solver[SET_MAX_STEPS])(run->memory, (long)run->max_steps) < 0)
        return SETUP_REFUSED;
    return DONE;
}

/* The same solver afresh from (run->time, run->y). */
EXPORT int64_t integration_restart(struct integration *run)
{
    memcpy(data_of(run, run->vector), run->y, (size_t)(run->fmu.states + run->fmu.rates) * sizeof(double));
    return ((int (*)(void *, double, void *))run->solver[REINIT])(run->memory, run->time, run->vector) < 0 ? SETUP_REFUSED : DONE;
}

/* Iterate events until the FMU is content, then back to continuous time. */
static enum reason settle(struct integration *run, bool *changed)
{
    struct fmu *fmu = &run->fmu;
    for (int round = 0; round < EVENT_ROUNDS; round++) {
        struct fmi2_event_info info = {0, 0, 0, 0, 0, 0.0};
        int status;
        if (fmu->three) {
            bool again = false, ends = false, nominals = false, states = false, has_next = false;
            status = ((int (*)(void *, bool *, bool *, bool *, bool *, bool *, double *))fmu->call[UPDATE_DISCRETE])(
                fmu->component, &again, &ends, &nominals, &states, &has_next, &info.next);
            info.needs_update = again, info.ends = ends, info.states_changed = states, info.has_next = has_next;
        } else {
            status = ((int (*)(void *, struct fmi2_event_info *))fmu->call[UPDATE_DISCRETE])(fmu->component, &info);
        }
        if (refused(fmu, UPDATE_DISCRETE, status)) return CALL_REFUSED;
        *changed = *changed || info.states_changed;
        if (info.ends) return WANTS_END;
        if (!info.needs_update) {
            run->next_event = info.has_next ? info.next : INFINITY;
            return enter(fmu, ENTER_CONTINUOUS) ? CALL_REFUSED : DONE;
        }
    }
    return NEVER_SETTLES;
}

/* Inputs that jump to run->values at (run->time, run->y): an event of the FMU, which may change the states; then the solver starts afresh. */
EXPORT int64_t integration_jump(struct integration *run)
{
    struct fmu *fmu = &run->fmu;
    bool changed = false;
    if (move(fmu, run->time, run->y) || enter(fmu, ENTER_EVENT)) return CALL_REFUSED;
    if (write_values(fmu, fmu->input_references, fmu->inputs, run->values)) return CALL_REFUSED;
    enum reason reason = settle(run, &changed);
    if (reason != DONE) return reason;
    if (changed && fill(fmu, GET_STATES, run->y, fmu->states)) return CALL_REFUSED;
    return integration_restart(run);
}

/* Whether the FMU wants an event after an accepted step. */
static enum reason completed(struct integration *run, double time, const double *y, bool *wants)
{
    struct fmu *fmu = &run->fmu;
    if (move(fmu, time, y)) return CALL_REFUSED;
    int status;
    if (fmu->three) {
        bool event = false, ends = false;
        status = ((int (*)(void *, bool, bool *, bool *))fmu->call[COMPLETED_STEP])(fmu->component, true, &event, &ends);
        *wants = event;
    } else {
        int event = 0, ends = 0;
        status = ((int (*)(void *, int, int *, int *))fmu->call[COMPLETED_STEP])(fmu->component, 1, &event, &ends);
        *wants = event != 0;
    }
    return refused(fmu, COMPLETED_STEP, status) ? CALL_REFUSED : DONE;
}

/* The outputs (outputs) at (time, y), if all is as it should be; y's accumulated part goes to sums (rates). */
static enum reason record(struct integration *run, double time, const double *y, double *outputs, double *sums)
{
    struct fmu *fmu = &run->fmu;
    for (int64_t i = 0; i < fmu->states; i++)
        if (!(fabs(y[i]) < run->bound[i])) return OUT_OF_BOUNDS;
    if (!all_finite(y, fmu->states + fmu->rates)) return SUM_NOT_FINITE;
    if (move(fmu, time, y) || read_values(fmu, fmu->output_references, fmu->outputs, outputs)) return CALL_REFUSED;
    if (!all_finite(outputs, fmu->outputs)) return OUTPUT_NOT_FINITE;
    memcpy(sums, y + fmu->states, (size_t)fmu->rates * sizeof(double));
    return DONE;
}

/* To one point; run->time is where CVODE came to, y its vector. */
static enum reason advance_to(struct integration *run, double target, double stop, const double *y)
{
    double to = fmin(target, run->next_event), end = fmin(run->wants_steps ? target : stop, run->next_event);
    for (;;) {
        if (((int (*)(void *, double))run->solver[SET_STOP])(run->memory, end) < 0) return STOP_TIME_REFUSED;
        run->fault = DONE;
        run->flag = ((int (*)(void *, double, void *, double *, int))run->solver[ADVANCE])(
            run->memory, to, run->vector, &run->time, run->wants_steps ? ONE_STEP : NORMAL);
        if (run->flag == ROOT_RETURN) ((int (*)(void *, int32_t *))run->solver[GET_ROOTS])(run->memory, run->roots);
        ((int (*)(void *))run->solver[CLEAR_STOP])(run->memory);
        if (run->fault != DONE) return (enum reason)run->fault;
        if (run->flag < 0) return SOLVER_FAILED;
        bool wants = false;
        if (run->wants_steps && run->flag != ROOT_RETURN && completed(run, run->time, y, &wants) != DONE) return CALL_REFUSED;
        if (run->flag == ROOT_RETURN || wants || run->time >= run->next_event) return EVENT;
        if (run->wants_steps && run->flag != STOP_RETURN && run->time < target) continue;
        return DONE;
    }
}

/* From point to point, at times `targets` (count), none of them beyond `stop`: outputs (count, outputs), sums (count, rates), run->reached of them. */
EXPORT int64_t integration_advance(struct integration *run, const double *targets, int64_t count, double stop, double *outputs, double *sums)
{
    struct fmu *fmu = &run->fmu;
    const double *y = data_of(run, run->vector);
    enum reason reason = DONE;
    for (run->reached = 0; run->reached < count && reason == DONE; run->reached += reason == DONE) {
        double target = targets[run->reached];
        reason = advance_to(run, target, stop, y);
        if (reason == DONE) {
            run->time = target;
            reason = record(run, target, y, outputs + run->reached * fmu->outputs, sums + run->reached * fmu->rates);
        }
    }
    memcpy(run->y, y, (size_t)(fmu->states + fmu->rates) * sizeof(double));
    return reason;
}
