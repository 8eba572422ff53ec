/* FMI 2.0: getting and setting variables by value reference, and directional derivatives. */
#include "fmi2_instance.h"

static int is_start_value(VariableKind kind)
{
    return kind == KIND_POSITION || kind == KIND_VELOCITY || kind == KIND_PARAMETER;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[])
{
    Instance *self = allowed(c, "fmi2GetReal", PHASES_READABLE);
    if (!self) return fmi2Error;
    if (nvr > 0 && (!vr || !value)) return FAIL(self, "fmi2GetReal: the value references or the place for the values are missing.");
    if (nvr > 0 && evaluated(self) != fmi2OK) return fmi2Error;
    for (size_t i = 0; i < nvr; i++) {
        const Variable *variable = variable_of(self, "fmi2GetReal", vr[i]);
        if (!variable) return fmi2Error;
        value[i] = model_value(&self->model, variable);
    }
    return fmi2OK;
}

/* A sentence is logged and fmi2Error returned unless `variable` may be given `value` now. */
static fmi2Status check_assignment(const Instance *self, const Variable *variable, double value)
{
    const int starting = PHASE_INSTANTIATED | PHASE_INITIALIZATION;
    const VariableKind kind = variable->kind;
    const int phases = kind == KIND_INPUT ? starting | PHASES_RUNNING
        : kind == KIND_INTERNAL_STEP      ? starting | PHASE_EVENT | PHASE_STEP_COMPLETE
        : is_start_value(kind)            ? starting
                                          : 0;
    if (!phases) return FAIL(self, "fmi2SetReal: %s is calculated and cannot be set.", variable->name);
    if (!(self->model.phase & phases)) return FAIL(self, "fmi2SetReal: %s cannot be set in the state '%s'.", variable->name, phase_name(self->model.phase));
    if (!isfinite(value)) return FAIL(self, "fmi2SetReal: the value given to %s is not a finite number.", variable->name);
    /* Inputs may exceed their range: it is the actuator's, and judging that is not the model's business. */
    if (kind != KIND_INPUT && !(value >= variable->lower && value <= variable->upper))
        return FAIL(self, "fmi2SetReal: %g lies outside the range [%g, %g] of %s.", value, variable->lower, variable->upper, variable->name);
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Real value[])
{
    Instance *self = allowed(c, "fmi2SetReal", PHASE_INSTANTIATED | PHASE_INITIALIZATION | PHASES_RUNNING);
    if (!self) return fmi2Error;
    if (nvr > 0 && (!vr || !value)) return FAIL(self, "fmi2SetReal: the value references or the values are missing.");
    for (size_t i = 0; i < nvr; i++) {
        const Variable *variable = variable_of(self, "fmi2SetReal", vr[i]);
        if (!variable || check_assignment(self, variable, value[i]) != fmi2OK) return fmi2Error;
    }
    for (size_t i = 0; i < nvr; i++) model_assign(&self->model, &MODEL_VARIABLES[vr[i]], value[i]);
    return fmi2OK;
}

static fmi2Status no_variables(fmi2Component c, const char *function, const char *type, size_t nvr)
{
    Instance *self = allowed(c, function, PHASES_ALL);
    if (!self) return fmi2Error;
    return nvr == 0 ? fmi2OK : FAIL(self, "%s: the model has no variables of type %s.", function, type);
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Integer value[])
{
    (void)vr;
    (void)value;
    return no_variables(c, "fmi2GetInteger", "Integer", nvr);
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Boolean value[])
{
    (void)vr;
    (void)value;
    return no_variables(c, "fmi2GetBoolean", "Boolean", nvr);
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2String value[])
{
    (void)vr;
    (void)value;
    return no_variables(c, "fmi2GetString", "String", nvr);
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Integer value[])
{
    (void)vr;
    (void)value;
    return no_variables(c, "fmi2SetInteger", "Integer", nvr);
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Boolean value[])
{
    (void)vr;
    (void)value;
    return no_variables(c, "fmi2SetBoolean", "Boolean", nvr);
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2String value[])
{
    (void)vr;
    (void)value;
    return no_variables(c, "fmi2SetString", "String", nvr);
}

/* Put one known's seed into the tangent; an error if the variable is not a known in the present state. */
static fmi2Status seed(const Instance *self, const Variable *variable, double value, Tangent *tangent)
{
    const int i = variable->index;
    switch (variable->kind) {
    case KIND_POSITION: tangent->q[i] += value; return fmi2OK;
    case KIND_VELOCITY: tangent->v[i] += value; return fmi2OK;
    case KIND_INPUT: tangent->u[i] += value; return fmi2OK;
    case KIND_PARAMETER:
        if (self->model.phase != PHASE_INITIALIZATION) break;
        tangent->p[i] += value;
        return fmi2OK;
    default: break;
    }
    return FAIL(self, "fmi2GetDirectionalDerivative: %s is not a known in the state '%s'; states and inputs are, and parameters during initialization.",
        variable->name, phase_name(self->model.phase));
}

static int is_unknown(VariableKind kind)
{
    return kind != KIND_TIME && kind != KIND_INPUT && kind != KIND_PARAMETER && kind != KIND_INTERNAL_STEP;
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[], size_t nUnknown,
    const fmi2ValueReference vKnown_ref[], size_t nKnown, const fmi2Real dvKnown[], fmi2Real dvUnknown[])
{
    Instance *self = allowed(c, "fmi2GetDirectionalDerivative", PHASES_READABLE);
    if (!self) return fmi2Error;
    if ((nUnknown > 0 && (!vUnknown_ref || !dvUnknown)) || (nKnown > 0 && (!vKnown_ref || !dvKnown)))
        return FAIL(self, "fmi2GetDirectionalDerivative: value references, seeds or the place for the result are missing.");
    Tangent tangent;
    memset(&tangent, 0, sizeof tangent);
    for (size_t i = 0; i < nKnown; i++) {
        const Variable *variable = variable_of(self, "fmi2GetDirectionalDerivative", vKnown_ref[i]);
        if (!variable || seed(self, variable, dvKnown[i], &tangent) != fmi2OK) return fmi2Error;
    }
    if (evaluated(self) != fmi2OK) return fmi2Error;
    if (model_tangent(&self->model, &tangent)) return FAIL(self, "fmi2GetDirectionalDerivative: the mass matrix is not positive definite.");
    for (size_t i = 0; i < nUnknown; i++) {
        const Variable *variable = variable_of(self, "fmi2GetDirectionalDerivative", vUnknown_ref[i]);
        if (!variable) return fmi2Error;
        if (!is_unknown(variable->kind)) return FAIL(self, "fmi2GetDirectionalDerivative: %s is given, not an unknown.", variable->name);
        dvUnknown[i] = model_value_tangent(&self->model, &tangent, variable);
    }
    return fmi2OK;
}
