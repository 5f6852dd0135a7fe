"""The evaluations of a search as a store of Optuna studies, which its dashboard opens and its functions analyse.

    optuna-dashboard sqlite:///search.db

A search of one design is a study of the folder's name; a grid of layouts has a study a cell. What a layout varies, x_0
and so on, is 0 to 1 within its bounds. The only file that knows Optuna, the extra `optuna`.
"""

from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

from fabdesign.errors import InputError
from studies.evaluations_table import OBJECTIVE, EvaluationsTable


def write_optuna_store(table: EvaluationsTable, path: Path, name: str) -> None:
    """Write a SQLite file. name: of a study that is the only one. Raises InputError for what has no objective."""
    if OBJECTIVE not in table.columns:
        raise InputError(f"{name}: has no {OBJECTIVE}; expected the folder of a search for an Optuna store")
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    storage = optuna.storages.RDBStorage(f"sqlite:///{path}")
    try:
        rows = [dict(zip(table.columns, row, strict=True)) for row in table.rows]
        for part, own in groupby(rows, key=lambda row: row["part"]):
            study = optuna.create_study(storage=storage, study_name=name if part == "." else part, direction="minimize")
            study.set_user_attr("objective", OBJECTIVE)
            study.add_trials([*_trials(own)])
    finally:
        storage.engine.dispose()


def _trials(rows: Iterator[dict[str, Any]]) -> Iterator[Any]:
    """One that diverged is a failed trial, without a value."""
    import optuna

    for row in rows:
        x = {key: value for key, value in row.items() if key.startswith("x_") and value is not None}
        yield optuna.trial.create_trial(
            state=optuna.trial.TrialState.FAIL if row["diverged"] else optuna.trial.TrialState.COMPLETE,
            value=row[OBJECTIVE],
            params=x,
            distributions=dict.fromkeys(x, optuna.distributions.FloatDistribution(0.0, 1.0)),
            user_attrs={key: row[key] for key in ("evaluation", "seconds", "stage")},
        )
