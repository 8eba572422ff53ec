/* FMI 2.0: names and types of the standard for the version-free functions. */
#ifndef FMI2_INSTANCE_H
#define FMI2_INSTANCE_H

#include "fmi2Functions.h"
#include "instance.h"

/* Static libraries need names of their own: FMI2_FUNCTION_PREFIX, which some copies of the standard header ignore. */
#ifdef FMI2_FUNCTION_PREFIX
#undef fmi2FullName
#define PREFIXED_AGAIN(prefix, name) prefix##name
#define PREFIXED(prefix, name) PREFIXED_AGAIN(prefix, name)
#define fmi2FullName(name) PREFIXED(FMI2_FUNCTION_PREFIX, name)
#endif

typedef char same_status_numbers[(int)fmi2OK == (int)STATUS_OK && (int)fmi2Error == (int)STATUS_ERROR ? 1 : -1];

/* The status of a version-free function. */
static inline fmi2Status said(Status status)
{
    return status == STATUS_OK ? fmi2OK : fmi2Error;
}

#endif
