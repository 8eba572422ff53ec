/* Carts in a row by hand: the loss of a plan and its gradient, forward and back, nothing general about it.

   q, v: (steps + 1) x n; u, gradient: steps x 2. Semi-implicit Euler, contact force and damping at the start of a step,
   loss = mean((x_T - goal)^2) + weight sum u^2, contact force k max(d - (q[i+1] - q[i]), 0). */
#include <math.h>

#if defined(_WIN32)
#define API __declspec(dllexport)
#else
#define API __attribute__((visibility("default")))
#endif
#define LARGEST 64

API double cart_gradient(int n, int steps, double h, double m, double c, double k, double d, double weight, const double *start,
                         const double *goal, const double *u, double *q, double *v, double *gradient)
{
    double loss = 0.0, q_bar[LARGEST], v_bar[LARGEST], force[LARGEST];
    if (n > LARGEST)
        return NAN;
    for (int i = 0; i < n; i++) {
        q[i] = start[i];
        v[i] = start[n + i];
    }
    for (int t = 0; t < steps; t++) {
        const double *q0 = q + t * n, *v0 = v + t * n;
        double *q1 = q + (t + 1) * n, *v1 = v + (t + 1) * n;
        for (int i = 0; i < n; i++)
            force[i] = -c * v0[i];
        force[0] += u[2 * t];
        force[n - 1] += u[2 * t + 1];
        for (int i = 0; i + 1 < n; i++) {
            double phi = d - (q0[i + 1] - q0[i]), push = phi > 0.0 ? k * phi : 0.0;
            force[i] -= push;
            force[i + 1] += push;
        }
        for (int i = 0; i < n; i++) {
            v1[i] = v0[i] + h / m * force[i];
            q1[i] = q0[i] + h * v1[i];
        }
        loss += weight * (u[2 * t] * u[2 * t] + u[2 * t + 1] * u[2 * t + 1]);
    }
    for (int i = 0; i < n; i++) {
        double miss = q[steps * n + i] - goal[i], speed = v[steps * n + i] - goal[n + i];
        loss += (miss * miss + speed * speed) / (2 * n);
        q_bar[i] = miss / n;
        v_bar[i] = speed / n;
    }
    for (int t = steps - 1; t >= 0; t--) {
        const double *q0 = q + t * n;
        for (int i = 0; i < n; i++) {
            v_bar[i] += h * q_bar[i];
            force[i] = h / m * v_bar[i];
        }
        gradient[2 * t] = force[0] + 2 * weight * u[2 * t];
        gradient[2 * t + 1] = force[n - 1] + 2 * weight * u[2 * t + 1];
        for (int i = 0; i < n; i++)
            v_bar[i] -= c * force[i];
        for (int i = 0; i + 1 < n; i++)
            if (d - (q0[i + 1] - q0[i]) > 0.0) {
                double slope = k * (force[i + 1] - force[i]);
                q_bar[i] += slope;
                q_bar[i + 1] -= slope;
            }
    }
    return loss;
}
