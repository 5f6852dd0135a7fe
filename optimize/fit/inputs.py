"""What a trial's inputs are good to, and what errors of them do to the residuals."""

from dataclasses import dataclass, replace

import numpy as np

from fabdesign.nouns.forward import Case, Term
from fabdesign.nouns.trial import Accuracy, Trial
from optimize.fit.clouds import Array, frames_of
from optimize.fit.problem import Evaluation, FitProblem

_PATTERNS = 2  # of signs, of all inputs together, whose two sides say what is not proportional


@dataclass(frozen=True, eq=False)
class InputErrors:
    """What errors of the inputs do to the residuals at a state. columns: (N, k) m, by a standard deviation of each
    input. bent: (N,) m RMS of the point's frame, what errors to either side do that is not proportional: where they
    lead to another shape, that is all there is."""

    columns: Array
    bent: Array


def input_errors(problem: FitProblem, evaluation: Evaluation, accuracy: Accuracy) -> InputErrors:
    """By a motion for each channel of the trials and each axis of the frame's tilt, and two sides of two patterns."""
    channels = max(s.trial.program.pressure.shape[1] for s in problem.samples)
    single = [*np.eye(channels + 2)]
    rng = np.random.default_rng(0)
    patterns = [rng.choice([-1.0, 1.0], channels + 2) for _ in range(_PATTERNS)]
    rows = [*single, *(sign * pattern for pattern in patterns for sign in (1.0, -1.0))]
    changed = problem.differences(
        evaluation, [[_changed(problem, s.trial, evaluation.x, row, accuracy) for s in problem.samples] for row in rows]
    )
    ends = changed[:, channels + 2 :].reshape(len(changed), _PATTERNS, 2)
    bent = np.sqrt(np.square(0.5 * ends.sum(axis=2)).mean(axis=1))
    frame, groups = frames_of(evaluation.found)
    by_frame = np.array([np.sqrt(np.square(bent[points]).mean()) for points in groups])
    return InputErrors(changed[:, : channels + 2], by_frame[frame])


def _changed(problem: FitProblem, trial: Trial, x: Array, deviations: Array, accuracy: Accuracy) -> Case:
    """deviations: (channels + 2,), in standard deviations: of the pressures, then of the tilt about x and z."""
    case = problem.vector.case(trial, x)
    own = case.program.pressure.shape[1]
    program = replace(case.program, pressure=case.program.pressure * (1 + accuracy.pressure * deviations[:own]))
    if not deviations[-2:].any():
        return replace(case, program=program)
    about_x, about_z = (accuracy.tilt * deviations[-2:]).tolist()
    level = Term("frame_tilt", {"about_x": about_x, "about_z": about_z})
    return replace(case, program=program, effects=(*case.effects, level))
