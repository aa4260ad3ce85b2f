/* @title@ C99.
 *
@convention@
 */
#ifndef WIMU_CALIBRATION_H
#define WIMU_CALIBRATION_H

#define WIMU_REFERENCE_C @t0@
#ifndef WIMU_INPUT_TO_MPS2
#define WIMU_INPUT_TO_MPS2 @scale@
#endif

/* x = a^-1 y, after a's diagonal was multiplied by 1 + s dt. */
static inline void wimu_solve(double a[3][3], const double s[3], double dt, const double y[3], double x[3])
{
    double det;
    int i, j;

    for (i = 0; i < 3; i++)
        a[i][i] *= 1.0 + s[i] * dt;
    det = a[0][0] * (a[1][1] * a[2][2] - a[1][2] * a[2][1])
        - a[0][1] * (a[1][0] * a[2][2] - a[1][2] * a[2][0])
        + a[0][2] * (a[1][0] * a[2][1] - a[1][1] * a[2][0]);
    for (i = 0; i < 3; i++) {
        x[i] = 0.0;
        for (j = 0; j < 3; j++) {
            const int r1 = (j + 1) % 3, r2 = (j + 2) % 3, c1 = (i + 1) % 3, c2 = (i + 2) % 3;
            x[i] += (a[r1][c1] * a[r2][c2] - a[r1][c2] * a[r2][c1]) / det * y[j];
        }
    }
}

/* Specific force, m/s^2, body axes, of the accelerometer's output at a temperature in degrees Celsius;
   pass WIMU_REFERENCE_C where there is no thermometer. */
static inline void wimu_correct(const double output[3], double temperature_c, double force[3])
{
    static const double b0[3] = @b0@, b1[3] = @b1@, b2[3] = @b2@;
    static const double s1[3] = @s1@, q[3] = @q@;
    static const double r[3][3] = @r@;
    double a[3][3] = @a@;
    const double dt = temperature_c - WIMU_REFERENCE_C;
    double y[3], z[3];
    int i;

    for (i = 0; i < 3; i++)
        y[i] = output[i] * WIMU_INPUT_TO_MPS2 - (b0[i] + (b1[i] + b2[i] * dt) * dt);
    wimu_solve(a, s1, dt, y, z);
    for (i = 0; i < 3; i++)
        z[i] -= q[i] * z[i] * z[i];
    for (i = 0; i < 3; i++)
        force[i] = r[i][0] * z[0] + r[i][1] * z[1] + r[i][2] * z[2];
}
@gyroscope{

/* Angular rate, rad/s, body axes, of the gyroscope's output in @wunit@, with the specific force of wimu_correct. */
static inline void wimu_correct_rate(const double output[3], const double force[3], double temperature_c, double rate[3])
{
    static const double b0[3] = @wb0@, b1[3] = @wb1@, s1[3] = @ws1@;
    static const double g[3][3] = @wg@;
    static const double r[3][3] = @r@;
    double a[3][3] = @wa@;
    const double dt = temperature_c - @wt0@;
    double u[3], y[3], z[3];
    int i;

    for (i = 0; i < 3; i++)
        u[i] = r[0][i] * force[0] + r[1][i] * force[1] + r[2][i] * force[2];
    for (i = 0; i < 3; i++)
        y[i] = output[i] * @wscale@ - (b0[i] + b1[i] * dt) - (g[i][0] * u[0] + g[i][1] * u[1] + g[i][2] * u[2]);
    wimu_solve(a, s1, dt, y, z);
    for (i = 0; i < 3; i++)
        rate[i] = r[i][0] * z[0] + r[i][1] * z[1] + r[i][2] * z[2];
}
@}

#endif
