/* The loops of a replay over any FMU's functions, FMI 2.0 or 3.0, by their addresses.
 *
 * What is called of an FMU; then Model Exchange under CVODE, from point to point of the record until an event (validate/judge/replay/reference.py);
 * then Co-Simulation, step after step of a plan until one is refused (validate/judge/replay/everyday.py).
 *
 * loops.py reads the fields of the structs fmu, integration and stepping from here. */
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

/* In the order of CALLS in loops.py. */
enum fmi_call {
    GET_REAL, SET_REAL, SET_TIME, SET_STATES, GET_STATES, GET_DERIVATIVES, GET_INDICATORS, COMPLETED_STEP, ENTER_EVENT, UPDATE_DISCRETE,
    ENTER_CONTINUOUS, DO_STEP, SET_SLOPES, CALLS
};

/* Why a loop came back; in the order of Reason in loops.py. */
enum reason {
    DONE, EVENT, CALL_REFUSED, RATE_NOT_FINITE, OUT_OF_BOUNDS, SUM_NOT_FINITE, OUTPUT_NOT_FINITE, SOLVER_FAILED, STOP_TIME_REFUSED,
    SETUP_REFUSED, WANTS_END, NEVER_SETTLES, EARLY_RETURN
};

typedef void (*function)(void);

struct fmu {
    void *component;
    int64_t three; /* whether FMI 3.0, else 2.0 */
    int64_t states, indicators, inputs, outputs, rates;
    const uint32_t *input_references, *output_references, *rate_references;
    function call[CALLS];
    int64_t fault_call, fault_status; /* of the call that was refused */
};

/* 0 if the status is ok or a warning; else it is kept. */
static inline int refused(struct fmu *fmu, enum fmi_call call, int status)
{
    if (status == 0 || status == 1) return 0;
    fmu->fault_call = call;
    fmu->fault_status = status;
    return 1;
}

static inline int read_values(struct fmu *fmu, const uint32_t *references, int64_t count, double *values)
{
    if (!count) return 0;
    function call = fmu->call[GET_REAL];
    size_t n = (size_t)count;
    return refused(fmu, GET_REAL, fmu->three ? ((int (*)(void *, const uint32_t *, size_t, double *, size_t))call)(fmu->component, references, n, values, n)
                                             : ((int (*)(void *, const uint32_t *, size_t, double *))call)(fmu->component, references, n, values));
}

static inline int write_values(struct fmu *fmu, const uint32_t *references, int64_t count, const double *values)
{
    if (!count) return 0;
    function call = fmu->call[SET_REAL];
    size_t n = (size_t)count;
    return refused(fmu, SET_REAL, fmu->three ? ((int (*)(void *, const uint32_t *, size_t, const double *, size_t))call)(fmu->component, references, n, values, n)
                                             : ((int (*)(void *, const uint32_t *, size_t, const double *))call)(fmu->component, references, n, values));
}

/* To time [s] and states (states). */
static inline int move(struct fmu *fmu, double time, const double *states)
{
    if (refused(fmu, SET_TIME, ((int (*)(void *, double))fmu->call[SET_TIME])(fmu->component, time))) return 1;
    return refused(fmu, SET_STATES,
        ((int (*)(void *, const double *, size_t))fmu->call[SET_STATES])(fmu->component, states, (size_t)fmu->states));
}

/* One of the functions that fill an array: derivatives, indicators, states. */
static inline int fill(struct fmu *fmu, enum fmi_call call, double *values, int64_t count)
{
    return refused(fmu, call, ((int (*)(void *, double *, size_t))fmu->call[call])(fmu->component, values, (size_t)count));
}

/* One of the functions that change the mode. */
static inline int enter(struct fmu *fmu, enum fmi_call call)
{
    return refused(fmu, call, ((int (*)(void *))fmu->call[call])(fmu->component));
}

static inline bool all_finite(const double *values, int64_t count)
{
    for (int64_t i = 0; i < count; i++)
        if (!isfinite(values[i])) return false;
    return true;
}

/* Model Exchange under CVODE (cvode.py), by the addresses of its functions; in the order of SOLVER in loops.py. */
enum solver_call { VECTOR_DATA, REINIT, SET_STOP, CLEAR_STOP, ADVANCE, GET_ROOTS, SOLVER_CALLS };
enum { NORMAL = 1, ONE_STEP = 2, STOP_RETURN = 1, ROOT_RETURN = 2 };
/* Rounds of event iteration before an FMU is given up as never settling. */
enum { EVENT_ROUNDS = 100 };

/* y: states, then what is accumulated. */
struct integration {
    struct fmu fmu;
    function solver[SOLVER_CALLS];
    void *memory, *vector; /* CVODE, and the vector that it moves */
    int64_t wants_steps, linear;
    const double *bound; /* (states) */
    int32_t *roots;      /* (indicators) of the last event */
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

/* The FMU at (time, y), with the inputs of that time: those on lines are others at every call. */
static int at(struct integration *run, double time, const double *y) { return (run->linear && held_inputs(run, time)) || move(&run->fmu, time, y); }

/* CVRhsFn: negative, and run->fault says why. */
EXPORT int integration_rates(double time, void *y, void *yp, void *data)
{
    struct integration *run = data;
    struct fmu *fmu = &run->fmu;
    double *rate = data_of(run, yp), sum = 0.0;
    run->fault = CALL_REFUSED;
    if (at(run, time, data_of(run, y)) || fill(fmu, GET_DERIVATIVES, rate, fmu->states)) return -1;
    if (read_values(fmu, fmu->rate_references, fmu->rates, rate + fmu->states)) return -1;
    if (fmu->states + fmu->rates == 0) rate[0] = 0.0; /* the constant number of a model without states */
    for (int64_t i = 0; i < fmu->states + fmu->rates; i++) sum += rate[i];
    run->fault = isfinite(sum) ? DONE : RATE_NOT_FINITE;
    run->fault_time = time;
    return run->fault == DONE ? 0 : -1;
}

/* CVRootFn. */
EXPORT int integration_indicators(double time, void *y, double *values, void *data)
{
    struct integration *run = data;
    run->fault = CALL_REFUSED;
    if (at(run, time, data_of(run, y)) || fill(&run->fmu, GET_INDICATORS, values, run->fmu.indicators)) return -1;
    run->fault = DONE;
    return 0;
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
    if (at(run, time, y)) return CALL_REFUSED;
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
    if (at(run, time, y) || read_values(fmu, fmu->output_references, fmu->outputs, outputs)) return CALL_REFUSED;
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

/* Co-Simulation. */
struct stepping {
    struct fmu fmu;
    const double *times, *values, *slopes; /* of the plan (steps + 1), (steps, inputs), (steps, inputs) */
    int64_t linear;                        /* inputs are lines within a step */
    int64_t gives_slopes;                  /* and the FMU is told their slopes, else each call has the value at its middle */
    const int32_t *orders;                 /* (inputs) ones: of the derivatives that are told */
    int64_t parts;                         /* calls of doStep a step of the plan */
    int64_t bounded;                       /* the first outputs, which must stay below this */
    double bound;
    double *outputs; /* (steps + 1, outputs): row 0 is given */
    double *applied; /* (inputs) */
    /* What came of it. */
    int64_t done; /* steps */
    double reached; /* where the FMU returned early [s] */
};

static enum reason do_step(struct stepping *run, double time, double length)
{
    struct fmu *fmu = &run->fmu;
    if (!fmu->three)
        return refused(fmu, DO_STEP, ((int (*)(void *, double, double, int))fmu->call[DO_STEP])(fmu->component, time, length, 1)) ? CALL_REFUSED : DONE;
    bool needs_event = false, ends = false, early = false;
    int status = ((int (*)(void *, double, double, bool, bool *, bool *, bool *, double *))fmu->call[DO_STEP])(
        fmu->component, time, length, true, &needs_event, &ends, &early, &run->reached);
    if (refused(fmu, DO_STEP, status)) return CALL_REFUSED;
    return early ? EARLY_RETURN : DONE;
}

static enum reason advance(struct stepping *run, int64_t step)
{
    struct fmu *fmu = &run->fmu;
    int64_t calls = run->parts;
    const double *value = run->values + step * fmu->inputs, *slope = run->slopes + step * fmu->inputs;
    double begin = run->times[step], length = run->times[step + 1] - begin;
    for (int64_t call = 0; call < calls; call++) {
        double at = run->gives_slopes || !run->linear ? (double)call : (double)call + 0.5;
        for (int64_t i = 0; i < fmu->inputs; i++) run->applied[i] = value[i] + slope[i] * (length * at / (double)calls);
        if (write_values(fmu, fmu->input_references, fmu->inputs, run->applied)) return CALL_REFUSED;
        if (run->gives_slopes && fmu->inputs
            && refused(fmu, SET_SLOPES,
                ((int (*)(void *, const uint32_t *, size_t, const int32_t *, const double *))fmu->call[SET_SLOPES])(
                    fmu->component, fmu->input_references, (size_t)fmu->inputs, run->orders, slope)))
            return CALL_REFUSED;
        enum reason reason = do_step(run, begin + length * (double)call / (double)calls, length / (double)calls);
        if (reason != DONE) return reason;
    }
    return DONE;
}

/* Steps first .. last - 1 of the plan; run->done counts them. */
EXPORT int64_t step_through(struct stepping *run, int64_t first, int64_t last)
{
    struct fmu *fmu = &run->fmu;
    for (int64_t step = first; step < last; step++) {
        double *after = run->outputs + (step + 1) * fmu->outputs;
        enum reason reason = advance(run, step);
        if (reason != DONE) return reason;
        if (read_values(fmu, fmu->output_references, fmu->outputs, after)) return CALL_REFUSED;
        if (!all_finite(after, fmu->outputs)) return OUTPUT_NOT_FINITE;
        for (int64_t i = 0; i < run->bounded; i++)
            if (fabs(after[i]) > run->bound) return OUT_OF_BOUNDS;
        run->done = step + 1;
    }
    return DONE;
}
