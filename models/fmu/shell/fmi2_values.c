/* FMI 2.0: getting and setting variables by value reference, and directional derivatives. */
#include "access.h"
#include "fmi2_instance.h"

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[])
{
    return said(get_reals(c, "fmi2GetReal", (References){vr, nvr}, value));
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Real value[])
{
    return said(set_reals(c, "fmi2SetReal", (References){vr, nvr}, value));
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Integer value[])
{
    const Instance *self = readable(c, "fmi2GetInteger", vr, value, nvr);
    if (!self) return fmi2Error;
    for (size_t i = 0; i < nvr; i++) {
        const Variable *variable = typed_variable(self, "fmi2GetInteger", vr[i], 1);
        if (!variable) return fmi2Error;
        value[i] = (fmi2Integer)model_value(&self->model, variable);
    }
    return fmi2OK;
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Integer value[])
{
    Instance *self = writable(c, "fmi2SetInteger", vr, value, nvr);
    if (!self) return fmi2Error;
    for (size_t i = 0; i < nvr; i++)
        if (check_assignment(self, "fmi2SetInteger", vr[i], (double)value[i], 1) != STATUS_OK) return fmi2Error;
    for (size_t i = 0; i < nvr; i++) model_assign(&self->model, &MODEL_VARIABLES[vr[i]], (double)value[i]);
    return fmi2OK;
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Boolean value[])
{
    (void)vr;
    (void)value;
    return said(no_variables(c, "fmi2GetBoolean", "Boolean", nvr));
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Boolean value[])
{
    (void)vr;
    (void)value;
    return said(no_variables(c, "fmi2SetBoolean", "Boolean", nvr));
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2String value[])
{
    (void)vr;
    (void)value;
    return said(no_variables(c, "fmi2GetString", "String", nvr));
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2String value[])
{
    (void)vr;
    (void)value;
    return said(no_variables(c, "fmi2SetString", "String", nvr));
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[], size_t nUnknown,
    const fmi2ValueReference vKnown_ref[], size_t nKnown, const fmi2Real dvKnown[], fmi2Real dvUnknown[])
{
    const JacobianProduct product = {.unknowns = {vUnknown_ref, nUnknown}, .knowns = {vKnown_ref, nKnown}, .seed = dvKnown, .seeds = nKnown,
        .result = dvUnknown, .results = nUnknown, .parameter_phases = PHASE_INITIALIZATION};
    return said(directional_derivative(c, "fmi2GetDirectionalDerivative", &product));
}
