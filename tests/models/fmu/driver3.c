/* As driver.c, for FMI 3.0: both types, event mode and early return, intermediate update, saved states, derivatives, errors.
 * Prints nothing and returns 0 if all is well, else the line that failed. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "fmi3Functions.h" /* with FMI3_FUNCTION_PREFIX, so that several models fit into one program */

#define EXPECT(condition)    \
    do {                     \
        if (!(condition)) {  \
            printf("line %d: %s\n", __LINE__, #condition); \
            return 1;        \
        }                    \
    } while (0)

static int sentences, updates;

static void logger(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category, fmi3String message)
{
    (void)environment;
    (void)status;
    if (category && message) sentences++;
}

/* The environment is the place of the instance itself. */
static void update(fmi3InstanceEnvironment environment, fmi3Float64 time, fmi3Boolean may_set, fmi3Boolean may_get, fmi3Boolean finished,
    fmi3Boolean can_return, fmi3Boolean *early, fmi3Float64 *when)
{
    (void)can_return;
    fmi3Instance c = *(fmi3Instance *)environment;
    const fmi3ValueReference clock = 0;
    fmi3Float64 value = -1.0;
    if (may_get && fmi3GetFloat64(c, &clock, 1, &value, 1) == fmi3OK && value == time && finished) updates++;
    if (may_set && INPUTS > 0) {
        const fmi3ValueReference first = INPUT;
        value = sin(time);
        if (fmi3SetFloat64(c, &first, 1, &value, 1) != fmi3OK) updates = -1000000;
    }
    *early = fmi3False;
    *when = time;
}

static int co_simulation(fmi3Boolean event_mode)
{
    fmi3Instance c = NULL;
    const fmi3ValueReference input = INPUT;
    c = fmi3InstantiateCoSimulation("cs", GUID, "", fmi3False, fmi3True, event_mode, event_mode, &input, INPUTS > 0, &c, logger, update);
    EXPECT(c);
    EXPECT(fmi3EnterInitializationMode(c, fmi3False, 0.0, 0.0, fmi3True, STEPS * 0.01) == fmi3OK && fmi3ExitInitializationMode(c) == fmi3OK);
    fmi3Boolean event, terminate, early, flags[5];
    fmi3Float64 reached = 0.0, next;
    if (event_mode) {
        EXPECT(fmi3UpdateDiscreteStates(c, flags, flags + 1, flags + 2, flags + 3, flags + 4, &next) == fmi3OK);
        EXPECT(fmi3EnterStepMode(c) == fmi3OK);
    }
    fmi3FMUState state = NULL;
    EXPECT(fmi3GetFMUState(c, &state) == fmi3OK);
    size_t size = 0;
    EXPECT(fmi3SerializedFMUStateSize(c, state, &size) == fmi3OK && size > 0);
    fmi3Byte *bytes = malloc(size);
    EXPECT(bytes && fmi3SerializeFMUState(c, state, bytes, size) == fmi3OK);
    EXPECT(fmi3SerializeFMUState(c, state, bytes, size - 1) == fmi3Error);
    for (int n = 1; n <= STEPS;) {
        EXPECT(fmi3DoStep(c, reached, n * 0.01 - reached, fmi3True, &event, &terminate, &early, &reached) == fmi3OK && !terminate);
        if (event) {
            EXPECT(event_mode && fmi3EnterEventMode(c) == fmi3OK);
            EXPECT(fmi3UpdateDiscreteStates(c, flags, flags + 1, flags + 2, flags + 3, flags + 4, &next) == fmi3OK);
            EXPECT(fmi3EnterStepMode(c) == fmi3OK);
        }
        if (!early) n++;
    }
    EXPECT(updates >= STEPS);
    EXPECT(fmi3DoStep(c, STEPS * 0.01, 0.01, fmi3True, &event, &terminate, &early, &reached) == fmi3Error && sentences > 0);
    EXPECT(fmi3DoStep(c, STEPS * 0.01, 0.01, fmi3True, NULL, NULL, NULL, NULL) == fmi3Error);
    fmi3Float64 all[VARIABLES];
    fmi3ValueReference references[VARIABLES + 1];
    for (unsigned i = 0; i <= VARIABLES; i++) references[i] = i;
    EXPECT(fmi3GetFloat64(c, references, VARIABLES, all, VARIABLES) == fmi3OK);
    EXPECT(fmi3GetFloat64(c, references + VARIABLES, 1, all, 1) == fmi3Error);
    fmi3Int64 method = 0;
    EXPECT(fmi3GetInt64(c, references + VARIABLES, 1, &method, 1) == fmi3OK && method == 4);
    for (int i = 0; i < VARIABLES; i++) EXPECT(isfinite(all[i]));
    EXPECT(fmi3SetFMUState(c, state) == fmi3OK);
    EXPECT(fmi3FreeFMUState(c, &state) == fmi3OK && !state);
    EXPECT(fmi3DeserializeFMUState(c, bytes, size, &state) == fmi3OK);
    EXPECT(fmi3DeserializeFMUState(c, bytes, size - 1, &state) == fmi3Error);
    EXPECT(fmi3FreeFMUState(c, &state) == fmi3OK && fmi3FreeFMUState(c, &state) == fmi3OK);
    free(bytes);
    EXPECT(fmi3Reset(c) == fmi3OK);
    fmi3FreeInstance(c);
    return 0;
}

static int model_exchange(void)
{
    fmi3Instance c = fmi3InstantiateModelExchange("me", GUID, "", fmi3False, fmi3True, NULL, logger);
    EXPECT(c);
    EXPECT(fmi3EnterInitializationMode(c, fmi3True, 1e-6, 0.0, fmi3False, 0.0) == fmi3OK && fmi3ExitInitializationMode(c) == fmi3OK);
    size_t states = 0, indicators = 99;
    EXPECT(fmi3GetNumberOfContinuousStates(c, &states) == fmi3OK && states == STATES);
    EXPECT(fmi3GetNumberOfEventIndicators(c, &indicators) == fmi3OK && indicators == INDICATORS);
    fmi3Float64 x[STATES], dx[STATES], gaps[INDICATORS + 1], next;
    fmi3Boolean flags[5];
    for (int n = 0; n < STEPS; n++) {
        EXPECT(fmi3UpdateDiscreteStates(c, flags, flags + 1, flags + 2, flags + 3, flags + 4, &next) == fmi3OK);
        EXPECT(fmi3EnterContinuousTimeMode(c) == fmi3OK);
        EXPECT(fmi3GetContinuousStates(c, x, STATES) == fmi3OK && fmi3GetContinuousStateDerivatives(c, dx, STATES) == fmi3OK);
        EXPECT(fmi3GetEventIndicators(c, gaps, INDICATORS) == fmi3OK);
        for (int i = 0; i < STATES; i++) x[i] += 0.005 * dx[i];
        EXPECT(fmi3SetTime(c, 0.005 * (n + 1)) == fmi3OK && fmi3SetContinuousStates(c, x, STATES) == fmi3OK);
        EXPECT(fmi3SetContinuousStates(c, x, STATES + 1) == fmi3Error);
        fmi3Boolean enter, stop;
        EXPECT(fmi3CompletedIntegratorStep(c, fmi3True, &enter, &stop) == fmi3OK && !stop);
        EXPECT(fmi3EnterEventMode(c) == fmi3OK);
    }
    const fmi3ValueReference known[] = {1, 1 + STATES / 2};
    fmi3Float64 seed[2 * STATES], result[2 * STATES];
    fmi3ValueReference unknown[2 * STATES];
    for (unsigned i = 0; i < 2 * STATES; i++) {
        unknown[i] = 1 + i;
        seed[i] = 1.0;
    }
    EXPECT(fmi3GetDirectionalDerivative(c, unknown, 2 * STATES, known, 2, seed, 2, result, 2 * STATES) == fmi3OK);
    EXPECT(fmi3GetAdjointDerivative(c, unknown, 2 * STATES, known, 2, seed, 2 * STATES, result, 2) == fmi3OK);
    EXPECT(fmi3GetAdjointDerivative(c, unknown, 2 * STATES, known, 2, seed, 2, result, 2) == fmi3Error);
    EXPECT(fmi3GetDirectionalDerivative(c, unknown, 0, known, 0, NULL, 0, NULL, 0) == fmi3OK);
    EXPECT(fmi3GetInt32(c, known, 1, NULL, 1) == fmi3Error && fmi3EnterConfigurationMode(c) == fmi3Error);
    EXPECT(fmi3Terminate(c) == fmi3OK);
    fmi3FreeInstance(c);
    return 0;
}

int CHECK(void)
{
    EXPECT(!fmi3InstantiateModelExchange("x", "wrong", "", fmi3False, fmi3False, NULL, logger));
    EXPECT(!fmi3InstantiateModelExchange("x", "wrong", "", fmi3False, fmi3False, NULL, NULL));
    EXPECT(!fmi3InstantiateScheduledExecution("x", GUID, "", fmi3False, fmi3False, NULL, logger, NULL, NULL, NULL));
    EXPECT(fmi3EnterStepMode(NULL) == fmi3Error && fmi3GetBinary(NULL, NULL, 0, NULL, NULL, 0) == fmi3Error);
    fmi3FreeInstance(NULL);
    return co_simulation(fmi3False) || co_simulation(fmi3True) || model_exchange();
}
