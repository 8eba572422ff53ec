/* One instance of a MuJoCo model behind the shell of our FMUs, in place of model.h and
 * equations.h with the same functions.
 *
 * Model is flat and contains MuJoCo's integration state (mjSTATE_INTEGRATION, with the warm
 * start): copying its bytes copies the state. Everything else belongs to the instance: `data`
 * only performs mj_step; values are computed in `view`, so that reading changes nothing. */
#ifndef EQUATIONS_H
#define EQUATIONS_H

#include <math.h>
#include <setjmp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <mujoco/mujoco.h>

/* MuJoCo's own function to capture messages of one thread, used by its compiler and Python
 * package; this library is shipped with it. */
mjfLogHandler _mjPRIVATE_setTlsLogHandler(mjfLogHandler handler);

#define INPUTS_SLOPE 0 /* MuJoCo holds its controls over a step */

/* Velocities are followed by activations of actuators. All parameters may change between steps. */
typedef enum {
    KIND_TIME, KIND_POSITION, KIND_VELOCITY, KIND_POSITION_RATE, KIND_VELOCITY_RATE, KIND_INPUT, KIND_PARAMETER, KIND_TUNABLE, KIND_OUTPUT,
    KIND_INTERNAL_STEP, KIND_INTEGRATOR
} VariableKind;

/* The two sides of a requested contact: geoms from `first` on. */
typedef struct {
    int first[2], count[2];
} Pair;

#include "variable.h"
#include "model_config.h" /* MODEL_GUID, MODEL_VARIABLES, VARIABLE_COUNT, STATE_NOMINALS; NQ, NV, NA, NU, NT, the places of MuJoCo's numbers */

#define EXACT 1e-14
#define NL 0 /* no event indicators: MuJoCo's forces follow from the state */
#define STATE_COUNT (NQ + NV + NA)
#define VALUES (NSENSORDATA + 2 * NPAIRS)

/* Settings: these, then a mass for each of MASS_BODIES. */
enum { GRAVITY = 0, FRICTION_SCALE = 3, STIFFNESS_SCALE, GIVE_SCALE, TIMESTEP, INTEGRATOR, MASSES };

typedef struct {
    mjModel *given, *model; /* as shipped, and with the settings */
    mjData *data, *view;
    const char *path; /* of the shipped model, during opening */
    double h; /* length and number of steps */
    long count;
    int loaded; /* whether `data` has the Model's state */
    int applied;
    double t[ROOM(NT)]; /* settings of `model`, if `applied` */
    char trouble[256];
} Engine;

typedef struct {
    double time;
    double state[1 + STATE_COUNT + REST_SIZE]; /* mjSTATE_INTEGRATION: time, positions, velocities, activations, .. */
    double u[ROOM(NU)], u_rate[ROOM(NU)]; /* rates are never set */
    double t[ROOM(NT)];
    double internal_step; /* t[TIMESTEP] */
    double start_time, stop_time;
    double values[ROOM(VALUES)], rates[ROOM(STATE_COUNT)]; /* valid while `evaluated` */
    unsigned long long piece; /* smooth piece of the equations */
    int begun; /* a step was made: MuJoCo now keeps the time */
    int frozen;
    int evaluated;
    int stop_defined;
    int phase;
    Engine *engine; /* of the instance, never copied */
} Model;

/* A direction, and its results. */
typedef struct {
    double x[ROOM(STATE_COUNT)], u[ROOM(NU)], t[ROOM(NT)], values[ROOM(VALUES)], rates[ROOM(STATE_COUNT)];
} Tangent;

static inline int is_integer(VariableKind kind) { return kind == KIND_INTEGRATOR; }
static inline int is_state(VariableKind kind) { return kind == KIND_POSITION || kind == KIND_VELOCITY; }
static inline int is_setting(VariableKind kind) { return kind == KIND_TUNABLE || kind == KIND_INTERNAL_STEP || kind == KIND_INTEGRATOR; }
static inline int is_calculated(VariableKind kind) { return kind == KIND_OUTPUT || kind == KIND_POSITION_RATE || kind == KIND_VELOCITY_RATE; }

/* ---- MuJoCo's errors would end the process; during calls from here they return to `guard`.
 * ---- */

static __thread Engine *watched;
static __thread jmp_buf guard;

static void keep_message(const mjLogMessage *message)
{
    if (watched && message->level >= mjLOG_WARNING) {
        char *text = watched->trouble;
        snprintf(text, sizeof watched->trouble, "MuJoCo says: %.*s", (int)sizeof watched->trouble - 32, message->subject);
        for (char *at = text; *at; at++)
            if (*at == '%' || *at == '\n') *at = ' '; /* FMI 2.0's logger formats the text again */
        for (size_t end = strlen(text); end > 0 && strchr(" .", text[end - 1]); end--) text[end - 1] = '\0';
    }
    if (message->level == mjLOG_ERROR) longjmp(guard, 1);
}

/* Run `part`, which returns an error text or NULL. Return 1 and set the engine's trouble after
 * an error, also one of MuJoCo. */
static int guarded(Model *m, const char *(*part)(Model *))
{
    const mjfLogHandler before = _mjPRIVATE_setTlsLogHandler(keep_message);
    volatile int failed = 1;
    watched = m->engine;
    if (setjmp(guard) == 0) {
        const char *wrong = part(m);
        if (wrong && wrong != m->engine->trouble) snprintf(m->engine->trouble, sizeof m->engine->trouble, "%s", wrong);
        failed = wrong != NULL;
    }
    watched = NULL;
    _mjPRIVATE_setTlsLogHandler(before);
    return failed;
}

static inline const char *model_trouble(const Model *m) { return m->engine->trouble; }

/* Return an error of MuJoCo's numbers, after which it would restart or omit contacts, or NULL. */
static inline const char *went_wrong(const mjData *data)
{
    const mjWarningStat *seen = data->warning;
    if (seen[mjWARN_BADQPOS].number || seen[mjWARN_BADQVEL].number || seen[mjWARN_BADQACC].number)
        return "a position, velocity or acceleration became infinite, not a number or huge (timestep too large?)";
    if (seen[mjWARN_BADCTRL].number) return "an input is beyond what MuJoCo takes";
    if (seen[mjWARN_CONTACTFULL].number || seen[mjWARN_CNSTRFULL].number)
        return "the model's memory holds no more contacts; give it more by <size memory=\"..\"/> and export it anew";
    return NULL;
}

/* ---- Begin and end. ---- */

/* Write the model's path below the resources, a path or FMI 2.0's URI. Return 0 if it is too
 * long. */
static inline int model_path(const char *at, char *path, size_t size)
{
    size_t length = 0;
    if (strncmp(at, "file://", 7) == 0) at += strcspn(at + 7, "/") + 7; /* after the host, which is empty or this one */
    else if (strncmp(at, "file:", 5) == 0) at += 5;
    for (unsigned int code; *at && length + 16 < size; at++) {
        const int coded = *at == '%' && sscanf(at + 1, "%2x", &code) == 1;
        path[length++] = coded ? (char)code : *at;
        at += 2 * coded;
    }
    snprintf(path + length, size - length, "/model.mjb");
    return length + 16 < size;
}

static const char *open_model(Model *m)
{
    Engine *engine = m->engine;
    engine->given = mj_loadModel(engine->path, NULL);
    if (!engine->given) return engine->trouble[0] ? engine->trouble : "MuJoCo says nothing";
    engine->model = mj_copyModel(NULL, engine->given);
    engine->data = mj_makeData(engine->model);
    engine->view = mj_makeData(engine->model);
    return NULL;
}

/* Open the engine of a new instance. Return NULL, or the reason of a failure as a clause. */
static inline const char *model_open(Model *m, const char *resources)
{
    static __thread char why[1400];
    char path[1024];
    Engine *engine = m->engine = calloc(1, sizeof *engine);
    if (!engine) return "out of memory";
    if (!resources || !resources[0]) return "the place of the resources is missing";
    if (!model_path(resources, path, sizeof path)) return "the path of the resources is too long";
    if (mj_version() != mjVERSION_HEADER) {
        snprintf(why, sizeof why, "the process has MuJoCo %s loaded, but the FMU needs " MUJOCO_VERSION ", which it carries; load it in a process of its own", mj_versionString());
        return why;
    }
    engine->path = path;
    if (guarded(m, open_model)) {
        snprintf(why, sizeof why, "%s cannot be loaded, so the FMU is damaged (%s)", path, engine->trouble);
        return why;
    }
    const mjModel *model = engine->model;
    if (model->nq != NQ || model->nv != NV || model->na != NA || model->nu != NU || model->nsensordata != NSENSORDATA
        || mj_stateSize(model, mjSTATE_INTEGRATION) != 1 + STATE_COUNT + REST_SIZE)
        return "resources/model.mjb belongs to another FMU";
    return engine->data && engine->view ? NULL : "out of memory";
}

static inline void model_close(Model *m)
{
    Engine *engine = m->engine;
    if (!engine) return;
    mj_deleteData(engine->data);
    mj_deleteData(engine->view);
    mj_deleteModel(engine->model);
    mj_deleteModel(engine->given);
    free(engine);
}

/* Copy the saved state; the engine stays and follows before its next use. */
static inline void model_copy(Model *to, const Model *from)
{
    Engine *engine = to->engine;
    memcpy(to, from, sizeof *to);
    to->engine = engine;
    if (engine) engine->loaded = 0;
}

/* ---- Values. ---- */

/* Place of a variable's number in a Model or a direction, NULL for the time. */
#define ENTRY(of, states, variable) entry_of(variable, states, (of)->rates, (of)->u, (of)->t, (of)->values)
static inline double *entry_of(const Variable *variable, double *x, double *rates, double *u, double *t, double *values)
{
    switch (variable->kind) {
    case KIND_POSITION:
    case KIND_VELOCITY: return x + variable->index;
    case KIND_POSITION_RATE:
    case KIND_VELOCITY_RATE: return rates + variable->index;
    case KIND_INPUT: return u + variable->index;
    case KIND_OUTPUT: return values + variable->index;
    case KIND_TIME: return NULL;
    default: return t + variable->index;
    }
}

static inline double model_value(const Model *m, const Variable *variable)
{
    Model *readable = (Model *)m;
    return variable->kind == KIND_TIME ? m->time : *ENTRY(readable, readable->state + 1, variable);
}

static inline void model_assign(Model *m, const Variable *variable, double value)
{
    double *entry = ENTRY(m, m->state + 1, variable);
    if (entry) *entry = value;
    m->internal_step = m->t[TIMESTEP];
    m->evaluated = 0;
    if (is_state(variable->kind) || is_setting(variable->kind)) m->engine->loaded = 0;
}

/* Set all values to their starts, with equal bytes for every fresh or reset instance except the
 * engine. */
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

/* Scale the contact properties of `n` geoms or pairs. MuJoCo's solref is (time constant, damping
 * ratio) or (-stiffness, -damping); the damping ratio is kept. Its solimp is (d0, dmax, ..),
 * with a compliance of 1 - d. A scale of 1 keeps all bits. */
static inline void scale_contacts(const double *t, int n, int frictions, double *friction, double *solref, double *solimp)
{
    const double stiffer = t[STIFFNESS_SCALE];
    for (int i = 0; i < n * frictions; i++) friction[i] *= t[FRICTION_SCALE];
    for (int i = 0; i < n; i++, solref += mjNREF, solimp += mjNIMP) {
        if (solref[0] > 0.0) solref[0] /= sqrt(stiffer);
        else solref[0] *= stiffer;
        if (solref[1] <= 0.0) solref[1] *= sqrt(stiffer);
        for (int k = 0; k < 2; k++) solimp[k] += (1.0 - solimp[k]) * (1.0 - t[GIVE_SCALE]);
    }
}

/* Apply the settings to the engine's model. */
static inline void apply_settings(const Model *m)
{
    static const int masses[] = MASS_BODIES;
    Engine *engine = m->engine;
    mjModel *model = engine->model;
    const double *t = m->t;
    if (!engine->applied || memcmp(engine->t, t, sizeof m->t) != 0) {
        int heavier = 0;
        mj_copyModel(model, engine->given);
        model->opt.integrator = (int)t[INTEGRATOR] - 1;
        memcpy(model->opt.gravity, t + GRAVITY, sizeof model->opt.gravity);
        scale_contacts(t, (int)model->ngeom, 3, model->geom_friction, model->geom_solref, model->geom_solimp);
        scale_contacts(t, (int)model->npair, 5, model->pair_friction, model->pair_solref, model->pair_solimp);
        for (int i = MASSES; i < NT; i++) {
            const int body = masses[i - MASSES];
            const double ratio = t[i] / model->body_mass[body];
            heavier |= ratio != 1.0;
            model->body_mass[body] = t[i];
            for (int k = 0; k < 3; k++) model->body_inertia[3 * body + k] *= ratio;
        }
        if (heavier) mj_setConst(model, engine->view);
        memcpy(engine->t, t, sizeof m->t);
        engine->applied = 1;
    }
    model->opt.timestep = m->internal_step; /* may be shortened by steps */
    model->opt.tolerance = engine->given->opt.tolerance;
    model->opt.disableflags = engine->given->opt.disableflags | mjDSBL_AUTORESET; /* infinite values are reported instead of a restart */
}

/* Load the Model's state and inputs into MuJoCo's data. */
static inline void load(const Model *m, mjData *data)
{
    apply_settings(m);
    mj_setState(m->engine->model, data, m->state, mjSTATE_INTEGRATION);
    if (!m->begun || m->frozen) data->time = m->time;
    memset(data->warning, 0, sizeof data->warning);
}

static inline int on_side(const Pair *pair, int side, int geom)
{
    return geom >= pair->first[side] && geom < pair->first[side] + pair->count[side];
}

/* Compute the sum of the normal forces [N] between both sides, and their smallest distance [m],
 * negative for an overlap, at most FARTHEST. */
static inline void look_at_pair(const mjModel *model, mjData *data, const Pair *pair, double *force, double *gap)
{
    *force = 0.0;
    *gap = FARTHEST;
    for (int i = 0; i < (int)data->ncon; i++) {
        const int *geom = data->contact[i].geom;
        mjtNum wrench[6];
        if (!(on_side(pair, 0, geom[0]) && on_side(pair, 1, geom[1])) && !(on_side(pair, 0, geom[1]) && on_side(pair, 1, geom[0]))) continue;
        mj_contactForce(model, data, i, wrench);
        *force += wrench[0];
        *gap = fmin(*gap, data->contact[i].dist);
    }
    for (int i = 0; i < pair->count[0] * pair->count[1]; i++)
        *gap = fmin(*gap, mj_geomDistance(model, data, pair->first[0] + i / pair->count[1], pair->first[1] + i % pair->count[1], FARTHEST, NULL));
}

/* Return whether steps of this length clip a time constant at twice their length (refsafe). */
static inline int cuts(const mjModel *a)
{
    const mjtNum *solref[] = {a->geom_solref, a->pair_solref, a->eq_solref, a->jnt_solref, a->dof_solref, a->tendon_solref_lim, a->tendon_solref_fri, a->opt.o_solref};
    const mjtSize count[] = {a->ngeom, a->npair, a->neq, a->njnt, a->nv, a->ntendon, a->ntendon, 1};
    for (int of = 0; of < 8; of++)
        for (const mjtNum *at = solref[of], *end = at + mjNREF * count[of]; at < end; at += mjNREF)
            if (*at > 0.0 && *at < 2.0 * a->opt.timestep) return 1;
    return 0;
}

/* Evaluate the state. MuJoCo's solver stops when its cost falls by less than opt.tolerance, too
 * early for differences of 1e-5; so it continues here. */
static inline void forward(Model *m, int flags)
{
    mjModel *model = m->engine->model;
    load(m, m->engine->view);
    model->opt.disableflags |= flags;
    model->opt.tolerance = fmin(model->opt.tolerance, EXACT);
    memcpy(m->engine->view->ctrl, m->u, NU * sizeof *m->u);
    mj_forward(model, m->engine->view);
}

/* Mix four small numbers into all bits (SplitMix64). */
static inline unsigned long long mixed(int a, int b, int c, int d)
{
    unsigned long long z = (((unsigned long long)(unsigned)a * 0x9E3779B97F4A7C15u + (unsigned)b) * 0xBF58476D1CE4E5B9u + (unsigned)c) * 0x94D049BB133111EBu + (unsigned)d;
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
    return z ^ (z >> 31);
}

static inline int side_of(double value, const mjtNum range[2], int strictly)
{
    return strictly ? (value > range[1]) - (value < range[0]) : (value >= range[1]) - (value <= range[0]);
}

/* Identify the smooth piece of the equations at a point, as a sum independent of the order:
 * existing constraints (a contact by its geoms), which press, stick or slide, which controls and
 * forces are clipped, the side of a tendon's dead band and its wrapping. */
static inline unsigned long long piece_of(const mjModel *model, const mjData *data)
{
    unsigned long long sum = 0;
    for (int i = 0; i < (int)data->nefc; i++) {
        const int is_contact = data->efc_type[i] >= mjCNSTR_CONTACT_FRICTIONLESS, id = data->efc_id[i];
        const mjContact *contact = is_contact ? &data->contact[id] : NULL;
        sum += mixed(data->efc_type[i] * 16 + data->efc_state[i], contact ? contact->geom[0] : id, contact ? contact->geom[1] : -1, contact ? i - contact->efc_address : 0);
    }
    for (int i = 0; i < NU; i++)
        if (model->actuator_ctrllimited[i] && !(model->opt.disableflags & mjDSBL_CLAMPCTRL))
            sum += mixed(-1, i, side_of(data->ctrl[i], model->actuator_ctrlrange + 2 * i, 1), 0);
    for (int i = 0; i < (int)model->nactuator && model->nout == model->nactuator; i++)
        if (model->actuator_forcelimited[i]) sum += mixed(-2, i, side_of(data->actuator_force[i], model->actuator_forcerange + 2 * i, 0), 0);
    for (int i = 0; i < (int)model->ntendon; i++)
        sum += mixed(-3, i, side_of(data->ten_length[i], model->tendon_lengthspring + 2 * i, 1), data->ten_wrapnum[i]);
    return sum;
}

/* Rates are the limit of ever smaller steps, without clipped time constants; sensors are those
 * of the actual steps, once there are steps. */
static const char *evaluate(Model *m)
{
    static const Pair pairs[] = PAIRS;
    const mjModel *model = m->engine->model;
    mjData *view = m->engine->view;
    forward(m, mjDSBL_REFSAFE);
    m->piece = piece_of(model, view);
    memcpy(m->rates + NQ, view->qacc, NV * sizeof *m->rates);
    memcpy(m->rates + NQ + NV, view->act_dot, NA * sizeof *m->rates);
    for (int joint = 0; joint < (int)model->njnt; joint++) {
        const int type = model->jnt_type[joint], lines = type == mjJNT_FREE ? 3 : type == mjJNT_BALL ? 0 : 1;
        const double *q = m->state + 1 + model->jnt_qposadr[joint], *v = view->qvel + model->jnt_dofadr[joint];
        double *rate = m->rates + model->jnt_qposadr[joint];
        memcpy(rate, v, lines * sizeof *v);
        if (NQ == NV || (type != mjJNT_FREE && type != mjJNT_BALL)) continue; /* no quaternion */
        const double half[3] = {0.5 * v[lines], 0.5 * v[lines + 1], 0.5 * v[lines + 2]};
        mju_mulQuatAxis(rate + lines, q + lines, half); /* dq/dt = q (0, w) / 2, w in body axes */
    }
    if (m->begun && cuts(model)) {
        forward(m, 0);
        m->piece = 3 * m->piece + piece_of(model, view);
    }
    memcpy(m->values, view->sensordata, NSENSORDATA * sizeof *m->values);
    for (int i = 0; i < NPAIRS; i++) look_at_pair(model, view, &pairs[i], &m->values[NSENSORDATA + i], &m->values[NSENSORDATA + NPAIRS + i]);
    return went_wrong(view);
}

/* Compute values and rates. Return 1 and set the engine's trouble if MuJoCo fails. */
static inline int model_evaluate(Model *m)
{
    if (!m->evaluated) m->evaluated = !guarded(m, evaluate);
    return !m->evaluated;
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

/* ---- Derivatives: differences over steps of DIFFERENCE and half of it, extrapolated: central,
 * or one-sided if a contact opens, closes or begins to slide on the other side. With such a kink
 * on both sides the steps shrink to SMALLEST_DIFFERENCE; below, the solver's relative error of
 * 1e-12 would exceed the 5e-5 that `check` allows. Closer to a kink the result is the mean of
 * two derivatives. ---- */

#define DIFFERENCE 1e-5
#define SMALLEST_DIFFERENCE 1e-7

static inline void time_direction(const Model *m, Tangent *d) { memcpy(d->x, m->rates, sizeof m->rates); }
static inline double *known_entry(const Variable *variable, Tangent *d) { return ENTRY(d, d->x, variable); }
static inline double model_value_tangent(const Model *m, Tangent *d, const Variable *variable) { return (void)m, *ENTRY(d, d->x, variable); }

/* Samples of a direction, at these shares of a step. */
enum { HERE, AHEAD, BEHIND, HALF_AHEAD, HALF_BEHIND, SAMPLES };

/* Complete a direction with given x and u at an evaluated Model. Return 1 and set the engine's
 * trouble if MuJoCo fails. */
static inline int model_tangent(const Model *m, Tangent *d)
{
    static const double share[SAMPLES] = {0.0, 1.0, -1.0, 0.5, -0.5};
    static const double central[SAMPLES] = {0.0, -1.0 / 6.0, 1.0 / 6.0, 4.0 / 3.0, -4.0 / 3.0}, from_here[SAMPLES] = {-3.0, -1.0, 0.0, 4.0, 0.0},
                        to_here[SAMPLES] = {3.0, 0.0, 1.0, 0.0, -4.0};
    double size = 0.0, values[SAMPLES][ROOM(VALUES)], rates[SAMPLES][ROOM(STATE_COUNT)];
    for (int i = 0; i < STATE_COUNT; i++) size = fmax(size, fabs(d->x[i]));
    for (int i = 0; i < NU; i++) size = fmax(size, fabs(d->u[i]));
    if (!(size > 0.0)) return 0;
    const double *weight = NULL;
    double h = 0.0;
    for (double step = DIFFERENCE; !weight; step /= 10.0) {
        int bent[SAMPLES] = {0};
        h = step / size;
        for (int n = 0; n < SAMPLES; n++) {
            Model at = *m;
            for (int i = 0; i < STATE_COUNT; i++) at.state[1 + i] += share[n] * h * d->x[i];
            for (int i = 0; i < NU; i++) at.u[i] += share[n] * h * d->u[i];
            if (n != HERE) at.evaluated = 0;
            if (model_evaluate(&at)) return 1;
            bent[n] = at.piece != m->piece;
            memcpy(values[n], at.values, sizeof at.values);
            memcpy(rates[n], at.rates, sizeof at.rates);
        }
        const int ahead = bent[AHEAD] || bent[HALF_AHEAD], behind = bent[BEHIND] || bent[HALF_BEHIND];
        if (ahead != behind) weight = ahead ? to_here : from_here;
        else if (!ahead || step < 2.0 * SMALLEST_DIFFERENCE) weight = central;
    }
    for (int n = 0; n < SAMPLES; n++) {
        if (weight[n] == 0.0) continue;
        for (int i = 0; i < VALUES; i++) d->values[i] += weight[n] / h * values[n][i];
        for (int i = 0; i < STATE_COUNT; i++) d->rates[i] += weight[n] / h * rates[n][i];
    }
    return 0;
}

/* There are no adjoints. */
static inline int model_adjoint(const Model *m, Tangent *bar)
{
    snprintf(m->engine->trouble, sizeof m->engine->trouble, "adjoint derivatives are not offered");
    return (void)bar, 1;
}

static inline void model_value_adjoint(const Model *m, double weight, const Variable *variable, Tangent *bar) { (void)m, (void)weight, (void)variable, (void)bar; }

#endif
