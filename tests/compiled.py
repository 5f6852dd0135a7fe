"""Forces of a stretched cloth [N], computed in a process of its own: `python -m tests.compiled FILE.npy`."""

import sys

import numpy as np
import taichi as ti

from fabdesign.nouns.forward import Case
from fabdesign.nouns.pressure import PressureProgram
from sim.forces.cloth import fabric_force
from sim.grid import Support
from sim.kernels.fields import LANES, F, Timed
from sim.loading import load
from sim.time_steps import Integrator, Scheme
from tests.sim_designs import cloth

N = 11  # nodes a side
SCHEME = Scheme(1 / 480, Integrator.GENERALISED_ALPHA)


@ti.kernel
def _forces(n: ti.i32):
    ti.loop_config(serialize=True)
    for _ in range(1):
        fabric_force(0, n, n, int(Support.NONE), False)


def main() -> None:
    case = Case(cloth(), PressureProgram(np.array([0.0]), np.zeros((1, 1)), 1.0))
    load([case] * LANES, N, support=Support.TOP, blocks=1)
    scheme, state = F.scheme.to_numpy(), F.node3.to_numpy()
    scheme[0] = np.array(SCHEME.entries(Support.NONE))[:, None]
    inside = ((np.arange(N)[:, None] + 1) * (N + 2) + np.arange(N) + 1).ravel()
    state[0, F.q + inside] *= 1.02
    state[0, F.q + inside] += 1e-4 * np.random.default_rng(7).standard_normal(state[0, F.q + inside].shape)
    F.scheme.from_numpy(scheme)
    F.node3.from_numpy(state)
    Timed(_forces)(N)
    np.save(sys.argv[1], F.node3.to_numpy()[0, F.f + inside])


if __name__ == "__main__":
    main()
