/* Single time steps of a scene: linearised at given states, or consecutive with feedback. A
 * library of its own that includes rollout.c as rollout.h. State x = (q, v), 2 NQ entries. */
#include <stddef.h>

#include "rollout.h"

#define NX (2 * NQ)

/* One step from x with inputs u into next (NX) and lam (NL). Return 1 if it is not finite. */
static int one_step(double h, const double *parameters, int law, double b, const double *x, const double *u, double *q, double *v, double *lam)
{
    return kernel_rollout(1, h, parameters, law, b, x, u, q, v, lam) < 1;
}

/* n independent steps from states x (n, NX) with inputs u (n, NU): ends next (n, NX), forces lam
 * (n, NL), and the derivatives of next, A (n, NX, NX) by x and B (n, NX, NU) by u, from the
 * adjoint. A may be NULL: no derivatives. Return the number of steps, fewer than n if one is not
 * finite. */
EXPORT int kernel_linearise(int n, double h, const double *parameters, int law, double b, const double *x, const double *u, double *next,
    double *lam, double *A, double *B)
{
    for (int t = 0; t < n; t++) {
        const double *inputs = u + t * NU;
        double q[2 * NQ], v[2 * NQ], q_bar[2 * NQ] = {0}, v_bar[2 * NQ] = {0}, u_bar[SIZE(NU)];
        if (one_step(h, parameters, law, b, x + t * NX, inputs, q, v, lam + t * NL)) return t;
        for (int i = 0; i < NQ; i++) {
            next[t * NX + i] = q[NQ + i];
            next[t * NX + NQ + i] = v[NQ + i];
        }
        for (int row = 0; A && row < NX; row++) {
            double *bar = row < NQ ? q_bar + NQ + row : v_bar + row; /* v_bar + NQ + (row - NQ): of the end of the step */
            *bar = 1.0;
            if (kernel_adjoint(1, h, parameters, law, b, q, v, lam + t * NL, inputs, q_bar, v_bar, NULL, NULL, 0.0, u_bar, A + (t * NX + row) * NX))
                return t;
            *bar = 0.0;
            for (int j = 0; j < NU; j++) B[(t * NX + row) * NU + j] = u_bar[j];
        }
    }
    return n;
}

/* x[t+1] = f(x[t], u[t]) + jump[t] with u[t] = clip(u_plan[t] + gain[t] (x[t] - x_plan[t]),
 * lower, upper), from x[0] = start.
 *
 * x_plan (steps, NX), u_plan (steps, NU), gain (steps, NU, NX), lower, upper (NU); jump (steps,
 * NX) or NULL. Write x (steps + 1, NX), u (steps, NU), lam (steps, NL); return the number of
 * finite steps. */
EXPORT int kernel_feedback_rollout(int steps, double h, const double *parameters, int law, double b, const double *start,
    const double *x_plan, const double *u_plan, const double *gain, const double *lower, const double *upper, const double *jump, double *x,
    double *u, double *lam)
{
    for (int i = 0; i < NX; i++) x[i] = start[i];
    for (int t = 0; t < steps; t++) {
        const double *from = x + t * NX;
        double q[2 * NQ], v[2 * NQ], *next = x + (t + 1) * NX;
        for (int j = 0; j < NU; j++) {
            double value = u_plan[t * NU + j];
            for (int i = 0; i < NX; i++) value += gain[(t * NU + j) * NX + i] * (from[i] - x_plan[t * NX + i]);
            u[t * NU + j] = value < lower[j] ? lower[j] : value > upper[j] ? upper[j] : value;
        }
        if (one_step(h, parameters, law, b, from, u + t * NU, q, v, lam + t * NL)) return t;
        for (int i = 0; i < NQ; i++) {
            next[i] = q[NQ + i] + (jump ? jump[t * NX + i] : 0.0);
            next[NQ + i] = v[NQ + i] + (jump ? jump[t * NX + NQ + i] : 0.0);
        }
    }
    return steps;
}
