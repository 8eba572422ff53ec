/* One instance of a MuJoCo model behind the shell of our FMUs: the place of model.h and equations.h, with the same functions.
 *
 * Model is flat and holds the whole integration state of MuJoCo (mjSTATE_INTEGRATION, the warm start with it): copying its bytes copies the
 * state. What cannot be copied belongs to the instance: `data` steps and nothing else, so that a run is mj_step after mj_step; what is read at a
 * point is computed in `view`, so that reading changes nothing.
 */
#ifndef EQUATIONS_H
#define EQUATIONS_H

#include <math.h>
#include <setjmp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <mujoco/mujoco.h>

/* MuJoCo's own way to take over one thread's messages, which its compiler and its Python package use; the library is shipped with this file. */
mjfLogHandler _mjPRIVATE_setTlsLogHandler(mjfLogHandler handler);

#define ROOM(n) ((n) > 0 ? (n) : 1)
#define INPUTS_SLOPE 0 /* MuJoCo holds its controls over a step */

typedef enum {
    KIND_TIME,
    KIND_POSITION,
    KIND_VELOCITY, /* and activations of actuators, behind them */
    KIND_POSITION_RATE,
    KIND_VELOCITY_RATE,
    KIND_INPUT,
    KIND_PARAMETER, /* none: all may be changed between steps */
    KIND_TUNABLE,
    KIND_OUTPUT,
    KIND_INTERNAL_STEP,
    KIND_INTEGRATOR
} VariableKind;

/* A row of the variable table; its position is the value reference. index: place within the variables of its kind. */
typedef struct {
    const char *name;
    VariableKind kind;
    int index;
    double start, lower, upper;
} Variable;

/* The two sides of a contact that is asked for: a geom, or all geoms of a body. */
typedef struct {
    int is_body[2], id[2];
} Pair;

#include "model_config.h" /* MODEL_GUID, MODEL_VARIABLES, VARIABLE_COUNT, STATE_NOMINALS; NQ, NV, NA, NU, NT, the places of MuJoCo's numbers */

#define NL 0 /* no event indicators: MuJoCo's forces follow from the state */
#define STATE_COUNT (NQ + NV + NA)
#define STATE_SIZE (1 + NQ + NV + NA + REST_SIZE)
#define PAIR_VALUES NSENSORDATA
#define VALUES (PAIR_VALUES + 2 * NPAIRS)

/* Tunable parameters: these, then a mass for each of MASS_BODIES. */
enum { GRAVITY = 0, FRICTION_SCALE = 3, STIFFNESS_SCALE, GIVE_SCALE, MASSES };

typedef struct {
    mjModel *given, *model; /* as shipped, and with the parameters */
    mjData *data, *view;
    int loaded; /* whether `data` holds the Model's state */
    int applied;
    double t[ROOM(NT)]; /* the parameters that `model` has, if `applied` */
    char trouble[256];
} Engine;

typedef struct {
    double time;
    double state[STATE_SIZE]; /* mjSTATE_INTEGRATION: time, positions, velocities, activations, .. */
    double u[ROOM(NU)], u_rate[ROOM(NU)]; /* no rates are ever set */
    double t[ROOM(NT)];
    double internal_step;
    int integrator; /* MuJoCo's number + 1 */
    double start_time, stop_time;
    double values[ROOM(VALUES)], rates[ROOM(STATE_COUNT)]; /* belong to the state while `evaluated` */
    int begun; /* a step was made: from then on MuJoCo keeps its own time */
    int frozen;
    int evaluated;
    int stop_defined;
    int phase;
    Engine *engine; /* of the instance: never copied */
} Model;

typedef struct {
    double x[ROOM(STATE_COUNT)], u[ROOM(NU)], values[ROOM(VALUES)], rates[ROOM(STATE_COUNT)];
    double none;
} Tangent;

static inline int is_integer(VariableKind kind) { return kind == KIND_INTEGRATOR; }
static inline int is_state(VariableKind kind) { return kind == KIND_POSITION || kind == KIND_VELOCITY; }
static inline int is_setting(VariableKind kind) { return kind == KIND_TUNABLE || kind == KIND_INTERNAL_STEP || kind == KIND_INTEGRATOR; }
static inline int is_calculated(VariableKind kind) { return kind == KIND_OUTPUT || kind == KIND_POSITION_RATE || kind == KIND_VELOCITY_RATE; }

/* ---- MuJoCo's errors, which would end the process: while it is called from here they come back to `guard`. ---- */

static __thread Engine *watched;
static __thread jmp_buf guard;

static void keep_message(const mjLogMessage *message)
{
    if (watched && message->level >= mjLOG_WARNING) {
        snprintf(watched->trouble, sizeof watched->trouble, "MuJoCo says: %.*s", (int)sizeof watched->trouble - 32, message->subject);
        for (char *at = watched->trouble; *at; at++)
            if (*at == '%' || *at == '\n') *at = ' '; /* FMI 2.0's logger formats it once more */
        for (size_t end = strlen(watched->trouble); end > 0 && strchr(" .", watched->trouble[end - 1]); end--) watched->trouble[end - 1] = '\0';
    }
    if (message->level == mjLOG_ERROR) longjmp(guard, 1);
}

/* Run `code` with MuJoCo's messages kept in the engine; `failed` is 1 if an error ended it. */
#define GUARDED(engine, failed, code)                                          \
    do {                                                                       \
        const mjfLogHandler before = _mjPRIVATE_setTlsLogHandler(keep_message); \
        watched = (engine);                                                    \
        if (setjmp(guard) == 0) {                                              \
            code;                                                              \
            (failed) = 0;                                                      \
        } else (failed) = 1;                                                   \
        watched = NULL;                                                        \
        _mjPRIVATE_setTlsLogHandler(before);                                   \
    } while (0)

static inline const char *model_trouble(const Model *m) { return m->engine->trouble; }

/* What is wrong with numbers that MuJoCo goes on with: it would start anew, or leave contacts out. NULL: nothing. */
static inline const char *went_wrong(const mjData *data)
{
    if (data->warning[mjWARN_BADQPOS].number || data->warning[mjWARN_BADQVEL].number || data->warning[mjWARN_BADQACC].number)
        return "a position, velocity or acceleration became infinite, not a number or huge (timestep too large?)";
    if (data->warning[mjWARN_BADCTRL].number) return "an input is beyond what MuJoCo takes";
    if (data->warning[mjWARN_CONTACTFULL].number || data->warning[mjWARN_CNSTRFULL].number)
        return "the model's memory holds no more contacts; give it more by <size memory=\"..\"/> and export it anew";
    return NULL;
}

/* ---- Begin and end. ---- */

/* The file of the model below the resources: a path, or FMI 2.0's URI. 0 if it is too long. */
static inline int model_path(const char *resources, char *path, size_t size)
{
    size_t length = 0;
    if (strncmp(resources, "file:", 5) == 0) {
        resources += 5;
        if (strncmp(resources, "///", 3) == 0) resources += 2;
        else if (strncmp(resources, "//localhost/", 12) == 0) resources += 11;
    }
    for (const char *at = resources; *at && length + 16 < size; at++) {
        unsigned int code;
        if (*at == '%' && sscanf(at + 1, "%2x", &code) == 1) {
            path[length++] = (char)code;
            at += 2;
        } else path[length++] = *at;
    }
    snprintf(path + length, size - length, "%smodel.mjb", length && path[length - 1] == '/' ? "" : "/");
    return length + 16 < size;
}

/* The engine of a new instance; NULL, or why there is none, in the middle of a sentence. */
static inline const char *model_open(Model *m, const char *resources)
{
    static __thread char why[1400];
    char path[1024];
    int failed;
    if (!resources || !model_path(resources, path, sizeof path)) return "the path of the resources is missing or too long";
    Engine *engine = m->engine = calloc(1, sizeof *engine);
    if (!engine) return "out of memory";
    if (mj_version() != mjVERSION_HEADER) {
        snprintf(why, sizeof why, "the process has MuJoCo %s loaded, but the FMU needs " MUJOCO_VERSION ", which it carries; load it in a process of its own", mj_versionString());
        return why;
    }
    GUARDED(engine, failed, engine->given = mj_loadModel(path, NULL); if (engine->given) engine->model = mj_copyModel(NULL, engine->given););
    const mjModel *model = engine->model;
    if (failed || !model) {
        snprintf(why, sizeof why, "%s cannot be loaded, so the FMU is damaged (%s)", path, engine->trouble[0] ? engine->trouble : "MuJoCo says nothing");
        return why;
    }
    if (model->nq != NQ || model->nv != NV || model->na != NA || model->nu != NU || model->nsensordata != NSENSORDATA || mj_stateSize(model, mjSTATE_INTEGRATION) != STATE_SIZE)
        return "resources/model.mjb belongs to another FMU";
    GUARDED(engine, failed, engine->data = mj_makeData(model); engine->view = mj_makeData(model););
    return failed || !engine->data || !engine->view ? "out of memory" : NULL;
}

static inline void model_close(Model *m)
{
    Engine *engine = m->engine;
    if (!engine) return;
    if (engine->data) mj_deleteData(engine->data);
    if (engine->view) mj_deleteData(engine->view);
    if (engine->model) mj_deleteModel(engine->model);
    if (engine->given) mj_deleteModel(engine->given);
    free(engine);
}

/* All that is saved; the engine stays where it is, and follows before it is used again. */
static inline void model_copy(Model *to, const Model *from)
{
    Engine *engine = to->engine;
    memcpy(to, from, sizeof *to);
    to->engine = engine;
    if (engine) engine->loaded = 0;
}

static inline void model_assign(Model *m, const Variable *variable, double value)
{
    const int i = variable->index;
    switch (variable->kind) {
    case KIND_POSITION: m->state[1 + i] = value; break;
    case KIND_VELOCITY: m->state[1 + NQ + i] = value; break;
    case KIND_INPUT: m->u[i] = value; break;
    case KIND_TUNABLE: m->t[i] = value; break;
    case KIND_INTERNAL_STEP: m->internal_step = value; break;
    case KIND_INTEGRATOR: m->integrator = (int)value; break;
    default: return;
    }
    m->evaluated = 0;
    if (is_state(variable->kind) || is_setting(variable->kind)) m->engine->loaded = 0;
}

/* All values at their starts; equal bytes for every fresh or reset instance, but for the engine. */
static inline void model_start(Model *m)
{
    Engine *engine = m->engine;
    memset(m, 0, sizeof *m);
    m->engine = engine;
    engine->loaded = 0;
    mj_resetData(engine->given, engine->view);
    if (KEYFRAME >= 0) mj_resetDataKeyframe(engine->given, engine->data, KEYFRAME);
    else mj_resetData(engine->given, engine->data);
    mj_getState(engine->given, engine->data, m->state, mjSTATE_INTEGRATION);
    for (int i = 0; i < VARIABLE_COUNT; i++) model_assign(m, &MODEL_VARIABLES[i], MODEL_VARIABLES[i].start);
}

/* ---- Evaluate. ---- */

/* MuJoCo's solref is (time constant, damping ratio), or (-stiffness, -damping); a stiffness s times as large at the same damping ratio. */
static inline void stiffen(const double *given, double s, double *solref)
{
    solref[0] = given[0] > 0.0 ? given[0] / sqrt(s) : given[0] * s;
    if (given[1] <= 0.0) solref[1] = given[1] * sqrt(s);
}

/* solimp is (d0, dmax, ..): a constraint of impedance d gives way by 1 - d. */
static inline void harden(const double *given, double s, double *solimp)
{
    for (int i = 0; i < 2; i++) solimp[i] = 1.0 - (1.0 - given[i]) * s;
}

/* Bring the engine's model up to date with the parameters; what has its own value keeps its bits. */
static inline void apply_parameters(const Model *m)
{
    static const int masses[] = MASS_BODIES;
    Engine *engine = m->engine;
    const mjModel *given = engine->given;
    mjModel *model = engine->model;
    const double *t = m->t;
    int heavier = 0;
    const int same = engine->applied && memcmp(engine->t, t, sizeof m->t) == 0;
    if (!same) mj_copyModel(model, given);
    model->opt.timestep = m->internal_step;
    model->opt.integrator = m->integrator - 1;
    if (same) return;
    model->opt.disableflags |= mjDSBL_AUTORESET; /* what became infinite is told, and does not start anew */
    memcpy(model->opt.gravity, t + GRAVITY, sizeof model->opt.gravity);
    for (int i = 0; i < 3 * (int)given->ngeom && t[FRICTION_SCALE] != 1.0; i++) model->geom_friction[i] *= t[FRICTION_SCALE];
    for (int i = 0; i < 5 * (int)given->npair && t[FRICTION_SCALE] != 1.0; i++) model->pair_friction[i] *= t[FRICTION_SCALE];
    for (int i = 0; i < (int)given->ngeom; i++) {
        if (t[STIFFNESS_SCALE] != 1.0) stiffen(given->geom_solref + mjNREF * i, t[STIFFNESS_SCALE], model->geom_solref + mjNREF * i);
        if (t[GIVE_SCALE] != 1.0) harden(given->geom_solimp + mjNIMP * i, t[GIVE_SCALE], model->geom_solimp + mjNIMP * i);
    }
    for (int i = 0; i < (int)given->npair; i++) {
        if (t[STIFFNESS_SCALE] != 1.0) stiffen(given->pair_solref + mjNREF * i, t[STIFFNESS_SCALE], model->pair_solref + mjNREF * i);
        if (t[GIVE_SCALE] != 1.0) harden(given->pair_solimp + mjNIMP * i, t[GIVE_SCALE], model->pair_solimp + mjNIMP * i);
    }
    for (int i = MASSES; i < NT; i++) {
        const int body = masses[i - MASSES];
        const double ratio = t[i] / given->body_mass[body];
        if (t[i] == given->body_mass[body]) continue;
        heavier = 1;
        model->body_mass[body] = t[i];
        for (int k = 0; k < 3; k++) model->body_inertia[3 * body + k] *= ratio;
    }
    if (heavier) mj_setConst(model, engine->view);
    memcpy(engine->t, t, sizeof m->t);
    engine->applied = 1;
}

/* A MuJoCo data brought to the Model's state and inputs. */
static inline void load(const Model *m, mjData *data)
{
    apply_parameters(m);
    mj_setState(m->engine->model, data, m->state, mjSTATE_INTEGRATION);
    if (!m->begun || m->frozen) data->time = m->time;
    memset(data->warning, 0, sizeof data->warning);
}

static inline int on_side(const mjModel *model, const Pair *pair, int side, int geom)
{
    return geom >= 0 && (pair->is_body[side] ? model->geom_bodyid[geom] : geom) == pair->id[side];
}

/* The sum of the normal forces [N] between the two sides, and their smallest distance [m], negative where they overlap, FARTHEST at most. */
static inline void look_at_pair(const mjModel *model, mjData *data, const Pair *pair, double *force, double *gap)
{
    int first[2], count[2];
    *force = 0.0;
    *gap = FARTHEST;
    for (int i = 0; i < (int)data->ncon; i++) {
        const mjContact *contact = &data->contact[i];
        const int a = contact->geom[0], b = contact->geom[1];
        if (!(on_side(model, pair, 0, a) && on_side(model, pair, 1, b)) && !(on_side(model, pair, 0, b) && on_side(model, pair, 1, a))) continue;
        mjtNum wrench[6];
        mj_contactForce(model, data, i, wrench);
        *force += wrench[0];
        if (contact->dist < *gap) *gap = contact->dist;
    }
    for (int side = 0; side < 2; side++) {
        first[side] = pair->is_body[side] ? model->body_geomadr[pair->id[side]] : pair->id[side];
        count[side] = pair->is_body[side] ? model->body_geomnum[pair->id[side]] : 1;
    }
    for (int i = 0; i < count[0]; i++)
        for (int k = 0; k < count[1]; k++) {
            const double distance = mj_geomDistance(model, data, first[0] + i, first[1] + k, FARTHEST, NULL);
            if (distance < *gap) *gap = distance;
        }
}

static inline void evaluate(Model *m)
{
    static const Pair pairs[] = PAIRS;
    mjModel *model = m->engine->model;
    mjData *view = m->engine->view;
    load(m, view);
    memcpy(view->ctrl, m->u, NU * sizeof *m->u);
    mj_forward(model, view);
    memcpy(m->values, view->sensordata, NSENSORDATA * sizeof *m->values);
    for (int i = 0; i < NPAIRS; i++) look_at_pair(model, view, &pairs[i], &m->values[PAIR_VALUES + i], &m->values[PAIR_VALUES + NPAIRS + i]);
    memcpy(m->rates + NQ, view->qacc, NV * sizeof *m->rates);
    memcpy(m->rates + NQ + NV, view->act_dot, NA * sizeof *m->rates);
    for (int joint = 0; joint < (int)model->njnt; joint++) {
        const int type = model->jnt_type[joint], turns = type == mjJNT_FREE || type == mjJNT_BALL;
        const int lines = type == mjJNT_FREE ? 3 : turns ? 0 : 1;
        const double *v = m->state + 1 + NQ + model->jnt_dofadr[joint];
        const int q = model->jnt_qposadr[joint];
        memcpy(m->rates + q, v, lines * sizeof *v);
        if (!HAS_QUATERNIONS || !turns) continue;
        mju_mulQuatAxis(m->rates + q + lines, m->state + 1 + q + lines, v + lines); /* dq/dt = q (0, w) / 2, w in the axes of the body */
        for (int k = 0; k < 4; k++) m->rates[q + lines + k] *= 0.5;
    }
}

/* Fill values and rates; 1, and the engine's trouble, if MuJoCo cannot. */
static inline int model_evaluate(Model *m)
{
    int failed;
    if (m->evaluated) return 0;
    GUARDED(m->engine, failed, evaluate(m););
    const char *wrong = failed ? NULL : went_wrong(m->engine->view);
    if (wrong) snprintf(m->engine->trouble, sizeof m->engine->trouble, "%s", wrong);
    m->evaluated = !failed && !wrong;
    return !m->evaluated;
}

static inline double model_value(const Model *m, const Variable *variable)
{
    const int i = variable->index;
    switch (variable->kind) {
    case KIND_TIME: return m->time;
    case KIND_POSITION: return m->state[1 + i];
    case KIND_VELOCITY: return m->state[1 + NQ + i];
    case KIND_POSITION_RATE: return m->rates[i];
    case KIND_VELOCITY_RATE: return m->rates[NQ + i];
    case KIND_INPUT: return m->u[i];
    case KIND_TUNABLE: return m->t[i];
    case KIND_OUTPUT: return m->values[i];
    case KIND_INTERNAL_STEP: return m->internal_step;
    case KIND_INTEGRATOR: return m->integrator;
    default: return NAN;
    }
}

/* ---- Model Exchange. ---- */

static inline void model_states(const Model *m, double *x) { memcpy(x, m->state + 1, STATE_COUNT * sizeof *x); }
static inline void model_rates(const Model *m, double *rates) { memcpy(rates, m->rates, STATE_COUNT * sizeof *rates); }

static inline void model_set_states(Model *m, const double *x)
{
    memcpy(m->state + 1, x, STATE_COUNT * sizeof *x);
    m->evaluated = m->engine->loaded = 0;
}

static inline int model_update_modes(Model *m) { return (void)m, 0; }
static inline int model_modes_wrong(const Model *m) { return (void)m, 0; }
static inline void model_indicators(const Model *m, double *indicators) { (void)m, (void)indicators; }

/* ---- Derivatives are not offered: every product fails, and says so. ---- */

static inline int no_derivatives(const Model *m)
{
    snprintf(m->engine->trouble, sizeof m->engine->trouble, "derivatives are not offered");
    return 1;
}

static inline void time_direction(const Model *m, Tangent *tangent) { (void)m, (void)tangent; }
static inline double *known_entry(const Variable *variable, Tangent *tangent) { return (void)variable, &tangent->none; }
static inline int model_tangent(const Model *m, Tangent *d) { return (void)d, no_derivatives(m); }
static inline int model_adjoint(const Model *m, Tangent *bar) { return (void)bar, no_derivatives(m); }
static inline double model_value_tangent(const Model *m, const Tangent *d, const Variable *variable) { return (void)m, (void)d, (void)variable, NAN; }

static inline void model_value_adjoint(const Model *m, double weight, const Variable *variable, Tangent *bar)
{
    (void)m, (void)weight, (void)variable, (void)bar;
}

#endif
