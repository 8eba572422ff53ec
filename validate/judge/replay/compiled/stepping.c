/* A Co-Simulation through a plan: inputs, doStep, outputs, step after step, until one of them is refused; the loop of validate/judge/replay/everyday.py. */
#include "fmu_calls.h"

/* Filled by validate/judge/replay/everyday.py, field by field in this order. */
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
    /* Step halving: each step is made in half as many calls and at twice the FMU's own step too, and taken back. */
    int64_t rolls_back, own_step_count;
    const uint32_t *own_step_reference;
    double own_step, same; /* share of its size to which a restored output is the one before */
    void *place;           /* the FMU's saved state */
    double *coarse;        /* (outputs) */
    double *local;         /* (steps, outputs): fine less coarse */
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

static enum reason advance(struct stepping *run, int64_t step, int64_t calls)
{
    struct fmu *fmu = &run->fmu;
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

static int set_own_step(struct stepping *run, double length)
{
    return write_values(&run->fmu, run->own_step_reference, run->own_step_count, &length);
}

/* One step twice: coarsely, taken back, and finely. Leaves the coarse outputs in run->coarse. */
static enum reason step_twice(struct stepping *run, int64_t step, const double *before, double *after)
{
    struct fmu *fmu = &run->fmu;
    if (refused(fmu, SAVE, ((int (*)(void *, void **))fmu->call[SAVE])(fmu->component, &run->place))) return CALL_REFUSED;
    if (set_own_step(run, 2.0 * run->own_step)) return CALL_REFUSED;
    enum reason reason = advance(run, step, run->parts / 2 > 1 ? run->parts / 2 : 1);
    if (reason != DONE) return reason;
    if (read_values(fmu, fmu->output_references, fmu->outputs, run->coarse)) return CALL_REFUSED;
    if (refused(fmu, RESTORE, ((int (*)(void *, void *))fmu->call[RESTORE])(fmu->component, run->place))) return CALL_REFUSED;
    if (read_values(fmu, fmu->output_references, fmu->outputs, after)) return CALL_REFUSED;
    double size = 0.0;
    for (int64_t i = 0; i < run->bounded; i++) size = fmax(size, fabs(before[i]));
    for (int64_t i = 0; i < run->bounded; i++)
        if (!(fabs(after[i] - before[i]) <= run->same * size)) return NOT_RESTORED;
    if (set_own_step(run, run->own_step)) return CALL_REFUSED;
    return advance(run, step, run->parts);
}

/* Steps first .. last - 1 of the plan; run->done counts them. */
EXPORT int64_t step_through(struct stepping *run, int64_t first, int64_t last)
{
    struct fmu *fmu = &run->fmu;
    for (int64_t step = first; step < last; step++) {
        double *before = run->outputs + step * fmu->outputs, *after = before + fmu->outputs;
        enum reason reason = run->rolls_back ? step_twice(run, step, before, after) : advance(run, step, run->parts);
        if (reason != DONE) return reason;
        if (read_values(fmu, fmu->output_references, fmu->outputs, after)) return CALL_REFUSED;
        if (run->rolls_back) {
            double *local = run->local + step * fmu->outputs;
            for (int64_t i = 0; i < fmu->outputs; i++) local[i] = after[i] - run->coarse[i];
        }
        if (!all_finite(after, fmu->outputs)) return OUTPUT_NOT_FINITE;
        for (int64_t i = 0; i < run->bounded; i++)
            if (fabs(after[i]) > run->bound) return OUT_OF_BOUNDS;
        run->done = step + 1;
    }
    return DONE;
}
