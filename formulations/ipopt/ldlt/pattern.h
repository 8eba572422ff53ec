/* Which variables are neighbours, and which go together: what a matrix is made into before it is ordered. */

#ifndef TOUCHSTONE_LDLT_PATTERN_H
#define TOUCHSTONE_LDLT_PATTERN_H

/* Neighbours of each variable, off the diagonal, entries of one place added up; nodes of one or two variables. */
struct pattern {
    int *start, *adjacent;
    double *entry, *diagonal;
    int nodes;
    int *node_of, *member, *weight; /* per variable; per node two variables or one and -1; how many */
};

/* start: zeros, n + 1; last: n, used up. Columns and rows count from 1. */
void read_pattern(int n, int nz, const int *row, const int *column, const double *value, struct pattern *p, int *last);
/* Makes the nodes. mate, by_degree: n; place: zeros, n + 1; all used up. */
void pair_zero_diagonals(int n, struct pattern *p, int *mate, int *by_degree, int *place);
/* The neighbours of each node: adjacent[start[c]] .. of length[c]; met: per node, used up. */
void join_nodes(const struct pattern *p, int *start, int *length, int *adjacent, int *met);

#endif
