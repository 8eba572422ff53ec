/* FMI 3.0: getting and setting variables by value reference, directional and adjoint derivatives. */
#include "access.h"
#include "fmi3_instance.h"

/* Every variable is a scalar: as many values as value references. */
static int as_many(fmi3Instance instance, const char *function, size_t references, size_t values)
{
    if (references == values) return 1;
    not_offered(instance, function, "the model has scalars only, so as many values as value references are needed");
    return 0;
}

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference vr[], size_t nvr, fmi3Float64 values[], size_t nValues)
{
    if (!as_many(instance, "fmi3GetFloat64", nvr, nValues)) return fmi3Error;
    return said(get_reals(instance, "fmi3GetFloat64", (References){vr, nvr}, values));
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference vr[], size_t nvr, const fmi3Float64 values[], size_t nValues)
{
    if (!as_many(instance, "fmi3SetFloat64", nvr, nValues)) return fmi3Error;
    return said(set_reals(instance, "fmi3SetFloat64", (References){vr, nvr}, values));
}

/* Enumerations are got and set as Int64. */
fmi3Status fmi3GetInt64(fmi3Instance instance, const fmi3ValueReference vr[], size_t nvr, fmi3Int64 values[], size_t nValues)
{
    if (!as_many(instance, "fmi3GetInt64", nvr, nValues)) return fmi3Error;
    const Instance *self = readable(instance, "fmi3GetInt64", vr, values, nvr);
    if (!self) return fmi3Error;
    for (size_t i = 0; i < nvr; i++) {
        const Variable *variable = typed_variable(self, "fmi3GetInt64", vr[i], 1);
        if (!variable) return fmi3Error;
        values[i] = (fmi3Int64)model_value(&self->model, variable);
    }
    return fmi3OK;
}

fmi3Status fmi3SetInt64(fmi3Instance instance, const fmi3ValueReference vr[], size_t nvr, const fmi3Int64 values[], size_t nValues)
{
    if (!as_many(instance, "fmi3SetInt64", nvr, nValues)) return fmi3Error;
    Instance *self = writable(instance, "fmi3SetInt64", vr, values, nvr);
    if (!self) return fmi3Error;
    for (size_t i = 0; i < nvr; i++)
        if (check_assignment(self, "fmi3SetInt64", vr[i], (double)values[i], 1) != STATUS_OK) return fmi3Error;
    for (size_t i = 0; i < nvr; i++) model_assign(&self->model, &MODEL_VARIABLES[vr[i]], (double)values[i]);
    return fmi3OK;
}

/* Both derivatives know the parameters at all times: FMI 3.0 counts them among the knowns of every mode. */
static JacobianProduct product_of(const fmi3ValueReference unknowns[], size_t nUnknowns, const fmi3ValueReference knowns[], size_t nKnowns,
    const fmi3Float64 seed[], size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity)
{
    return (JacobianProduct){.unknowns = {unknowns, nUnknowns}, .knowns = {knowns, nKnowns}, .seed = seed, .seeds = nSeed, .result = sensitivity,
        .results = nSensitivity, .parameter_phases = PHASES_READABLE};
}

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[], size_t nUnknowns, const fmi3ValueReference knowns[],
    size_t nKnowns, const fmi3Float64 seed[], size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity)
{
    const JacobianProduct product = product_of(unknowns, nUnknowns, knowns, nKnowns, seed, nSeed, sensitivity, nSensitivity);
    return said(directional_derivative(instance, "fmi3GetDirectionalDerivative", &product));
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[], size_t nUnknowns, const fmi3ValueReference knowns[],
    size_t nKnowns, const fmi3Float64 seed[], size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity)
{
    const JacobianProduct product = product_of(unknowns, nUnknowns, knowns, nKnowns, seed, nSeed, sensitivity, nSensitivity);
    return said(adjoint_derivative(instance, "fmi3GetAdjointDerivative", &product));
}
