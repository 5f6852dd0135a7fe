"""What is not measured yet: a layout before it is sewn, with intervals, and designs left out in turn."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fabdesign.errors import InputError
from fabdesign.interface.arguments import (
    DesignLike,
    ModelLike,
    Progress,
    Say,
    SetLike,
    all_sets,
    computing,
    one_design,
    one_model,
    study_file,
    unheard,
    warn,
    work_folder,
)
from fabdesign.interface.study_results import Unseen


def unseen(
    design: DesignLike | None = None,
    model: ModelLike | None = None,
    out: Path | str | None = None,
    *,
    pressures: Sequence[Sequence[float]] | None = None,
    outputs: Sequence[str] = (),
    measured: SetLike | None = None,
    trials: int = 12,
    free: Sequence[str] = (),
    samples: int = 32,
    seconds: float | None = None,
    seed: int = 1,
    grid: int | None = None,
    force: bool = False,
    progress: Progress = unheard,
    say: Say = warn,
    cluster: str | None = None,
    **keys: Any,
) -> Unseen:
    """Shapes of a design that is not sewn yet, with intervals, and which measurement would narrow them; or designs of a
    measured set, each left out in turn.

    design: with a `model` that has a covariance; or, with neither model nor set, the file of a study of kind `unseen`.
    pressures: kPa, a row a pose. outputs: of each shape, in words (docs/sensitivity.md). measured: a set of two designs
    or more, of which at most so many `trials` of each are evaluated; free: effects fitted to the others, as
    `calibrate --free` takes them. samples: models drawn. grid: points a side, by default the model's. keys: further
    ones of a study (docs/files.md), such as `candidates`, `rig_limits`, `rise`, `hold`. out: the folder for what the
    command writes, and to go on in.
    """
    from fabdesign.unseen_file import read_unseen
    from studies.unseen.run import run_unseen

    if model is None and measured is None:
        study: Any = study_file(design)
        where = study
    else:
        if (design is None) != (model is None):
            raise InputError("unseen: a design or a model alone; expected both, or neither beside measured")
        root: dict[str, Any] = {"samples": samples, "seed": seed, "outputs": [*outputs], **keys}
        root |= {} if pressures is None else {"pressures": pressures}
        root |= {} if grid is None else {"points_per_side": grid}
        root |= (
            {} if measured is None else {"measured": {"set": all_sets(measured)[0], "trials": trials, "free": [*free]}}
        )
        root |= {} if design is None else {"design": one_design(design), "model": one_model(model, say=say)}
        study, where = read_unseen(root), None
    with work_folder(out) as folder, computing(cluster, where, say=say):
        result = run_unseen(
            study,
            folder,
            seconds=seconds,
            force=force,
            progress=progress,
        )
    return Unseen(result)
