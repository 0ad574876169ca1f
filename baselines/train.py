"""Forwards to `maniskill-grpd train`."""

from maniskill_grpd.commands import forward

if __name__ == "__main__":
    forward("train")
