"""What the commands that run a study share."""

from collections.abc import Callable
from typing import Any

import click

from fabdesign.cli.console import FILE, SECONDS, force_option, json_option
from fabdesign.cli.machines import cluster_option
from fabdesign.cli.models import effects_option

Command = Callable[..., None]


def study_options(seconds: str) -> Callable[[Command], Command]:
    """STUDY, -o, --effects, --cluster, --seconds, --force and --json, in this order. seconds: what they limit."""
    options: tuple[Callable[[Any], Any], ...] = (
        click.argument("study", type=FILE),
        click.option("-o", "--output", type=FILE, required=True, help="Folder to write to, or to continue in."),
        effects_option,
        cluster_option,
        click.option("--seconds", type=SECONDS, help=seconds),
        force_option,
        json_option,
    )

    def add(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return add
