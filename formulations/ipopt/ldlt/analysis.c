/* From a matrix to its fronts: order, tree, amalgamation, places of the entries. */

#include <limits.h>
#include <stdlib.h>
#include <string.h>

#include "ldlt.h"
#include "pattern.h"

/* Fronts with fewer pivots than this join their parent, if that has as few: their zeros cost less than passing them on. */
enum { FEW_PIVOTS = 4 };

/* The elimination tree, per step. into: the step a step was joined to; chain: the steps joined to one, itself first. */
struct tree {
    int *child, *next, *pivots, *rows, *into, *chain, *tail, *number, *order;
    int fronts, all_rows;
};

static void grow_tree(const struct pattern *p, const struct ordering *o, struct tree *t)
{
    for (int s = 0; s < o->count; s++) {
        t->child[s] = t->next[s] = t->chain[s] = -1;
        t->into[s] = t->tail[s] = s;
    }
    for (int c = 0; c < p->nodes; c++)
        t->pivots[o->leader[c]] += p->weight[c];
    for (int s = o->count - 1; s >= 0; s--) {
        t->rows[s] = t->pivots[s];
        for (int k = o->first[s]; k < o->first[s + 1]; k++)
            t->rows[s] += p->weight[o->list[k]];
        if (o->parent[s] >= 0) {
            t->next[s] = t->child[o->parent[s]];
            t->child[o->parent[s]] = s;
        }
    }
}

/* A child joins its parent where that adds no zeros, or where both are small. */
static void amalgamate(const struct ordering *o, struct tree *t)
{
    for (int p = 0; p < o->count; p++) {
        int *link = &t->child[p], orphans = -1;
        while (*link >= 0) {
            int c = *link, after = t->next[c];
            int fits = t->rows[c] - t->pivots[c] == t->rows[p], small = t->pivots[c] < FEW_PIVOTS && t->pivots[p] < FEW_PIVOTS;
            if (!fits && !small) {
                link = &t->next[c];
                continue;
            }
            t->pivots[p] += t->pivots[c];
            t->rows[p] += t->pivots[c];
            t->into[c] = p;
            t->chain[t->tail[p]] = c;
            t->tail[p] = t->tail[c];
            for (int g = t->child[c], later; g >= 0; g = later) {
                later = t->next[g];
                t->next[g] = orphans;
                orphans = g;
            }
            *link = after;
        }
        *link = orphans;
    }
}

static void number_fronts(const struct ordering *o, struct tree *t, int *stack)
{
    enum { NEW = -1, OPEN = -2 };
    for (int s = 0; s < o->count; s++)
        t->number[s] = NEW;
    for (int root = 0; root < o->count; root++) {
        if (o->parent[root] >= 0)
            continue;
        int top = 0;
        stack[top++] = root;
        while (top > 0) {
            int s = stack[top - 1];
            if (t->number[s] == NEW) {
                t->number[s] = OPEN;
                for (int c = t->child[s]; c >= 0; c = t->next[c])
                    stack[top++] = c;
                continue;
            }
            top--;
            t->number[s] = t->fronts;
            t->order[t->fronts++] = s;
            t->all_rows += t->rows[s];
        }
    }
}

static int parent_front(const struct ordering *o, const struct tree *t, int s)
{
    int up = o->parent[s];
    if (up < 0)
        return -1;
    while (t->into[up] != up)
        up = t->into[up];
    return t->number[up];
}

/* Rows of every front: its pivots, step by step, then what its own step was next to. home: the front that eliminates a variable. */
static void write_rows(const struct pattern *p, const struct ordering *o, const struct tree *t, struct analysis *a, int *with, int *head, int *home)
{
    for (int s = 0; s < o->count; s++)
        head[s] = -1;
    for (int c = p->nodes - 1; c >= 0; c--) {
        with[c] = head[o->leader[c]];
        head[o->leader[c]] = c;
    }
    int at = 0;
    for (int f = 0; f < a->count; f++) {
        int s = t->order[f];
        a->first_row[f] = at;
        a->pivots[f] = t->pivots[s];
        a->size[f] = t->rows[s];
        for (int step = s; step >= 0; step = t->chain[step])
            for (int c = head[step]; c >= 0; c = with[c])
                for (int k = 0; k < p->weight[c]; k++) {
                    int i = p->member[2 * c + k];
                    home[i] = f;
                    a->rows[at++] = i;
                }
        for (int k = o->first[s]; k < o->first[s + 1]; k++)
            for (int w = 0; w < p->weight[o->list[k]]; w++)
                a->rows[at++] = p->member[2 * o->list[k] + w];
    }
}

static void write_places(int nz, const int *row, const int *column, const struct ordering *o, const struct tree *t, struct analysis *a,
                         const int *home, int *fill, int *place)
{
    for (int k = 0; k < nz; k++) { /* an entry belongs to the front that eliminates either variable first */
        int i = home[row[k] - 1], j = home[column[k] - 1];
        a->first_entry[(i < j ? i : j) + 1]++;
    }
    for (int f = 0; f < a->count; f++)
        a->first_entry[f + 1] += a->first_entry[f];
    memcpy(fill, a->first_entry, sizeof(int) * (size_t)a->count);
    for (int k = 0; k < nz; k++) {
        int i = home[row[k] - 1], j = home[column[k] - 1];
        a->entry[fill[i < j ? i : j]++] = k;
    }
    for (int f = 0; f < a->count; f++) {
        const int *own = a->rows + a->first_row[f];
        for (int r = 0; r < a->size[f]; r++)
            place[own[r]] = r;
        for (int k = a->first_entry[f]; k < a->first_entry[f + 1]; k++) {
            int i = place[row[a->entry[k]] - 1], j = place[column[a->entry[k]] - 1];
            a->entry_row[k] = i > j ? i : j;
            a->entry_column[k] = i > j ? j : i;
        }
    }
    for (int f = 0; f < a->count; f++) {
        int g = parent_front(o, t, t->order[f]);
        a->is_root[f] = g < 0;
        if (g < 0)
            continue;
        a->children[g]++;
        for (int r = 0; r < a->size[g]; r++)
            place[a->rows[a->first_row[g] + r]] = r;
        for (int r = a->first_row[f] + a->pivots[f]; r < a->first_row[f] + a->size[f]; r++)
            a->in_parent[r] = place[a->rows[r]];
    }
}

enum { HEADER = 4 };

struct analysis view(int *block)
{
    struct analysis a = {.n = block[0], .count = block[1]};
    int rows = block[2], nz = block[3], *at = block + HEADER;
    int **parts[] = {&a.pivots, &a.size, &a.children, &a.is_root, &a.first_row};
    for (size_t k = 0; k < sizeof parts / sizeof *parts; k++, at += a.count)
        *parts[k] = at;
    a.rows = at;
    a.in_parent = at + rows;
    a.first_entry = at + 2 * rows;
    a.entry = a.first_entry + a.count + 1;
    a.entry_row = a.entry + nz;
    a.entry_column = a.entry_row + nz;
    return a;
}

static int *block_for(int n, int nz, const struct tree *t, int *length)
{
    int64_t needed = HEADER + 6 * (int64_t)t->fronts + 1 + 2 * (int64_t)t->all_rows + 3 * (int64_t)nz;
    if (needed > INT_MAX)
        return NULL;
    *length = (int)needed;
    int *block = calloc((size_t)needed, sizeof(int));
    if (block) {
        block[0] = n;
        block[1] = t->fronts;
        block[2] = t->all_rows;
        block[3] = nz;
    }
    return block;
}

int *analyse(int n, int nz, const int *row, const int *column, const double *value, int *length)
{
    struct memory memory = {.count = 0};
    struct ordering order = {.count = 0};
    struct tree tree = {.fronts = 0};
    struct pattern p = {.nodes = 0};
    size_t size = (size_t)n, both = 2 * (size_t)nz;
    p.start = take(&memory, size + 1, sizeof(int));
    p.adjacent = take(&memory, both, sizeof(int));
    p.entry = take(&memory, both, sizeof(double));
    p.diagonal = take(&memory, size, sizeof(double));
    p.node_of = take(&memory, size, sizeof(int));
    p.member = take(&memory, 2 * size, sizeof(int));
    p.weight = take(&memory, size, sizeof(int));
    int *start = take(&memory, size, sizeof(int)), *count = take(&memory, size, sizeof(int)), *adjacent = take(&memory, both, sizeof(int));
    int *one = take(&memory, size, sizeof(int)), *two = take(&memory, size, sizeof(int)), *three = take(&memory, size + 1, sizeof(int));
    int **parts[] = {&tree.child, &tree.next, &tree.pivots, &tree.rows, &tree.into, &tree.chain, &tree.tail, &tree.number, &tree.order};
    for (size_t k = 0; k < sizeof parts / sizeof *parts; k++)
        *parts[k] = take(&memory, size, sizeof(int));
    int *block = NULL;
    if (!memory.failed) {
        read_pattern(n, nz, row, column, value, &p, one);
        pair_zero_diagonals(n, &p, one, two, three);
        join_nodes(&p, start, count, adjacent, one);
        if (order_nodes(p.nodes, p.weight, start, count, adjacent, &order)) {
            grow_tree(&p, &order, &tree);
            amalgamate(&order, &tree);
            number_fronts(&order, &tree, one);
            block = block_for(n, nz, &tree, length);
        }
    }
    if (block) {
        struct analysis a = view(block);
        write_rows(&p, &order, &tree, &a, start, two, three);
        write_places(nz, row, column, &order, &tree, &a, three, start, two);
    }
    release_ordering(&order);
    release(&memory);
    return block;
}
