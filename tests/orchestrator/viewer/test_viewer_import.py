"""Who does not look pays nothing for the viewer."""

from __future__ import annotations

import subprocess
import sys


def test_the_viewer_is_imported_without_rerun() -> None:
    program = (
        "import sys\n"
        "from nufleet.orchestrator.viewer import events, writer\n"
        "from nufleet.orchestrator.viewer.server import picture, open as show\n"
        "writer.RerunWriter('run-1', recording=None, serve=None)\n"
        "sys.exit('rerun' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", program]).returncode == 0
