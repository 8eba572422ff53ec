/* Analyse a matrix: neighbours of each variable, pairs for zero diagonals, order, elimination
 * tree, amalgamation, places of the entries. */

#include <limits.h>
#include <math.h>
#include <string.h>

#include "ldlt.h"

/* Neighbours of each variable without the diagonal, duplicate entries summed; nodes of one or two
 * variables. */
struct pattern {
    int *start, *adjacent;
    double *entry, *diagonal;
    int nodes;
    int *node_of; /* per variable */
    int *member;  /* per node: two variables, or one and -1 */
    int *weight;  /* per node: number of variables */
};

/* Smallest relative entry that pairs a neighbour with a zero diagonal. */
static const double WEAK = 1e-3;

/* Read the pattern. start: zeros, n + 1; last: n, overwritten. Rows and columns count from 1. */
static void read_pattern(int n, int nz, const int *row, const int *column, const double *value, struct pattern *p, int *last)
{
    int *end = last;
    for (int k = 0; k < nz; k++)
        if (row[k] != column[k]) {
            p->start[row[k]]++;
            p->start[column[k]]++;
        }
    for (int i = 0; i < n; i++)
        p->start[i + 1] += p->start[i];
    memcpy(end, p->start, sizeof(int) * (size_t)n);
    for (int k = 0; k < nz; k++) {
        int i = row[k] - 1, j = column[k] - 1;
        if (i == j) {
            p->diagonal[i] += value[k];
            continue;
        }
        p->adjacent[end[i]] = j;
        p->entry[end[i]++] = value[k];
        p->adjacent[end[j]] = i;
        p->entry[end[j]++] = value[k];
    }
    for (int i = 0; i < n; i++)
        last[i] = -1; /* place of a neighbour in the list of the current variable */
    int write = 0, begin = 0;
    for (int i = 0; i < n; i++) {
        int first = write, after = p->start[i + 1];
        for (int k = begin; k < after; k++) {
            int j = p->adjacent[k];
            if (last[j] >= first) {
                p->entry[last[j]] += p->entry[k];
                continue;
            }
            last[j] = write;
            p->entry[write] = p->entry[k];
            p->adjacent[write++] = j;
        }
        p->start[i] = first;
        begin = after;
    }
    p->start[n] = write;
}

static int degree(const struct pattern *p, int i)
{
    return p->start[i + 1] - p->start[i];
}

/* Return the partner of i: the neighbour with the fewest neighbours among comparably large
 * entries, or -1. */
static int partner(const struct pattern *p, const int *mate, int i)
{
    int best = -1;
    double chosen = 0.0;
    for (int k = p->start[i]; k < p->start[i + 1]; k++) {
        int j = p->adjacent[k];
        double a = fabs(p->entry[k]);
        if (mate[j] >= 0)
            continue;
        if (a > 1.5 * chosen || (a > 0.6 * chosen && best >= 0 && degree(p, j) < degree(p, best))) {
            chosen = a;
            best = j;
        }
    }
    return chosen > WEAK ? best : -1;
}

/* Form the nodes. A variable with a zero diagonal cannot be a single pivot and joins a
 * neighbour; variables with few neighbours choose first. mate, by_degree: n; place: zeros, n +
 * 1; all overwritten. */
static void pair_zero_diagonals(int n, struct pattern *p, int *mate, int *by_degree, int *place)
{
    int count = 0;
    for (int i = 0; i < n; i++) {
        mate[i] = -1;
        if (p->diagonal[i] == 0.0)
            place[degree(p, i) + 1]++;
    }
    for (int d = 0; d < n; d++)
        place[d + 1] += place[d];
    for (int i = 0; i < n; i++)
        if (p->diagonal[i] == 0.0) {
            by_degree[place[degree(p, i)]++] = i;
            count++;
        }
    for (int m = 0; m < count; m++) {
        int i = by_degree[m], j = mate[i] < 0 ? partner(p, mate, i) : -1;
        if (j >= 0) {
            mate[i] = j;
            mate[j] = i;
        }
    }
    for (int i = 0; i < n; i++) {
        if (mate[i] >= 0 && mate[i] < i) {
            p->node_of[i] = p->node_of[mate[i]];
            p->member[2 * p->node_of[i] + 1] = i;
            p->weight[p->node_of[i]] = 2;
            continue;
        }
        p->node_of[i] = p->nodes;
        p->member[2 * p->nodes] = i;
        p->weight[p->nodes++] = 1;
    }
}

/* Join the neighbours of each node: adjacent[start[c]] .. of length[c]. met: per node,
 * overwritten. */
static void join_nodes(const struct pattern *p, int *start, int *length, int *adjacent, int *met)
{
    int write = 0;
    for (int c = 0; c < p->nodes; c++)
        met[c] = -1;
    for (int c = 0; c < p->nodes; c++) {
        start[c] = write;
        met[c] = c;
        for (int s = 0; s < p->weight[c]; s++) {
            int i = p->member[2 * c + s];
            for (int k = p->start[i]; k < p->start[i + 1]; k++) {
                int d = p->node_of[p->adjacent[k]];
                if (met[d] != c) {
                    met[d] = c;
                    adjacent[write++] = d;
                }
            }
        }
        length[c] = write - start[c];
    }
}

/* Fronts with fewer pivots join a parent that also has fewer: their zeros are cheaper than the
 * transfer. */
enum { FEW_PIVOTS = 4 };

/* The elimination tree, per step. into: the step that a step joined; chain: the steps joined to
 * one, itself first. */
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

/* Join a child to its parent if that adds no zeros, or if both are small. */
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

/* Write the rows of every front: its pivots by step, then the neighbours of its own step. home:
 * the front that eliminates a variable. */
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
    for (int k = 0; k < nz; k++) { /* an entry belongs to the front that eliminates the first of its variables */
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
