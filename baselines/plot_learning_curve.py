"""Forwards to `maniskill-grpd plot`."""

from maniskill_grpd.commands import forward

if __name__ == "__main__":
    forward("plot")
