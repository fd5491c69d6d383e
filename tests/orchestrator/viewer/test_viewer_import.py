"""Who does not look pays nothing for the viewer."""

from __future__ import annotations

import subprocess
import sys


def test_the_viewer_is_imported_without_rerun() -> None:
    program = (
        "import sys\n"
        "from orchestrator.viewer import events, picture, show, writer\n"
        "writer.RerunWriter('run-1', recording=None, serve=None)\n"
        "sys.exit('rerun' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", program]).returncode == 0
