/* A row of the variable table, whatever the model. */
#ifndef VARIABLE_H
#define VARIABLE_H

/* Arrays have room for at least one entry, because C has no empty arrays. */
#define ROOM(n) ((n) > 0 ? (n) : 1)

/* Its position is the value reference. index: place within the variables of its kind, or of the kinds that the model numbers as one. */
typedef struct {
    const char *name;
    VariableKind kind;
    int index;
    double start, lower, upper;
} Variable;

#endif
