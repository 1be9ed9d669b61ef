/* The limit: two masses with a degrading Bouc-Wen spring between them, under a near-fault pulse, many at once.

   The same method as the package: classical Runge-Kutta at a constant step, the pulse by two rotations per half step, peaks at
   the reversal inside a step, the jump of the law's slope there mended.  What only hand-writing gives: a tile of lanes that
   stays in the first-level cache, one loop over the lanes per step for the compiler to vectorise, no shaking once every pulse
   of the tile is over, and the mending's two slopes in closed form. */
#include <math.h>

/* LANES, how many simulations a tile holds, is defined by whoever compiles this. */

typedef struct {
  double u1, u2, v1, v2, z, e;
} State;

typedef struct {
  double w1, w2, k1, k2, c11, c12, c21, c22; /* w: inverse masses; k and c: already over the mass */
} System;

static inline __attribute__((always_inline)) State rates(State s, double ground, double a, double beta, double eta,
                                                         System m) {
  double v = s.v2 - s.v1;
  State f;
  f.u1 = s.v1;
  f.u2 = s.v2;
  f.v1 = s.z * m.w1 - (m.c11 * s.v1 + m.c12 * s.v2 + m.k1 * s.u1) - ground;
  f.v2 = -s.z * m.w2 - (m.c21 * s.v1 + m.c22 * s.v2 + m.k2 * s.u2) - ground;
  f.z = (a * v - beta * fabs(v) * s.z) / (1 + eta * s.e);
  f.e = s.z * v;
  return f;
}

static inline __attribute__((always_inline)) State moved(State s, State f, double h) {
  State n = {s.u1 + h * f.u1, s.u2 + h * f.u2, s.v1 + h * f.v1, s.v2 + h * f.v2, s.z + h * f.z, s.e + h * f.e};
  return n;
}

typedef double Lane[LANES] __attribute__((aligned(64)));

typedef struct {
  Lane u1, u2, v1, v2, z, e, force, elongation; /* state and peaks */
  Lane a, beta, eta;                            /* the law */
  Lane pc, ps, qc, qs, pdc, pds, qdc, qds;      /* phasors of carrier and envelope, and their rotations */
  Lane fp, fq, offset, end, ground;             /* factors of the pulse, its end, the last sample */
} Tile;

static inline __attribute__((always_inline)) double shake(Tile *t, int i, double time) {
  double pc = t->pc[i] * t->pdc[i] - t->ps[i] * t->pds[i], ps = t->ps[i] * t->pdc[i] + t->pc[i] * t->pds[i];
  double qc = t->qc[i] * t->qdc[i] - t->qs[i] * t->qds[i], qs = t->qs[i] * t->qdc[i] + t->qc[i] * t->qds[i];
  t->pc[i] = pc, t->ps[i] = ps, t->qc[i] = qc, t->qs[i] = qs;
  return time <= t->end[i] ? -t->fp[i] * ps * (1 + qc) - (t->fq[i] * pc - t->offset[i]) * qs : 0.0;
}

static inline __attribute__((always_inline)) void advance(Tile *t, int i, System m, double h, double time, int shaken) {
  double a = t->a[i], beta = t->beta[i], eta = t->eta[i], g0 = 0, gm = 0, g1 = 0;
  if (shaken) {
    g0 = t->ground[i];
    gm = shake(t, i, time + 0.5 * h);
    g1 = shake(t, i, time + h);
    t->ground[i] = g1;
  }
  State s = {t->u1[i], t->u2[i], t->v1[i], t->v2[i], t->z[i], t->e[i]};
  State k1 = rates(s, g0, a, beta, eta, m);
  State k2 = rates(moved(s, k1, 0.5 * h), gm, a, beta, eta, m);
  State k3 = rates(moved(s, k2, 0.5 * h), gm, a, beta, eta, m);
  State k4 = rates(moved(s, k3, h), g1, a, beta, eta, m);
  State n = moved(moved(moved(s, k1, h / 6), k4, h / 6), (State){k2.u1 + k3.u1, k2.u2 + k3.u2, k2.v1 + k3.v1,
                                                                 k2.v2 + k3.v2, k2.z + k3.z, k2.e + k3.e}, h / 3);

  /* A zero of the rate inside the step: where, how far it went, with what force, and what the step missed of the kink. */
  double d0 = s.u2 - s.u1, v0 = s.v2 - s.v1, d1 = n.u2 - n.u1, v1 = n.v2 - n.v1;
  int turns = v0 * v1 < 0;
  double theta = turns ? v0 / (v0 - v1) : 1.0, rest = 1 - theta;
  double d = d0 * rest * rest * (1 + 2 * theta) + d1 * theta * theta * (3 - 2 * theta) +
             h * theta * rest * (rest * v0 - theta * v1);
  double z = s.z + k1.z / (turns ? v0 : 1.0) * (d - d0);
  double jump = copysign(2.0, v1) * beta * z / (1 + eta * n.e);
  double simpson = (v0 + (theta > 0.5 ? 2 * (v0 + v1) : 0.0)) / 6;
  n.z += turns ? h * jump * (0.5 * v0 * theta - simpson) : 0.0;

  double force = fabs(turns ? z : n.z), elongation = fabs(d);
  t->force[i] = t->force[i] > force ? t->force[i] : force;
  t->elongation[i] = t->elongation[i] > elongation ? t->elongation[i] : elongation;
  t->u1[i] = n.u1, t->u2[i] = n.u2, t->v1[i] = n.v1, t->v2[i] = n.v2, t->z[i] = n.z, t->e[i] = n.e;
}

static void start(Tile *t, int i, double v_p, double t_p, double gamma, double nu, double h) {
  double p = 2 * M_PI / t_p, q = p / gamma, before = -0.5 * gamma * t_p;
  double sines = sin(nu + gamma * M_PI) - sin(nu - gamma * M_PI);
  t->u1[i] = t->u2[i] = t->v1[i] = t->v2[i] = t->z[i] = t->e[i] = t->force[i] = t->elongation[i] = t->ground[i] = 0;
  t->pc[i] = cos(p * before + nu), t->ps[i] = sin(p * before + nu), t->qc[i] = cos(q * before), t->qs[i] = sin(q * before);
  t->pdc[i] = cos(0.5 * h * p), t->pds[i] = sin(0.5 * h * p), t->qdc[i] = cos(0.5 * h * q), t->qds[i] = sin(0.5 * h * q);
  t->fp[i] = 0.5 * v_p * p, t->fq[i] = 0.5 * v_p * q;
  t->offset[i] = q * v_p * sines / (4 * M_PI * (1 - gamma * gamma) * gamma);
  t->end[i] = gamma * t_p;
}

/* system: 1/m1, 1/m2, k1, k2, c11, c12, c21, c22; pulse: gamma, nu; the others per simulation; out: 3 per simulation. */
void simulate(int count, const double *v_p, const double *t_p, const double *a, const double *beta, double eta,
              const double *system, const double *pulse, double step, int steps, double *out) {
  double w1 = system[0], w2 = system[1];
  System m = {w1, w2, system[2] * w1, system[3] * w2, system[4] * w1, system[5] * w1, system[6] * w2, system[7] * w2};
  Tile t;
  for (int first = 0; first < count; first += LANES) {
    double end = 0;
    for (int i = 0; i < LANES; i++) {
      int lane = first + i < count ? first + i : count - 1;
      start(&t, i, v_p[lane], t_p[lane], pulse[0], pulse[1], step);
      t.a[i] = a[lane], t.beta[i] = beta[lane], t.eta[i] = eta;
      end = t.end[i] > end ? t.end[i] : end;
    }
    int shaken = (int)ceil(end / step) + 1;
    if (shaken > steps) shaken = steps;
    for (int k = 0; k < shaken; k++) {
#pragma omp simd
      for (int i = 0; i < LANES; i++) advance(&t, i, m, step, k * step, 1);
    }
    for (int k = shaken; k < steps; k++) {
#pragma omp simd
      for (int i = 0; i < LANES; i++) advance(&t, i, m, step, 0.0, 0);
    }
    for (int i = 0; i < LANES && first + i < count; i++) {
      double *o = out + 3 * (first + i);
      o[0] = t.force[i], o[1] = t.elongation[i], o[2] = t.e[i];
    }
  }
}
