"""Forwards to `maniskill-grpd study`."""

from maniskill_grpd.commands import forward

if __name__ == "__main__":
    forward("study")
