"""A fleet of real processes for each test; a process left over afterwards fails the test."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from child_processes import children_of

from benchmarks.faults.lab import Lab, opened_lab
from benchmarks.faults.program import wait_until


@pytest.fixture(autouse=True)
def _nothing_is_left_running() -> Iterator[None]:
    threads = set(threading.enumerate())
    children = set(children_of())
    yield
    wait_until(lambda: set(threading.enumerate()) <= threads)
    wait_until(lambda: set(children_of()) <= children)


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    with opened_lab(tmp_path) as lab:
        yield lab
