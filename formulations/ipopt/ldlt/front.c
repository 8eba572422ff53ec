/* Pivots of one and two variables are sought in a front and eliminated, by panels, so that what is updated stays in the cache. */

#include <math.h>

#include "front.h"
#include "ldlt.h"

/* No pivot: its inverse is no number. */
static const double NOTHING = 1e-300;

/* Columns of a front kept up to date while pivots are sought among them; the others follow when these give no more. */
enum { PANEL = 48 };

/* Pivots are sought with this threshold first, and with the caller's where there are none. */
static const double CAREFUL = 0.01;

static void exchange(double *a, double *b)
{
    double t = *a;
    *a = *b;
    *b = t;
}

static void swap(struct front *f, int a, int b)
{
    if (a == b)
        return;
    int v = f->variable[a];
    f->variable[a] = f->variable[b];
    f->variable[b] = v;
    for (int j = 0; j < a; j++)
        exchange(column_of(f, j) + a, column_of(f, j) + b);
    double *first = column_of(f, a), *second = column_of(f, b);
    exchange(first + a, second + b);
    for (int k = a + 1; k < b; k++)
        exchange(first + k, column_of(f, k) + b);
    for (int i = b + 1; i < f->rows; i++)
        exchange(first + i, second + i);
}

/* Largest entry of column c from row k on, off the diagonal and but for row `but`; *inner: the choosable row with the largest. */
static double largest(const struct front *f, int k, int c, int but, int *inner)
{
    double most = 0.0, chosen = -1.0;
    const double *column = column_of(f, c);
    for (int i = k; i < f->choosable; i++) {
        if (i == but || i == c)
            continue;
        double a = fabs(i < c ? column_of(f, i)[c] : column[i]);
        if (a > chosen) {
            chosen = a;
            *inner = i;
        }
    }
    if (chosen > most)
        most = chosen;
    for (int i = f->choosable; i < f->rows; i++)
        if (fabs(column[i]) > most)
            most = fabs(column[i]);
    return most;
}

/* Brings an acceptable pivot to k: 1 or 2 variables, 0 if there is none; -1: a column is zero, now and in every front to come. */
static int choose(struct front *f, int k, double u)
{
    for (int c = k; c < f->choosable; c++) {
        int r = -1, ignored;
        double most = largest(f, k, c, -1, &r), own = column_of(f, c)[c];
        if (own == 0.0 && most == 0.0)
            return -1;
        if (fabs(own) > NOTHING && fabs(own) >= u * most) {
            swap(f, k, c);
            return 1;
        }
        if (r < 0)
            continue;
        int first = c < r ? c : r, second = c < r ? r : c;
        double across = fabs(column_of(f, first)[second]), other = column_of(f, r)[r], determinant = fabs(own * other - across * across);
        if (!(determinant > NOTHING))
            continue;
        double beside = largest(f, k, c, r, &ignored), beyond = largest(f, k, r, c, &ignored);
        if (u * (fabs(other) * beside + across * beyond) <= determinant && u * (across * beside + fabs(own) * beyond) <= determinant) {
            swap(f, k, first);
            swap(f, k + 1, second);
            return 2;
        }
    }
    return 0;
}

/* Eliminates the variable at k from the choosable columns; its own becomes that of L. Returns how many eigenvalues are negative. Columns are divided
 * and not multiplied by an inverse: a row stated twice then leaves zeros more often than rounding. Rounding that is left becomes a pivot, as with
 * MA27: it cannot be told from a barrier's terms, which fall to 1e-18, and a degenerate problem regularised for these ends off its solution. */
static int eliminate_one(struct front *f, int k)
{
    double *restrict l = column_of(f, k), *restrict product = f->product + (size_t)k * (size_t)f->rows;
    double pivot = l[k], inverse = 1.0 / pivot;
    int rows = f->rows;
    for (int i = k + 1; i < rows; i++) {
        product[i] = l[i];
        l[i] /= pivot;
    }
    for (int j = k + 1; j < f->choosable; j++) {
        double s = product[j], *restrict target = column_of(f, j);
        if (s != 0.0)
            for (int i = j; i < rows; i++)
                target[i] -= s * l[i];
    }
    l[k] = inverse;
    f->kind[k] = SINGLE;
    return pivot < 0.0;
}

static int eliminate_pair(struct front *f, int k)
{
    double *restrict l = column_of(f, k), *restrict m = column_of(f, k + 1);
    double *restrict product = f->product + (size_t)k * (size_t)f->rows, *restrict other = product + f->rows;
    double a = l[k], b = l[k + 1], c = m[k + 1], determinant = a * c - b * b;
    double aa = c / determinant, bb = -b / determinant, cc = a / determinant;
    int rows = f->rows;
    for (int i = k + 2; i < rows; i++) {
        double x = l[i], y = m[i];
        product[i] = x;
        other[i] = y;
        l[i] = (c * x - b * y) / determinant;
        m[i] = (a * y - b * x) / determinant;
    }
    for (int j = k + 2; j < f->choosable; j++) {
        double s = product[j], t = other[j], *restrict target = column_of(f, j);
        if (s != 0.0 || t != 0.0)
            for (int i = j; i < rows; i++)
                target[i] -= s * l[i] + t * m[i];
    }
    l[k] = aa;
    l[k + 1] = bb;
    m[k + 1] = cc;
    f->kind[k] = FIRST;
    f->kind[k + 1] = SECOND;
    return determinant < 0.0 ? 1 : a + c < 0.0 ? 2 : 0;
}

/* The columns behind the choosable ones lose what the pivots from `first` to before `pivots` eliminated, four at a time. */
static void update_rest(struct front *f, int first, int pivots)
{
    int rows = f->rows;
    size_t ahead = (size_t)rows;
    for (int j = f->choosable; j < rows; j++) {
        double *restrict target = column_of(f, j);
        int k = first;
        for (; k + 3 < pivots; k += 4) {
            const double *restrict l = column_of(f, k), *restrict p = f->product + (size_t)k * ahead;
            const double *restrict l2 = l + ahead, *restrict l3 = l2 + ahead, *restrict l4 = l3 + ahead;
            double a = p[j], b = p[(size_t)j + ahead], c = p[(size_t)j + 2 * ahead], d = p[(size_t)j + 3 * ahead];
            if (a == 0.0 && b == 0.0 && c == 0.0 && d == 0.0)
                continue;
            for (int i = j; i < rows; i++)
                target[i] -= (a * l[i] + b * l2[i]) + (c * l3[i] + d * l4[i]);
        }
        for (; k < pivots; k++) {
            const double *restrict l = column_of(f, k);
            double a = f->product[(size_t)k * ahead + (size_t)j];
            if (a != 0.0)
                for (int i = j; i < rows; i++)
                    target[i] -= a * l[i];
        }
    }
}

int eliminate(struct front *f, double u, int *negative)
{
    int all = f->choosable, k = 0, applied = 0;
    f->choosable = all < PANEL ? all : PANEL;
    for (;;) {
        int made = choose(f, k, u > CAREFUL ? u : CAREFUL);
        if (!made && u < CAREFUL)
            made = choose(f, k, u);
        if (made < 0)
            return -1;
        if (made > 0) {
            *negative += made == 1 ? eliminate_one(f, k) : eliminate_pair(f, k);
            k += made;
            continue;
        }
        update_rest(f, applied, k);
        if (f->choosable == all)
            return k;
        applied = k;
        f->choosable = all - f->choosable < PANEL ? all : f->choosable + PANEL;
    }
}
