/* FMI 3.0: names and types of the standard for the version-free functions. */
#ifndef FMI3_INSTANCE_H
#define FMI3_INSTANCE_H

#include "fmi3Functions.h"
#include "instance.h"

typedef char same_status_numbers[(int)fmi3OK == (int)STATUS_OK && (int)fmi3Error == (int)STATUS_ERROR ? 1 : -1];

/* The status of a version-free function. */
static inline fmi3Status said(Status status)
{
    return status == STATUS_OK ? fmi3OK : fmi3Error;
}

/* The answer of a function that this FMU does not offer. */
static inline fmi3Status not_offered(fmi3Instance instance, const char *function, const char *why)
{
    const Instance *self = instance;
    return self ? said(FAIL(self, "%s: %s.", function, why)) : fmi3Error;
}

#endif
