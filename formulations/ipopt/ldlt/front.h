/* One front of the factorisation: a dense symmetric matrix some of whose columns are eliminated. */

#ifndef TOUCHSTONE_LDLT_FRONT_H
#define TOUCHSTONE_LDLT_FRONT_H

#include <stddef.h>

/* A symmetric front, its lower triangle by columns. The first `choosable` columns may become pivots, k of them are. */
struct front {
    int rows, choosable;
    double *entry;
    double *product; /* per pivot the column L D, rows long */
    int *variable, *kind;
};

static inline double *column_of(const struct front *f, int j)
{
    return f->entry + (size_t)j * (size_t)f->rows;
}

/* Eliminates what can be of the choosable columns, panel by panel, with threshold u; adds the negative eigenvalues. Returns how many columns, -1
 * where the matrix is singular. */
int eliminate(struct front *f, double u, int *negative);

#endif
