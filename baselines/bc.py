"""Forwards to `maniskill-grpd clone`."""

from maniskill_grpd.commands import forward

if __name__ == "__main__":
    forward("clone")
