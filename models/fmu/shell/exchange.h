/* Model Exchange: the importer integrates. Contact modes are frozen between events and change
 * only in event mode, after a sign change of the event indicators (gaps, reserves of frictions).
 * Version-free, see instance.h. */
#ifndef EXCHANGE_H
#define EXCHANGE_H

#include "instance.h"

#define PHASES_STATES (PHASE_INITIALIZATION | PHASE_EVENT | PHASE_CONTINUOUS | PHASE_TERMINATED | PHASE_ERROR)

/* As allowed_type; the array must have the right length. */
static inline Instance *allowed_array(void *instance, const char *function, int phases, const void *array, size_t given, size_t needed)
{
    Instance *self = allowed_type(instance, function, phases, MODEL_EXCHANGE);
    if (!self) return NULL;
    if (given != needed || (needed > 0 && !array)) {
        FAIL(self, "%s: an array of %lu numbers is needed, but one of %lu was given.", function, (unsigned long)needed, (unsigned long)(array ? given : 0));
        return NULL;
    }
    return self;
}

/* Request an event if a contact is in the wrong mode beyond its hysteresis. Importers that do
 * not locate the indicators' roots thus get the right modes one step late. */
static inline Status integrator_step_completed(void *instance, const char *function, const void *places, int *enter_event_mode)
{
    Instance *self = allowed_type(instance, function, PHASE_CONTINUOUS, MODEL_EXCHANGE);
    if (!self) return STATUS_ERROR;
    if (!places) return FAIL(self, "%s: the place for an answer is missing.", function);
    if (evaluated(self) != STATUS_OK) return STATUS_ERROR;
    *enter_event_mode = model_modes_wrong(&self->model);
    return STATUS_OK;
}

static inline Status set_time(void *instance, const char *function, double time)
{
    Instance *self = allowed_type(instance, function, PHASE_EVENT | PHASE_CONTINUOUS, MODEL_EXCHANGE);
    if (!self) return STATUS_ERROR;
    /* A time beyond stopTime is accepted: higher-order integrators step past the end and
     * interpolate back. */
    if (!isfinite(time)) return FAIL(self, "%s: the time is not a finite number.", function);
    self->model.time = time;
    return STATUS_OK;
}

static inline Status set_states(void *instance, const char *function, const double *x, size_t count)
{
    Instance *self = allowed_array(instance, function, PHASE_EVENT | PHASE_CONTINUOUS, x, count, STATE_COUNT);
    if (!self) return STATUS_ERROR;
    for (int i = 0; i < STATE_COUNT; i++)
        if (!isfinite(x[i])) return FAIL(self, "%s: state %d is not a finite number at t = %g s.", function, i, self->model.time);
    model_set_states(&self->model, x);
    return STATUS_OK;
}

static inline Status get_states(void *instance, const char *function, double *x, size_t count)
{
    Instance *self = allowed_array(instance, function, PHASES_STATES, x, count, STATE_COUNT);
    if (!self) return STATUS_ERROR;
    model_states(&self->model, x);
    return STATUS_OK;
}

static inline Status get_rates(void *instance, const char *function, double *rates, size_t count)
{
    Instance *self = allowed_array(instance, function, PHASES_STATES, rates, count, STATE_COUNT);
    if (!self || evaluated(self) != STATUS_OK) return STATUS_ERROR;
    model_rates(&self->model, rates);
    return STATUS_OK;
}

static inline Status get_indicators(void *instance, const char *function, double *indicators, size_t count)
{
    Instance *self = allowed_array(instance, function, PHASES_STATES, indicators, count, NL);
    if (!self || evaluated(self) != STATUS_OK) return STATUS_ERROR;
    model_indicators(&self->model, indicators);
    return STATUS_OK;
}

static inline Status get_nominals(void *instance, const char *function, double *nominals, size_t count)
{
    Instance *self = allowed_array(instance, function, PHASE_INSTANTIATED | PHASES_STATES, nominals, count, STATE_COUNT);
    if (!self) return STATUS_ERROR;
    memcpy(nominals, STATE_NOMINALS, sizeof STATE_NOMINALS);
    return STATUS_OK;
}

#endif
