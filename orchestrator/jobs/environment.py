"""The environment variables that set options of commands."""

ROUTER_VARIABLE = "NUFLEET_ROUTER"
RUNS_VARIABLE = "NUFLEET_RUNS"
REPOSITORY_VARIABLE = "NUFLEET_REPOSITORY"
