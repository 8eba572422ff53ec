/* The loss of a plan, its mean over random inputs, and the loop of gradient descent, over the compiled time step of any scene.
 *
 *   loss = terminal mean((x_T - goal)^2) + running * cost          x = (q, v); no error where the goal is free
 *   u <- clip(u - rate * gradient, lower, upper)
 *
 * The time step comes as addresses of rollout.c's functions. Every operation and its order are those of objective.py, so that both give the
 * same bits; only the gradient's norm is summed in another order than a BLAS does. */
#include <math.h>
#include <string.h>

#define EXPORT __attribute__((visibility("default")))

typedef int (*rollout_function)(int steps, double h, const double *parameters, int law, double b, const double *start, const double *u, double *q,
    double *v, double *lam);
typedef int (*adjoint_function)(int steps, double h, const double *parameters, int law, double b, const double *q, const double *v,
    const double *lam, const double *u, const double *q_bar, const double *v_bar, const double *lam_bar, double cost_bar, double *u_bar,
    double *start_bar);
typedef double (*cost_function)(int n, const double *parameters, const double *q, const double *v, const double *u);

/* A loss and the buffers of its last evaluation. goal (2 nq): not a number where the end is free; error (2 nq): x_T - goal, 0 there; q, v:
 * (steps + 1, nq); u, u_bar: (steps, nu); q_bar, v_bar: zero but for their last rows. */
typedef struct {
    rollout_function rollout;
    adjoint_function adjoint;
    cost_function cost;
    int steps, nq, nu, law;
    double h, b, terminal, running;
    const double *parameters, *start, *goal;
    double *u, *q, *v, *lam, *q_bar, *v_bar, *u_bar, *start_bar, *error;
    /* Of the last evaluation. */
    double value, squares, last_cost;
    int finite_steps;
} loss_data;

enum { EVALUATED, DIVERGED, INDEFINITE };

/* value, squares, last_cost, error at u. */
static int loss_value(loss_data *d)
{
    const int nq = d->nq;
    d->finite_steps = d->rollout(d->steps, d->h, d->parameters, d->law, d->b, d->start, d->u, d->q, d->v, d->lam);
    if (d->finite_steps < d->steps) return DIVERGED;
    d->last_cost = d->cost(d->steps, d->parameters, d->q, d->v, d->u);
    d->squares = 0.0;
    for (int i = 0; i < 2 * nq; i++) {
        const double end = i < nq ? d->q[d->steps * nq + i] : d->v[d->steps * nq + i - nq];
        d->error[i] = isnan(d->goal[i]) ? 0.0 : end - d->goal[i];
        d->squares += d->error[i] * d->error[i];
    }
    d->value = d->terminal * d->squares / (2 * nq) + d->running * d->last_cost;
    return EVALUATED;
}

/* u_bar, at the inputs evaluated last. */
static int loss_gradient(loss_data *d)
{
    const int nq = d->nq;
    const double factor = 2.0 * d->terminal / (2 * nq);
    for (int i = 0; i < nq; i++) {
        d->q_bar[d->steps * nq + i] = d->error[i] * factor;
        d->v_bar[d->steps * nq + i] = d->error[nq + i] * factor;
    }
    return d->adjoint(d->steps, d->h, d->parameters, d->law, d->b, d->q, d->v, d->lam, d->u, d->q_bar, d->v_bar, NULL, d->running, d->u_bar,
               d->start_bar)
        ? INDEFINITE
        : EVALUATED;
}

/* Mean of the loss, and of its gradient (steps, nu), over inputs u + noise[i], noise (samples, steps, nu). */
EXPORT int loss_mean(loss_data *d, int samples, const double *u, const double *noise, double *mean, double *gradient)
{
    const int size = d->steps * d->nu;
    double total = 0.0;
    memset(gradient, 0, (size_t)size * sizeof *gradient);
    for (int sample = 0; sample < samples; sample++) {
        const double *added = noise + (size_t)sample * size;
        for (int i = 0; i < size; i++) d->u[i] = u[i] + added[i];
        int status = loss_value(d);
        if (status == EVALUATED && isfinite(d->value)) status = loss_gradient(d);
        if (status || !isfinite(d->value)) return status ? status : DIVERGED;
        total += d->value;
        for (int i = 0; i < size; i++) gradient[i] += d->u_bar[i];
    }
    for (int i = 0; i < size; i++) gradient[i] /= samples;
    *mean = total / samples;
    return EVALUATED;
}

/* Four sums side by side: one alone would wait for each addition. */
static double norm(int n, const double *x)
{
    double sums[4] = {0.0, 0.0, 0.0, 0.0};
    int i = 0;
    for (; i + 4 <= n; i += 4)
        for (int k = 0; k < 4; k++) sums[k] += x[i + k] * x[i + k];
    for (; i < n; i++) sums[0] += x[i] * x[i];
    return sqrt((sums[0] + sums[1]) + (sums[2] + sums[3]));
}

/* The stopping rule (stopping.py) after `count` losses; best[i]: the least of the first i + 1. */
enum { DESCENDING, SETTLED, RUNAWAY };
#define SHORTEST_WINDOW 50
#define WINDOW_SHARE 4
#define NOTHING_LEFT 1e-20
#define RUNAWAY_FACTOR 2.0

EXPORT int loss_progress(int count, const double *losses, const double *best, double tolerance)
{
    const double least = best[count - 1];
    const int window = count / WINDOW_SHARE > SHORTEST_WINDOW ? count / WINDOW_SHARE : SHORTEST_WINDOW;
    if (least <= NOTHING_LEFT * losses[0]) return SETTLED;
    if (count <= window) return DESCENDING;
    int i = count - 1;
    while (i >= count - window / 2 && losses[i] > RUNAWAY_FACTOR * least) i--;
    if (i < count - window / 2) return RUNAWAY;
    const double earlier = best[count - 1 - window];
    return (earlier > 0.0 ? (earlier - least) / earlier : 0.0) <= tolerance ? SETTLED : DESCENDING;
}

/* A descent under way. count: evaluations so far, one more than steps taken; each of them has a row in the columns of history, which have
 * `capacity` rows. lower, upper, best_u (steps, nu): bounds of the inputs, and the inputs of the least loss. by_rule: whether the stopping rule may end it. */
typedef struct {
    double rate, tolerance;
    int limit, by_rule, count, capacity;
    const double *lower, *upper;
    double *losses, *terminal_errors, *costs, *norms, *best, *best_u;
} descent_data;

enum { UNDER_WAY, ENDED_SETTLED, ENDED_RUNAWAY, ENDED_AT_LIMIT, ENDED_NOT_FINITE, ENDED_INDEFINITE };

static void descent_step(int n, double rate, const double *restrict gradient, const double *restrict lower, const double *restrict upper,
    double *restrict u)
{
    for (int i = 0; i < n; i++) {
        const double next = u[i] - rate * gradient[i], above = next < lower[i] ? lower[i] : next;
        u[i] = above > upper[i] ? upper[i] : above;
    }
}

/* At most `most` evaluations more, of inputs d->u, each but the first after a step; says why it ended. */
EXPORT int descent_run(loss_data *d, descent_data *s, int most)
{
    for (int done = 0; done < most && s->count < s->capacity; done++) {
        if (s->count) descent_step(d->steps * d->nu, s->rate, d->u_bar, s->lower, s->upper, d->u);
        int status = loss_value(d);
        if (status == EVALUATED) status = loss_gradient(d);
        if (status) return status == DIVERGED ? ENDED_NOT_FINITE : ENDED_INDEFINITE;
        const double slope = norm(d->steps * d->nu, d->u_bar);
        if (!isfinite(slope) || !isfinite(d->value)) return ENDED_NOT_FINITE;
        const int n = s->count++;
        s->losses[n] = d->value;
        s->terminal_errors[n] = sqrt(d->squares);
        s->costs[n] = d->last_cost;
        s->norms[n] = slope;
        s->best[n] = n && s->best[n - 1] <= d->value ? s->best[n - 1] : d->value;
        if (s->best[n] == d->value) memcpy(s->best_u, d->u, (size_t)(d->steps * d->nu) * sizeof *d->u);
        if (s->by_rule) {
            const int progress = loss_progress(s->count, s->losses, s->best, s->tolerance);
            if (progress) return progress == SETTLED ? ENDED_SETTLED : ENDED_RUNAWAY;
        }
        if (n == s->limit) return ENDED_AT_LIMIT;
    }
    return UNDER_WAY;
}
