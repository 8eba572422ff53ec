/* Minimum degree on a quotient graph with approximate degrees: Amestoy, Davis and Duff, An
 * approximate minimum degree ordering algorithm, SIAM J. Matrix Anal. Appl. 17 (1996). An
 * eliminated node becomes an element, the list of its neighbours, and absorbs adjacent elements.
 * Hubs, nodes adjacent to a large part of the graph, come last together: every step would read
 * their lists again. */

#include <limits.h>
#include <math.h>
#include <string.h>

#include "ldlt.h"

enum { ABSORBED = -2 };

/* Nodes by degree, in doubly linked lists. */
struct queue {
    int *head, *next, *before, *degree;
    int lowest;
};

struct graph {
    const int *weight, *start;
    int *length, *adjacent; /* a node's list: elements, then neighbours */
    int *elements;          /* how many elements */
    int *gone;              /* eliminated */
    int *mark; /* step whose element last contained the node */
    int *met; /* per element: step that last read it, or ABSORBED */
    int *outside; /* per element: weight of its nodes outside the element of this step */
    int *element_weight;
};

static void enqueue(struct queue *queue, int i)
{
    int d = queue->degree[i];
    queue->next[i] = queue->head[d];
    queue->before[i] = -1;
    if (queue->head[d] >= 0)
        queue->before[queue->head[d]] = i;
    queue->head[d] = i;
    if (d < queue->lowest)
        queue->lowest = d;
}

static void dequeue(struct queue *queue, int i)
{
    if (queue->before[i] >= 0)
        queue->next[queue->before[i]] = queue->next[i];
    else
        queue->head[queue->degree[i]] = queue->next[i];
    if (queue->next[i] >= 0)
        queue->before[queue->next[i]] = queue->before[i];
}

static int append(struct graph *graph, int i, int step, int *list, int used)
{
    if (graph->gone[i] || graph->mark[i] == step)
        return used;
    graph->mark[i] = step;
    list[used] = i;
    return used + 1;
}

/* Make the element of p: its neighbours and those of its elements. Return the end of its list. */
static int make_element(struct graph *graph, int p, int step, struct ordering *out)
{
    int used = out->first[step];
    for (int k = 0; k < graph->length[p]; k++) {
        int a = graph->adjacent[graph->start[p] + k];
        if (k >= graph->elements[p]) {
            used = append(graph, a, step, out->list, used);
            continue;
        }
        out->parent[a] = step;
        graph->met[a] = ABSORBED;
        for (int m = out->first[a]; m < out->first[a + 1]; m++)
            used = append(graph, out->list[m], step, out->list, used);
    }
    return used;
}

/* Compute the weight of each adjacent element outside the list. */
static void weigh_outside(struct graph *graph, const int *list, int count, int step)
{
    for (int m = 0; m < count; m++) {
        const int *own = graph->adjacent + graph->start[list[m]];
        for (int k = 0; k < graph->elements[list[m]]; k++) {
            int e = own[k];
            if (graph->met[e] == ABSORBED)
                continue;
            if (graph->met[e] != step) {
                graph->met[e] = step;
                graph->outside[e] = graph->element_weight[e];
            }
            graph->outside[e] -= graph->weight[list[m]];
        }
    }
}

/* Remove what the new element `step` covers from node i. Return the weight of its other
 * neighbours, -1 without any. */
static int renew(struct graph *graph, int i, int step, struct ordering *out)
{
    int *own = graph->adjacent + graph->start[i], before = graph->elements[i], kept = 0, degree = 0, write = before;
    for (int k = 0; k < before; k++) {
        int e = own[k];
        if (graph->met[e] == ABSORBED)
            continue;
        if (graph->outside[e] <= 0) { /* entirely in the new element */
            out->parent[e] = step;
            graph->met[e] = ABSORBED;
            continue;
        }
        own[kept++] = e;
        degree += graph->outside[e];
    }
    for (int k = before; k < graph->length[i]; k++) {
        int j = own[k];
        if (graph->gone[j] || graph->mark[j] == step)
            continue;
        own[write++] = j;
        degree += graph->weight[j];
    }
    int plain = write - before;
    /* Append the new element after the old ones. There is room: p as a neighbour or an element
     * of i has left the list. */
    if (kept < before)
        memmove(own + kept + 1, own + before, sizeof(int) * (size_t)plain);
    else if (plain > 0)
        own[write] = own[before];
    own[kept] = step;
    graph->elements[i] = kept + 1;
    graph->length[i] = kept + 1 + plain;
    return kept + plain > 0 ? degree : -1;
}

static int make_room(struct ordering *out, int *capacity, int64_t needed)
{
    if (needed <= *capacity)
        return 1;
    if (needed > INT_MAX / 2)
        return 0;
    int *more = realloc(out->list, sizeof(int) * (size_t)(*capacity = 2 * (int)needed));
    if (more)
        out->list = more;
    return more != NULL;
}

static int eliminate_all(int n, struct graph *graph, struct queue *queue, int left, struct ordering *out)
{
    int capacity = 0, step = 0;
    while (left > 0) {
        while (queue->head[queue->lowest] < 0)
            queue->lowest++;
        int p = queue->head[queue->lowest], begin = out->first[step];
        if (!make_room(out, &capacity, (int64_t)begin + n))
            return 0;
        dequeue(queue, p);
        graph->gone[p] = 1;
        out->leader[p] = step;
        out->parent[step] = -1;
        left -= graph->weight[p];
        int *list = out->list + begin, count = make_element(graph, p, step, out) - begin, kept = 0, own = 0;
        weigh_outside(graph, list, count, step);
        for (int m = 0; m < count; m++) {
            int i = list[m];
            dequeue(queue, i);
            int degree = renew(graph, i, step, out);
            if (degree < 0) { /* no other neighbours: eliminated with p without fill */
                graph->gone[i] = 1;
                out->leader[i] = step;
                left -= graph->weight[i];
                continue;
            }
            queue->degree[i] = degree;
            own += graph->weight[i];
            list[kept++] = i;
        }
        graph->element_weight[step] = own;
        for (int m = 0; m < kept; m++) {
            int i = list[m], most = left - graph->weight[i], degree = queue->degree[i] + own - graph->weight[i];
            queue->degree[i] = degree < most ? degree : most;
            enqueue(queue, i);
        }
        out->first[++step] = begin + kept;
    }
    out->count = step;
    return 1;
}

/* For every step adjacent to hub h, through its nodes or absorbed elements: increment `count`,
 * or append h at `end`. */
static void reach(const struct graph *graph, int h, const struct ordering *out, int *seen, int *count, int *list, int *end)
{
    for (int k = 0; k < graph->length[h]; k++) {
        int i = graph->adjacent[graph->start[h] + k];
        for (int s = out->leader[i]; s >= 0 && seen[s] != h; s = out->parent[s]) {
            seen[s] = h;
            if (end)
                list[end[s]++] = h;
            else
                count[s]++;
        }
    }
}

/* Make the hubs the last step, and append them to the lists of all adjacent steps. seen, count:
 * one place per step and one more. */
static int append_hubs(const struct graph *graph, const int *hub, int hubs, struct ordering *out, int *seen, int *count)
{
    int last = out->count;
    int64_t length = out->first[last];
    for (int s = 0; s < last; s++) {
        seen[s] = -1;
        count[s] = 0;
    }
    for (int q = 0; q < hubs; q++)
        out->leader[hub[q]] = -1; /* no step yet: adjacent hubs are skipped */
    for (int q = 0; q < hubs; q++)
        reach(graph, hub[q], out, seen, count, NULL, NULL);
    for (int s = 0; s < last; s++)
        length += count[s];
    int *list = length > INT_MAX ? NULL : malloc(sizeof(int) * ((size_t)length + 1));
    if (!list)
        return 0;
    int write = 0;
    for (int s = 0; s < last; s++) {
        int begin = out->first[s], own = out->first[s + 1] - begin, more = count[s];
        if (own > 0)
            memcpy(list + write, out->list + begin, sizeof(int) * (size_t)own);
        out->first[s] = write;
        count[s] = write + own; /* place of its hubs */
        write += own + more;
        seen[s] = -1;
    }
    for (int q = 0; q < hubs; q++)
        reach(graph, hub[q], out, seen, NULL, list, count);
    for (int s = 0; s < last; s++)
        if (out->parent[s] < 0 && count[s] > out->first[s])
            out->parent[s] = last;
    for (int q = 0; q < hubs; q++)
        out->leader[hub[q]] = last;
    out->parent[last] = -1;
    out->first[last] = out->first[last + 1] = write;
    out->count = last + 1;
    free(out->list);
    out->list = list;
    return 1;
}

int order_nodes(int n, const int *weight, const int *start, int *length, int *adjacent, struct ordering *out)
{
    struct memory memory = {.count = 0};
    struct graph graph = {.weight = weight, .start = start, .length = length, .adjacent = adjacent};
    int total = 0, ok = 0, hubs = 0, *hub = take(&memory, (size_t)n, sizeof(int));
    double many = 10.0 * sqrt((double)n);
    for (int i = 0; i < n; i++)
        total += weight[i];
    struct queue queue = {.lowest = total};
    int **parts[] = {&graph.elements, &graph.gone, &graph.mark, &graph.met, &graph.outside, &graph.element_weight,
                     &queue.next, &queue.before, &queue.degree};
    for (size_t k = 0; k < sizeof parts / sizeof *parts; k++)
        *parts[k] = take(&memory, (size_t)n, sizeof(int));
    queue.head = take(&memory, (size_t)total + 1, sizeof(int));
    *out = (struct ordering){.parent = calloc((size_t)n + 1, sizeof(int)), .leader = calloc((size_t)n + 1, sizeof(int)),
                             .first = calloc((size_t)n + 2, sizeof(int))};
    if (!memory.failed && out->parent && out->leader && out->first) {
        for (int d = 0; d <= total; d++)
            queue.head[d] = -1;
        int left = total;
        for (int i = 0; i < n; i++)
            if (length[i] > many) {
                graph.gone[i] = 1;
                hub[hubs++] = i;
                left -= weight[i];
            }
        for (int i = n - 1; i >= 0; i--) {
            graph.mark[i] = graph.met[i] = -1;
            if (graph.gone[i])
                continue;
            for (int k = 0; k < length[i]; k++)
                if (!graph.gone[adjacent[start[i] + k]])
                    queue.degree[i] += weight[adjacent[start[i] + k]];
            enqueue(&queue, i);
        }
        ok = eliminate_all(n, &graph, &queue, left, out) && (hubs == 0 || append_hubs(&graph, hub, hubs, out, graph.mark, graph.outside));
    }
    release(&memory);
    return ok;
}

void release_ordering(struct ordering *ordering)
{
    free(ordering->parent);
    free(ordering->leader);
    free(ordering->first);
    free(ordering->list);
}
