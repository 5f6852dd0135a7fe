"""Front muscles curl the cloth to the front, back muscles to the back, by as much."""

import numpy as np

from fabdesign.files.pressure_file import constant_program
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import Case, ForwardModel


def main(forward: ForwardModel) -> float:
    """m that the lower edge comes forward when the four front muscles of *basic* hold 300 kPa."""
    design = build("basic")
    front, back = [300e3] * 4 + [0.0] * 4, [0.0] * 4 + [300e3] * 4  # Pa
    shapes = forward.equilibria([Case(design, constant_program(p)) for p in (front, back)])
    side = round(np.sqrt(len(shapes[0]) / 2))
    lower_edges = [shape.reshape(2, side, side, 3).mean(axis=0)[-1] for shape in shapes]
    forward_by, back_by = (float(edge[:, 2].mean()) for edge in lower_edges)
    print(f"lower edge: {1e3 * forward_by:+.1f} mm with front muscles, {1e3 * back_by:+.1f} mm with back muscles")
    assert forward_by > 0.01
    assert abs(forward_by + back_by) < 0.02 * forward_by
    return forward_by


if __name__ == "__main__":
    from sim import Simulator

    main(Simulator(points_per_side=21))
