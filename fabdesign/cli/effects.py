"""What effects there are."""

import click

from fabdesign.cli.console import commands, json_option, print_result
from fabdesign.cli.models import effects_option


@commands.command()
@click.argument("name", required=False)
@effects_option
@json_option
def effects(name: str | None, as_json: bool) -> None:
    """List the effects that a model can have, or describe one: parameters, units, priors, what data show."""
    from fabdesign.effects import EFFECTS
    from fabdesign.effects.registry import effect_named, register_installed
    from fabdesign.effects.table import as_json as json_of
    from fabdesign.effects.table import as_text, one_as_text

    register_installed()
    if name is None:
        print_result({"effects": json_of(EFFECTS)}, as_text(EFFECTS), as_json)
        return
    found = effect_named(name, "effects")
    print_result({"effects": json_of({name: found})}, one_as_text(found), as_json)
