"""Forwards to `maniskill-grpd plan`."""

from maniskill_grpd.commands import forward

if __name__ == "__main__":
    forward("plan")
