/* The neighbours of each variable, zero diagonals paired with one of them, and the neighbours of the nodes that makes. */

#include <math.h>
#include <string.h>

#include "pattern.h"

/* A neighbour with a smaller entry is no partner for a zero diagonal. */
static const double WEAK = 1e-3;

void read_pattern(int n, int nz, const int *row, const int *column, const double *value, struct pattern *p, int *last)
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
        last[i] = -1; /* where a neighbour stands in the list of the variable at hand */
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

/* The partner of i: a large entry, and of comparable ones the neighbour with the fewest neighbours; -1 if there is none. */
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

/* A variable without a diagonal cannot be a pivot alone: it goes with a neighbour, those with few neighbours choosing first. */
void pair_zero_diagonals(int n, struct pattern *p, int *mate, int *by_degree, int *place)
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

void join_nodes(const struct pattern *p, int *start, int *length, int *adjacent, int *met)
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
