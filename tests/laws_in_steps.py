"""Spring laws once more, as a structural engineer programs them: states that change branch by branch, one small step at a time.

The independent truth of `test_laws.py`.  They are themselves held against forces that OpenSees computed (`data/laws.csv`).
"""

import math


class Bilinear:
    """Kinematic hardening: a yield surface of fixed size whose centre moves."""

    def __init__(self, k, F_y, b=0.0):
        self.k, self.F_y, self.b = k, F_y, b
        self.u = self.f = 0.0

    def move(self, u, nu=1.0):
        """Force at the next elongation; ν divides the size of the elastic part, not the hardening line."""
        line, half = self.b * self.k * u, (1 - self.b) * self.F_y / nu
        self.f += self.k * (u - self.u)
        self.f = min(max(self.f, line - half), line + half)
        self.u = u
        return self.f


class Takeda:
    """Branches by name: backbone, unloading, reloading; each turn decides which comes next."""

    def __init__(self, k, F_y, b=0.0, alpha=0.0):
        self.k, self.F_y, self.b, self.alpha = k, F_y, b, alpha
        self.u = self.f = 0.0
        self.furthest = {1: F_y / k, -1: F_y / k}  # to either side, positive
        self.origin = {1: 0.0, -1: 0.0}  # where the force was last zero on the way to that side

    def move(self, u, nu=1.0):
        """Force at the next elongation; ν divides the backbone."""
        while u != self.u:
            side = 1 if u > self.u else -1
            if self.f * side < 0:  # unloading from the other side, at most to zero
                stiffness = self.softened(-side)
                zero = self.u - self.f / stiffness
                if (u - zero) * side < 0:
                    self.f += stiffness * (u - self.u)
                    self.u = u
                    return self.f
                self.u, self.f, self.origin[side] = zero, 0.0, zero
                if u == zero:
                    return self.f
            x, furthest, origin = u * side, self.furthest[side], self.origin[side] * side
            elastic = self.f * side + self.softened(side) * abs(u - self.u)
            if x >= furthest:
                aimed = self.backbone(x) / nu
            else:
                aimed = self.backbone(furthest) / nu * (x - origin) / (furthest - origin)
            self.f, self.u = side * min(elastic, aimed), u
            self.furthest[side] = max(furthest, x)
        return self.f

    def backbone(self, x):
        return self.F_y + self.b * self.k * (x - self.F_y / self.k)

    def softened(self, side):
        return self.k * (self.furthest[side] * self.k / self.F_y) ** -self.alpha


class MenegottoPinto:
    """Steel02 by its published description."""

    def __init__(self, k, F_y, b=0.0, R0=20.0, cR1=0.925, cR2=0.15, a1=0.0, a2=1.0, a3=0.0, a4=1.0):
        self.k, self.F_y, self.b, self.R0, self.cR1, self.cR2 = k, F_y, b, R0, cR1, cR2
        self.isotropic = {-1: (a1, a2), 1: (a3, a4)}
        self.u = self.f = 0.0
        self.side = None
        self.most = {1: F_y / k, -1: -F_y / k}

    def move(self, u, nu=1.0):
        """Force at the next elongation; ν divides the yield force, and with it the yield elongation of the hardening line."""
        if u == self.u:
            return self.f
        side, u_y = (1 if u > self.u else -1), self.F_y / self.k
        if side != self.side:
            self.shift = 1.0
            if self.side is not None:
                extreme = max if self.side == 1 else min
                self.most[self.side] = extreme(self.most[self.side], self.u)
                share, after = self.isotropic[side]
                self.shift += share * ((self.most[1] - self.most[-1]) / (2 * after * u_y)) ** 0.8
            self.side, self.from_u, self.from_f = side, self.u, self.f
        hard = self.b * self.k
        offset = side * self.shift * (self.F_y - hard * u_y) / nu  # of the hardening line at u = 0
        corner_u = (offset - self.from_f + self.k * self.from_u) / (self.k - hard)
        corner_f = offset + hard * corner_u
        xi = abs(self.most[side] - corner_u) / u_y
        R = self.R0 * (1 - self.cR1 * xi / (self.cR2 + xi))
        x = (u - self.from_u) / (corner_u - self.from_u)
        bent = self.b * x + (1 - self.b) * x / (1 + x**R) ** (1 / R)
        self.u, self.f = u, self.from_f + bent * (corner_f - self.from_f)
        return self.f


def shaken(law, mass, damping, ground, step, steps, **slots):
    """Largest force, elongation and work of an oscillator on the law, by central differences.

    Arguments:
        law: what has `move`.
        mass, damping: [kg], [N·s/m].
        ground: from time [s] to acceleration [m/s²].
        step, steps: [s], and how many.
        slots: `nu`, a function of the work so far [J].
    """
    before = u = force = work = 0.0
    peak_force = peak = 0.0
    u = -0.5 * step**2 * ground(0.0)
    for number in range(1, steps):
        last, force = force, law.move(u, **{name: slot(work) for name, slot in slots.items()})
        work += 0.5 * (last + force) * (u - before)
        peak_force, peak = max(peak_force, abs(force)), max(peak, abs(u))
        pushed = -mass * ground(number * step) - force
        after = (pushed * step**2 + 2 * mass * u - (mass - 0.5 * damping * step) * before) / (
            mass + 0.5 * damping * step
        )
        before, u = u, after
    assert math.isfinite(u)
    return {"peak_force": peak_force, "peak_elongation": peak, "dissipated_energy": work}
