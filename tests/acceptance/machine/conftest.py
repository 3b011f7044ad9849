"""The tests of `guest/` run in the machine only."""

collect_ignore = ["guest"]
