"""Forwards to `maniskill-grpd evaluate`."""

from maniskill_grpd.commands import forward

if __name__ == "__main__":
    forward("evaluate")
