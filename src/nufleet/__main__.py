"""The `nufleet` command. A stop gets in front of all other programs before anything is loaded."""

import sys
from typing import NoReturn

from nufleet.shared.urgency import urgent


def main() -> NoReturn:
    """Run the command line and exit with its code."""
    # Most of the time from a person's command to the stop goes into loading, on a busy machine.
    if next((word for word in sys.argv[1:] if not word.startswith("-")), None) == "stop":
        urgent(True)
    from nufleet.shared.command_line import main as run

    run()


if __name__ == "__main__":
    main()
