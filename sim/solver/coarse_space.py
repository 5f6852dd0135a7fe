"""A coarse space for the preconditioner: the softest modes, in which a bent sheet couples normal and tangential motion.

The flat cloth's own problem (sim/solver/flat_cloth.py) knows curvature only as a constant normal stiffness: modes that
bend without stretching seem up to a thousand times too stiff there. In the span W of COARSE_ACROSS x COARSE_DOWN
products of modes, three components each in the preconditioner's frames, strains u' + kappa w of the shape at hand count
instead: y += W (E^-1 - E_P^-1) W^T r, with E the Galerkin matrix of the coupled problem and E_P = W^T P W (an additive
two-level preconditioner; Nicolaides 1987, SIAM J. Numer. Anal. 24). Both must be of the same shape as P, else P^-1 may
be indefinite. Nodes held one by one, which W does not know, do without. Curvatures are sampled at COARSE_SAMPLES^2
nodes.
"""

import taichi as ti

from sim.forces.membrane import normal_stiffness
from sim.kernels.fields import C, F
from sim.solver.coarse_bent import bent
from sim.solver.coarse_flat import flat, pull
from sim.solver.coarse_solve import factorise
from sim.state import COARSE, COARSE_ACROSS, COARSE_DOWN

# of the flat cloth's normal stiffness (CURVATURE) in E: with none, more cloths that snap run away; with much, a flat
# cloth seems at rest when it is not
KEPT = 0.05


@ti.func
def assemble(b, nu, nv, npt):
    """E and E_P of the shape at hand, factored."""
    flat(b)
    if npt > 0:
        pull(b, npt)
    copy(b)
    bent(b, nu, nv)
    for which in range(2):
        factorise(b, C.coupled + which * COARSE * COARSE)


@ti.func
def copy(b):
    """E <- E_P, and E_P gets its normal stiffness."""
    i = 0
    while i < COARSE:
        k = i * COARSE + i - i % 4
        while k < (i + 1) * COARSE:
            F.coarse[b, C.coupled + k] = F.coarse[b, C.alone + k]
            k = F.after[k]
        i = F.after[i]
    hoop = normal_stiffness(b)
    k = 2 * COARSE_ACROSS * COARSE_DOWN
    while k < COARSE:
        o = C.alone + k * (COARSE + 1)
        F.coarse[b, o] = F.coarse[b, o] + hoop
        F.coarse[b, o - C.alone + C.coupled] = F.coarse[b, o - C.alone + C.coupled] + KEPT * hoop
        k = F.after[k]
