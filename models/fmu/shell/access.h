/* Getting and setting variables by value reference; directional and adjoint derivatives.
 * Version-free, see instance.h. */
#ifndef ACCESS_H
#define ACCESS_H

#include "instance.h"

/* As variable_of; the variable must have the requested type, integer or real. */
static inline const Variable *typed_variable(const Instance *self, const char *function, unsigned int reference, int integer)
{
    const Variable *variable = variable_of(self, function, reference);
    if (variable && is_integer(variable->kind) != integer) {
        FAIL(self, "%s: %s is %s.", function, variable->name, integer ? "a real variable" : "a whole number (an enumeration)");
        return NULL;
    }
    return variable;
}

/* Return whether one of these variables needs the model's results. Invalid references are
 * refused when read. */
static inline int any_calculated(const unsigned int *references, size_t count)
{
    for (size_t i = 0; i < count; i++)
        if (references[i] < VARIABLE_COUNT && is_calculated(MODEL_VARIABLES[references[i]].kind)) return 1;
    return 0;
}

/* Return the instance if its variables may be read now into `values`. */
static inline Instance *readable(void *instance, const char *function, const unsigned int *references, const void *values, size_t count)
{
    Instance *self = allowed(instance, function, PHASES_READABLE | PHASE_OUTPUT_UPDATE);
    if (!self) return NULL;
    if (count > 0 && (!references || !values)) {
        FAIL(self, "%s: the value references or the place for the values are missing.", function);
        return NULL;
    }
    return any_calculated(references, count) && evaluated(self) != STATUS_OK ? NULL : self;
}

/* Return the instance if variables may be set now from `values`. */
static inline Instance *writable(void *instance, const char *function, const void *references, const void *values, size_t count)
{
    Instance *self = allowed(instance, function, PHASES_STARTING | PHASES_RUNNING | PHASE_INPUT_UPDATE);
    if (!self) return NULL;
    if (count > 0 && (!references || !values)) {
        FAIL(self, "%s: the value references or the values are missing.", function);
        return NULL;
    }
    return self;
}

/* Log a sentence and return an error unless `reference` may be set to `value` now. */
static inline Status check_assignment(const Instance *self, const char *function, unsigned int reference, double value, int integer)
{
    const Variable *variable = typed_variable(self, function, reference, integer);
    if (!variable) return STATUS_ERROR;
    const VariableKind kind = variable->kind;
    const int phases = kind == KIND_INPUT ? PHASES_STARTING | PHASES_RUNNING | PHASE_INPUT_UPDATE
        : is_setting(kind)                ? PHASES_STARTING | PHASE_EVENT | PHASE_STEP_COMPLETE
        : is_state(kind)                  ? PHASES_STARTING | PHASE_CONTINUOUS /* instead of SetContinuousStates */
        : kind == KIND_PARAMETER          ? PHASES_STARTING
                                          : 0;
    if (!phases) return FAIL(self, "%s: %s is calculated and cannot be set.", function, variable->name);
    if (!(self->model.phase & phases)) return FAIL(self, "%s: %s cannot be set in the state '%s'.", function, variable->name, phase_name(self->model.phase));
    if (!isfinite(value)) return FAIL(self, "%s: the value given to %s is not a finite number.", function, variable->name);
    /* Inputs may exceed their range, which belongs to the actuator; judging that is not the
     * model's task. */
    if (kind != KIND_INPUT && !(value >= variable->lower && value <= variable->upper))
        return FAIL(self, "%s: %g lies outside the range [%g, %g] of %s.", function, value, variable->lower, variable->upper, variable->name);
    return STATUS_OK;
}

/* Do nothing: the model has no variables of this type. */
static inline Status no_variables(void *instance, const char *function, const char *type, size_t count)
{
    Instance *self = allowed(instance, function, PHASES_ALL);
    if (!self) return STATUS_ERROR;
    return count == 0 ? STATUS_OK : FAIL(self, "%s: the model has no variables of type %s.", function, type);
}

/* Value references of real variables, in both standards' type, and their values. */
typedef struct {
    const unsigned int *references;
    size_t count;
} References;

static inline Status get_reals(void *instance, const char *function, References of, double *values)
{
    Instance *self = readable(instance, function, of.references, values, of.count);
    if (!self) return STATUS_ERROR;
    for (size_t i = 0; i < of.count; i++) {
        const Variable *variable = typed_variable(self, function, of.references[i], 0);
        if (!variable) return STATUS_ERROR;
        values[i] = model_value(&self->model, variable);
    }
    return STATUS_OK;
}

static inline Status set_reals(void *instance, const char *function, References of, const double *values)
{
    Instance *self = writable(instance, function, of.references, values, of.count);
    if (!self) return STATUS_ERROR;
    for (size_t i = 0; i < of.count; i++)
        if (check_assignment(self, function, of.references[i], values[i], 0) != STATUS_OK) return STATUS_ERROR;
    for (size_t i = 0; i < of.count; i++) model_assign(&self->model, &MODEL_VARIABLES[of.references[i]], values[i]);
    return STATUS_OK;
}

/* Return whether the variable may be a seed: states and inputs, and parameters in
 * `parameter_phases`; else log. */
static inline Status check_known(const Instance *self, const char *function, const Variable *variable, int parameter_phases)
{
    const VariableKind kind = variable->kind;
    if (is_state(kind) || kind == KIND_INPUT) return STATUS_OK;
    if (kind == KIND_PARAMETER && self->model.phase & parameter_phases) return STATUS_OK;
    return FAIL(self, "%s: %s is not a known in the state '%s'; states and inputs are, and parameters %s.", function, variable->name,
        phase_name(self->model.phase), parameter_phases == PHASE_INITIALIZATION ? "during initialization" : "too");
}

static inline Status check_unknown(const Instance *self, const char *function, const Variable *variable)
{
    const VariableKind kind = variable->kind;
    if (kind == KIND_TIME || kind == KIND_INPUT || kind == KIND_PARAMETER || is_setting(kind))
        return FAIL(self, "%s: %s is given, not an unknown.", function, variable->name);
    return STATUS_OK;
}

/* A product with the Jacobian J of unknowns by knowns: seed in, result out. */
typedef struct {
    References unknowns, knowns;
    const double *seed;
    size_t seeds;
    double *result;
    size_t results;
    int parameter_phases; /* phases in which parameters are knowns */
} JacobianProduct;

/* Return the instance if all arguments of the product are valid. */
static inline Instance *differentiable(void *instance, const char *function, const JacobianProduct *product, size_t seeds, size_t results)
{
    Instance *self = allowed(instance, function, PHASES_READABLE);
    if (!self) return NULL;
    const References unknowns = product->unknowns, knowns = product->knowns;
    if ((unknowns.count > 0 && !unknowns.references) || (knowns.count > 0 && !knowns.references) || (seeds > 0 && !product->seed)
        || (results > 0 && !product->result)) {
        FAIL(self, "%s: value references, seeds or the place for the result are missing.", function);
        return NULL;
    }
    if (product->seeds != seeds || product->results != results) {
        FAIL(self, "%s: %lu seeds and room for %lu results are needed, but %lu and %lu were given.", function, (unsigned long)seeds,
            (unsigned long)results, (unsigned long)product->seeds, (unsigned long)product->results);
        return NULL;
    }
    for (size_t i = 0; i < knowns.count; i++) {
        const Variable *variable = variable_of(self, function, knowns.references[i]);
        if (!variable || check_known(self, function, variable, product->parameter_phases) != STATUS_OK) return NULL;
    }
    for (size_t i = 0; i < unknowns.count; i++) {
        const Variable *variable = variable_of(self, function, unknowns.references[i]);
        if (!variable || check_unknown(self, function, variable) != STATUS_OK) return NULL;
    }
    return evaluated(self) == STATUS_OK ? self : NULL;
}

/* result = J seed */
static inline Status directional_derivative(void *instance, const char *function, const JacobianProduct *product)
{
    const References unknowns = product->unknowns, knowns = product->knowns;
    Instance *self = differentiable(instance, function, product, knowns.count, unknowns.count);
    if (!self) return STATUS_ERROR;
    Tangent tangent;
    memset(&tangent, 0, sizeof tangent);
    for (size_t i = 0; i < knowns.count; i++) *known_entry(&MODEL_VARIABLES[knowns.references[i]], &tangent) += product->seed[i];
    if (model_tangent(&self->model, &tangent)) return FAIL(self, "%s: %s.", function, model_trouble(&self->model));
    for (size_t i = 0; i < unknowns.count; i++)
        product->result[i] = model_value_tangent(&self->model, &tangent, &MODEL_VARIABLES[unknowns.references[i]]);
    return STATUS_OK;
}

/* result = J' seed */
static inline Status adjoint_derivative(void *instance, const char *function, const JacobianProduct *product)
{
    const References unknowns = product->unknowns, knowns = product->knowns;
    Instance *self = differentiable(instance, function, product, unknowns.count, knowns.count);
    if (!self) return STATUS_ERROR;
    Tangent adjoint;
    memset(&adjoint, 0, sizeof adjoint);
    for (size_t i = 0; i < unknowns.count; i++)
        model_value_adjoint(&self->model, product->seed[i], &MODEL_VARIABLES[unknowns.references[i]], &adjoint);
    if (model_adjoint(&self->model, &adjoint)) return FAIL(self, "%s: %s.", function, model_trouble(&self->model));
    for (size_t i = 0; i < knowns.count; i++) product->result[i] = *known_entry(&MODEL_VARIABLES[knowns.references[i]], &adjoint);
    return STATUS_OK;
}

/* First time derivatives of variables; constant inputs have none. */
static inline Status output_derivatives(void *instance, const char *function, References of, const int *orders, double *values)
{
    const int phases = PHASE_STEP_COMPLETE | PHASE_TERMINATED | PHASE_ERROR | PHASE_OUTPUT_UPDATE;
    Instance *self = allowed_type(instance, function, phases, CO_SIMULATION);
    if (!self) return STATUS_ERROR;
    if (of.count > 0 && (!of.references || !orders || !values))
        return FAIL(self, "%s: value references, orders or the place for the values are missing.", function);
    if (of.count > 0 && evaluated(self) != STATUS_OK) return STATUS_ERROR;
    Tangent tangent; /* the direction of time */
    memset(&tangent, 0, sizeof tangent);
    time_direction(&self->model, &tangent);
    if (model_tangent(&self->model, &tangent)) return FAIL(self, "%s: %s.", function, model_trouble(&self->model));
    for (size_t i = 0; i < of.count; i++) {
        const Variable *variable = typed_variable(self, function, of.references[i], 0);
        if (!variable) return STATUS_ERROR;
        if (orders[i] != 1) return FAIL(self, "%s: order %d was asked of %s; only the first derivative is supported.", function, orders[i], variable->name);
        values[i] = model_value_tangent(&self->model, &tangent, variable);
    }
    return STATUS_OK;
}

#endif
