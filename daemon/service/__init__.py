"""The running daemon: event loop, health, viewers, systemd."""
