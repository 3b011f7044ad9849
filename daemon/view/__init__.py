"""The live page: a process of its own between the daemon's Unix socket and browsers."""
