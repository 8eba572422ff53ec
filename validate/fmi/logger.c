/* The logger of FMI 2.0: a message and its arguments, as printf takes them, become one text for the instance that said it. */

#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>

#define EXPORT __attribute__((visibility("default")))
#define INSTANCES 64

typedef void (*Sink)(const char *);

static Sink sinks[INSTANCES];
static unsigned made;

/* Take a sink, the environment of a new instance; the oldest one leaves. */
EXPORT void logger_takes(void *sink) { sinks[made++ % INSTANCES] = (Sink)sink; }

/* An environment that is no sink is a mistake of the FMU: its message goes to the newest one. */
EXPORT void logger_say(void *environment, const char *instance, int status, const char *category, const char *message, ...)
{
    char text[4096];
    Sink sink = made ? sinks[(made - 1) % INSTANCES] : NULL;
    va_list arguments;
    (void)instance, (void)status, (void)category;
    for (unsigned place = 0; place < INSTANCES; place++)
        if (environment && environment == (void *)sinks[place]) sink = sinks[place];
    if (!message) message = "";
    va_start(arguments, message);
    vsnprintf(text, sizeof text, message, arguments);
    va_end(arguments);
    if (sink) sink(text);
}
