"""A corrector that learns what the simulator leaves out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Unpack

from fabdesign.interface.fits import unknowns_of
from fabdesign.interface.run import Run, all_sets, paths_of, simulator
from fabdesign.interface.verb import Computing, Shown, verb
from fabdesign.units import in_mm

if TYPE_CHECKING:
    from fabdesign.interface.verb import ModelLike, SetLike, Toml
    from studies.training.train import HeldOutErrors, TrainingResult


def _trained(result: TrainingResult, given: Mapping[str, Any]) -> Shown:
    out = Path(given["out"])
    content = {"model": str(out), "weights": str(out.with_suffix(".safetensors")), "skipped": [*result.skipped]}
    text = [f"{out}: {_in_words(result)}", *(f"skipped: {line}" for line in result.skipped)]
    return Shown(result.to_json() | content, "\n".join(text))


def _in_words(result: TrainingResult) -> str:
    """Return lines for a person: what was learned from what, and what it is worth on trials that took no part."""
    lines = [
        f"{result.about['network']} corrector on {result.base}, {result.learned_from} trials learned from"
        + ("" if result.held_out else "; no trial was held out, so nothing says what it is worth")
    ]
    lines += [_line(name, of, ordered=result.about["network"] == "field") for name, of in result.held_out.items()]
    for one in result.about["left_out"]:
        lines.append(
            f"design {one['design']} left out: {one['before_mm']:.2f} to {one['after_mm']:.2f} mm along the normal, "
            f"at a distance of {one['distance']:.2f}"
        )
    if result.about["network"] == "field":
        lines.append(
            f"designs farther than {result.about['trust_limit']:.2f} from those learned from are not corrected"
        )
    lines.append(result.intervals)
    if result.used.stretches is not None:
        lines.append(result.used.in_words)
    return "\n".join(lines)


def _line(name: str, of: HeldOutErrors, *, ordered: bool) -> str:
    before, after = of.before, of.after
    trials = f"{of.trials} trial{'s' * (of.trials != 1)} of {name} held out"
    if not ordered:
        return (
            f"{trials}: Chamfer {in_mm(before.chamfer):.2f} to {in_mm(after.chamfer):.2f} mm (floor "
            f"{in_mm(before.chamfer_floor):.2f})"
        )
    share = "" if of.closed.surface is None else f", {of.closed.surface:.0%} of the excess error removed"
    far = "" if of.trust.applies else f"; {of.trust.distance:.2f} from what was learned, too far: not corrected"
    sheet = "" if of.sheet is None else f"data sheet {in_mm(of.sheet.surface_rms):.2f}, base and corrector "
    return (
        f"{trials}: surface RMS {sheet}{in_mm(before.surface_rms):.2f} to {in_mm(after.surface_rms):.2f} mm (floor "
        f"{in_mm(after.surface_floor):.2f}){share}{far}"
    )


@verb(_trained, "SETS...", title="training")
def train(
    measured: SetLike | Sequence[SetLike],
    out: Toml,
    *,
    network: Literal["field", "paper"] = "field",
    hold_out: Sequence[str] = (),
    model: ModelLike | None = None,
    free: Sequence[str] = (),
    skip_bad: bool = False,
    seed: int = 0,
    grid: int | None = None,
    **given: Unpack[Computing],
) -> TrainingResult:
    """Train a corrector on measured SETS.

    The corrector learns what the simulator leaves out. The same command continues after a stop.

    out: The model to write (TOML); its weights are written beside it.
    network: field: moves the points of the simulator; paper: the network of Peng et al., which gives an unordered
        cloud.
    hold_out: A design whose trials are not used for training.
    model: A model file with the parameters of the motions; by default the data sheet.
    free: Effects to fit before the training, with the declared parameters and to the same trials, as with
        `calibrate --free`; all: the strengths of every effect.

    The network of the paper needs the extra `corrector`. After Ctrl-C the same call goes on.
    """
    if network == "paper":
        import corrector.paper_training  # noqa: F401 loads PyTorch: without it nothing is begun
    from fabdesign.nouns.model import Model
    from fabdesign.output import new_files
    from fabdesign.runtime.effort import CALIBRATION, fit_seconds, in_words, on_cores, training_seconds
    from studies.measured.sensitive_stretches import GRID as COARSE
    from studies.training.data import TrainingOptions
    from studies.training.train import train as train_on

    run, out = Run(**given), Path(out)
    base = run.model(model) or Model()
    sets, skipped = run.sound(all_sets(measured), skip_bad)
    base = replace(base, points_per_side=grid or base.points_per_side)
    vector = unknowns_of(free, (), base, sets) if free else None
    beside = out.with_suffix(".safetensors").name
    places = new_files(out, companions=[beside], force=run.force, inputs=paths_of(measured, model))
    motion = [float(t.times[-1]) for one in sets for t in one.trials if t.role == "fit"]
    seconds = training_seconds(motion)
    if vector is not None:
        seconds += fit_seconds(CALIBRATION, motion, len(vector.parameters), base.points_per_side)
    # how long the paper's takes is its plan's
    estimate = in_words(seconds, f"{len(motion)} trials", on_cores()) if motion and network == "field" else None
    show = run.opened(lambda: estimate)
    with places as unfinished, run.computing():
        options = TrainingOptions(
            base=base,
            vector=vector,
            slopes=simulator(min(base.points_per_side, COARSE)),
            network=network,
            hold_out=hold_out,
            seed=seed,
            coarse=simulator(COARSE),
        )
        result = train_on(
            sets,
            simulator(base.points_per_side),
            unfinished,
            options,
            goes_to=out,
            force=run.force,
            progress=lambda what, done, of: show(f"{what} {done} of {of}", done / of),
        )
    return replace(result, skipped=tuple(skipped))
