/* Saving, restoring and serialising the whole state of an instance. Version-free, see instance.h. */
#ifndef SAVED_STATE_H
#define SAVED_STATE_H

#include "instance.h"

/* A saved state is the bytes of a Model behind a head that says which model and which kind of instance it belongs to. */
typedef struct {
    char guid[sizeof MODEL_GUID];
    int type, event_mode_used;
    Model model;
} SavedState;

static inline Status save_state(void *instance, const char *function, void **state)
{
    Instance *self = allowed(instance, function, PHASES_ALL);
    if (!self) return STATUS_ERROR;
    if (!state) return FAIL(self, "%s: the place for the state is missing.", function);
    if (!*state) *state = calloc(1, sizeof(SavedState));
    SavedState *saved = *state;
    if (!saved) return FAIL(self, "%s: out of memory.", function);
    memcpy(saved->guid, MODEL_GUID, sizeof MODEL_GUID);
    saved->type = (int)self->type;
    saved->event_mode_used = self->event_mode_used;
    memcpy(&saved->model, &self->model, sizeof self->model);
    return STATUS_OK;
}

static inline Status restore_state(void *instance, const char *function, const void *state)
{
    Instance *self = allowed(instance, function, PHASES_ALL);
    if (!self) return STATUS_ERROR;
    const SavedState *saved = state;
    if (!saved) return FAIL(self, "%s: the state is missing.", function);
    if (saved->type != (int)self->type) return FAIL(self, "%s: the state was saved by an instance of the other FMU type.", function);
    if (saved->event_mode_used != self->event_mode_used)
        return FAIL(self, "%s: the state was saved by an instance that was made %s event mode.", function, saved->event_mode_used ? "with" : "without");
    memcpy(&self->model, &saved->model, sizeof self->model);
    return STATUS_OK;
}

static inline Status free_state(void *instance, const char *function, void **state)
{
    if (!allowed(instance, function, PHASES_ALL)) return STATUS_ERROR;
    if (state) {
        free(*state);
        *state = NULL;
    }
    return STATUS_OK;
}

static inline Status serialized_size(void *instance, const char *function, const void *state, size_t *size)
{
    Instance *self = allowed(instance, function, PHASES_ALL);
    if (!self) return STATUS_ERROR;
    if (!state || !size) return FAIL(self, "%s: the state or the place for its size is missing.", function);
    *size = sizeof(SavedState);
    return STATUS_OK;
}

static inline Status serialize(void *instance, const char *function, const void *state, void *bytes, size_t size)
{
    Instance *self = allowed(instance, function, PHASES_ALL);
    if (!self) return STATUS_ERROR;
    if (!state || !bytes) return FAIL(self, "%s: the state or the place for its bytes is missing.", function);
    if (size < sizeof(SavedState))
        return FAIL(self, "%s: %lu bytes are needed, but there is room for %lu.", function, (unsigned long)sizeof(SavedState), (unsigned long)size);
    memcpy(bytes, state, sizeof(SavedState));
    return STATUS_OK;
}

static inline Status deserialize(void *instance, const char *function, const void *bytes, size_t size, void **state)
{
    Instance *self = allowed(instance, function, PHASES_ALL);
    if (!self) return STATUS_ERROR;
    if (!bytes || !state) return FAIL(self, "%s: the bytes or the place for the state are missing.", function);
    if (size != sizeof(SavedState) || memcmp(bytes, MODEL_GUID, sizeof MODEL_GUID) != 0)
        return FAIL(self, "%s: these %lu bytes are not a state of this model.", function, (unsigned long)size);
    if (!*state) *state = calloc(1, sizeof(SavedState));
    if (!*state) return FAIL(self, "%s: out of memory.", function);
    memcpy(*state, bytes, sizeof(SavedState));
    return STATUS_OK;
}

#endif
