"""How the forces of the muscles change in a direction: sim/forces/muscles.py, differentiated line by line.

Changes at the fixed points lie in the planes of F.point3 that held the preconditioner's frames there, from X.fu on:
nothing reads those once the preconditioner is built.
"""

import taichi as ti

from sim.forces.muscles import sample, scatter
from sim.kernels.fields import F, T, X, indices
from sim.kernels.vectors import Wide, crossed, sum3, thrice


@ti.func
def muscle_tangent(b, nu, npt):
    """F.f += the change of the muscles' forces in the direction F.p."""
    sample(b, nu, npt, F.p, F.p, 1, X.fu)
    points(b, npt)
    pull(b, npt)
    couples(b, npt)
    scatter(b, nu, npt, T.point3, T.d_force, F.f)


@ti.func
def points(b, npt):
    """Changes of the normals and positions of the fixed points."""
    for pt in indices(npt):
        along_u = F.point3[b, X.tan_u + pt]
        along_v = F.point3[b, X.tan_v + pt]
        d_u = F.point3[b, X.fu_u + pt]
        d_v = F.point3[b, X.fu_v + pt]
        normal = F.point3[b, X.normal + pt]
        il = thrice(F.point[b, X.inv_area + pt])
        offset = thrice(F.point[b, X.offset + pt])
        d_area = il * (crossed(d_v, along_u) + crossed(along_v, d_u))
        larger = thrice(sum3(d_area * normal))
        d_normal = d_area - larger * normal
        T.point3[b, T.d_normal + pt] = d_normal
        F.point3[b, X.fu + pt] = F.point3[b, X.fu + pt] + offset * d_normal


@ti.func
def pull(b, npt):
    """Changes of the intervals' pulls on their fixed points."""
    for pt in indices(npt):
        T.point3[b, T.d_force + pt] = Wide(0.0)
    for k in indices(npt - 1):
        along = F.point3[b, X.dir + k]
        apart = F.point3[b, X.pos + k + 1] - F.point3[b, X.pos + k]
        il = 1.0 / ti.sqrt(sum3(apart * apart) + 1e-16)  # spare points lie upon each other
        change = F.point3[b, X.fu + k + 1] - F.point3[b, X.fu + k]
        longer = sum3(along * change)
        turned = (change - thrice(longer) * along) * thrice(il)
        tension = longer / F.point[b, X.compliance + k]
        active = F.point[b, X.active + k]
        d_pull = thrice(active * tension) * along + thrice(active * F.point[b, X.tension + k]) * turned
        T.point3[b, T.d_force + k] = T.point3[b, T.d_force + k] + d_pull
        T.point3[b, T.d_force + k + 1] = T.point3[b, T.d_force + k + 1] - d_pull


@ti.func
def couples(b, npt):
    """Changes of the couples that the forces make by their lever, to X.grad_u and X.grad_v."""
    for pt in indices(npt):
        force = F.point3[b, X.force + pt]
        d_force = T.point3[b, T.d_force + pt]
        normal = F.point3[b, X.normal + pt]
        d_normal = T.point3[b, T.d_normal + pt]
        along_u = F.point3[b, X.tan_u + pt]
        along_v = F.point3[b, X.tan_v + pt]
        d_u = F.point3[b, X.fu_u + pt]
        d_v = F.point3[b, X.fu_v + pt]
        il = thrice(F.point[b, X.inv_area + pt])
        lever = thrice(F.point[b, X.offset + pt]) * il
        along = sum3(force * normal)
        couple = lever * (force - thrice(along) * normal)
        larger = il * thrice(sum3(normal * (crossed(d_v, along_u) + crossed(along_v, d_u))))
        d_along = sum3(d_force * normal + force * d_normal)
        d_couple = lever * (d_force - thrice(d_along) * normal - thrice(along) * d_normal) - larger * couple
        F.point3[b, X.grad_u + pt] = crossed(d_couple, along_v) + crossed(couple, d_v)
        F.point3[b, X.grad_v + pt] = crossed(d_u, couple) + crossed(along_u, d_couple)
