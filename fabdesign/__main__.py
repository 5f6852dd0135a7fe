"""The program: the console script and `python -m fabdesign`. Nothing heavy is loaded before signals are answered."""

from fabdesign.supervisor import supervised


def main() -> None:
    """Run the command line in a child process of this one."""
    supervised(_command_line, _give_up)


def _command_line() -> None:
    from fabdesign.cli import main

    main()


def _give_up(records: list[dict[str, object]]) -> list[str]:
    from fabdesign.output import given_up

    return given_up(records)


if __name__ == "__main__":
    main()
