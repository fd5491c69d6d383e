"""The work of `nufleet router`."""

from __future__ import annotations

import threading
from pathlib import Path

import click

from nufleet.shared.lifeline import when_stdin_closes
from nufleet.shared.wire.openness import check_closed
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
    opening = (
        open_router(
            [
                check_closed(at, allow_open=allow_open, anonymous=True)
                for at in endpoints or (DEFAULT_ENDPOINT,)
            ],
            connect=[check_closed(at, allow_open=allow_open) for at in others],
        )
        if configuration is None
        else open_configured_router(configuration, allow_open=allow_open)
    )
    with opening as session:
        click.echo(f"router listening on {', '.join(session.listening_on())}", err=True)
        ended.wait()
