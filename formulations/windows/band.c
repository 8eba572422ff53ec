/* LU factorisation of a banded matrix with row pivoting, column by column, as dense band: entry (i, j) of the matrix at
 * band[j * height + shift + i - j]. Zeros inside the band, of which optimality systems have many, cost a comparison in the factorisation, and
 * nothing afterwards: solutions and products go over lists of the nonzeros. */

#include <math.h>
#include <stddef.h>
#include <string.h>

#define EXPORT __attribute__((visibility("default")))

/* The nonzeros of columns: those of column j are number starts[j] .. starts[j + 1] - 1, at these rows of the matrix. */
struct nonzeros {
    int *starts, *rows;
    double *values;
};

EXPORT int band_common(int size, int height, const double *one, const double *other);
EXPORT int band_factor(int size, int width, double *band, int *pivots, int first);
EXPORT void band_gather(int size, int height, int shift, int top, int bottom, const double *band, int first, struct nonzeros *found);
EXPORT void band_solve(int size, const int *pivots, const struct nonzeros *lower, const struct nonzeros *upper, double *x);
EXPORT void band_product(int size, const struct nonzeros *matrix, const double *x, double *y);
EXPORT void band_solve_several(int size, int several, const int *pivots, const struct nonzeros *lower, const struct nonzeros *upper, double *x);
EXPORT void band_product_several(int size, int several, const struct nonzeros *matrix, const double *x, double *y);

static int smaller(int a, int b) { return a < b ? a : b; }

/* How many of their first columns two bands have in common. */
EXPORT int band_common(int size, int height, const double *one, const double *other)
{
    int j = 0;
    while (j < size && memcmp(one + (ptrdiff_t)j * height, other + (ptrdiff_t)j * height, (size_t)height * sizeof *one) == 0)
        j++;
    return j;
}

/* What column j does to the columns first .. last: two rows change places, and a multiple of column j is taken off. */
static void eliminate(int width, double *band, int j, int pivot, int deepest, int first, int last)
{
    const ptrdiff_t height = 3 * (ptrdiff_t)width + 1;
    const double *column = band + j * height + 2 * width; /* column[i] is row j + i */
    for (int c = first; c <= last; c++) {
        double *target = band + c * height + 2 * width + j - c;
        const double factor = target[pivot];
        target[pivot] = target[0];
        target[0] = factor;
        if (factor != 0.0)
            for (int i = 1; i <= deepest; i++)
                target[i] -= column[i] * factor;
    }
}

/* In place; width diagonals on either side, height = 3 width + 1, shift = 2 width: the upper width rows are filled by pivoting.
 * Columns before `first` hold their factors and pivots already, from an earlier matrix that began with the same columns; those from `first` on hold
 * the matrix. Returns 0, or 1 + the first column without a pivot. */
EXPORT int band_factor(int size, int width, double *band, int *pivots, int first)
{
    const ptrdiff_t height = 3 * (ptrdiff_t)width + 1;
    int last = 0; /* the last column that a pivot row reaches */
    for (int j = 0; j < size; j++) {
        double *column = band + j * height + 2 * width;
        const int below = smaller(width, size - 1 - j);
        int pivot = 0, deepest = 0;
        if (j >= first) {
            for (int i = 1; i <= below; i++)
                if (fabs(column[i]) > fabs(column[pivot]))
                    pivot = i;
            pivots[j] = pivot;
            if (!(fabs(column[pivot]) > 0.0))
                return j + 1;
            const double kept = column[pivot];
            column[pivot] = column[0];
            column[0] = kept;
        } else
            pivot = pivots[j];
        if (j + pivot + width > last)
            last = smaller(j + pivot + width, size - 1);
        if (last < first)
            continue;
        for (int i = 1; i <= below; i++)
            if (column[i] != 0.0) {
                if (j >= first)
                    column[i] /= column[0];
                deepest = i;
            }
        eliminate(width, band, j, pivot, deepest, j >= first ? j + 1 : first, last);
    }
    return 0;
}

/* The nonzeros in rows top .. bottom - 1 of a band, of its columns from `first` on; those of the columns before are there already. */
EXPORT void band_gather(int size, int height, int shift, int top, int bottom, const double *band, int first, struct nonzeros *found)
{
    int count = found->starts[first], *rows = found->rows;
    double *values = found->values;
    for (int j = first; j < size; j++) {
        const double *column = band + (ptrdiff_t)j * height;
        int begin = top > shift - j ? top : shift - j, end = smaller(bottom, shift + size - j);
        while (begin + 4 <= end && column[begin] == 0.0 && column[begin + 1] == 0.0 && column[begin + 2] == 0.0 && column[begin + 3] == 0.0)
            begin += 4;
        while (begin + 4 <= end && column[end - 1] == 0.0 && column[end - 2] == 0.0 && column[end - 3] == 0.0 && column[end - 4] == 0.0)
            end -= 4;
        for (int i = begin; i < end; i++) { /* no branch: which entries are zero cannot be foreseen */
            rows[count] = j + i - shift;
            values[count] = column[i];
            count += column[i] != 0.0;
        }
        found->starts[j + 1] = count;
    }
}

/* x becomes the solution of the factorised system with right-hand side x. The diagonal is the last entry of each column of the upper factor. */
EXPORT void band_solve(int size, const int *pivots, const struct nonzeros *lower, const struct nonzeros *upper, double *x)
{
    for (int j = 0; j < size; j++) {
        const double value = x[j + pivots[j]];
        x[j + pivots[j]] = x[j];
        x[j] = value;
        if (value != 0.0)
            for (int at = lower->starts[j]; at < lower->starts[j + 1]; at++)
                x[lower->rows[at]] -= lower->values[at] * value;
    }
    for (int j = size - 1; j >= 0; j--) {
        if (x[j] == 0.0)
            continue;
        const int diagonal = upper->starts[j + 1] - 1;
        const double value = x[j] / upper->values[diagonal];
        x[j] = value;
        for (int at = upper->starts[j]; at < diagonal; at++)
            x[upper->rows[at]] -= upper->values[at] * value;
    }
}

/* y = matrix x, of the matrix itself. */
EXPORT void band_product(int size, const struct nonzeros *matrix, const double *x, double *y)
{
    for (int i = 0; i < size; i++)
        y[i] = 0.0;
    for (int j = 0; j < size; j++)
        if (x[j] != 0.0)
            for (int at = matrix->starts[j]; at < matrix->starts[j + 1]; at++)
                y[matrix->rows[at]] += matrix->values[at] * x[j];
}

/* row -= factor * of, of `several` numbers each. */
static void subtract(int several, double factor, const double *restrict of, double *restrict row)
{
    for (int k = 0; k < several; k++)
        row[k] -= factor * of[k];
}

static int is_zero(int several, const double *row)
{
    int k = 0;
    while (k < several && row[k] == 0.0)
        k++;
    return k == several;
}

/* As band_solve, for several right-hand sides at once: x (size, several), row by row, each column by the same operations. */
EXPORT void band_solve_several(int size, int several, const int *pivots, const struct nonzeros *lower, const struct nonzeros *upper, double *x)
{
    for (int j = 0; j < size; j++) {
        double *row = x + (ptrdiff_t)j * several, *other = row + (ptrdiff_t)pivots[j] * several;
        for (int k = 0; other != row && k < several; k++) {
            const double value = other[k];
            other[k] = row[k];
            row[k] = value;
        }
        if (!is_zero(several, row))
            for (int at = lower->starts[j]; at < lower->starts[j + 1]; at++)
                subtract(several, lower->values[at], row, x + (ptrdiff_t)lower->rows[at] * several);
    }
    for (int j = size - 1; j >= 0; j--) {
        double *row = x + (ptrdiff_t)j * several;
        if (is_zero(several, row))
            continue;
        const int diagonal = upper->starts[j + 1] - 1;
        for (int k = 0; k < several; k++)
            row[k] /= upper->values[diagonal];
        for (int at = upper->starts[j]; at < diagonal; at++)
            subtract(several, upper->values[at], row, x + (ptrdiff_t)upper->rows[at] * several);
    }
}

/* y = matrix x for several x at once, both (size, several), row by row. */
EXPORT void band_product_several(int size, int several, const struct nonzeros *matrix, const double *x, double *y)
{
    memset(y, 0, (size_t)size * (size_t)several * sizeof *y);
    for (int j = 0; j < size; j++) {
        const double *row = x + (ptrdiff_t)j * several;
        if (!is_zero(several, row))
            for (int at = matrix->starts[j]; at < matrix->starts[j + 1]; at++)
                subtract(several, -matrix->values[at], row, y + (ptrdiff_t)matrix->rows[at] * several);
    }
}
