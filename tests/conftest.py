"""What has to be in the environment before any test module is imported."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Generator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from lifeline import Lifeline
from purity import is_pure

from nufleet.sims.quadrotors.environment import environment

# What the simulated quadrotors need from the start of their process, such as SciPy's array
# interface, which SciPy reads when it is first imported.
os.environ.update(environment())

# Killed outright, a run of the tests leaves no process and no file either.
_LIFELINE = Lifeline()

# What agents started here remember must neither come from nor go to the user's own fleets.
os.environ["NUFLEET_STATE"] = str(_LIFELINE.folder / "state")

# Small matrices, many of them: with threads, BLAS takes ten times as long on a busy machine.
os.environ["OPENBLAS_NUM_THREADS"] = "1"

# Where Python may not keep what it compiles, as in many containers, every process compiles all of
# nufleet again, which is a third of what starting an agent costs.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# Started in the background of a script, a process ignores Ctrl-C, and so do all that it starts;
# tests interrupt some of those.
signal.signal(signal.SIGINT, signal.default_int_handler)

# A busy machine is no failure: how long one example takes is not what these tests are about.
# Continuous integration tries the same examples each time, so that a change is judged by what it
# changes; at a desk every run tries new ones.
settings.register_profile(
    "nufleet",
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
    print_blob=True,
    derandomize="CI" in os.environ,
)
settings.register_profile("quick", settings.get_profile("nufleet"), max_examples=20)
settings.load_profile("nufleet")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Offer the tests that `make check` runs."""
    words = "only tests that start no process, open no connection and run no foreign simulator"
    parser.addoption("--pure", action="store_true", help=words)


def pytest_configure(config: pytest.Config) -> None:
    """Try fewer examples in the quick check."""
    if config.getoption("pure"):
        settings.load_profile("quick")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Pass over the others without importing them."""
    if config.getoption("pure") and collection_path.match("test_*.py"):
        return not is_pure(collection_path) or None
    return None


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Let reports of drivers that raise text which is no UTF-8 pass between processes."""
    report = yield
    report.sections = [
        (name, text.encode(errors="replace").decode()) for name, text in report.sections
    ]
    return report
