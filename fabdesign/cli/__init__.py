"""The command line. Each command parses, calls one function and prints; heavy imports stay inside the commands."""

import sys

import click

from fabdesign.cli import files, measurements, motions, searches  # noqa: F401 their commands join the group
from fabdesign.cli.console import commands
from fabdesign.errors import InputError, SimulationError

_EXTRAS = {"open3d": "clouds", "trimesh": "mesh", "numba": "rig", "ezdxf": "dxf"}


def main() -> None:
    """Run the command line: exit 0 on success, 2 on bad input and 1 on other failures, each with one line."""
    try:
        commands.main(prog_name="fabdesign", standalone_mode=False)
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        sys.exit(2)
    except click.ClickException as error:
        _fail(error.format_message(), error.exit_code)
    except InputError as error:
        _fail(str(error), 2)
    except SimulationError as error:
        _fail(str(error), 1)
    except ModuleNotFoundError as error:
        if error.name not in _EXTRAS:
            raise
        _fail(f"needs {error.name}; install it with: pip install 'fabdesign[{_EXTRAS[error.name]}]'", 1)
    except click.exceptions.Abort:
        _fail("interrupted", 130)


def _fail(message: str, code: int) -> None:
    click.echo(f"fabdesign: {' '.join(message.split())}", err=True)
    sys.exit(code)
