"""Writes deploy/requirements.txt: what nufleet needs on each machine, with the hash of every file.

    python deploy/lock.py

The versions are those of constraints.txt. pip chooses the files for the platforms below and takes
their hashes from the package index; nothing is installed.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
EXTRAS = ("repository", "logs")
PLATFORMS = ("x86_64", "aarch64")
PYTHONS = ("3.11", "3.12", "3.13")
HEADER = """\
# Made by `python deploy/lock.py` from constraints.txt, for Linux on x86_64 and aarch64:
#   pip install --require-hashes -r deploy/requirements.txt
#   pip install --no-deps --no-build-isolation .
"""


def needed() -> list[str]:
    """Return the requirements of the product and of its build."""
    document = tomllib.loads((ROOT / "pyproject.toml").read_text())
    project = document["project"]
    optional = [one for extra in EXTRAS for one in project["optional-dependencies"][extra]]
    return [*project["dependencies"], *optional, *document["build-system"]["requires"]]


def chosen(platform: str, python: str) -> list[dict[str, Any]]:
    """Return pip's report of the files that it would install."""
    tags = [f"manylinux_2_{minor}_{platform}" for minor in (39, 35, 34, 31, 28, 27, 26, 24, 17)]
    tags.append(f"manylinux2014_{platform}")
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder, "report.json")
        command = [sys.executable, "-m", "pip", "install", "--quiet", "--dry-run"]
        command += ["--ignore-installed", "--only-binary", ":all:", "--target", folder]
        command += [part for tag in tags for part in ("--platform", tag)]
        command += ["--python-version", python, "--report", str(report)]
        # From the public index alone: a local one may hold files of its own.
        environment = {**os.environ, "PIP_CONFIG_FILE": os.devnull}
        command += ["-c", str(ROOT / "constraints.txt"), *needed()]
        subprocess.run(command, check=True, env=environment)
        found: list[dict[str, Any]] = json.loads(report.read_text())["install"]
        return found


def main() -> None:
    """Write the requirements."""
    hashes: dict[str, set[str]] = {}
    for platform in PLATFORMS:
        for python in PYTHONS:
            for file in chosen(platform, python):
                known = f"{file['metadata']['name']}=={file['metadata']['version']}"
                digest = file["download_info"]["archive_info"]["hashes"]["sha256"]
                hashes.setdefault(known, set()).add(digest)
    lines = [
        " \\\n    ".join([known, *(f"--hash=sha256:{one}" for one in sorted(hashes[known]))])
        for known in sorted(hashes, key=str.lower)
    ]
    (ROOT / "deploy" / "requirements.txt").write_text(HEADER + "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
