"""The `nufleet` command. A stop gets in front of all other programs before anything is loaded."""

import os
import sys
from contextlib import suppress
from typing import NoReturn

FIRST = -20
"""Priority of what runs before all that is not urgent."""


def main() -> NoReturn:
    """Run the command line and exit with its code."""
    try:
        # On a busy machine most of the time from a person's command to the stop goes into loading.
        if next((word for word in sys.argv[1:] if not word.startswith("-")), None) == "stop":
            with suppress(PermissionError):  # most systems grant it to an administrator only
                os.setpriority(os.PRIO_PROCESS, 0, FIRST)
        from nufleet.shared.command_line import main as run
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        sys.exit(130)
    run()


if __name__ == "__main__":
    main()
