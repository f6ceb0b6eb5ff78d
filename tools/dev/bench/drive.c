/* The native loop over a step in C, as `drive` in tools/dev/bench/steps.py. By hand: it is the yardstick
 * of that loop. */
#include <string.h>

typedef void step_function(double, double, double *, double *, double *, double *);

/* `repeats` times: state x0, then `rows` steps, each with a row of `inputs`. Views are those of v,
 * as in the table: parameters, state, inputs, outputs end at at[0] to at[3]. */
void drive(step_function *step, long long repeats, long long rows, double dt, double *v,
           const long long *at, const double *x0, const double *inputs)
{
    double *x = v + at[0], *y = v + at[2];
    long long n_x = at[1] - at[0], n_u = at[2] - at[1];
    for (long long n = 0; n < repeats; n++) {
        memcpy(x, x0, n_x * sizeof *x);
        for (long long k = 0; k < rows; k++)
            step(k * dt, dt, v, x, (double *)inputs + k * n_u, y);
    }
}
