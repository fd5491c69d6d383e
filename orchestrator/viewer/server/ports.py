"""The default ports under which a running study can be watched."""

from __future__ import annotations

GRPC_PORT = 9876
"""Port for native viewers, Rerun's own default."""

WEB_PORT = 9090
"""Port of the page for browsers."""
