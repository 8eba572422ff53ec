/* One instance of a scene's model, without any FMI in it: values, contact modes, and which variable is which.
 *
 * Model is a flat struct: copying its bytes copies the state, which is all that get/set/serialise of an FMU state needs.
 * Arrays have room for at least one entry, because C has no empty arrays and a scene may have no inputs or contacts.
 */
#ifndef MODEL_H
#define MODEL_H

#include <math.h>
#include <string.h>

/* Inlined wherever it is called: forces and the solve within an acceleration, forces in modes that the caller knows. At -O2 gcc leaves
 * that, which costs two_finger 7 % of the instructions of Model Exchange and 4 % of those of Co-Simulation. */
#if defined(__GNUC__)
#define SCENE_INLINE static inline __attribute__((always_inline, unused))
#endif
#include "scene_model.h"
#include "scene_sensitivity.h"

#define INPUTS_SLOPE 1 /* whether they may follow a derivative over a communication step */

/* Rows of lam hold the contact forces, then the friction forces; rows of modes and event indicators likewise. */
#ifdef DAMPING
#define NL (NC + NF + ND) /* and then those of the damped contacts: damping_modes.h */
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

/* How Co-Simulation integrates; the values of the variable `integrator`. */
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
    double phi[ROOM(NC)], k[ROOM(NC)], lam[ROOM(NL)], a[NQ]; /* belong to the values above while `evaluated` */
    int modes[ROOM(NL)];  /* contacts: closed or not; frictions: see friction_modes.h */
    int frozen;           /* modes change in event mode only; otherwise they follow the true law */
    int evaluated;
    int stop_defined;
    int phase; /* of the FMI state machine; here because it belongs to what is saved and restored */
} Model;

/* A direction in the space of everything the model depends on, and what follows from it. As an adjoint: the derivatives of
 * one number with respect to all of these. */
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

/* Whether reading it needs an evaluated Model: here all do, as modes follow from the state. */
static inline int is_calculated(VariableKind kind)
{
    return (void)kind, 1;
}

/* A scene needs nothing but its bytes: there is nothing to open, and nothing that belongs to one instance alone. */
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

/* Why an evaluation failed, in the middle of a sentence. */
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

/* Their derivatives, of an evaluated Model. */
static inline void model_rates(const Model *m, double *rates)
{
    memcpy(rates, m->v, sizeof m->v);
    memcpy(rates + NQ, m->a, sizeof m->a);
}

/* The direction in which time moves an evaluated Model. */
static inline void time_direction(const Model *m, Tangent *tangent)
{
    memcpy(tangent->q, m->v, sizeof m->v);
    memcpy(tangent->v, m->a, sizeof m->a);
}

/* All values at their starts; equal bytes for every fresh or reset instance. */
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
