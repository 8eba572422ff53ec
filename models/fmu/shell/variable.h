/* A row of the variable table of any model. */
#ifndef VARIABLE_H
#define VARIABLE_H

/* At least one entry, because C has no empty arrays. */
#define ROOM(n) ((n) > 0 ? (n) : 1)

/* The position is the value reference. index: place within the variables of its kind, or of
 * kinds that the model numbers together. */
typedef struct {
    const char *name;
    VariableKind kind;
    int index;
    double start, lower, upper;
} Variable;

#endif
