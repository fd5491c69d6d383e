"""`python -m nufleet`: the command line, where no script is installed."""

from nufleet.shared.command_line import main

if __name__ == "__main__":
    main()
