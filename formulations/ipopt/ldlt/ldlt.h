/* Sparse symmetric indefinite L D L^T by fronts, for the optimality systems of an interior point method. Indices count from 0 but in ma27.c. */

#ifndef TOUCHSTONE_LDLT_H
#define TOUCHSTONE_LDLT_H

#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

/* The elimination: fronts, children before parents. One block of integers, so that it can be kept where the caller keeps integers.
 * A front has its pivots first, then the rows it shares with its parent; of an entry (row >= column) the places in its front are told. */
struct analysis {
    int n, count;
    int *pivots, *size, *children, *is_root; /* per front; size: rows, pivots among them */
    int *first_row, *rows, *in_parent;       /* variables of each front; place of a row that is no pivot among the parent's rows */
    int *first_entry, *entry, *entry_row, *entry_column;
};

/* What a minimum degree order leaves behind, per step: nodes eliminated together, and the nodes they were next to. */
struct ordering {
    int count;
    int *parent; /* step that absorbs this one, or -1 */
    int *leader; /* per node: the step it goes with */
    int *first, *list;
};

/* Memory taken together and released together; `failed` once any was refused. */
struct memory {
    void *blocks[24];
    int count, failed;
};

static inline void *take(struct memory *memory, size_t number, size_t bytes)
{
    void *block = memory->count < (int)(sizeof memory->blocks / sizeof *memory->blocks) ? calloc(number + 1, bytes) : NULL;
    if (block)
        memory->blocks[memory->count++] = block;
    else
        memory->failed = 1;
    return block;
}

static inline void release(struct memory *memory)
{
    while (memory->count > 0)
        free(memory->blocks[--memory->count]);
}

/* Neighbours of node i: adjacent[start[i]] .. of length[i]; both lists are used up. False without memory; `out` then is released all the same. */
int order_nodes(int n, const int *weight, const int *start, int *length, int *adjacent, struct ordering *out);
void release_ordering(struct ordering *ordering);

/* A block of *length integers to be freed by the caller, or NULL without memory. value: entries, scaled; columns and rows count from 1. */
int *analyse(int n, int nz, const int *row, const int *column, const double *value, int *length);
/* The analysis in a block. */
struct analysis view(int *block);

struct outcome {
    int negative, rank, largest; /* negative eigenvalues, pivots found, rows of the largest front */
    int64_t reals, integers;     /* room the factor needs, whether it had it or not */
};

/* Of a pivot: alone, or one of a pair. */
enum { SINGLE = 1, FIRST = 2, SECOND = 3 };

enum { FACTORISED = 0, NO_MEMORY = -1, INTEGERS_TOO_SHORT = -3, REALS_TOO_SHORT = -4 };

/* value: entries, scaled; u: threshold of the pivots, 0 .. 0.5. A rank below n, whatever is answered, is that of a singular matrix. */
int factorise(const struct analysis *analysis, const double *value, double u, double *real, int64_t reals, int *index, int64_t integers,
              struct outcome *out);

/* x: right side, then solution; work: rows of the largest front. */
void solve_factor(int count, const double *real, const int *index, double *x, double *work);

#endif
