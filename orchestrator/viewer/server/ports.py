"""Where a running study can be watched, unless it is told otherwise."""

from __future__ import annotations

GRPC_PORT = 9876
"""Native viewers connect here; Rerun's own default."""

WEB_PORT = 9090
"""The page for browsers."""
