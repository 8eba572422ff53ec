/* Forward and back substitution with the factor of factor.c. */

#include "ldlt.h"

static void forward(int rows, int pivots, const int *kind, const double *l, double *w)
{
    for (int k = 0; k < pivots; k++, l += rows) {
        double p = w[k];
        if (kind[k] == SINGLE) {
            if (p != 0.0)
                for (int i = k + 1; i < rows; i++)
                    w[i] -= l[i] * p;
            continue;
        }
        const double *m = l + rows;
        double q = w[k + 1];
        if (p != 0.0 || q != 0.0)
            for (int i = k + 2; i < rows; i++)
                w[i] -= l[i] * p + m[i] * q;
        k++;
        l += rows;
    }
}

static void divide(int rows, int pivots, const int *kind, const double *l, double *w)
{
    for (int k = 0; k < pivots; k++, l += rows) {
        if (kind[k] == SINGLE) {
            w[k] *= l[k];
            continue;
        }
        double p = w[k], q = w[k + 1];
        w[k] = l[k] * p + l[k + 1] * q;
        w[k + 1] = l[k + 1] * p + l[rows + k + 1] * q;
        k++;
        l += rows;
    }
}

static void backward(int rows, int pivots, const int *kind, const double *factor, double *w)
{
    for (int k = pivots - 1; k >= 0; k--) {
        const double *l = factor + (long)k * rows;
        double t = w[k];
        if (kind[k] == SINGLE) {
            for (int i = k + 1; i < rows; i++)
                t -= l[i] * w[i];
            w[k] = t;
            continue;
        }
        const double *m = l - rows;
        double s = w[k - 1];
        for (int i = k + 1; i < rows; i++) {
            t -= l[i] * w[i];
            s -= m[i] * w[i];
        }
        w[k--] = t;
        w[k] = s;
    }
}

void solve_factor(int count, const double *real, const int *index, double *x, double *work)
{
    for (int s = 0; s < count; s++) {
        int rows = index[0], pivots = index[1];
        const int *variable = index + 2, *kind = variable + rows;
        for (int i = 0; i < rows; i++)
            work[i] = x[variable[i]];
        forward(rows, pivots, kind, real, work);
        divide(rows, pivots, kind, real, work);
        for (int i = 0; i < rows; i++)
            x[variable[i]] = work[i];
        real += (long)rows * pivots;
        index += 3 + rows + pivots;
    }
    for (int s = 0; s < count; s++) {
        index -= index[-1];
        int rows = index[0], pivots = index[1];
        const int *variable = index + 2, *kind = variable + rows;
        real -= (long)rows * pivots;
        for (int i = 0; i < rows; i++)
            work[i] = x[variable[i]];
        backward(rows, pivots, kind, real, work);
        for (int k = 0; k < pivots; k++)
            x[variable[k]] = work[k];
    }
}
