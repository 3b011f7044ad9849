"""Log lines on standard error, as journald and people want them."""

from __future__ import annotations

import logging
import os
import sys


def configure_logging(*, verbose: bool) -> None:
    """Log to standard error; under systemd without times, which the journal adds itself."""
    under_systemd = "JOURNAL_STREAM" in os.environ
    form = "%(levelname)s %(name)s: %(message)s" if under_systemd else "%(asctime)s %(levelname)s %(message)s"
    logging.basicConfig(stream=sys.stderr, level=logging.DEBUG if verbose else logging.INFO, format=form)
    # python-can tells at INFO what we tell better, and once.
    logging.getLogger("can").setLevel(logging.WARNING)
    logging.getLogger("asyncio").setLevel(logging.WARNING)
