/* Co-Simulation by consecutive mj_step, in place of the scenes' integrator with the same
 * functions; the Observer is not called. */
#ifndef INTEGRATOR_H
#define INTEGRATOR_H

#include "equations.h"

/* Return the failure as a clause. */
static inline const char *step_trouble(const Model *m, StepResult result) { return (void)result, m->engine->trouble; }

/* A step within this share of the model's own equals it, to the bit. */
#define SAME_STEP 1e-9

static const char *make_steps(Model *m)
{
    Engine *engine = m->engine;
    if (engine->loaded) apply_settings(m);
    else load(m, engine->data);
    engine->loaded = 0; /* until the step is complete */
    engine->model->opt.timestep = engine->h;
    for (long n = 0; n < engine->count; n++) {
        memcpy(engine->data->ctrl, m->u, NU * sizeof *m->u);
        mj_step(engine->model, engine->data);
        const char *wrong = went_wrong(engine->data);
        if (wrong) return wrong;
    }
    mj_getState(engine->model, engine->data, m->state, mjSTATE_INTEGRATION);
    engine->loaded = 1;
    return NULL;
}

/* Integrate over a communication step *dt from `time` in `count` equal steps. A failure leaves
 * the Model unchanged. */
static inline StepResult model_step(Model *m, double time, double *dt, long count, int stopping, const Observer *observer)
{
    (void)stopping, (void)observer;
    Engine *engine = m->engine;
    engine->count = count;
    engine->h = *dt / (double)count;
    if (fabs(engine->h - m->internal_step) <= SAME_STEP * m->internal_step) engine->h = m->internal_step;
    if (guarded(m, make_steps)) {
        mj_resetData(engine->given, engine->data);
        return STEP_NOT_FINITE;
    }
    m->begun = 1;
    m->evaluated = 0;
    m->time = time + *dt;
    return STEP_OK;
}

#endif
