"""Forwards to `maniskill-grpd play`."""

from maniskill_grpd.commands import forward

if __name__ == "__main__":
    forward("play")
