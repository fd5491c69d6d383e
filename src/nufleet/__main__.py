"""The `nufleet` command. A stop gets in front of all other programs before anything is loaded."""

import sys
from typing import NoReturn


def main() -> NoReturn:
    """Run the command line and exit with its code."""
    try:
        from nufleet.shared.urgency import urgent

        # On a busy machine most of the time from a person's command to the stop goes into loading.
        if next((word for word in sys.argv[1:] if not word.startswith("-")), None) == "stop":
            urgent(True)
        from nufleet.shared.command_line import main as run
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        sys.exit(130)
    run()


if __name__ == "__main__":
    main()
