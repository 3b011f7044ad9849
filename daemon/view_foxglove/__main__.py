"""`python -m daemon.view_foxglove SOCKET`: the server by itself."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from daemon.errors import describe
from daemon.view_foxglove.server import PORT, serve

parser = argparse.ArgumentParser(description="The daemon behind SOCKET as a live source for Foxglove and Lichtblick.")
parser.add_argument("socket", type=Path)
parser.add_argument("--host", default="127.0.0.1")
parser.add_argument("--port", type=int, default=PORT)
arguments = parser.parse_args()
try:
    serve(arguments.socket, arguments.host, arguments.port, lambda url: print(url, file=sys.stderr, flush=True))
except Exception as error:
    described = describe(error)
    if described is None:
        raise
    print(*described[1], sep="\n", file=sys.stderr)
    sys.exit(described[0])
