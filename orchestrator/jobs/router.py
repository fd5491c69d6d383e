"""The work of `nufleet router`."""

from __future__ import annotations

import threading
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path

import click

from nufleet.shared.lifeline import when_stdin_closes
from nufleet.shared.wire.openness import check_closed
from nufleet.shared.wire.routing import OpenRouter, route
from nufleet.shared.wire.session import Session
from nufleet.shared.wire.transport import DEFAULT_ENDPOINT, open_configured_router, open_router


def run_router(
    endpoints: tuple[str, ...],
    others: tuple[str, ...],
    configuration: Path | None,
    *,
    until_stdin_closes: bool,
    allow_open: bool,
) -> None:
    """Run a router until Ctrl-C.

    Args:
        endpoints: Endpoints to listen on; empty for the default one.
        others: Endpoints of other routers to link with, whenever they are there.
        configuration: File with a Zenoh configuration that takes the place of both.
        until_stdin_closes: Whether the router also ends when its standard input is closed.
        allow_open: Whether it may listen where every machine could command the robots.

    Raises:
        EndpointInUseError: The router cannot listen on an endpoint.
        InvalidInputError: The configuration cannot be used, or is open.
    """
    ended = threading.Event()
    if until_stdin_closes:
        when_stdin_closes(ended.set)
    if configuration is None:
        listen = [
            check_closed(at, allow_open=allow_open, anonymous=True)
            for at in endpoints or (DEFAULT_ENDPOINT,)
        ]
        connect = [check_closed(at, allow_open=allow_open) for at in others]
        opening: OpenRouter = partial(open_router, connect=connect)
    else:
        listen, connect = [], []
        opening = partial(_open_configured, configuration, allow_open=allow_open)
    route(opening, listen, ended, _say_open, links=bool(connect))


def _open_configured(
    configuration: Path, _listen: list[str], *, allow_open: bool
) -> AbstractContextManager[Session]:
    return open_configured_router(configuration, allow_open=allow_open)


def _say_open(endpoints: list[str]) -> None:
    click.echo(f"router listening on {', '.join(endpoints)}", err=True)
