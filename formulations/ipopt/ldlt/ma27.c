/* The factorisation behind the calls of MA27, which every Ipopt can load: the interface of Duff
 * and Reid, our own code. All state is in the caller's arrays, so that solvers are independent.
 *
 * A after a factorisation: the scaling of n variables, then the factor. IW: the length of the
 * analysis, the analysis, the integers of the factor. IKEEP[0] marks an IW that holds the
 * analysis; it is computed again if the caller allocates longer arrays. */

#include <limits.h>
#include <math.h>
#include <string.h>

#include "ldlt.h"

#define EXPORT __attribute__((visibility("default")))

EXPORT void ma27id_(int *icntl, double *cntl);
EXPORT void ma27ad_(const int *n, const int *nz, const int *irn, const int *icn, int *iw, int *liw, int *ikeep, int *iw1, int *nsteps, int *iflag,
                    int *icntl, double *cntl, int *info, double *ops);
EXPORT void ma27bd_(const int *n, const int *nz, const int *irn, const int *icn, double *a, const int *la, int *iw, const int *liw, int *ikeep,
                    int *nsteps, int *maxfrt, int *iw1, int *icntl, double *cntl, int *info);
EXPORT void ma27cd_(const int *n, const double *a, const int *la, const int *iw, const int *liw, double *w, const int *maxfrt, double *rhs, int *iw1,
                    const int *nsteps, int *icntl, int *info);

enum { OUT_OF_MEMORY = -9, SINGULAR = -5, INFO_LENGTH = 20 };
/* Places in INFO. */
enum { REALS = 4, INTEGERS = 5, NEGATIVE = 14 };

static int as_int(double number)
{
    return number > INT_MAX ? INT_MAX : (int)number;
}

/* Compute powers of two that scale the largest entry of every row to about 1: Ruiz, A scaling
 * algorithm to equilibrate both rows and columns norms in matrices (2001), on exponents. Return
 * 0 if an entry is not finite. */
static int scale_rows(int n, int nz, const int *irn, const int *icn, const double *a, double *scale, int *exponent, int *shift, int *most)
{
    enum { SWEEPS = 3, NONE = -100000, LIMIT = 300 };
    /* Bits of a double. */
    enum { INFINITE = 0x7ff, BIAS = 1022 };
    for (int k = 0; k < nz; k++) {
        uint64_t bits;
        memcpy(&bits, a + k, sizeof bits);
        int biased = (int)(bits >> 52) & INFINITE;
        if (biased == INFINITE)
            return 0;
        exponent[k] = a[k] != 0.0 ? biased - BIAS : NONE;
        if (biased == 0 && a[k] != 0.0)
            frexp(a[k], &exponent[k]);
    }
    for (int sweep = 0; sweep < SWEEPS; sweep++) {
        for (int i = 0; i < n; i++)
            most[i] = NONE;
        for (int k = 0; k < nz; k++) {
            int i = irn[k] - 1, j = icn[k] - 1, e = exponent[k] + shift[i] + shift[j];
            most[i] = e > most[i] ? e : most[i]; /* unconditional store: a branch is mispredicted half the time */
            most[j] = e > most[j] ? e : most[j];
        }
        for (int i = 0; i < n; i++)
            if (most[i] > NONE / 2) {
                int s = shift[i] - most[i] / 2;
                shift[i] = s > LIMIT ? LIMIT : s < -LIMIT ? -LIMIT : s;
            }
    }
    for (int i = 0; i < n; i++)
        scale[i] = ldexp(1.0, shift[i]);
    return 1;
}

void ma27id_(int *icntl, double *cntl)
{
    memset(icntl, 0, 30 * sizeof(int));
    memset(cntl, 0, 5 * sizeof(double));
    cntl[0] = 0.1;
}

/* Set INFO only: the order depends on which diagonals are zero, and values arrive later. The
 * sizes in INFO usually suffice. */
void ma27ad_(const int *n, const int *nz, const int *irn, const int *icn, int *iw, int *liw, int *ikeep, int *iw1, int *nsteps, int *iflag, int *icntl,
             double *cntl, int *info, double *ops)
{
    (void)irn, (void)icn, (void)iw, (void)liw, (void)iw1, (void)iflag, (void)icntl, (void)cntl;
    memset(info, 0, INFO_LENGTH * sizeof(int));
    info[REALS] = as_int(3.0 * *nz + *n);
    info[INTEGERS] = as_int(2.0 * *nz + 6.0 * *n);
    ikeep[0] = 0;
    *nsteps = 1;
    *ops = 0.0;
}

/* Return the length of the analysis in IW with its marker; compute it if it is missing. 0
 * without memory, negative if IW is too short. */
static int analysis_in(int n, int nz, const int *irn, const int *icn, const double *value, int *iw, int liw, int *ikeep)
{
    if (ikeep[0])
        return iw[0] + 1;
    int length = 0, *block = analyse(n, nz, irn, icn, value, &length);
    if (!block)
        return 0;
    int fits = liw > length;
    if (fits) {
        iw[0] = length;
        memcpy(iw + 1, block, sizeof(int) * (size_t)length);
        ikeep[0] = 1;
    }
    free(block);
    return fits ? length + 1 : -(length + 1);
}

static void ask_for(int *info, int *ikeep, int what, double room)
{
    double most = 1.1 * room + 16.0;
    info[0] = most > INT_MAX / 2 ? OUT_OF_MEMORY : what; /* callers double this int */
    info[1] = as_int(most);
    ikeep[0] = 0;
}

void ma27bd_(const int *n, const int *nz, const int *irn, const int *icn, double *a, const int *la, int *iw, const int *liw, int *ikeep, int *nsteps,
             int *maxfrt, int *iw1, int *icntl, double *cntl, int *info)
{
    (void)iw1, (void)icntl;
    memset(info, 0, INFO_LENGTH * sizeof(int));
    struct memory memory = {.count = 0};
    size_t size = (size_t)*n;
    double *value = take(&memory, (size_t)*nz, sizeof(double)), *scale = take(&memory, size, sizeof(double));
    int *exponent = take(&memory, (size_t)*nz, sizeof(int)), *shift = take(&memory, size, sizeof(int)), *most = take(&memory, size, sizeof(int));
    struct outcome out = {.negative = 0};
    int begin = 0;
    if (memory.failed)
        info[0] = OUT_OF_MEMORY;
    else if (!scale_rows(*n, *nz, irn, icn, a, scale, exponent, shift, most))
        info[0] = SINGULAR;
    else {
        for (int k = 0; k < *nz; k++)
            value[k] = a[k] * scale[irn[k] - 1] * scale[icn[k] - 1];
        begin = analysis_in(*n, *nz, irn, icn, value, iw, *liw, ikeep);
        if (begin == 0)
            info[0] = OUT_OF_MEMORY;
        else if (begin < 0)
            ask_for(info, ikeep, INTEGERS_TOO_SHORT, -begin + 8.0 * *n);
    }
    if (info[0] == 0) {
        struct analysis analysis = view(iw + 1);
        int status = factorise(&analysis, value, cntl[0], a + *n, (int64_t)*la - *n, iw + begin, (int64_t)*liw - begin, &out);
        *nsteps = analysis.count;
        *maxfrt = out.largest;
        info[NEGATIVE] = out.negative;
        if (status == NO_MEMORY)
            info[0] = OUT_OF_MEMORY;
        else if (out.rank < *n) { /* more room would not help */
            info[0] = SINGULAR;
            info[1] = out.rank;
        } else if (status == REALS_TOO_SHORT)
            ask_for(info, ikeep, status, (double)out.reals + *n);
        else if (status == INTEGERS_TOO_SHORT)
            ask_for(info, ikeep, status, (double)out.integers + begin);
        else
            memcpy(a, scale, sizeof(double) * size);
    }
    release(&memory);
}

void ma27cd_(const int *n, const double *a, const int *la, const int *iw, const int *liw, double *w, const int *maxfrt, double *rhs, int *iw1,
             const int *nsteps, int *icntl, int *info)
{
    (void)la, (void)liw, (void)maxfrt, (void)iw1, (void)icntl;
    info[0] = 0;
    for (int i = 0; i < *n; i++)
        rhs[i] *= a[i];
    solve_factor(*nsteps, a + *n, iw + 1 + iw[0], rhs, w);
    for (int i = 0; i < *n; i++)
        rhs[i] *= a[i];
}
