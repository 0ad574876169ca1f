"""Forwards to `maniskill-grpd demo`."""

from maniskill_grpd.commands import forward

if __name__ == "__main__":
    forward("demo")
