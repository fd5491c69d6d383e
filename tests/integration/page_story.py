"""Does what a page tells its reader to type, in the order of the page and in one folder."""

from __future__ import annotations

import io
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import pytest
from command_processes import begun
from page_blocks import ROOT, Block, blocks, difference
from polling import PATIENCE_S

from nufleet.shared import command_line

SERVING = {("fleet", "up"): "are up", ("router",): "listening", ("agent",): "serving"}
"""Commands that serve until they are interrupted, and what they say when they do."""
_LINKED = re.compile(r"\]\(([\w./-]+\.(?:svg|csv))\)")


@dataclass(frozen=True)
class Printed:
    """What a command printed."""

    out: str
    """Its results, on stdout."""
    shown: str
    """What a terminal shows: stdout and stderr, in their order."""


class Story:
    """The folder of a reader, and the terminals in which commands serve meanwhile.

    Commands run in this process, with `NUFLEET_ROUTER` and `NUFLEET_LISTEN` instead of the usual
    port; those that serve run as processes until the story ends.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.endpoint = f"unixsock-stream/{folder}/r.sock"
        self._serving = ExitStack()

    def __enter__(self) -> Story:
        return self

    def __exit__(self, *error: object) -> None:
        self._serving.close()

    def follow(self, page: str) -> str:
        """Run the blocks of a page and compare what they print with what it shows.

        Returns:
            All that was printed.
        """
        path, shown, everything = ROOT / page, "", ""
        for linked in _LINKED.findall(path.read_text(encoding="utf-8")):
            shutil.copy(path.parent / linked, self.folder)
        with self._terminal() as terminal:
            for block in blocks(path):
                if block.note.startswith("file: "):
                    (self.folder / block.note.removeprefix("file: ")).write_text(block.code)
                elif block.note == "printed":
                    _compare(block, shown)
                elif block.is_run:
                    typed = block.commands
                    if block.note:
                        typed = [block.note.removeprefix("printed by ")]
                    shown = "".join(self._type(terminal, command) for command in typed)
                    if block.language == "python":
                        shown = _python(block.code)
                    everything += shown
                    if block.note:
                        _compare(block, shown)
        return everything

    def type(self, command: str) -> str:
        """Type one line, as a page's are; return all that it printed."""
        with self._terminal() as terminal:
            return self._type(terminal, command)

    def nufleet(self, *words: str) -> Printed:
        """Run one command, which has to succeed."""
        with self._terminal():
            return _run(words)

    @contextmanager
    def _terminal(self) -> Iterator[pytest.MonkeyPatch]:
        """This process in the folder of the reader, in a terminal 80 columns wide."""
        handlers = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)}
        with pytest.MonkeyPatch.context() as terminal:
            for name, value in (
                *(("COLUMNS", "80"), ("HOME", self.folder), ("XDG_CONFIG_HOME", "")),
                *(("NUFLEET_ROUTER", self.endpoint), ("NUFLEET_LISTEN", self.endpoint)),
                ("NUFLEET_STATE", self.folder / "state"),
            ):
                terminal.setenv(name, str(value))
            terminal.chdir(self.folder)
            try:
                yield terminal
            finally:
                for number, handler in handlers.items():
                    signal.signal(number, handler)

    def _type(self, terminal: pytest.MonkeyPatch, command: str) -> str:
        program, *words = map(os.path.expanduser, shlex.split(command))
        match program, *words:
            case "cp", source, destination:
                shutil.copy(source, destination)
                return ""
            case "pip", "install", "-e", package:
                return self._install(terminal, package)
            case "nufleet", *_:
                for serving, sign in SERVING.items():
                    if tuple(words[: len(serving)]) == serving:
                        return self._serve(words, sign)
                return _run(words).shown
        raise AssertionError(f"a test cannot run {command!r}")

    def _install(self, terminal: pytest.MonkeyPatch, package: str) -> str:
        """Install a package for this page alone, where its own processes find it, too."""
        site = self.folder / "site"
        pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps"]
        build = ["--no-build-isolation", "--target", str(site), str(Path(package).resolve())]
        subprocess.run([*pip, *build], check=True, timeout=PATIENCE_S)
        terminal.syspath_prepend(site)
        terminal.setenv("PYTHONPATH", str(site), prepend=os.pathsep)
        return ""

    def _serve(self, words: list[str], sign: str) -> str:
        served = begun(*words, cwd=self.folder)
        assert served.stderr is not None
        self._serving.callback(served.communicate, timeout=PATIENCE_S)
        self._serving.callback(served.send_signal, signal.SIGINT)
        said = ""
        while sign not in said:
            line = served.stderr.readline()
            assert line, f"nufleet {shlex.join(words)} ended: {said}"
            said += line
        return said


def _compare(block: Block, shown: str) -> None:
    drift = difference(block.code, shown)
    assert drift is None, f"{block.page}: {drift}"


def _python(code: str) -> str:
    shown = io.StringIO()
    with redirect_stdout(shown), redirect_stderr(shown):
        exec(code, {"__name__": "__main__"})  # noqa: S102 - the page's own
    return shown.getvalue()


class _Copied(io.StringIO):
    """A stream that is written to another one, too."""

    def __init__(self, other: io.StringIO) -> None:
        super().__init__()
        self._other = other

    def write(self, text: str) -> int:
        self._other.write(text)
        return super().write(text)


def _run(words: tuple[str, ...] | list[str]) -> Printed:
    shown = io.StringIO()
    out = _Copied(shown)
    with pytest.MonkeyPatch.context() as typed, redirect_stdout(out), redirect_stderr(shown):
        typed.setattr(sys, "argv", ["nufleet", *words])
        with pytest.raises(SystemExit) as ended:
            command_line.main()
    assert ended.value.code == 0, f"nufleet {shlex.join(words)}: {shown.getvalue()}"
    return Printed(out.getvalue(), shown.getvalue())
