"""What an installation lacks, and how to bring it: the program is on no package index."""

from __future__ import annotations


def needs(what: str, package: str, extra: str) -> str:
    """A sentence: `what` needs `package`, which `extra` of this program brings."""
    return f"{what} needs {package}: {how_to_bring(extra)}"


def how_to_bring(extra: str) -> str:
    """The commands: where it is installed as a service, and in the folder of the sources."""
    option = "" if extra == "hardware" else f" --with {extra}"
    return f'`systemd/install.sh{option} WHEEL` as root, or `pip install ".[{extra}]"` in the sources'
