/* LU factorisation of a banded matrix with row pivoting, as a dense band: entry (i, j) at band[j
 * * height + shift + i - j]. Optimality systems have many zeros inside the band; each costs only
 * a comparison. */

#include <math.h>
#include <stddef.h>

#define EXPORT __attribute__((visibility("default")))

EXPORT int band_factor(int size, int width, double *band, int *pivots);
EXPORT void band_solve(int size, int width, const double *band, const int *pivots, double *x);
EXPORT void band_product(int size, int width, const double *matrix, const double *x, double *y);

static int smaller(int a, int b) { return a < b ? a : b; }

/* y -= factor * x, of `count` numbers each. */
static void subtract(int count, double factor, const double *restrict x, double *restrict y)
{
    for (int i = 0; i < count; i++)
        y[i] -= factor * x[i];
}

/* Factorise in place; width diagonals on either side, height = 3 width + 1, shift = 2 width:
 * pivoting fills the upper width rows. Return 0, or 1 + the first column without a pivot. */
EXPORT int band_factor(int size, int width, double *band, int *pivots)
{
    const ptrdiff_t height = 3 * (ptrdiff_t)width + 1;
    int last = 0; /* last column of a pivot row */
    for (int j = 0; j < size; j++) {
        double *column = band + j * height + 2 * width; /* column[i] is row j + i */
        const int below = smaller(width, size - 1 - j);
        int pivot = 0, deepest = 0;
        for (int i = 1; i <= below; i++)
            if (fabs(column[i]) > fabs(column[pivot]))
                pivot = i;
        pivots[j] = pivot;
        if (!(fabs(column[pivot]) > 0.0))
            return j + 1;
        const double top = column[pivot];
        column[pivot] = column[0];
        column[0] = top;
        for (int i = 1; i <= below; i++)
            if (column[i] != 0.0) {
                column[i] /= top;
                deepest = i;
            }
        if (j + pivot + width > last)
            last = smaller(j + pivot + width, size - 1);
        for (int c = j + 1; c <= last; c++) {
            double *target = band + c * height + 2 * width + j - c;
            const double factor = target[pivot];
            target[pivot] = target[0];
            target[0] = factor;
            if (factor != 0.0)
                subtract(deepest, factor, column + 1, target + 1);
        }
    }
    return 0;
}

/* Replace the right-hand side x by the solution. */
EXPORT void band_solve(int size, int width, const double *band, const int *pivots, double *x)
{
    const ptrdiff_t height = 3 * (ptrdiff_t)width + 1;
    for (int j = 0; j < size; j++) {
        const double value = x[j + pivots[j]];
        x[j + pivots[j]] = x[j];
        x[j] = value;
        if (value != 0.0)
            subtract(smaller(width, size - 1 - j), value, band + j * height + 2 * width + 1, x + j + 1);
    }
    for (int j = size - 1; j >= 0; j--) {
        const double *diagonal = band + j * height + 2 * width;
        const int above = smaller(2 * width, j);
        x[j] /= diagonal[0];
        if (x[j] != 0.0)
            subtract(above, x[j], diagonal - above, x + j - above);
    }
}

/* Compute y = matrix x with width diagonals on either side, height = 2 width + 1, shift = width. */
EXPORT void band_product(int size, int width, const double *matrix, const double *x, double *y)
{
    for (int i = 0; i < size; i++)
        y[i] = 0.0;
    for (int j = 0; j < size; j++) {
        const int above = smaller(width, j), below = smaller(width, size - 1 - j);
        if (x[j] != 0.0)
            subtract(above + below + 1, -x[j], matrix + j * (2 * (ptrdiff_t)width + 1) + width - above, y + j - above);
    }
}
