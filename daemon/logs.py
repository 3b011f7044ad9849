"""Log lines: entries with fields in the journal of systemd, else lines on standard error for people."""

from __future__ import annotations

import logging
import sys

from daemon.service import journal


def configure_logging(*, verbose: bool) -> None:
    """Log to the journal if standard error goes there, which adds its own times; else to standard error."""
    handler: logging.Handler
    if journal.is_ours():
        handler = journal.JournalHandler()
        form = "%(message)s"
    else:
        handler = logging.StreamHandler(sys.stderr)
        form = "%(asctime)s %(levelname)s %(message)s"
    handler.setFormatter(logging.Formatter(form))
    logging.basicConfig(handlers=[handler], level=logging.DEBUG if verbose else logging.INFO)
    # python-can tells at INFO what we tell better, and once.
    logging.getLogger("can").setLevel(logging.WARNING)
    logging.getLogger("asyncio").setLevel(logging.WARNING)
