/* The linear-quadratic subproblem of multiple shooting, by dynamic programming over its stages.
 *
 *   min sum_t  lx'dx + lu'du + 1/2 (dx'lxx dx + 2 du'lux dx + du'luu du)
 *              + px'dx_N + 1/2 dx_N'pxx dx_N
 *   s.t. dx[t+1] = A dx[t] + B du[t] + gap[t],  dx[0] = 0,   lower <= u + du <= upper
 *
 * Arrays are row-major, one block per stage. The bounds hold for du at dx = 0; an input at a
 * bound has no feedback. */
#include <math.h>
#include <string.h>

#define EXPORT __attribute__((visibility("default")))
#define QP_ROUNDS 50

/* Cholesky of the free part of H (n, n), in place of L; return 1 if it is not positive definite.
 * Rows of held inputs become those of the identity. */
static int factor(int n, const double *H, const int *held, double *L)
{
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) L[i * n + j] = held[i] || held[j] ? (i == j ? 1.0 : 0.0) : H[i * n + j];
    for (int j = 0; j < n; j++) {
        for (int k = 0; k < j; k++) L[j * n + j] -= L[j * n + k] * L[j * n + k];
        if (!(L[j * n + j] > 0.0)) return 1;
        L[j * n + j] = sqrt(L[j * n + j]);
        for (int i = j + 1; i < n; i++) {
            for (int k = 0; k < j; k++) L[i * n + j] -= L[i * n + k] * L[j * n + k];
            L[i * n + j] /= L[j * n + j];
        }
    }
    return 0;
}

/* Solve L L' x = x in place, with entries `stride` apart. */
static void solve(int n, const double *L, double *x, int stride)
{
    for (int i = 0; i < n; i++) {
        for (int k = 0; k < i; k++) x[i * stride] -= L[i * n + k] * x[k * stride];
        x[i * stride] /= L[i * n + i];
    }
    for (int i = n - 1; i >= 0; i--) {
        for (int k = i + 1; k < n; k++) x[i * stride] -= L[k * n + i] * x[k * stride];
        x[i * stride] /= L[i * n + i];
    }
}

static double clip(double value, double lower, double upper) { return value < lower ? lower : value > upper ? upper : value; }

static double quadratic(int n, const double *H, const double *g, const double *x)
{
    double value = 0.0;
    for (int i = 0; i < n; i++) {
        value += g[i] * x[i];
        for (int j = 0; j < n; j++) value += 0.5 * x[i] * H[i * n + j] * x[j];
    }
    return value;
}

/* Minimise 1/2 x'Hx + g'x over low <= x <= high by projected Newton steps from x. held: entries
 * at a bound; L: factor of the rest; work: 3 n. Return 1 if H is not positive definite. */
static int box_qp(int n, const double *H, const double *g, const double *low, const double *high, double *x, int *held, double *L, double *work)
{
    double *slope = work, *direction = work + n, *moved = work + 2 * n, first = 0.0;
    for (int i = 0; i < n; i++) x[i] = clip(x[i], low[i], high[i]);
    for (int round = 0; round < QP_ROUNDS; round++) {
        const double value = quadratic(n, H, g, x);
        double decrease = 0.0, length = 1.0;
        for (int i = 0; i < n; i++) {
            slope[i] = g[i];
            for (int j = 0; j < n; j++) slope[i] += H[i * n + j] * x[j];
            held[i] = (x[i] <= low[i] && slope[i] > 0.0) || (x[i] >= high[i] && slope[i] < 0.0);
        }
        if (factor(n, H, held, L)) return 1;
        for (int i = 0; i < n; i++) direction[i] = held[i] ? 0.0 : -slope[i];
        solve(n, L, direction, 1);
        for (int i = 0; i < n; i++) decrease -= slope[i] * direction[i];
        if (round == 0) first = decrease;
        if (!(decrease > 1e-14 * first)) return 0;
        for (int halving = 0; halving < 40; halving++, length *= 0.5) {
            for (int i = 0; i < n; i++) moved[i] = clip(x[i] + length * direction[i], low[i], high[i]);
            if (quadratic(n, H, g, moved) <= value - 1e-4 * length * decrease) break;
        }
        memcpy(x, moved, n * sizeof *x);
    }
    return 0;
}

/* y (n, m) = X' Z with X (k, n), Z (k, m) */
static void transposed_product(int k, int n, int m, const double *X, const double *Z, double *y)
{
    for (int i = 0; i < n * m; i++) y[i] = 0.0;
    for (int l = 0; l < k; l++)
        for (int i = 0; i < n; i++)
            for (int j = 0; j < m; j++) y[i * m + j] += X[l * n + i] * Z[l * m + j];
}

static void product(int n, int k, int m, const double *X, const double *Z, double *y)
{
    for (int i = 0; i < n; i++)
        for (int j = 0; j < m; j++) {
            double sum = 0.0;
            for (int l = 0; l < k; l++) sum += X[i * k + l] * Z[l * m + j];
            y[i * m + j] = sum;
        }
}

/* Size of the work buffer of riccati_backward [doubles]. */
EXPORT int riccati_work(int nx, int nu) { return 4 * nx * nx + 4 * nx * nu + 2 * nu * nu + 4 * nx + 8 * nu; }

/* Sweep from the last stage to the first. shift is added to the diagonal of the inputs' Hessian.
 * Vx (steps + 1, nx), Vxx (nx, nx): slopes of the value and its Hessian; the caller sets those
 * of the last node. k (steps, nu), K (steps, nu, nx): du = k + K dx. held (nu): work space.
 * Return 1 if a Hessian is not positive definite. */
EXPORT int riccati_backward(int steps, int nx, int nu, const double *A, const double *B, const double *gap, const double *lx, const double *lu,
    const double *lxx, const double *lux, const double *luu, double shift, const double *u, const double *lower, const double *upper,
    double *Vx, double *Vxx, double *k, double *K, double *work, int *held)
{
    double *VA = work, *Qxx = VA + nx * nx, *next = Qxx + nx * nx, *VB = next + nx * nx, *Qux = VB + nx * nu, *QK = Qux + nx * nu;
    double *Quu = QK + nx * nu, *L = Quu + nu * nu, *s = L + nu * nu, *Qx = s + nx, *Qu = Qx + nx, *low = Qu + nu, *high = low + nu;
    double *room = high + nu, *Qk = room + 3 * nu;
    for (int t = steps - 1; t >= 0; t--) {
        const double *At = A + t * nx * nx, *Bt = B + t * nx * nu, *gt = gap + t * nx, *ut = u + t * nu;
        double *kt = k + t * nu, *Kt = K + t * nu * nx;
        for (int i = 0; i < nx; i++) {
            s[i] = Vx[(t + 1) * nx + i];
            for (int j = 0; j < nx; j++) s[i] += Vxx[i * nx + j] * gt[j];
        }
        product(nx, nx, nx, Vxx, At, VA);
        product(nx, nx, nu, Vxx, Bt, VB);
        transposed_product(nx, nx, nx, At, VA, Qxx);
        transposed_product(nx, nu, nx, Bt, VA, Qux);
        transposed_product(nx, nu, nu, Bt, VB, Quu);
        transposed_product(nx, nx, 1, At, s, Qx);
        transposed_product(nx, nu, 1, Bt, s, Qu);
        for (int i = 0; i < nx * nx; i++) Qxx[i] += lxx[t * nx * nx + i];
        for (int i = 0; i < nx * nu; i++) Qux[i] += lux[t * nx * nu + i];
        for (int i = 0; i < nu * nu; i++) Quu[i] += luu[t * nu * nu + i];
        for (int i = 0; i < nx; i++) Qx[i] += lx[t * nx + i];
        for (int i = 0; i < nu; i++) {
            Qu[i] += lu[t * nu + i];
            Quu[i * nu + i] += shift;
            low[i] = lower[i] - ut[i];
            high[i] = upper[i] - ut[i];
            kt[i] = 0.0;
        }
        if (box_qp(nu, Quu, Qu, low, high, kt, held, L, room)) return 1;
        for (int i = 0; i < nu; i++)
            for (int j = 0; j < nx; j++) Kt[i * nx + j] = held[i] ? 0.0 : -Qux[i * nx + j];
        for (int j = 0; j < nx; j++) solve(nu, L, Kt + j, nx);
        /* Vx = Qx + K'(Quu k + Qu) + Qux'k,  Vxx = Qxx + K'Quu K + K'Qux + Qux'K */
        product(nu, nu, 1, Quu, kt, Qk);
        for (int i = 0; i < nu; i++) Qk[i] += Qu[i];
        product(nu, nu, nx, Quu, Kt, QK);
        for (int i = 0; i < nu * nx; i++) QK[i] += Qux[i];
        transposed_product(nu, nx, nx, Kt, QK, next);
        transposed_product(nu, nx, nx, Qux, Kt, Vxx);
        for (int i = 0; i < nx * nx; i++) next[i] += Vxx[i] + Qxx[i];
        for (int i = 0; i < nx; i++)
            for (int j = 0; j < nx; j++) Vxx[i * nx + j] = 0.5 * (next[i * nx + j] + next[j * nx + i]);
        transposed_product(nu, nx, 1, Kt, Qk, s);
        transposed_product(nu, nx, 1, Qux, kt, Vx + t * nx);
        for (int i = 0; i < nx; i++) Vx[t * nx + i] += s[i] + Qx[i];
        for (int i = 0; i < nx; i++)
            if (!isfinite(Vx[t * nx + i])) return 1;
    }
    return 0;
}

/* Apply the feedback law to the linearised stages: dx (steps + 1, nx), du (steps, nu), from
 * dx[0] = 0. */
EXPORT void riccati_forward(int steps, int nx, int nu, const double *A, const double *B, const double *gap, const double *k, const double *K,
    double *dx, double *du)
{
    for (int i = 0; i < nx; i++) dx[i] = 0.0;
    for (int t = 0; t < steps; t++) {
        const double *from = dx + t * nx;
        double *to = dx + (t + 1) * nx, *ut = du + t * nu;
        for (int i = 0; i < nu; i++) {
            ut[i] = k[t * nu + i];
            for (int j = 0; j < nx; j++) ut[i] += K[(t * nu + i) * nx + j] * from[j];
        }
        for (int i = 0; i < nx; i++) {
            to[i] = gap[t * nx + i];
            for (int j = 0; j < nx; j++) to[i] += A[(t * nx + i) * nx + j] * from[j];
            for (int j = 0; j < nu; j++) to[i] += B[(t * nx + i) * nu + j] * ut[j];
        }
    }
}
