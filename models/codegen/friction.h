/* Dry friction within one time step of semi-implicit Euler, and its adjoint. Needs
 * scene_model.h; only for scenes with friction.
 *
 * The friction forces f depend on the slip at the *end* of the step, s = S(q[t]) v[t+1], so that
 * a step can stick.
 *
 *   v[t+1] = v[t] + h a(q, v, u, lam, f),      s = s0 + h W f,      W = S M^-1 S'
 *
 *   law 0, Coulomb:      f minimises f s over |f| <= mu N:  s = 0, or |f| = mu N against s
 *   law 1, regularised:  f = -mu N tanh(b L s / (2 nominal)), L the scene's length
 *
 * Both minimise a convex function of f (W is positive semidefinite). Sweeps over single forces
 * find the minimiser; sticking forces are then solved exactly. */
#ifndef FRICTION_H
#define FRICTION_H

#include <math.h>
#include <string.h>

#include "scene_model.h"

/* One force needs one sweep; coupled ones converge linearly, in tens of sweeps. The score
 * measures the remaining error (friction law). */
#define FRICTION_SWEEPS 10000

typedef struct {
    double s0[NF];        /* slip at the end of the step without friction [m/s] */
    double hW[NF][NF];    /* h S M^-1 S' [m/s per N] */
    double A[NF][NQ];     /* row j: M^-1 S_j', the acceleration of a unit of friction force j */
    double limit[NF];     /* mu N [N] */
} FrictionStep;

/* A smaller share of the diagonal is rounding: earlier frictions already hold this motion. */
#define FRICTION_REDUNDANT 1e-14

/* Solve the symmetric positive semidefinite system K x = b of size n in place (K is destroyed);
 * a redundant friction gets 0. Return 1 if K contains NaN. */
SCENE_FUNCTION int friction_solve(int n, double K[NF][NF], double *x)
{
    for (int j = 0; j < n; j++) {
        const double diagonal = K[j][j];
        for (int k = 0; k < j; k++) K[j][j] -= K[j][k] * K[j][k];
        if (!(K[j][j] >= -INFINITY)) return 1; /* NaN */
        K[j][j] = K[j][j] > FRICTION_REDUNDANT * diagonal ? sqrt(K[j][j]) : INFINITY;
        for (int i = j + 1; i < n; i++) {
            for (int k = 0; k < j; k++) K[i][j] -= K[i][k] * K[j][k];
            K[i][j] /= K[j][j];
        }
    }
    for (int i = 0; i < n; i++) {
        for (int k = 0; k < i; k++) x[i] -= K[i][k] * x[k];
        x[i] /= K[i][i];
    }
    for (int i = n - 1; i >= 0; i--) {
        for (int k = i + 1; k < n; k++) x[i] -= K[k][i] * x[k];
        x[i] /= K[i][i];
    }
    return 0;
}

/* Compute A, hW = h S M^-1 S' and the limits at the contact forces in lam. Return 1 if the mass
 * matrix is not positive definite. */
SCENE_FUNCTION int friction_columns(double h, const double *p, const double *q, const double *v, const double *u, const double *lam, FrictionStep *step)
{
    double zero_q[NQ], zero_u[NU > 0 ? NU : 1], unit[NC + NF];
    memset(zero_q, 0, sizeof zero_q);
    memset(zero_u, 0, sizeof zero_u);
    scene_friction_limit(q, lam, p, step->limit);
    for (int j = 0; j < NF; j++) {
        double column[NF];
        if (!(step->limit[j] > 0.0)) step->limit[j] = 0.0;
        memset(unit, 0, sizeof unit);
        unit[NC + j] = 1.0;
        if (scene_acceleration_jvp(q, v, u, lam, p, zero_q, zero_q, zero_u, unit, step->A[j])) return 1;
        scene_slip(q, step->A[j], p, column);
        for (int i = 0; i < NF; i++) step->hW[i][j] = h * column[i];
    }
    return 0;
}

/* Prepare a step. lam: contact forces (NC), then NF entries that are set to zero. Return 1 if
 * the mass matrix is not positive definite. */
SCENE_FUNCTION int friction_step(double h, const double *p, const double *q, const double *v, const double *u, double *lam, FrictionStep *step)
{
    double a[NQ], end[NQ];
    for (int j = 0; j < NF; j++) lam[NC + j] = 0.0;
    if (scene_acceleration(q, v, u, lam, p, a)) return 1;
    for (int i = 0; i < NQ; i++) end[i] = v[i] + h * a[i];
    scene_slip(q, end, p, step->s0);
    return friction_columns(h, p, q, v, u, lam, step);
}

SCENE_FUNCTION double slip_at_end(const FrictionStep *step, const double *f, int j)
{
    double s = step->s0[j];
    for (int i = 0; i < NF; i++) s += step->hW[j][i] * f[i];
    return s;
}

SCENE_FUNCTION double friction_sharpness(double b, int j) { return 0.5 * b * SCENE_LENGTH / scene_friction_nominals[j]; }

/* Return the root in [-1, 1] of x + tanh(c (rest + w x)), c, w >= 0: x = -tanh(y) with y + c w
 * tanh(y) = c rest. For rest > 0 the left side is concave between 0 and its root, so Newton from
 * below converges monotonically. */
SCENE_FUNCTION double regularised_root(double c, double rest, double w)
{
    const double cw = c * w, right = c * fabs(rest);
    double y = fmax(right / (1.0 + cw), right - cw), g = tanh(y);
    for (int n = 0; n < 200; n++) {
        const double next = y + (right - y - cw * g) / (1.0 + cw * (1.0 - g * g));
        if (!(next > y)) break;
        y = next;
        g = tanh(y);
    }
    return rest > 0.0 ? -g : g;
}

/* One force, with the other forces fixed. */
SCENE_FUNCTION double friction_alone(int law, double b, const FrictionStep *step, const double *f, int j)
{
    const double limit = step->limit[j], w = step->hW[j][j];
    const double rest = slip_at_end(step, f, j) - w * f[j];
    if (limit == 0.0) return 0.0;
    if (law == 1) return limit * regularised_root(friction_sharpness(b, j), rest, w * limit);
    if (w == 0.0) return rest > 0.0 ? -limit : rest < 0.0 ? limit : 0.0;
    return fmin(fmax(-rest / w, -limit), limit);
}

/* Coulomb: forces inside their limits stick; solve these exactly unless that is contradictory. */
SCENE_FUNCTION void stick_exactly(const FrictionStep *step, double *f)
{
    int sticks[NF] = {0}, n = 0; /* zeros: compilers warn otherwise */
    double K[NF][NF], x[NF];
    for (int j = 0; j < NF; j++)
        if (fabs(f[j]) < step->limit[j]) sticks[n++] = j;
    for (int i = 0; i < n; i++) {
        x[i] = -step->s0[sticks[i]];
        for (int j = 0; j < NF; j++)
            if (!(fabs(f[j]) < step->limit[j])) x[i] -= step->hW[sticks[i]][j] * f[j];
        for (int j = 0; j < n; j++) K[i][j] = step->hW[sticks[i]][sticks[j]];
    }
    if (n == 0 || friction_solve(n, K, x)) return;
    for (int i = 0; i < n; i++)
        if (!(fabs(x[i]) <= step->limit[sticks[i]])) return;
    for (int i = 0; i < n; i++) f[sticks[i]] = x[i];
}

/* Compute all forces with nonzero `free` (NULL: all), starting at f; the rest is fixed. */
SCENE_FUNCTION void friction_balance(int law, double b, const FrictionStep *step, const int *free, double *f)
{
    for (int n = 0; n < FRICTION_SWEEPS; n++) {
        double change = 0.0;
        for (int j = 0; j < NF; j++) {
            if (free && !free[j]) continue;
            const double before = f[j];
            f[j] = friction_alone(law, b, step, f, j);
            if (step->limit[j] > 0.0) change = fmax(change, fabs(f[j] - before) / step->limit[j]);
        }
        if (NF == 1 || change <= 1e-15) break;
    }
    if (law == 0 && NF > 1) stick_exactly(step, f);
}

/* Compute the friction forces of a step into lam[NC ..] from the contact forces before. Return
 * as friction_step. */
SCENE_FUNCTION int friction_forces(int law, double b, double h, const double *p, const double *q, const double *v, const double *u, double *lam)
{
    FrictionStep step;
    if (friction_step(h, p, q, v, u, lam, &step)) return 1;
    friction_balance(law, b, &step, NULL, lam + NC);
    return 0;
}

/* The part of the adjoint of a step through the friction forces.
 *
 * v_bar (NQ): derivative of the loss by v[t+1] = v_end; S' s_bar is added. Adds to q_bar through
 * slip and limit, and to lam_bar[0 .. NC) through the limit; lam_bar[NC ..] are the derivatives
 * by f = lam[NC ..].
 *
 * With f_bar = lam_bar + h A (v_bar + S' s_bar): slipping or regularised forces have s_bar =
 * (df/ds) f_bar; for sticking ones f_bar = 0 determines s_bar. */
SCENE_FUNCTION int friction_adjoint(int law, double b, double h, const double *p, const double *q, const double *v, const double *u,
    const double *lam, const double *v_end, double *v_bar, double *q_bar, double *lam_bar)
{
    FrictionStep step;
    double work[NC + NF], s_bar[NF], f_bar[NF], limit_bar[NF], slope[NF], sign[NF], K[NF][NF];
    const double *f = lam + NC;
    int at[NF], n = 0;
    memcpy(work, lam, sizeof work);
    if (friction_step(h, p, q, v, u, work, &step)) return 1;
    for (int j = 0; j < NF; j++) {
        const double s = slip_at_end(&step, f, j), c = friction_sharpness(b, j), limit = step.limit[j];
        f_bar[j] = lam_bar[NC + j];
        for (int i = 0; i < NQ; i++) f_bar[j] += h * step.A[j][i] * v_bar[i];
        s_bar[j] = 0.0;
        if (law == 1) {
            const double g = tanh(c * s);
            sign[j] = -g;
            slope[j] = limit * c * (1.0 - g * g);
        } else {
            sign[j] = f[j] > 0.0 ? 1.0 : f[j] < 0.0 ? -1.0 : 0.0;
            slope[j] = fabs(f[j]) < limit ? INFINITY : 0.0;
        }
        if (slope[j] > 0.0) at[n++] = j;
    }
    /* (1/slope + hW) s_bar = -f_bar for the forces that depend on the slip */
    for (int i = 0; i < n; i++) {
        s_bar[i] = -f_bar[at[i]];
        for (int j = 0; j < n; j++) K[i][j] = step.hW[at[i]][at[j]] + (i == j ? 1.0 / slope[at[i]] : 0.0);
    }
    if (n > 0 && friction_solve(n, K, s_bar)) return 1;
    for (int i = n - 1; i >= 0; i--) {
        const double value = s_bar[i];
        s_bar[i] = 0.0;
        s_bar[at[i]] = value; /* at[i] >= i, and later entries were moved before */
    }
    for (int j = 0; j < NF; j++) {
        limit_bar[j] = f_bar[j];
        for (int i = 0; i < NF; i++) limit_bar[j] += step.hW[j][i] * s_bar[i];
        limit_bar[j] *= law == 0 && slope[j] > 0.0 ? 0.0 : sign[j];
    }
    scene_slip_vjp(q, v_end, p, s_bar, q_bar, v_bar);
    scene_friction_limit_vjp(q, lam, p, limit_bar, q_bar, lam_bar);
    return 0;
}

#endif
