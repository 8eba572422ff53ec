/* Run a tape: the arithmetic of one term shape, one instruction at a time, over LANES instances.
 * See tape.py.
 *
 * A register holds one number per instance: first the numbers of the tape, then the variables,
 * then results. A negative operand -1-k is row k of the data, which has one number per instance. */

#include <math.h>
#include <stdlib.h>

enum { LANES = 32 };

/* In the order of tape.py; FALLING_POWER + k is the derivative of order k. */
enum { OUT, ADD, SUB, MUL, DIV, POW, NEG, SQRT, FIRST_FUNCTION };

static double softplus(double z)
{
    return z > 0.0 ? z + log1p(exp(-z)) : log1p(exp(z));
}

static double logistic(double z)
{
    double small = exp(-fabs(z));
    return (z >= 0.0 ? 1.0 : small) / (1.0 + small);
}

/* 1 / cosh(z)^2 without overflow. */
static double sech2(double z)
{
    double c = cosh(z);
    return 1.0 / c / c;
}

static double (*const functions[])(double) = {exp,  log,  log10, sin,   cos,   tan,   asin,     acos,     atan,
                                              sinh, cosh, tanh,  asinh, acosh, atanh, softplus, logistic, sech2};
enum { FALLING_POWER = FIRST_FUNCTION + sizeof functions / sizeof *functions };

/* p (p-1) .. (p-order+1) base^(p-order), and 0 if a factor is 0. */
static double falling_power(double base, double exponent, int order)
{
    double factor = 1.0;
    for (int k = 0; k < order; k++)
        factor *= exponent - k;
    return factor == 0.0 ? 0.0 : factor * pow(base, exponent - order);
}

#define EACH(expression)                                                                                                                             \
    for (int i = 0; i < lanes; i++)                                                                                                                  \
        r[i] = (expression);                                                                                                                         \
    break

static void compute(int code, int lanes, double *restrict r, const double *a, const double *b)
{
    switch (code) {
    case ADD: EACH(a[i] + b[i]);
    case SUB: EACH(a[i] - b[i]);
    case MUL: EACH(a[i] * b[i]);
    case DIV: EACH(a[i] / b[i]);
    case POW: EACH(pow(a[i], b[i]));
    case NEG: EACH(-a[i]);
    case SQRT: EACH(sqrt(a[i]));
    default:
        if (code < FALLING_POWER) {
            double (*function)(double) = functions[code - FIRST_FUNCTION];
            EACH(function(a[i]));
        }
        EACH(falling_power(a[i], b[i], code - FALLING_POWER));
    }
}

/* Add scale * output to sum[place] for each output of each instance; skip negative places.
 * Return 0 if the allocation fails.
 *
 * tape (length, 4): instruction, result (OUT: number of the output), operands. columns
 * (variables, instances): index in x of each variable. data (.., instances), scale (instances),
 * place (outputs, instances). */
__attribute__((visibility("default"))) int run_tape(int length, const int *tape, int number_count, const double *numbers, int variables,
                                                    int registers, int instances, const double *x, const int *columns, const double *data,
                                                    const double *scale, const int *place, double *sum)
{
    double *work = malloc(sizeof(double) * LANES * ((size_t)registers + 1));
    if (!work)
        return 0;
    for (int k = 0; k < number_count; k++)
        for (int i = 0; i < LANES; i++)
            work[k * LANES + i] = numbers[k];
    int blocks = (instances + LANES - 1) / LANES;
    for (int block = 0; block < blocks; block++) {
        size_t start = (size_t)instances * block / blocks;
        int lanes = (int)((size_t)instances * (block + 1) / blocks - start);
        double *row = work + (size_t)number_count * LANES;
        const int *column = columns + start;
        for (int k = 0; k < variables; k++, row += LANES, column += instances)
            for (int i = 0; i < lanes; i++)
                row[i] = x[column[i]];
        const int *end = tape + 4 * (size_t)length;
        for (const int *at = tape; at < end; at += 4) {
            const double *operand[2];
            for (int k = 0; k < 2; k++)
                operand[k] = at[2 + k] >= 0 ? work + (size_t)at[2 + k] * LANES : data + (size_t)(-1 - at[2 + k]) * instances + start;
            if (at[0] != OUT) {
                compute(at[0], lanes, work + (size_t)at[1] * LANES, operand[0], operand[1]);
                continue;
            }
            const int *there = place + (size_t)at[1] * instances + start;
            for (int i = 0; i < lanes; i++)
                if (there[i] >= 0)
                    sum[there[i]] += scale[start + i] * operand[0][i];
        }
    }
    free(work);
    return 1;
}
