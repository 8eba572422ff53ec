/* One instance of a scene's model, independent of FMI: values, contact modes, numbering of
 * variables.
 *
 * Model is a flat struct: copying its bytes copies the state, for get/set/serialise of an FMU
 * state. Arrays have at least one entry, because C has no empty arrays. */
#ifndef MODEL_H
#define MODEL_H

#include <math.h>
#include <string.h>

/* Inlined at every call: forces and the solve within an acceleration, forces in known modes. gcc
 * at -O2 does not inline them, which costs two_finger 7 % of the instructions in Model Exchange
 * and 4 % in Co-Simulation. */
#if defined(__GNUC__)
#define SCENE_INLINE static inline __attribute__((always_inline, unused))
#endif
#include "scene_model.h"
#include "scene_sensitivity.h"

#define INPUTS_SLOPE 1 /* whether inputs may follow a derivative over a communication step */

/* Rows of lam hold the contact forces, then the friction forces; modes and event indicators
 * likewise. */
#ifdef DAMPING
#define NL (NC + NF + ND) /* then the damped contacts: damping_modes.h */
#else
#define NL (NC + NF)
#endif

typedef enum {
    KIND_TIME,
    KIND_POSITION,
    KIND_VELOCITY,
    KIND_POSITION_RATE,
    KIND_VELOCITY_RATE,
    KIND_INPUT,
    KIND_PARAMETER,
    KIND_FORCE,
    KIND_GAP,
    KIND_SLIP,
    KIND_RESERVE,
#ifdef DAMPING
    KIND_PRESSING,
#endif
    KIND_KINETIC_ENERGY,
    KIND_POTENTIAL_ENERGY,
    KIND_CONTACT_ENERGY,
    KIND_INPUT_POWER,
    KIND_DISSIPATED_POWER,
    KIND_INTERNAL_STEP,
    KIND_INTEGRATOR
} VariableKind;

/* Methods of Co-Simulation; values of the variable `integrator`. */
typedef enum { EXPLICIT_EULER = 1, SEMI_IMPLICIT_EULER, HEUN, RUNGE_KUTTA } Integrator;

#include "variable.h"
#include "model_config.h" /* MODEL_GUID, MODEL_VARIABLES, VARIABLE_COUNT, STATE_NOMINALS, CONTACT_NOMINALS, FRICTION_NOMINALS */

typedef struct {
    double time;
    double q[NQ], v[NQ];
    double u[ROOM(NU)];
    double u_rate[ROOM(NU)]; /* du/dt during the next communication step */
    double p[ROOM(NP)];
    double internal_step;
    int integrator; /* an Integrator */
    double start_time, stop_time;
    double phi[ROOM(NC)], k[ROOM(NC)], lam[ROOM(NL)], a[NQ]; /* valid while `evaluated` */
    int modes[ROOM(NL)]; /* contacts: closed or not; frictions: friction_modes.h */
    int frozen; /* modes change in event mode only, else by the true law */
    int evaluated;
    int stop_defined;
    int phase; /* of the FMI state machine; part of the saved state */
} Model;

/* A direction in the space of all arguments of the model, and its results. As an adjoint: the
 * derivatives of one number by all of these. */
typedef struct {
    double q[NQ], v[NQ], u[ROOM(NU)], p[ROOM(NP)];
    double phi[ROOM(NC)], k[ROOM(NC)], lam[ROOM(NL)], a[NQ];
} Tangent;

/* A point of the motion, for the integrator. */
typedef struct {
    double q[NQ], v[NQ];
} Point;

static inline int is_integer(VariableKind kind)
{
    return kind == KIND_INTEGRATOR;
}

static inline int is_state(VariableKind kind)
{
    return kind == KIND_POSITION || kind == KIND_VELOCITY;
}

static inline int is_setting(VariableKind kind)
{
    return kind == KIND_INTERNAL_STEP || kind == KIND_INTEGRATOR;
}

/* Return whether reading needs an evaluated Model: always, because modes follow from the state. */
static inline int is_calculated(VariableKind kind)
{
    return (void)kind, 1;
}

/* A scene has no resources of one instance: nothing to open. */
static inline const char *model_open(Model *m, const char *resources)
{
    return (void)m, (void)resources, NULL;
}

static inline void model_close(Model *m)
{
    (void)m;
}

static inline void model_copy(Model *to, const Model *from)
{
    memcpy(to, from, sizeof *to);
}

/* Return the failed evaluation as a clause. */
static inline const char *model_trouble(const Model *m)
{
    return (void)m, "the mass matrix is not positive definite; check the masses and lengths";
}

/* Continuous states: positions, then velocities. */
#define STATE_COUNT (2 * NQ)

static inline void model_states(const Model *m, double *x)
{
    memcpy(x, m->q, sizeof m->q);
    memcpy(x + NQ, m->v, sizeof m->v);
}

static inline void model_set_states(Model *m, const double *x)
{
    memcpy(m->q, x, sizeof m->q);
    memcpy(m->v, x + NQ, sizeof m->v);
    m->evaluated = 0;
}

/* Compute the state derivatives of an evaluated Model. */
static inline void model_rates(const Model *m, double *rates)
{
    memcpy(rates, m->v, sizeof m->v);
    memcpy(rates + NQ, m->a, sizeof m->a);
}

/* Compute the direction of time of an evaluated Model. */
static inline void time_direction(const Model *m, Tangent *tangent)
{
    memcpy(tangent->q, m->v, sizeof m->v);
    memcpy(tangent->v, m->a, sizeof m->a);
}

/* Set all values to their starts, with equal bytes for every fresh or reset instance. */
static inline void model_start(Model *m)
{
    memset(m, 0, sizeof *m);
    for (int i = 0; i < VARIABLE_COUNT; i++) {
        const Variable *variable = &MODEL_VARIABLES[i];
        switch (variable->kind) {
        case KIND_POSITION: m->q[variable->index] = variable->start; break;
        case KIND_VELOCITY: m->v[variable->index] = variable->start; break;
        case KIND_INPUT: m->u[variable->index] = variable->start; break;
        case KIND_PARAMETER: m->p[variable->index] = variable->start; break;
        case KIND_INTERNAL_STEP: m->internal_step = variable->start; break;
        case KIND_INTEGRATOR: m->integrator = (int)variable->start; break;
        default: break;
        }
    }
}

#endif
