/* An FMU's functions, FMI 2.0 or 3.0, by their addresses: what the loops of integration.c and stepping.c call of it.
 *
 * struct fmu is filled by validate/judge/replay/compiled/library.py, field by field in this order; all fields are eight bytes long. */
#ifndef FMU_CALLS_H
#define FMU_CALLS_H

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

/* In the order of library.CALLS. */
enum fmi_call {
    GET_REAL, SET_REAL, SET_TIME, SET_STATES, GET_STATES, GET_DERIVATIVES, GET_INDICATORS, COMPLETED_STEP, ENTER_EVENT, UPDATE_DISCRETE,
    ENTER_CONTINUOUS, DO_STEP, SET_SLOPES, SAVE, RESTORE, CALLS
};

/* Why a loop came back; in the order of library.Reason. */
enum reason {
    DONE, EVENT, CALL_REFUSED, RATE_NOT_FINITE, OUT_OF_BOUNDS, SUM_NOT_FINITE, OUTPUT_NOT_FINITE, SOLVER_FAILED, STOP_TIME_REFUSED,
    SETUP_REFUSED, WANTS_END, NEVER_SETTLES, NOT_RESTORED, EARLY_RETURN
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

#endif
