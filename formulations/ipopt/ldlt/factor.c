/* Factorise front by front with pivots of one and two variables: Duff and Reid, The multifrontal
 * solution of indefinite sparse symmetric linear equations, ACM Trans. Math. Softw. 9 (1983). A
 * variable without an acceptable pivot is delayed to the parent. Pivots are searched and
 * eliminated by panels that stay in the cache.
 *
 * Stored per front, in `index`: numbers of rows and pivots, the rows' variables, the kind of
 * each pivot, the total length. In `real`: rows x pivots by columns, the inverse of D on the
 * diagonal (and below it in a pair), L below. */

#include <math.h>
#include <string.h>

#include "ldlt.h"

/* A symmetric front, its lower triangle by columns. Pivots come from the first `choosable`
 * columns. */
struct front {
    int rows, choosable;
    double *entry;
    double *product; /* column L D per pivot, `rows` long */
    int *variable, *kind;
};

static inline double *column_of(const struct front *f, int j)
{
    return f->entry + (size_t)j * (size_t)f->rows;
}

/* Smallest pivot; the inverse of a smaller one is not finite. */
static const double NOTHING = 1e-300;

/* Columns kept up to date during the search for pivots; the others follow when no pivot remains. */
enum { PANEL = 48 };

/* First pivot threshold; the caller's threshold applies if this accepts no pivot. */
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

/* Return the largest entry of column c from row k, without the diagonal and row `but`; *inner:
 * the choosable row with the largest entry. */
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

/* Move an acceptable pivot to k: return 1 or 2 variables, 0 without one, -1 if a column is zero
 * in this front and all later ones. */
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

/* Eliminate the variable at k from the choosable columns; its own column becomes that of L.
 * Return the number of negative eigenvalues. Columns are divided instead of multiplied by an
 * inverse: a repeated row then leaves exact zeros more often. A pivot of pure rounding is
 * accepted, as in MA27: barrier terms fall to 1e-18, and regularising degenerate problems for
 * them moves the solution. */
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

/* Update the columns behind the choosable ones with pivots `first` to `pivots` - 1, four at a
 * time. */
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

/* Eliminate the choosable columns by panels with threshold u; add the negative eigenvalues.
 * Return the number of eliminated columns, -1 for a singular matrix. */
static int eliminate(struct front *f, double u, int *negative)
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

/* Contributions that wait for their parent: lower triangles, and the delayed variables. */
struct waiting {
    double *entry;
    size_t capacity, top;
    int *front, *rows, *late; /* per child */
    int children;
    int *variable, put_off;
};

static int enough(double **block, size_t *capacity, size_t needed)
{
    if (needed <= *capacity)
        return 1;
    size_t more = needed + needed / 2;
    double *grown = realloc(*block, more * sizeof(double));
    if (!grown)
        return 0;
    *block = grown;
    *capacity = more;
    return 1;
}

/* Add the youngest waiting child to its parent, with its delayed variables at `at`. Return their
 * number. */
static int add_child(const struct analysis *a, struct front *f, struct waiting *w, int own, int delayed, int at, int *place)
{
    int size = w->rows[--w->children], late = w->late[w->children], child = w->front[w->children];
    const int *to = a->in_parent + a->first_row[child] + a->pivots[child];
    w->put_off -= late;
    for (int r = 0; r < late; r++) {
        f->variable[at + r] = w->variable[w->put_off + r];
        place[r] = at + r;
    }
    for (int r = late; r < size; r++)
        place[r] = to[r - late] < own ? to[r - late] : to[r - late] + delayed;
    w->top -= (size_t)size * ((size_t)size + 1) / 2;
    const double *from = w->entry + w->top;
    for (int j = 0; j < size; j++, from += size - j + 1) {
        int column = place[j];
        double *target = column_of(f, column);
        for (int i = j; i < size; i++) {
            int row = place[i];
            if (row >= column)
                target[row] += from[i - j];
            else
                column_of(f, row)[column] += from[i - j];
        }
    }
    return late;
}

static void assemble(const struct analysis *a, int s, const double *value, struct front *f, struct waiting *w, int delayed, int *place)
{
    int own = a->pivots[s], size = a->size[s];
    const int *rows = a->rows + a->first_row[s];
    for (int j = 0; j < f->rows; j++)
        memset(column_of(f, j) + j, 0, sizeof(double) * (size_t)(f->rows - j));
    for (int r = 0; r < size; r++)
        f->variable[r < own ? r : r + delayed] = rows[r];
    for (int k = a->first_entry[s]; k < a->first_entry[s + 1]; k++) {
        int i = a->entry_row[k], j = a->entry_column[k];
        column_of(f, j < own ? j : j + delayed)[i < own ? i : i + delayed] += value[a->entry[k]];
    }
    int at = own;
    for (int c = a->children[s]; c > 0; c--)
        at += add_child(a, f, w, own, delayed, at, place);
}

/* Store the columns from k on for the parent. */
static int pass_on(struct front *f, int s, int k, struct waiting *w)
{
    int rest = f->rows - k;
    if (!enough(&w->entry, &w->capacity, w->top + (size_t)rest * ((size_t)rest + 1) / 2))
        return 0;
    for (int j = k; j < f->rows; w->top += (size_t)(f->rows - j), j++)
        memcpy(w->entry + w->top, column_of(f, j) + j, sizeof(double) * (size_t)(f->rows - j));
    for (int j = k; j < f->choosable; j++)
        w->variable[w->put_off++] = f->variable[j];
    w->rows[w->children] = rest;
    w->late[w->children] = f->choosable - k;
    w->front[w->children++] = s;
    return 1;
}

static void keep(const struct front *f, int pivots, double *real, int *index)
{
    int length = 3 + f->rows + pivots;
    index[0] = f->rows;
    index[1] = pivots;
    memcpy(index + 2, f->variable, sizeof(int) * (size_t)f->rows);
    memcpy(index + 2 + f->rows, f->kind, sizeof(int) * (size_t)pivots);
    index[length - 1] = length;
    memcpy(real, f->entry, sizeof(double) * (size_t)f->rows * (size_t)pivots);
}

int factorise(const struct analysis *a, const double *value, double u, double *real, int64_t reals, int *index, int64_t integers,
              struct outcome *out)
{
    struct memory memory = {.count = 0};
    struct front f = {.rows = 0};
    struct waiting w = {.children = 0};
    size_t entries = 0, products = 0, n = (size_t)a->n;
    int status = FACTORISED, *place = take(&memory, n, sizeof(int));
    f.variable = take(&memory, n, sizeof(int));
    f.kind = take(&memory, n, sizeof(int));
    w.variable = take(&memory, n, sizeof(int));
    int **parts[] = {&w.front, &w.rows, &w.late};
    for (size_t k = 0; k < sizeof parts / sizeof *parts; k++)
        *parts[k] = take(&memory, (size_t)a->count, sizeof(int));
    *out = (struct outcome){.negative = 0};
    if (memory.failed)
        status = NO_MEMORY;
    for (int s = 0; s < a->count && status != NO_MEMORY; s++) {
        int delayed = 0;
        for (int c = 1; c <= a->children[s]; c++)
            delayed += w.late[w.children - c];
        f.rows = a->size[s] + delayed;
        f.choosable = a->pivots[s] + delayed;
        if (!enough(&f.entry, &entries, (size_t)f.rows * (size_t)f.rows) || !enough(&f.product, &products, (size_t)f.rows * (size_t)f.choosable)) {
            status = NO_MEMORY;
            break;
        }
        assemble(a, s, value, &f, &w, delayed, place);
        int k = eliminate(&f, u, &out->negative);
        if (k < 0) /* rank below n: no later front can change that */
            break;
        if (out->reals + (int64_t)f.rows * k > reals)
            status = REALS_TOO_SHORT;
        else if (status == FACTORISED && out->integers + 3 + f.rows + k > integers)
            status = INTEGERS_TOO_SHORT;
        if (status == FACTORISED)
            keep(&f, k, real + out->reals, index + out->integers);
        out->rank += k;
        out->reals += (int64_t)f.rows * k;
        out->integers += 3 + f.rows + k;
        if (f.rows > out->largest)
            out->largest = f.rows;
        if (!a->is_root[s] && !pass_on(&f, s, k, &w))
            status = NO_MEMORY;
    }
    free(f.entry);
    free(f.product);
    free(w.entry);
    release(&memory);
    return status;
}

/* Forward and back substitution. */

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
