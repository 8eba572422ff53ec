/* Co-Simulation: mj_step after mj_step. The place of the integrator of scenes, with the same function. */
#ifndef INTEGRATOR_H
#define INTEGRATOR_H

#include "equations.h"

typedef enum { STEP_OK, STEP_EVENT, STEP_MASS, STEP_NOT_FINITE } StepResult;

/* What failed, in the middle of a sentence. */
static inline const char *step_trouble(const Model *m, StepResult result)
{
    return (void)result, m->engine->trouble;
}

/* What the importer may do within a communication step of a scene's FMU; here it is never asked. */
typedef struct {
    void *context;
    void (*set_inputs)(void *context, double offset);
    void (*step_finished)(void *context, double offset, double *finish);
} Observer;

/* A step within this share of the model's own is the model's own, to the bit. */
#define SAME_STEP 1e-9

static inline void step_through(Model *m, double h, long count)
{
    Engine *engine = m->engine;
    if (!engine->loaded) load(m, engine->data);
    engine->loaded = 0; /* until the step is whole */
    engine->model->opt.timestep = h;
    for (long n = 0; n < count; n++) {
        memcpy(engine->data->ctrl, m->u, NU * sizeof *m->u);
        mj_step(engine->model, engine->data);
        if (went_wrong(engine->data)) return;
    }
    mj_getState(engine->model, engine->data, m->state, mjSTATE_INTEGRATION);
    engine->loaded = 1;
}

/* Integrate over a communication step *dt from `time` in `count` equal steps. On failure the Model is left as it was. */
static inline StepResult model_step(Model *m, double time, double *dt, long count, int stopping, const Observer *observer)
{
    (void)stopping, (void)observer;
    Engine *engine = m->engine;
    int failed;
    double h = *dt / (double)count;
    if (fabs(h - m->internal_step) <= SAME_STEP * m->internal_step) h = m->internal_step;
    GUARDED(engine, failed, step_through(m, h, count););
    const char *wrong = failed ? NULL : went_wrong(engine->data);
    if (wrong) snprintf(engine->trouble, sizeof engine->trouble, "%s", wrong);
    if (failed || wrong) {
        mj_resetData(engine->given, engine->data);
        return STEP_NOT_FINITE;
    }
    m->begun = 1;
    m->evaluated = 0;
    m->time = time + *dt;
    return STEP_OK;
}

#endif
