"""Forwards to `maniskill-grpd record`."""

from maniskill_grpd.commands import forward

if __name__ == "__main__":
    forward("record")
