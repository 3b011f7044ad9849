"""The commands, one module each: HELP, EXAMPLE, `configure(parser)` and `run(arguments) -> exit code`."""
