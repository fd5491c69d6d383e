"""Writes a package with a driver that works as it is, for an author to replace its robot."""

from __future__ import annotations

import keyword
import re
from importlib.util import find_spec
from pathlib import Path

from nufleet.shared.errors import InvalidInputError, system_errors_as
from nufleet.shared.robots.drivers import ENTRY_POINT_GROUP
from nufleet.shared.robots.installed import installed

TEMPLATES = Path(__file__).with_name("templates")
"""Folder with the files of the package; `NAME` stands for the driver's name in names and text."""


def write_package(name: str, folder: Path) -> None:
    """Write a package.

    Args:
        name: Name of its driver and of its Python module.
        folder: Folder to make; it must not exist, or be empty.

    Raises:
        InvalidInputError: The name cannot be a driver's, or the folder cannot be written.
    """
    if not re.fullmatch(r"[a-z][a-z0-9_]{0,62}", name):
        raise InvalidInputError(
            f"{name!r} cannot be the name of a driver: use lower-case letters, digits and _, "
            "and begin with a letter"
        )
    with system_errors_as(InvalidInputError, f"{folder}: cannot be written"):
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise InvalidInputError(f"{folder} exists already: give another --folder")
        if (
            keyword.iskeyword(name)
            or find_spec(name) is not None
            or name in installed(ENTRY_POINT_GROUP)
        ):
            raise InvalidInputError(
                f"{name!r} cannot be the name of a driver: Python, an installed package or an "
                "installed driver has this name; add something to it, as in my_drone"
            )
        for template in sorted(TEMPLATES.rglob("*.txt")):
            place = str(template.relative_to(TEMPLATES)).removesuffix(".txt")
            path = folder / place.replace("NAME", name)
            path.parent.mkdir(parents=True, exist_ok=True)
            text = template.read_text(encoding="utf-8").replace("NAME", name)
            path.write_text(text, encoding="utf-8")
