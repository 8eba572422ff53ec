/* Every function of a contact's FMU, called rightly and wrongly, for the sanitizers. Prints the refusals; 0 if what must work works. */
#include "contact.c"

#define COUNT (X_COUNT + Y_COUNT)
#define WORKS(call) if ((call) != fmi2OK) return __LINE__
#define REFUSED(call) if ((call) != fmi2Error) return __LINE__

static void tell(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category, fmi2String text, ...)
{
    (void)environment, (void)name, (void)status, (void)category;
    puts(text);
}

static int values(fmi2Component c, const fmi2ValueReference *all)
{
    double x[COUNT + 1], dy[Y_COUNT];
    const double nan = NAN;
    WORKS(fmi2GetReal(c, all, COUNT + 1, x));
    WORKS(fmi2SetReal(c, all + 1, X_COUNT, x + 1));
    REFUSED(fmi2GetReal(c, all + COUNT + 1, 1, x));
    REFUSED(fmi2SetReal(c, all, 1, x));
    REFUSED(fmi2SetReal(c, all + X_COUNT + 1, 1, x));
    REFUSED(fmi2SetReal(c, all + 1, 1, &nan));
    REFUSED(fmi2SetReal(c, NULL, 1, x));
    WORKS(fmi2GetDirectionalDerivative(c, all + X_COUNT + 1, Y_COUNT, all + 1, INPUT_COUNT, x, dy));
    REFUSED(fmi2GetDirectionalDerivative(c, all, 1, all + 1, 1, x, dy));
    REFUSED(fmi2GetDirectionalDerivative(c, all + X_COUNT + 1, 1, all, 1, x, dy));
    int whole;
    WORKS(fmi2GetInteger(c, all, 0, NULL));
    REFUSED(fmi2GetInteger(c, all, 1, &whole));
    return 0;
}

static int states(fmi2Component c)
{
    fmi2FMUstate saved = NULL, loaded = NULL;
    size_t size;
    WORKS(fmi2GetFMUstate(c, &saved));
    WORKS(fmi2GetFMUstate(c, &saved));
    WORKS(fmi2SerializedFMUstateSize(c, saved, &size));
    fmi2Byte *bytes = malloc(size);
    WORKS(fmi2SerializeFMUstate(c, saved, bytes, size));
    REFUSED(fmi2SerializeFMUstate(c, saved, bytes, size - 1));
    WORKS(fmi2DeSerializeFMUstate(c, bytes, size, &loaded));
    REFUSED(fmi2DeSerializeFMUstate(c, bytes, size - 1, &loaded));
    bytes[0] ^= 1;
    REFUSED(fmi2DeSerializeFMUstate(c, bytes, size, &loaded));
    WORKS(fmi2SetFMUstate(c, loaded));
    REFUSED(fmi2SetFMUstate(c, NULL));
    WORKS(fmi2FreeFMUstate(c, &saved));
    WORKS(fmi2FreeFMUstate(c, &loaded));
    WORKS(fmi2FreeFMUstate(c, &loaded));
    free(bytes);
    return 0;
}

static int life(fmi2Component c)
{
    fmi2ValueReference all[COUNT + 2];
    for (unsigned i = 0; i < COUNT + 2; i++) all[i] = i;
    double value;
    fmi2Status status;
    const char *category = "none";
    REFUSED(fmi2GetReal(c, all, 1, &value));
    WORKS(fmi2SetupExperiment(c, 0, 0.0, 0.0, 1, 1.0));
    WORKS(fmi2EnterInitializationMode(c));
    int line = values(c, all);
    if (line) return line;
    WORKS(fmi2ExitInitializationMode(c));
    REFUSED(fmi2SetReal(c, all + X_COUNT, 1, &value));
    for (int i = 0; i < 10; i++) WORKS(fmi2DoStep(c, 0.1 * i, 0.1, 1));
    REFUSED(fmi2DoStep(c, 1.0, 0.1, 1));
    REFUSED(fmi2DoStep(c, 0.3, 0.1, 1));
    REFUSED(fmi2DoStep(c, 1.0, -0.1, 1));
    REFUSED(fmi2DoStep(c, 1.0, NAN, 1));
    WORKS(fmi2GetRealStatus(c, fmi2LastSuccessfulTime, &value));
    REFUSED(fmi2GetStatus(c, fmi2DoStepStatus, &status));
    REFUSED(fmi2SetDebugLogging(c, 1, 1, &category));
    REFUSED(fmi2CancelStep(c));
    line = states(c);
    if (line) return line;
    WORKS(fmi2Terminate(c));
    WORKS(fmi2Reset(c));
    return 0;
}

int main(void)
{
    fmi2CallbackFunctions functions = {tell, calloc, free, NULL, NULL};
    if (fmi2Instantiate("it", fmi2CoSimulation, "another", "", &functions, 0, 0)) return 1;
    if (fmi2Instantiate("it", fmi2ModelExchange, MODEL_GUID, "", &functions, 0, 0)) return 1;
    if (fmi2Instantiate("", fmi2CoSimulation, MODEL_GUID, "", &functions, 0, 0)) return 1;
    fmi2Component c = fmi2Instantiate("it", fmi2CoSimulation, MODEL_GUID, "", &functions, 0, 0);
    const int line = life(c);
    fmi2FreeInstance(c);
    fmi2FreeInstance(NULL);
    REFUSED(fmi2DoStep(NULL, 0.0, 0.1, 1));
    if (line) printf("line %d\n", line);
    return line != 0;
}
