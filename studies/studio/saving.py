"""What the studio writes: a folder with the design, its pressures, a study and templates, which other commands take."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fabdesign.design_file import write_design
from fabdesign.errors import InputError
from fabdesign.forward import RISE
from fabdesign.output import new_folder, read_mark
from fabdesign.pressure import rising_program
from fabdesign.pressure_file import pressure_file_of, write_pressures
from fabdesign.sewing import export_design
from optimize.margins import Limits
from studies.studio.autosave import content_hash
from studies.studio.layout import Layout
from studies.studio.searching import study_document
from studies.studio.target import ShownTarget

SETTLED = 2.0  # s of the motion in pressures.csv after its rise


@dataclass(frozen=True)
class Saved:
    """The files, and what could not be made and why."""

    files: tuple[Path, ...]
    left_out: tuple[str, ...]


class Saving:
    """Saves into one folder, `design.toml` and all that goes with it; knows what it has put there itself."""

    def __init__(self) -> None:
        self._own: dict[Path, str | None] = {}  # folder -> hash of the design last written there

    def replaces(self, folder: Path) -> str | None:
        """Why a person should be asked before `folder` is replaced, in words; None where nothing would be lost."""
        mark, design = read_mark(folder), folder / "design.toml"
        if mark is None or not design.exists():
            return None  # nothing there, or what `new_folder` refuses anyway
        key = folder.resolve()
        if key not in self._own:
            return f"{folder} holds an earlier design"
        if self._own[key] != content_hash(design):
            return f"{design} was changed by another program since it was saved"
        return None

    def save(
        self,
        layout: Layout,
        folder: Path,
        *,
        targets: Sequence[ShownTarget] = (),
        poses: Sequence[tuple[float, ...]] = (),
        limits: Limits,
        model: Path | None,
        replace: bool = False,
    ) -> Saved:
        """Write `design.toml`, `pressures.csv`, with a target `study.toml`, and `template/`.

        poses: the pressures [Pa] of each of several targets; by default the layout's.
        replace: what stands in the folder, if this program made it. Raises InputError for another folder that is not
        empty, and where the folder would have to be replaced.
        """
        left_out: list[str] = []
        reason = self.replaces(folder)
        if reason is not None and not replace:
            raise InputError(f"{reason}; expected another folder, or leave to replace it")
        with new_folder(folder, made_by="studio", force=True) as unfinished:
            write_design(layout.design, unfinished / "design.toml")
            if layout.pressures:
                rows = poses or [layout.pressures]
                for pose, pressures in enumerate(rows, start=1):
                    program = rising_program(np.array(pressures), RISE, RISE + SETTLED)
                    write_pressures(program, unfinished / pressure_file_of(pose))
            if targets:
                text = study_document(
                    layout, targets, limits, vary="pressures and positions", seconds=600, model=model, beside=folder
                )
                (unfinished / "study.toml").write_text(text, encoding="utf-8", newline="\n")
            left_out += _template(layout, unfinished)
            names = sorted(p.relative_to(unfinished) for p in unfinished.rglob("*") if p.is_file())
        self._own[folder.resolve()] = content_hash(folder / "design.toml")
        return Saved(tuple(folder / name for name in names if not name.name.startswith(".")), tuple(left_out))


def save_template(layout: Layout, folder: Path, *, replace: bool) -> Saved:
    """Write what `fabdesign export` does into a folder. Raises InputError like it."""
    made = export_design(layout.design, folder, stem="design", tail_length=_tail(layout), force=replace)
    return Saved(made.files, made.left_out)


def _template(layout: Layout, folder: Path) -> list[str]:
    """Write the templates into `folder`/template; what is left out, and why."""
    if not layout.design.muscles:
        return ["no template: the design has no muscles"]
    try:
        return list(save_template(layout, folder / "template", replace=False).left_out)
    except InputError as error:
        return [f"no template: {error}"]


def _tail(layout: Layout) -> float | None:
    """m: 30 mm where a muscle type in use says nothing."""
    kinds = [layout.design.muscle_types[muscle.type] for muscle in layout.design.muscles]
    return 0.03 if any(kind.tail_length is None for kind in kinds) else None
