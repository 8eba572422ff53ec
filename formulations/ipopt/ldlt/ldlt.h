/* Sparse symmetric indefinite L D L^T by fronts, for the KKT systems of an interior point
 * method. Indices count from 0, except in ma27.c. */

#ifndef TOUCHSTONE_LDLT_H
#define TOUCHSTONE_LDLT_H

#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

/* The elimination: fronts, children before parents, in one block of integers that the caller can
 * store in an integer array. A front has its pivots first, then the rows it shares with its
 * parent. For each entry (row >= column) the analysis stores its place in the front. */
struct analysis {
    int n, count;
    /* Per front; size counts all rows including the pivots. */
    int *pivots, *size, *children, *is_root;
    /* Variables of each front; place of each row without pivot among the parent's rows. */
    int *first_row, *rows, *in_parent;
    int *first_entry, *entry, *entry_row, *entry_column;
};

/* Result of a minimum degree ordering, per step: the nodes eliminated together, and their
 * neighbours. */
struct ordering {
    int count;
    int *parent; /* step that absorbs this one, or -1 */
    int *leader; /* per node: its step */
    int *first, *list;
};

/* Allocations that are released together; `failed` is set if one was refused. */
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

/* Order the nodes. The neighbours of node i are adjacent[start[i]] .. of length[i]; both lists
 * are overwritten. Return 0 without memory; `out` is then already released. */
int order_nodes(int n, const int *weight, const int *start, int *length, int *adjacent, struct ordering *out);
void release_ordering(struct ordering *ordering);

/* Return a block of *length integers, to be freed by the caller, or NULL without memory. value:
 * scaled entries; rows and columns count from 1. */
int *analyse(int n, int nz, const int *row, const int *column, const double *value, int *length);
/* Return the analysis stored in a block. */
struct analysis view(int *block);

struct outcome {
    int negative;            /* negative eigenvalues */
    int rank;                /* pivots */
    int largest;             /* rows of the largest front */
    int64_t reals, integers; /* required size of the factor, also if the arrays were too short */
};

/* Kind of a pivot: single, or first or second of a pair. */
enum { SINGLE = 1, FIRST = 2, SECOND = 3 };

enum { FACTORISED = 0, NO_MEMORY = -1, INTEGERS_TOO_SHORT = -3, REALS_TOO_SHORT = -4 };

/* Factorise. value: scaled entries; u: pivot threshold, 0 .. 0.5. A rank below n means a
 * singular matrix, for any return value. */
int factorise(const struct analysis *analysis, const double *value, double u, double *real, int64_t reals, int *index, int64_t integers,
              struct outcome *out);

/* Solve. x: right side, then solution; work: as many as the rows of the largest front. */
void solve_factor(int count, const double *real, const int *index, double *x, double *work);

#endif
