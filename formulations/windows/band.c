/* LU factorisation of a banded matrix with row pivoting, column by column, as dense band: entry (i, j) of the matrix at
 * band[j * height + shift + i - j]. Zeros inside the band, of which optimality systems have many, cost a comparison only. */

#include <math.h>
#include <stddef.h>

#define EXPORT __attribute__((visibility("default")))

EXPORT int band_factor(int size, int width, double *band, int *pivots);
EXPORT void band_solve(int size, int width, const double *factors, const int *pivots, double *x);
EXPORT void band_product(int size, int width, const double *band, const double *x, double *y);

static int smaller(int a, int b) { return a < b ? a : b; }

/* In place; width diagonals on either side, height = 3 width + 1, shift = 2 width: the upper width rows are filled by pivoting.
 * Returns 0, or 1 + the first column without a pivot. */
EXPORT int band_factor(int size, int width, double *band, int *pivots)
{
    const ptrdiff_t height = 3 * (ptrdiff_t)width + 1;
    int last = 0; /* the last column that a pivot row reaches */
    for (int j = 0; j < size; j++) {
        double *column = band + j * height + 2 * width; /* column[i] is row j + i */
        const int below = smaller(width, size - 1 - j);
        int pivot = 0;
        for (int i = 1; i <= below; i++)
            if (fabs(column[i]) > fabs(column[pivot]))
                pivot = i;
        pivots[j] = pivot;
        if (!(fabs(column[pivot]) > 0.0))
            return j + 1;
        if (j + pivot + width > last)
            last = smaller(j + pivot + width, size - 1);
        if (pivot != 0)
            for (int c = j; c <= last; c++) {
                double *entry = band + c * height + 2 * width + j - c;
                const double kept = entry[0];
                entry[0] = entry[pivot];
                entry[pivot] = kept;
            }
        int deepest = 0;
        for (int i = 1; i <= below; i++)
            if (column[i] != 0.0) {
                column[i] /= column[0];
                deepest = i;
            }
        if (deepest == 0)
            continue;
        for (int c = j + 1; c <= last; c++) {
            double *target = band + c * height + 2 * width + j - c;
            const double factor = target[0];
            if (factor != 0.0)
                for (int i = 1; i <= deepest; i++)
                    target[i] -= column[i] * factor;
        }
    }
    return 0;
}

/* x becomes the solution of the factorised system with right-hand side x. */
EXPORT void band_solve(int size, int width, const double *factors, const int *pivots, double *x)
{
    const ptrdiff_t height = 3 * (ptrdiff_t)width + 1;
    for (int j = 0; j < size; j++) {
        const double value = x[j + pivots[j]];
        x[j + pivots[j]] = x[j];
        x[j] = value;
        if (value != 0.0) {
            const double *column = factors + j * height + 2 * width;
            const int below = smaller(width, size - 1 - j);
            for (int i = 1; i <= below; i++)
                x[j + i] -= column[i] * value;
        }
    }
    for (int j = size - 1; j >= 0; j--) {
        const double *column = factors + j * height + 2 * width;
        if (x[j] == 0.0)
            continue;
        x[j] /= column[0];
        const int above = smaller(2 * width, j);
        for (int i = 1; i <= above; i++)
            x[j - i] -= column[-i] * x[j];
    }
}

/* y = matrix x, of the matrix itself: height = 2 width + 1, shift = width. */
EXPORT void band_product(int size, int width, const double *band, const double *x, double *y)
{
    const ptrdiff_t height = 2 * (ptrdiff_t)width + 1;
    for (int i = 0; i < size; i++)
        y[i] = 0.0;
    for (int j = 0; j < size; j++) {
        const double *column = band + j * height + width;
        const int above = smaller(width, j), below = smaller(width, size - 1 - j);
        if (x[j] != 0.0)
            for (int i = -above; i <= below; i++)
                y[j + i] += column[i] * x[j];
    }
}
