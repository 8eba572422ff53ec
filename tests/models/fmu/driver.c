/* Calls an FMU from C, statically linked, so that sanitizers see every access: both types, saved states, errors, two models
 * in one program. Prints nothing and returns 0 if all is well, else the line that failed. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "fmi2FunctionTypes.h"
#include "names.h" /* #define fmi2DoStep <prefix>fmi2DoStep, and its declaration, for every function used */

#define EXPECT(condition)    \
    do {                     \
        if (!(condition)) {  \
            printf("line %d: %s\n", __LINE__, #condition); \
            return 1;        \
        }                    \
    } while (0)

static int sentences;

static void logger(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category, fmi2String message, ...)
{
    (void)environment;
    (void)status;
    (void)category;
    if (name && message) sentences++;
}

static int co_simulation(const fmi2CallbackFunctions *callbacks)
{
    fmi2Component c = fmi2Instantiate("cs", fmi2CoSimulation, GUID, "", callbacks, fmi2False, fmi2False);
    EXPECT(c);
    EXPECT(fmi2SetupExperiment(c, fmi2False, 0.0, 0.0, fmi2True, STEPS * 0.01) == fmi2OK);
    EXPECT(fmi2EnterInitializationMode(c) == fmi2OK);
    EXPECT(fmi2ExitInitializationMode(c) == fmi2OK);
    fmi2FMUstate state = NULL;
    EXPECT(fmi2GetFMUstate(c, &state) == fmi2OK);
    size_t size = 0;
    EXPECT(fmi2SerializedFMUstateSize(c, state, &size) == fmi2OK && size > 0);
    fmi2Byte *bytes = malloc(size);
    EXPECT(bytes && fmi2SerializeFMUstate(c, state, bytes, size) == fmi2OK);
    EXPECT(fmi2SerializeFMUstate(c, state, bytes, size - 1) == fmi2Error);
    const fmi2ValueReference input = INPUT;
    for (int n = 0; n < STEPS; n++) {
        const fmi2Real push = n / 20 % 2 ? 0.0 : 9.0; /* enough to let friction slip and stick */
        EXPECT(INPUTS == 0 || fmi2SetReal(c, &input, 1, &push) == fmi2OK);
        EXPECT(fmi2DoStep(c, n * 0.01, 0.01, fmi2True) == fmi2OK);
    }
    EXPECT(fmi2DoStep(c, STEPS * 0.01, 0.01, fmi2True) == fmi2Error && sentences > 0);
    fmi2Real all[VARIABLES];
    fmi2ValueReference references[VARIABLES + 1];
    for (unsigned i = 0; i <= VARIABLES; i++) references[i] = i;
    EXPECT(fmi2GetReal(c, references, VARIABLES, all) == fmi2OK);
    EXPECT(fmi2GetReal(c, references + VARIABLES, 1, all) == fmi2Error);
    for (int i = 0; i < VARIABLES; i++) EXPECT(isfinite(all[i]));
    EXPECT(fmi2SetFMUstate(c, state) == fmi2OK);
    EXPECT(fmi2FreeFMUstate(c, &state) == fmi2OK && !state);
    EXPECT(fmi2DeSerializeFMUstate(c, bytes, size, &state) == fmi2OK);
    EXPECT(fmi2DeSerializeFMUstate(c, bytes, size - 1, &state) == fmi2Error);
    EXPECT(fmi2FreeFMUstate(c, &state) == fmi2OK && fmi2FreeFMUstate(c, &state) == fmi2OK);
    free(bytes);
    EXPECT(fmi2Reset(c) == fmi2OK);
    EXPECT(fmi2DoStep(c, 0.0, 0.01, fmi2True) == fmi2Error);
    fmi2FreeInstance(c);
    return 0;
}

static int model_exchange(const fmi2CallbackFunctions *callbacks)
{
    fmi2Component c = fmi2Instantiate("me", fmi2ModelExchange, GUID, "", callbacks, fmi2False, fmi2True);
    EXPECT(c);
    EXPECT(fmi2SetupExperiment(c, fmi2True, 1e-6, 0.0, fmi2False, 0.0) == fmi2OK);
    EXPECT(fmi2EnterInitializationMode(c) == fmi2OK && fmi2ExitInitializationMode(c) == fmi2OK);
    fmi2Real x[STATES], dx[STATES], gaps[INDICATORS + 1];
    for (int n = 0; n < STEPS; n++) {
        fmi2EventInfo info;
        EXPECT(fmi2NewDiscreteStates(c, &info) == fmi2OK);
        EXPECT(fmi2EnterContinuousTimeMode(c) == fmi2OK);
        EXPECT(fmi2GetContinuousStates(c, x, STATES) == fmi2OK && fmi2GetDerivatives(c, dx, STATES) == fmi2OK);
        EXPECT(fmi2GetEventIndicators(c, gaps, INDICATORS) == fmi2OK);
        for (int i = 0; i < STATES; i++) x[i] += 0.005 * dx[i];
        EXPECT(fmi2SetTime(c, 0.005 * (n + 1)) == fmi2OK && fmi2SetContinuousStates(c, x, STATES) == fmi2OK);
        EXPECT(fmi2SetContinuousStates(c, x, STATES + 1) == fmi2Error);
        fmi2Boolean enter, stop;
        EXPECT(fmi2CompletedIntegratorStep(c, fmi2True, &enter, &stop) == fmi2OK && !stop);
        EXPECT(fmi2EnterEventMode(c) == fmi2OK);
    }
    const fmi2ValueReference known[] = {1, 1 + STATES / 2};
    const fmi2Real seed[] = {1.0, -1.0};
    fmi2ValueReference unknown[2 * STATES];
    fmi2Real result[2 * STATES];
    for (unsigned i = 0; i < 2 * STATES; i++) unknown[i] = 1 + i;
    EXPECT(fmi2GetDirectionalDerivative(c, unknown, 2 * STATES, known, 2, seed, result) == fmi2OK);
    EXPECT(fmi2GetDirectionalDerivative(c, unknown, 0, known, 0, NULL, NULL) == fmi2OK);
    EXPECT(fmi2Terminate(c) == fmi2OK);
    fmi2FreeInstance(c);
    return 0;
}

int CHECK(void)
{
    const fmi2CallbackFunctions callbacks = {.logger = logger};
    EXPECT(!fmi2Instantiate("x", fmi2CoSimulation, "wrong", "", &callbacks, fmi2False, fmi2False));
    EXPECT(!fmi2Instantiate("x", fmi2CoSimulation, GUID, "", NULL, fmi2False, fmi2False));
    EXPECT(fmi2DoStep(NULL, 0.0, 0.1, fmi2True) == fmi2Error);
    fmi2FreeInstance(NULL);
    return co_simulation(&callbacks) || model_exchange(&callbacks);
}
