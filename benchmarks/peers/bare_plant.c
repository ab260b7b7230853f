/* A bare quadrotor: the physics of the emulator in plain C, for its speed only (benchmarks/plant_speed.py).

   Written from the equations, not from the emulator's code: four rotors with lag, unbalance, lift offset and noise known
   at three times of a step, a rigid body with drag, hub moments and gyroscopic terms by RK4, gusts, battery, an IMU with
   lever arm, noise and low-pass, a complementary estimator and a cascade. No cameras, no faults that begin or end, no
   ground, and nothing is recorded. */
#include <math.h>

#define G 9.81
#define PI 3.14159265358979323846

typedef struct { double x[13], w[4], th[4], n[4], fl[4], F[4], wind[3], volt, ah, m[6][2], est[9], acc[3], integral[4]; } S;

static const double HX[4] = {-.19, .19, -.19, .19}, HY[4] = {.15, .15, -.15, -.15}, SG[4] = {-1, 1, 1, -1}, HZ = -.02;
static const double M = 1.504, I0 = .015, I1 = .014, I2 = .025, DRAG = .2, HUB = .01, J = 4e-5, KF = 3.2e-6, KQ = 68.9;
static const double U[2] = {1e-6, 5e-7}, D[2] = {1e-4, 5e-5};

static void turn(const double *q, double a, double b, double c, double *o) {
    double w = q[0], x = q[1], y = q[2], z = q[3];
    o[0] = (1 - 2 * (y * y + z * z)) * a + 2 * (x * y - w * z) * b + 2 * (x * z + w * y) * c;
    o[1] = 2 * (x * y + w * z) * a + (1 - 2 * (x * x + z * z)) * b + 2 * (y * z - w * x) * c;
    o[2] = 2 * (x * z - w * y) * a + 2 * (y * z + w * x) * b + (1 - 2 * (x * x + y * y)) * c;
}
static void unturn(const double *q, double a, double b, double c, double *o) {
    double r[4] = {q[0], -q[1], -q[2], -q[3]};
    turn(r, a, b, c, o);
}
static void slope(const double *x, const double *f, const double *wind, double *d) {
    double v[3], a[3], p = x[10], q = x[11], r = x[12], *e = d + 6;
    const double *Q = x + 6;
    unturn(Q, x[3] - wind[0], x[4] - wind[1], x[5] - wind[2], v);
    turn(Q, (f[0] - DRAG * v[0]) / M, (f[1] - DRAG * v[1]) / M, (f[2] - DRAG * v[2]) / M, a);
    for (int i = 0; i < 3; i++) { d[i] = x[3 + i]; d[3 + i] = a[i]; }
    d[5] += G;
    e[0] = .5 * (-Q[1] * p - Q[2] * q - Q[3] * r); e[1] = .5 * (Q[0] * p + Q[2] * r - Q[3] * q);
    e[2] = .5 * (Q[0] * q + Q[3] * p - Q[1] * r); e[3] = .5 * (Q[0] * r + Q[1] * q - Q[2] * p);
    double hx = I0 * p, hy = I1 * q, hz = I2 * r + f[6];
    d[10] = (f[3] - HUB * v[1] - (q * hz - r * hy)) / I0;
    d[11] = (f[4] + HUB * v[0] - (r * hx - p * hz)) / I1;
    d[12] = (f[5] - (p * hy - q * hx) - f[7]) / I2;
}
static double wrap(double a) { return a - 2 * PI * floor((a + PI) / (2 * PI)); }
static double clip(double a, double m) { return a > m ? m : a < -m ? -m : a; }

static void rotate(S *s, const double *cmd, const double *nrm, double dt, double f[3][8]) {
    const double a = .9, b = .43588989, c = .97, e = .24310492;
    for (int k = 0; k < 3; k++) for (int i = 0; i < 8; i++) f[k][i] = 0;
    for (int i = 0; i < 4; i++) {
        s->n[i] = a * s->n[i] + b * nrm[i]; s->fl[i] = c * s->fl[i] + e * nrm[4 + i];
        double lag = .03, ex = s->w[i] - cmd[i], half = exp(-.5 * dt / lag), dec = 1, w = 0, th = 0, F = 0;
        double g = 1 + .01 * s->fl[i], noise = 1 + .005 * s->n[i];
        for (int k = 0; k < 3; k++) {
            w = cmd[i] + ex * dec; th = s->th[i] + cmd[i] * .5 * k * dt + ex * lag * (1 - dec);
            double lift = KF * w * w * noise, co = cos(th), si = SG[i] * sin(th);
            F = lift * g;
            double fx = (co * U[0] - si * U[1]) * w * w, fy = (si * U[0] + co * U[1]) * w * w;
            f[k][0] += fx; f[k][1] += fy; f[k][2] -= F;
            f[k][3] -= (HY[i] + si * D[0] + co * D[1]) * F + HZ * fy;
            f[k][4] += (HX[i] + co * D[0] - si * D[1]) * F + HZ * fx;
            f[k][5] += HX[i] * fy - HY[i] * fx - SG[i] * lift / KQ;
            f[k][6] += J * SG[i] * w; f[k][7] -= J * SG[i] * ex * dec / lag;
            dec *= half;
        }
        s->w[i] = w; s->th[i] = fmod(th, 2 * PI); s->F[i] = F;
    }
}
static void advance(S *s, double f[3][8], double dt) {
    double k[4][13], y[13], *x = s->x;
    slope(x, f[0], s->wind, k[0]);
    for (int i = 0; i < 13; i++) y[i] = x[i] + .5 * dt * k[0][i];
    slope(y, f[1], s->wind, k[1]);
    for (int i = 0; i < 13; i++) y[i] = x[i] + .5 * dt * k[1][i];
    slope(y, f[1], s->wind, k[2]);
    for (int i = 0; i < 13; i++) y[i] = x[i] + dt * k[2][i];
    slope(y, f[2], s->wind, k[3]);
    for (int i = 0; i < 13; i++) x[i] += dt / 6 * (k[0][i] + 2 * k[1][i] + 2 * k[2][i] + k[3][i]);
    double q = sqrt(x[6] * x[6] + x[7] * x[7] + x[8] * x[8] + x[9] * x[9]);
    for (int i = 6; i < 10; i++) x[i] /= q;
}
static void sense(S *s, double f[3][8], const double *nrm, double *read) {
    double d[13], a[3], o[6], *x = s->x, p = x[10], q = x[11], r = x[12];
    slope(x, f[2], s->wind, d);
    unturn(x + 6, d[3], d[4], d[5] - G, a);
    double rx = .01, ry = .02, rz = .01, vx = q * rz - r * ry, vy = r * rx - p * rz, vz = p * ry - q * rx;
    o[0] = p; o[1] = q; o[2] = r;
    o[3] = a[0] + d[11] * rz - d[12] * ry + q * vz - r * vy;
    o[4] = a[1] + d[12] * rx - d[10] * rz + r * vx - p * vz;
    o[5] = a[2] + d[10] * ry - d[11] * rx + p * vy - q * vx;
    for (int i = 0; i < 6; i++) {
        double v = o[i] + .001 + (i < 3 ? .003 : .05) * nrm[i], u = .4 * v + s->m[i][0];
        s->m[i][0] = .8 * v - .2 * u + s->m[i][1]; s->m[i][1] = .4 * v - .4 * u; read[i] = u;
    }
}
static void estimate(S *s, const double *z, double yaw, double dt) {
    double *e = s->est;
    for (int i = 0; i < 3; i++) {
        double b = e[3 + i] - z[i], sl = e[6 + i];
        e[3 + i] = z[i] + .9 * b + 8e-4 * sl; e[6 + i] = -150 * b + .7 * sl; s->acc[i] += .01 * (z[3 + i] - s->acc[i]);
    }
    double n = sqrt(s->acc[0] * s->acc[0] + s->acc[1] * s->acc[1] + s->acc[2] * s->acc[2]) + 1e-9;
    double ay = -s->acc[1] / n, az = -s->acc[2] / n, ph = atan2(ay, az);
    double tha = atan2(s->acc[0] / n, ay * sin(ph) + az * cos(ph)), t = e[4] * sin(e[0]) + e[5] * cos(e[0]);
    double phi = e[0] + dt * (e[3] + tan(e[1]) * t) + 1e-3 * wrap(ph - e[0]);
    double psi = e[2] + dt * t / cos(e[1]) + 1e-3 * wrap(yaw - e[2]);
    e[1] = wrap(e[1] + dt * (e[4] * cos(e[0]) - e[5] * sin(e[0])) + 1e-3 * (tha - e[1]));
    e[0] = wrap(phi); e[2] = wrap(psi);
}
static void steer(S *s, double t, double yaw, double dt, double *duty) {
    double *x = s->x, *e = s->est, ref[4] = {cos(.5 * t), sin(.5 * t), -1, 0}, c = cos(yaw), n = sin(yaw), u[4], err[4];
    err[0] = c * (ref[0] - x[0]) + n * (ref[1] - x[1]); err[1] = c * (ref[1] - x[1]) - n * (ref[0] - x[0]);
    err[2] = ref[2] - x[2]; err[3] = wrap(ref[3] - yaw);
    double v[4] = {-c * x[3] - n * x[4], n * x[3] - c * x[4], -x[5], -e[5]};
    for (int i = 0; i < 4; i++) {
        s->integral[i] = clip(s->integral[i] + .05 * err[i] * dt, 1);
        u[i] = (i == 2 ? 8 : .2) * err[i] + (i == 2 ? 5 : .15) * v[i] + s->integral[i];
    }
    double thrust = M * G - u[2], pr = clip(6 * (clip(u[1], .4) - e[0]) - .1 * e[3], 4),
           qr = clip(6 * (clip(-u[0], .4) - e[1]) - .1 * e[4], 4);
    double T[3] = {clip(.2 * (pr - e[3]) - 1e-3 * e[6], 1), clip(.2 * (qr - e[4]) - 1e-3 * e[7], 1), clip(.1 * (u[3] - e[5]), .2)};
    for (int i = 0; i < 4; i++) {
        double F = thrust / 4 - T[0] * HY[i] / .09 + T[1] * HX[i] / .144 - T[2] * SG[i] * KQ / 40;
        duty[i] = fmin(1, fmax(.05, sqrt(fmax(F, 0) / 12.5)));
    }
}
/* normals: (n, 17). Returns something of the end, so that nothing is left out. */
double fly(int n, S *s, const double *normals, double t0) {
    double f[3][8] = {{0}}, duty[4], cmd[4], read[6], dt = 1e-3;
    for (int row = 0; row < n; row++) {
        const double *nrm = normals + 17 * row, *q = s->x + 6;
        double yaw = atan2(2 * (q[0] * q[3] + q[1] * q[2]), 1 - 2 * (q[2] * q[2] + q[3] * q[3])), power = 0;
        sense(s, f, nrm + 8, read);
        estimate(s, read, yaw, dt);
        steer(s, t0 + row * dt, yaw, dt, duty);
        for (int i = 0; i < 4; i++) cmd[i] = 130 * s->volt * duty[i];
        for (int i = 0; i < 3; i++) s->wind[i] = .995 * s->wind[i] + .05 * nrm[14 + i];
        rotate(s, cmd, nrm, dt, f);
        advance(s, f, dt);
        for (int i = 0; i < 4; i++) power += 3e-8 * s->w[i] * s->w[i] * s->w[i];
        double amp = power / s->volt + .5;
        s->ah += amp * dt / 3600; s->volt = 16.4 - .8 * s->ah - .02 * amp;
    }
    return s->x[2] + s->est[0];
}
void begin(S *s) {
    for (unsigned i = 0; i < sizeof *s / sizeof(double); i++) ((double *)s)[i] = 0;
    s->x[2] = -1; s->x[6] = 1; s->volt = 16; s->acc[2] = -G;
    for (int i = 0; i < 4; i++) s->w[i] = 1073;
}
