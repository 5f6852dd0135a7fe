"""Where the batches of a command are computed."""

from pathlib import Path

import click


def _connect(context: click.Context, parameter: click.Parameter, address: str | None) -> None:
    from fabdesign.cli.console import tell
    from fabdesign.cluster import on_cluster

    study: Path | None = context.params.get("study")
    if address is None and study is not None:
        from fabdesign.study_file import read_cluster

        address = read_cluster(study)
    context.with_resource(on_cluster(address, say=tell))


cluster_option = click.option(
    "--cluster", envvar="FABDESIGN_CLUSTER", show_envvar=True, metavar="ADDRESS", expose_value=False, callback=_connect,
    help="Dask scheduler whose workers compute; by default the study's, or this machine.",
)  # fmt: skip
