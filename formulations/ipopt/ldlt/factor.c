/* Factorisation front by front with pivots of one and two variables: Duff and Reid, The multifrontal solution of indefinite sparse symmetric
 * linear equations, ACM Trans. Math. Softw. 9 (1983). A variable without an acceptable pivot is put off to the parent.
 *
 * Kept of a front: in `index` its rows, its pivots, the rows' variables, the kind of each pivot, the length of all that; in `real` rows x pivots
 * column by column, the inverse of D on the diagonal (and below it in a pair), L below. */

#include <stdlib.h>
#include <string.h>

#include "front.h"
#include "ldlt.h"

/* Contributions that wait for their parent: lower triangles, and the variables put off. */
struct waiting {
    double *entry;
    size_t capacity, top;
    int *front, *rows, *late; /* per child */
    int children;
    int *variable, put_off;
};

static int enough(double **block, size_t *capacity, size_t needed)
{
    if (needed <= *capacity)
        return 1;
    size_t more = needed + needed / 2;
    double *grown = realloc(*block, more * sizeof(double));
    if (!grown)
        return 0;
    *block = grown;
    *capacity = more;
    return 1;
}

/* Adds the youngest waiting child to its parent; its late variables are put at `at`. Returns how many. */
static int add_child(const struct analysis *a, struct front *f, struct waiting *w, int own, int delayed, int at, int *place)
{
    int size = w->rows[--w->children], late = w->late[w->children], child = w->front[w->children];
    const int *to = a->in_parent + a->first_row[child] + a->pivots[child];
    w->put_off -= late;
    for (int r = 0; r < late; r++) {
        f->variable[at + r] = w->variable[w->put_off + r];
        place[r] = at + r;
    }
    for (int r = late; r < size; r++)
        place[r] = to[r - late] < own ? to[r - late] : to[r - late] + delayed;
    w->top -= (size_t)size * ((size_t)size + 1) / 2;
    const double *from = w->entry + w->top;
    for (int j = 0; j < size; j++, from += size - j + 1) {
        int column = place[j];
        double *target = column_of(f, column);
        for (int i = j; i < size; i++) {
            int row = place[i];
            if (row >= column)
                target[row] += from[i - j];
            else
                column_of(f, row)[column] += from[i - j];
        }
    }
    return late;
}

static void assemble(const struct analysis *a, int s, const double *value, struct front *f, struct waiting *w, int delayed, int *place)
{
    int own = a->pivots[s], size = a->size[s];
    const int *rows = a->rows + a->first_row[s];
    for (int j = 0; j < f->rows; j++)
        memset(column_of(f, j) + j, 0, sizeof(double) * (size_t)(f->rows - j));
    for (int r = 0; r < size; r++)
        f->variable[r < own ? r : r + delayed] = rows[r];
    for (int k = a->first_entry[s]; k < a->first_entry[s + 1]; k++) {
        int i = a->entry_row[k], j = a->entry_column[k];
        column_of(f, j < own ? j : j + delayed)[i < own ? i : i + delayed] += value[a->entry[k]];
    }
    int at = own;
    for (int c = a->children[s]; c > 0; c--)
        at += add_child(a, f, w, own, delayed, at, place);
}

/* The columns from k on wait for the parent. */
static int pass_on(struct front *f, int s, int k, struct waiting *w)
{
    int rest = f->rows - k;
    if (!enough(&w->entry, &w->capacity, w->top + (size_t)rest * ((size_t)rest + 1) / 2))
        return 0;
    for (int j = k; j < f->rows; w->top += (size_t)(f->rows - j), j++)
        memcpy(w->entry + w->top, column_of(f, j) + j, sizeof(double) * (size_t)(f->rows - j));
    for (int j = k; j < f->choosable; j++)
        w->variable[w->put_off++] = f->variable[j];
    w->rows[w->children] = rest;
    w->late[w->children] = f->choosable - k;
    w->front[w->children++] = s;
    return 1;
}

static void keep(const struct front *f, int pivots, double *real, int *index)
{
    int length = 3 + f->rows + pivots;
    index[0] = f->rows;
    index[1] = pivots;
    memcpy(index + 2, f->variable, sizeof(int) * (size_t)f->rows);
    memcpy(index + 2 + f->rows, f->kind, sizeof(int) * (size_t)pivots);
    index[length - 1] = length;
    memcpy(real, f->entry, sizeof(double) * (size_t)f->rows * (size_t)pivots);
}

int factorise(const struct analysis *a, const double *value, double u, double *real, int64_t reals, int *index, int64_t integers,
              struct outcome *out)
{
    struct memory memory = {.count = 0};
    struct front f = {.rows = 0};
    struct waiting w = {.children = 0};
    size_t entries = 0, products = 0, n = (size_t)a->n;
    int status = FACTORISED, *place = take(&memory, n, sizeof(int));
    f.variable = take(&memory, n, sizeof(int));
    f.kind = take(&memory, n, sizeof(int));
    w.variable = take(&memory, n, sizeof(int));
    int **parts[] = {&w.front, &w.rows, &w.late};
    for (size_t k = 0; k < sizeof parts / sizeof *parts; k++)
        *parts[k] = take(&memory, (size_t)a->count, sizeof(int));
    *out = (struct outcome){.negative = 0};
    if (memory.failed)
        status = NO_MEMORY;
    for (int s = 0; s < a->count && status != NO_MEMORY; s++) {
        int delayed = 0;
        for (int c = 1; c <= a->children[s]; c++)
            delayed += w.late[w.children - c];
        f.rows = a->size[s] + delayed;
        f.choosable = a->pivots[s] + delayed;
        if (!enough(&f.entry, &entries, (size_t)f.rows * (size_t)f.rows) || !enough(&f.product, &products, (size_t)f.rows * (size_t)f.choosable)) {
            status = NO_MEMORY;
            break;
        }
        assemble(a, s, value, &f, &w, delayed, place);
        int k = eliminate(&f, u, &out->negative);
        if (k < 0) /* the rank is short of n: no front to come can mend that */
            break;
        if (out->reals + (int64_t)f.rows * k > reals)
            status = REALS_TOO_SHORT;
        else if (status == FACTORISED && out->integers + 3 + f.rows + k > integers)
            status = INTEGERS_TOO_SHORT;
        if (status == FACTORISED)
            keep(&f, k, real + out->reals, index + out->integers);
        out->rank += k;
        out->reals += (int64_t)f.rows * k;
        out->integers += 3 + f.rows + k;
        if (f.rows > out->largest)
            out->largest = f.rows;
        if (!a->is_root[s] && !pass_on(&f, s, k, &w))
            status = NO_MEMORY;
    }
    free(f.entry);
    free(f.product);
    free(w.entry);
    release(&memory);
    return status;
}
